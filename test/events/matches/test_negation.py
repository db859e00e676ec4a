"""Storage and expiration of negated events."""

import random
from typing import Any, List, Tuple

import pytest
from checked_access import stream_clock
from events.program_runner import ProgramRunner, outputs_of

from retalis import Engine
from retalis.events.matches.expiration import SLICE_ENTRIES
from retalis.events.matches.negation import NegationBuffer


def _negations(program: Any) -> List[Any]:
    (rule,) = program.engine.rules.rules
    return [
        negation
        for node in rule.nodes
        for negation in getattr(node, "negations", ())
        if isinstance(negation, NegationBuffer)
    ]


def test_keys_without_matches_are_removed() -> None:
    program = ProgramRunner("d(X) <- (a(X) seq b(X)) cnot c(X) within 5.")
    for number in range(3000):
        program.feed(f"c({number})@{number}")
    (negation,) = _negations(program)
    assert len(negation.buffer.newest) < 10
    assert len(negation.frontiers) < 1100
    assert program.feed("a(1)@3000 a(2)@3000 c(1)@3001 b(1)@3002 b(2)@3002") == "d(2)@3000-3002"


def test_nested_negation_uses_outer_variables() -> None:
    rule = "s(Y) <- (p(Y) seq b) cnot (x fnot q(Y))."
    assert outputs_of(rule, "p(1)@1 b@5") == "s(1)@1-5"
    assert outputs_of(rule, "p(1)@1 x@3 b@5") == ""
    assert outputs_of(rule, "p(1)@1 q(2)@2 x@3 b@5") == ""
    assert outputs_of(rule, "p(1)@1 q(1)@2 x@3 b@5") == "s(1)@1-5"
    rule = "s(Y) <- b(Y) fnot (x fnot q(Y))."
    assert outputs_of(rule, "b(1)@5") == "s(1)@5-5"
    assert outputs_of(rule, "x@3 b(1)@5") == ""
    assert outputs_of(rule, "q(2)@2 x@3 b(1)@5") == ""
    assert outputs_of(rule, "q(1)@2 x@3 b(1)@5") == "s(1)@5-5"


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("o(Y) <- a(Y) fnot (d fnot e(Y)).", "d@1 a(1)@2", ""),
        ("o(Y) <- a(Y) fnot (d fnot e(Y)).", "e(1)@1 d@2 a(1)@3 a(2)@4", "o(1)@3-3"),
        ("o(Y) <- (a(Y) seq b) cnot (d fnot e(Y)).", "e(1)@1 a(1)@2 d@3 b@4", "o(1)@2-4"),
        ("o(Y) <- (a(Y) seq b) cnot (d fnot e(Y)).", "e(1)@1 a(2)@2 d@3 b@4", ""),
        ("o(Y) <- b(Y) fnot ((c seq d) cnot e(Y)).", "c@1 e(1)@2 d@3 b(1)@4 b(2)@5", "o(1)@4-4"),
        ("o(Y) <- a(Y) fnot (d fnot (e fnot f(Y))).", "f(1)@1 e@2 d@3 a(1)@4 a(2)@5", "o(2)@5-5"),
        ("o(Y) <- x(Y) seq (a fnot (d fnot e(Y))).", "e(1)@1 d@2 x(1)@3 x(2)@4 a@5", "o(1)@3-5"),
        ("o(Y) <- a(Y) fnot (d fnot e(Y)).", "e(1)@1 d@2 a(_)@3", "o(A)@3-3"),
        (
            "o(X) <- a(X) fnot (s seq aggregate(count, (b(Y) where Y > X), N) where N > 1).",
            "s@1 b(3)@2 b(1)@3 a(0)@4 a(2)@5",
            "o(2)@5-5",
        ),
        (
            "o(X) <- a(X) fnot (s seq ((b(Y) fnot c(X, Y)) star_times)).",
            "c(1,2)@1 a(1)@2 s@3 a(1)@4",
            "o(1)@2-2",
        ),
    ],
)
def test_negated_pattern_uses_outer_variables(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(rule, stream, "chronological") == expected


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "c(1)@1 d@2 b(0)@3", "o(0)@2-3"),
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "c(1)@1 d@2 b(1)@3", ""),
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "d@1 c(1)@2 a(1)@3 b(1)@4", "o(1)@1-4"),
        ("o(X) <- b(X) seq (((a(X) or d) seq e) cnot c(X)).", "b(1)@1 b(2)@2 d@3 c(2)@4 e@5", "o(1)@1-5"),
        ("o(X) <- b(X) and ((s seq aggregate(sum(X), a(X), _)) cnot c(X)).", "c(1)@1 s@2 b(0)@3", "o(0)@2-3"),
    ],
)
def test_negation_is_tested_when_variables_are_bound(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(rule, stream) == expected


def test_negated_conditions_share_bindings() -> None:
    rule = "o(X) <- a(X) fnot ((b(Y) where Z = f(X, Y)) where (Z = f(A, B), A < B, X > 0))."
    assert outputs_of(rule, "b(1)@1 a(0)@2 b(2)@3 a(1)@4 a(3)@5") == "o(0)@2-2 o(3)@5-5"


@pytest.mark.parametrize(
    "rule",
    [
        "l([property(window, 6)]) : o <- (a seq b) cnot c.",
        "o <- ((a seq b) cnot c) within 7.",
        "o <- ((a seq b) within 7) cnot c.",
        "l([property(window, 6)]) : o <- ((a seq b) cnot c) fnot d.",
    ],
)
def test_negated_event_is_kept_for_late_partner(rule: str) -> None:
    """At the rule's time, 17, the window of c has ended; that of b, which may match a late partner, has not."""
    assert outputs_of(rule, "b@12-14 c@17 a@8", flags=["out_of_order"]) == "o@8-14"
    assert outputs_of(rule, "c@10 b@12-14 c@17 a@8", flags=["out_of_order"]) == ""


def test_negated_parts_are_kept_for_late_partner() -> None:
    rule = "o <- ((a seq b) cnot (c seq d)) within 7."
    assert outputs_of(rule, "c@10 b@14 c@18 d@12 a@8", "recent_2", ["out_of_order"]) == ""


def test_negated_event_is_kept_by_outer_bound() -> None:
    """The pair, which is too long for the outer bound, would consume b."""
    rule = "o <- (((a seq b) cnot c) seq d) within 5."
    assert outputs_of(rule, "c@2 b@9 c@12 a@1 a@8 d@10", flags=["out_of_order"]) == "o@8-10"


@pytest.mark.parametrize("flags", [(), ("out_of_order",)])
def test_negated_event_without_partner_expires(flags: Tuple[Any, ...]) -> None:
    program = ProgramRunner("o <- ((a seq b) cnot (c seq d)) within 5.", flags)
    for number in range(0, 1000, 2):
        program.feed(f"c@{number} d@{number + 1}")
        assert program.engine.rules.match_count < 20


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("b@0 b@0.5 a@1 b@5 c@5", "x(1)@1-5"),
        ("b@0 b@0.5 a@1 b@4.999999999 c@5", ""),
        ("b@0 b@0.5 a@1 b@1 c@5", "x(1)@1-5"),
        ("b@0 b@0.5 a@1 b@1.000000001 c@5", ""),
    ],
)
def test_negated_event_meeting_side_is_not_between(stream: str, expected: str) -> None:
    """With two stored negated events, the third is searched by time, not compared alone."""
    assert outputs_of("x(1) <- (a seq c) cnot b.", stream) == expected


@pytest.mark.parametrize("policy", ["recent", "recent_2", "chronological", "chronological_2", "unrestricted"])
@pytest.mark.parametrize("value", ["1", "f(1)"])  # a plain key, and one that needs unification
@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("b(V)@10 a(V)@2", ""),
        ("b(V)@10 a(V)@5", ""),
        ("b(V)@10 a(V)@5.000000001", "o(V)@5.000000001-10"),
        ("b(V)@10 c(V)@7 a(V)@6", ""),
        ("b(V)@10 c(V)@5 a(V)@6", "o(V)@6-10"),
    ],
)
def test_late_first_side_respects_window_of_negation(
    policy: str, value: str, stream: str, expected: str
) -> None:
    rule = "o(X) <- ((a(X) seq b(X)) cnot c(X)) within 5."
    outputs = outputs_of(rule, stream.replace("V", value), policy, ["out_of_order"])
    assert outputs == expected.replace("V", value)


IN_ORDER = [
    "o(X, Y) <- (a(X) seq b(Y)) cnot c(_).",
    "o(X, Y) <- (a(X) seq b(Y)) cnot c(X).",
    "o(X) <- (a(X) seq b(X)) cnot c(_).",
    "o(X) <- (a(X) seq b(X)) cnot c(X).",
    "o(X, Y) <- (a(X) seq a(Y)) cnot c(X).",
    "o(X, Y) <- (a(X) seq b(Y)) cnot c(Y).",
    "o(X, Y) <- ((a(X) seq b(_)) cnot c(X)) seq a(Y).",
    "o(X, Y) <- (((a(X) seq b(_)) cnot c(X)) seq b(Y)) cnot c(_).",
    "o(X, Y) <- ((a(X) and a(_)) seq b(Y)) cnot (c(X) seq c(_)).",
]


@pytest.fixture
def _eager_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweep after every few events, and store no match that is ruled out."""
    monkeypatch.setattr("retalis.events.matches.negation.MAX_RULED_OUT", 0)
    monkeypatch.setattr("retalis.events.matches.expiration.VISITED_SLICE_ENTRIES", 3)
    for name, value in (
        ("STALE_ARRIVALS_TOLERANCE", 0),
        ("VISITED_SLICE_ENTRIES", 3),
        ("_MATCHES_PER_SWEEP_STEP", 1),
    ):
        monkeypatch.setattr(f"retalis.events.matches.match_limit.{name}", value)


@pytest.mark.usefixtures("_eager_sweeps")
@pytest.mark.parametrize("policy", ["recent", "recent_2", "chronological", "unrestricted"])
@pytest.mark.parametrize("rule", IN_ORDER)
def test_dropping_ruled_out_matches_changes_no_output(
    rule: str, policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(f"{rule} {policy}")
    dropping = ProgramRunner(rule, policy=policy)
    with monkeypatch.context() as patched:
        patched.setattr("retalis.events.network.join_node.JoinNode.sweeps", lambda node, mode: ())
        keeping = ProgramRunner(rule, policy=policy)
    dropped = 0
    for second in range(120):
        event = f"{rng.choice('aabbc')}({rng.randrange(4)})@{second}"
        assert dropping.feed(event) == keeping.feed(event)
        waiting, kept = (program.engine.rules.match_count for program in (dropping, keeping))
        assert waiting <= kept
        dropped = max(dropped, kept - waiting)
    assert dropped or "c(Y)" in rule or " and " in rule  # Y is known with b only; such pairs are few


@pytest.mark.usefixtures("_eager_sweeps")
def test_ruled_out_match_waits_until_window_ends() -> None:
    program = ProgramRunner("o(X) <- ((a(X) seq (b(X) seq d)) cnot c(X)) within 50.")
    program.feed("a(1)@1 b(1)@2 c(1)@3")
    program.feed(" ".join(f"a({second})@{second} c({second})@{second + 0.5}" for second in range(4, 30)))
    # The second side overlaps c(1), which does not rule the pair out.
    assert program.feed("d@30") == "o(1)@1-30"
    program.feed("a(0)@200")
    assert program.engine.rules.match_count < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "event_at"),
    [
        (
            "o(X, Y) <- (walk(X) seq walk(Y)) cnot temp.",
            lambda second: f"walk({second})" if second % 9 else "temp",
        ),
        (
            "o(X, Y) <- (walk(X) seq door(Y)) cnot temp.",
            lambda second: f"walk({second})" if second % 9 else "temp",
        ),
        (
            "o(X) <- (walk(X) seq door(X)) cnot temp.",
            lambda second: f"walk({second})" if second % 9 else "temp",
        ),
        (
            "o(X) <- (walk(X) seq door(X)) cnot temp(X).",
            lambda second: f"{('walk', 'temp')[second % 2]}({second // 2})",
        ),
        ("o <- (walk seq door) cnot temp.", lambda second: "temp" if second else "walk"),
        ("o(X) <- (walk(X) seq door(X)) cnot temp(X).", lambda second: f"temp({second})"),
    ],
)
def test_negated_events_are_bounded(rule: str, event_at: Any) -> None:
    program = ProgramRunner(rule)
    for second in range(20_000):
        program.engine.event(event_at(second), second)
        if second % 1000 == 0:
            assert program.engine.rules.match_count < 10_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "rule",
    [
        "o <- (walk seq door) cnot temp.",
        "o <- ((walk seq door) cnot temp) within 5.",
        "o(X) <- (walk(X) seq door(X)) cnot temp.",
    ],
)
@pytest.mark.parametrize("interval", [0, 9])
def test_frontier_drops_removed_events(rule: str, interval: int) -> None:
    program = ProgramRunner(rule)
    walk = "walk(1)" if "(X)" in rule else "walk"
    for second in range(20_000):
        program.engine.event(walk if interval and second % interval == 0 else "temp", second)
    (negation,) = _negations(program)
    (frontier,) = negation.frontiers.values()
    assert len(frontier.matches) < (1100 if "within" in rule else 12_000)


@pytest.mark.usefixtures("_eager_sweeps")
@pytest.mark.parametrize("value", ["_", "f(_)"])
def test_negated_event_is_kept_for_open_first_side(value: str) -> None:
    program = ProgramRunner("o(X, Y) <- (a(X, Y) seq b) cnot c(X, Y).", policy="unrestricted")
    program.feed(f"a(1,{value})@1 c(1,f(1))@2 a(2,{value})@3")
    for second in range(4, 40):
        program.feed(f"c(3,{second})@{second}")
    assert program.feed("b@50").startswith("o(2,")


def test_next_sweep_begins_earlier_after_removals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retalis.events.matches.negation.MAX_RULED_OUT", 5)
    monkeypatch.setattr("retalis.events.matches.expiration.VISITED_SLICE_ENTRIES", 20)
    for name, value in (
        ("STALE_ARRIVALS_TOLERANCE", 10),
        ("VISITED_SLICE_ENTRIES", 20),
        ("_MATCHES_PER_SWEEP_STEP", 1),
    ):
        monkeypatch.setattr(f"retalis.events.matches.match_limit.{name}", value)
    program = ProgramRunner("o(X) <- (a(X) seq b(X)) cnot c.", policy="chronological")
    for second in range(600):
        program.engine.event(f"a({second})" if second < 300 else f"b({second - 300})", second)
    assert program.engine.rules.match_count < 20
    for second in range(600, 1000):
        program.engine.event("c" if second % 2 else f"a({second})", second)
        assert program.engine.rules.match_count < 150


@pytest.mark.slow
def test_event_removes_few_expired_matches() -> None:
    program, event_count = ProgramRunner(), 20_000
    program.engine.rules.network.limit_stored(event_count + 2 * SLICE_ENTRIES)
    program.engine.load(rules="o(X) <- (a(X) seq b(X)) cnot c(X).")
    (rule,) = program.engine.rules.rules
    previous_count = 0
    for second in range(event_count + 5 * SLICE_ENTRIES):
        # First sides with equal values replace the oldest ones, until the number of matches exceeds the limit.
        pair = (second - event_count) // 2
        program.engine.event(
            f"a({second})" if second < event_count else f"{'ca'[second % 2]}({pair})", second
        )
        assert previous_count - len(rule.arrivals) <= SLICE_ENTRIES
        previous_count = len(rule.arrivals)
    assert rule.stored_match_count == rule.max_stored
    assert rule.dropped_count


@pytest.mark.slow
def test_newest_ruled_out_matches_wait_for_late_event() -> None:
    program = ProgramRunner("o(X, Y) <- (a(X) seq b(Y)) cnot c.", policy="recent_2")
    for second in range(0, 20_000, 2):
        program.engine.event(f"a({second})", second)
        program.engine.event("c", second + 1)
    assert program.feed("b(1)@19500.5-20000") == "o(19500,1)@19500-20000"
    assert program.feed("b(2)@19400.5") == "o(19400,2)@19400-19400.5"
    assert program.feed("b(3)@20001") == ""
    assert program.feed("a(0)@15000 b(4)@20002") == ""


@pytest.mark.parametrize(
    "rule", ["o(X) <- (a(X) seq b(X)) within 5.", "o(X) <- ((a(X) seq b(X)) cnot c(X)) within 5."]
)
def test_windows_expire_with_pinned_clock(rule: str) -> None:
    engine = Engine()
    rules = engine.rules
    stream_clock(engine).pin(0)
    engine.load(rules=rule)
    for second in range(1000):
        engine.event(f"{'ac'[second % 2]}({second})", second)
    assert rules.match_count < 10
