"""Storage and expiration of negated events."""

import random
from typing import Any, List, Tuple

import pytest
from asserting_accessors import stream_clock
from events.program_runner import ProgramRunner, outputs_of, term_text

from retalis import Engine
from retalis.events.matches.expiration import SLICE_ENTRIES
from retalis.events.matches.negation import MAX_RULED_OUT, NegationBuffer, OverlapBuffer
from retalis.prolog.terms.timestamps import SECOND


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
    assert outputs_of(rule, "c@10 b@14 c@18 a@8", "recent_2", ["out_of_order"]) == "o@8-14"
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


def _overlap_buffers(program: Any) -> List[OverlapBuffer]:
    (rule,) = program.engine.rules.rules
    return [
        negation
        for node in rule.nodes
        for negation, _ in getattr(node, "deferred_negations", ())
        if isinstance(negation, OverlapBuffer)
    ]


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("d <- (a seq b seq c) without r.", "a@1 r@2 b@3 c@4", ""),
        ("d <- (a seq b seq c) without r.", "r@1 a@1 b@3 c@4 r@4", "d@1-4"),
        ("d <- (a seq b) without r.", "a@1-3 r@2-2 b@4", ""),
        ("d <- (a seq b) without r.", "r@0-2 a@1 b@4", ""),
        ("d <- (a and b) without r.", "b@1 r@2 a@3", ""),
        ("d <- (a or b) without r.", "a@1-3 r@4-6 b@5-7 a@6-8", "d@1-3 d@6-8"),
        ("d(X) <- (a(X) seq b) without r(X).", "a(1)@1 a(2)@1 r(2)@2 b@3", "d(1)@1-3"),
        ("d(X) <- (a(X) seq b) without (r(Y) where Y > X).", "a(1)@1 a(5)@1 r(3)@2 b@3", "d(5)@1-3"),
        ("d(X) <- c(X) seq ((a seq b) without r(X)).", "c(1)@0 a@1 r(2)@2 b@3", "d(1)@0-3"),
        ("d(X) <- c(X) seq ((a seq b) without r(X)).", "c(1)@0 a@1 r(1)@2 b@3", ""),
        ("d(N) <- (a seq aggregate(count, b, N)) without r.", "a@1 b@2 r@3 b@4", "d(0)@1-1 d(1)@1-2"),
        ("d <- (a ntimes 3) without r.", "a@1 a@2 r@2.5 a@3 a@4 a@5", "d@3-5"),
        ("d <- ((a seq b) do true) without r.", "a@1 r@2 b@3 a@4 b@5", "d@4-5"),
    ],
)
def test_overlapping_event_excludes_match(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(rule, stream) == expected


@pytest.mark.parametrize("flag", [None, "out_of_order", "revision_flag", "etalis_justification"])
@pytest.mark.parametrize(
    ("pattern", "stream", "expected"),
    [
        ("(a(X) seq at_end(b(X))) cnot at_start(b(X))", "a(1)@1 b(1)@2-3 a(2)@5 b(2)@4-6", "d@5-6"),
        (
            "(a(X) seq at_end(b(Y))) cnot at_start(b(Z) where Z > X)",
            "a(1)@1 b(1)@2-3 a(1)@4 b(2)@5-6",
            "d@1-3",
        ),
        ("a(X) seq ((at_end(b(_)) and e) fnot at_start(b(X)))", "a(1)@1 e@3 b(1)@2-4 b(2)@5-6", ""),
        ("(a(X) and at_end(b(X))) fnot at_start(b(X))", "a(1)@3 b(1)@2-4 a(2)@5 b(2)@6-7", "d@5-7"),
    ],
)
def test_event_excludes_before_it_completes(pattern: str, stream: str, expected: str, flag: Any) -> None:
    assert ProgramRunner(f"d <- {pattern}.", [flag] if flag else []).feed(stream) == expected


def test_excluded_partner_of_without_remains() -> None:
    program = ProgramRunner("d(X) <- (a(X) seq b) without r.", policy="chronological")
    assert program.feed("a(1)@1 r@2 a(2)@3 b@4") == "d(2)@3-4"


def test_overlapping_event_excludes_late_match() -> None:
    program = ProgramRunner(":- set_etalis_flag(out_of_order, on). d <- (a seq b) without r within 5.")
    assert program.feed("r@2 b@3 a@1") == ""
    assert program.feed("b@13 r@10 a@11") == "d@11-13"


def test_late_start_of_repetition_is_excluded() -> None:
    rule = "r([property(event_rule_window, 4)]) : o <- (b(_) seq c star_times) without d."
    assert outputs_of(rule, "c@31 b(1)@13-17") == "o@13-17"
    assert outputs_of(rule, "c@31 d@13-17 b(1)@13-17") == ""


def test_retracted_overlapping_event_releases_match() -> None:
    for pattern in ("(a seq b)", "(a and b)", "at_end(b)", "(a seq b star_times)"):
        program = ProgramRunner(f":- set_etalis_flag(revision_flag, on). d <- {pattern} without r.")
        assert "d@" not in program.feed("a@1 r@0-6 b@5").replace("d@1-1", "")
        assert "d@" in program.feed("rev(r)@7"), pattern


def test_events_of_without_expire_by_their_ends() -> None:
    program = ProgramRunner("d <- (a seq b) without r within 5.")
    (buffer,) = _overlap_buffers(program)
    for number in range(0, 1000, 2):
        program.feed(f"r@{number}-{number + 1}")
        assert len(buffer.buffer.stored_matches()) <= 6
    assert program.feed("r@0-1001 a@1000 b@1002 a@1003 b@1004") == "d@1003-1004"


def test_events_of_without_are_bounded_without_limit() -> None:
    """Of each key, the newest events are stored that no other one contains, so no key affects another."""
    program = ProgramRunner("d(X) <- (a(X) seq b) without r(X).", policy="unrestricted")
    program.feed("r(0)@1 a(0)@0 " + " ".join(f"a({number})@2" for number in range(1, 4)))
    for number in range(MAX_RULED_OUT + 9):
        program.feed(f"r(1)@{3 + number} r(2)@3-{4 + number}")
    (buffer,) = _overlap_buffers(program)
    assert len(buffer.buffer.stored_matches()) == MAX_RULED_OUT + 2
    assert program.feed("b@5000") == "d(3)@2-5000"


def test_late_events_of_without_evict_those_that_end_first() -> None:
    for count in (1, MAX_RULED_OUT - 1, MAX_RULED_OUT + 9):
        program = ProgramRunner(":- set_etalis_flag(out_of_order, on). d <- (a seq b) without r.")
        assert program.feed("r@5000 " + " ".join(f"r@{4900 - number}" for number in range(count))) == ""
        assert program.feed("a@4950 b@5100") == "", count
        assert program.feed("a@5101 b@5102") == "d@5101-5102"


VISIT = "visit(W) <- aggregate(count, seen(W), _, session(30, max(600))). "


@pytest.mark.parametrize("justification", ["off", "on"])
@pytest.mark.parametrize(
    "rule",
    [
        "quiet(W) <- visit(W) without door.",
        "quiet(W) <- (visit(W) without door) within 650.",
        "quiet(W) <- (start seq visit(W)) without door.",
    ],
)
def test_event_of_without_excludes_result_of_session(rule: str, justification: str) -> None:
    engine = Engine()
    names: List[str] = []
    engine.call(f"set_etalis_flag(etalis_justification, {justification})")
    engine.load(rules=VISIT + rule)
    engine.on_event(lambda term, start, end: names.append(term_text(term)))
    later_doors = [("door", 10 + number / 10) for number in range(250)]
    events = [("start", 0), ("seen(a)", 1), ("door", 5), ("seen(a)", 9), *later_doors]
    for name, time in [*events, ("start", 59), ("seen(b)", 60), ("tick", 99)]:
        engine.event(name, time)
    assert [name for name in names if name.startswith("quiet")] == ["quiet(b)"]


@pytest.mark.parametrize(
    ("rule", "seconds"),
    [
        ("d <- (p without r) within 700.", 1400),
        ("x([property(window, 5)]) : d <- p without r.", 605),
        ("x([property(window, 5)]) : d <- (p without r) seq q.", 605),
        ("d <- ((p without r) seq q) within 5.", 605),
        ("d <- aggregate(count, p, _, session(30, max(600))) without r.", 1260),
        ("d <- aggregate(count, p, _, every(10)) without r.", 610),
        ("d <- aggregate(count, p, _, session(30)) without r.", None),
        ("x([property(window, 5)]) : d <- a cnot (p without r).", None),
        ("x([property(window, 5)]) : d <- at_end(p without r) seq q.", None),
        ("d <- p without r.", None),
    ],
)
def test_time_limit_ends_storage_of_without(rule: str, seconds: Any) -> None:
    (rule_at_run_time,) = ProgramRunner(rule).engine.rules.rules
    retentions = {
        negation.buffer.retention and round(negation.buffer.retention / SECOND)
        for node in rule_at_run_time.nodes
        for negation, _ in getattr(node, "deferred_negations", ())
    }
    assert retentions == {seconds}


def test_match_after_expiration_of_without_is_reported() -> None:
    program = ProgramRunner("d(X) <- (p(X) without r(X)) within 5.")
    assert program.feed("r(1)@3 r(2)@2000 p(1)@2-4 p(3)@2-4 p(2)@1900-1904") == "d(3)@2-4 d(2)@1900-1904"
    assert program.engine.rules.rules[0].late_count == 1
    assert "an event after without that it may overlap is not stored" in program.warnings[0].message
    program.engine.rules.clear()
    assert program.feed("p(1)@2-4") == "d(1)@2-4"


def test_retraction_after_expiration_of_without_releases_match() -> None:
    program = ProgramRunner(":- set_etalis_flag(revision_flag, on). d <- (p without r(_)) within 5.")
    assert program.feed("r(1)@2 p@1-3 r(2)@1000") == ""
    assert program.feed("rev(r(1))@1001") == "d@1-3"


def test_late_pair_of_without_is_decided_for_its_key_only() -> None:
    program = ProgramRunner("d(X) <- (a(X) seq b(X)) without r(X).", policy="unrestricted")
    program.feed("a(1)@1 a(2)@2 " + " ".join(f"r(1)@{3 + number}" for number in range(MAX_RULED_OUT + 9)))
    assert program.feed("b(1)@2 b(2)@3") == "d(2)@2-3"
    assert program.engine.rules.rules[0].late_count == 1


def test_lost_events_of_without_are_recorded_for_few_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retalis.events.matches.negation.MAX_LOST_KEYS", 2)
    program = ProgramRunner("d(X) <- (p(X) without r(X)) within 5.")
    program.feed("r(1)@3 r(2)@4 r(3)@5 r(4)@6 tick@9 r(9)@2000")
    assert program.feed("p(3)@6-7 p(5)@3-5 p(4)@5-7 p(5)@4-5") == "d(3)@6-7 d(5)@4-5"


def test_dropped_event_of_without_is_named() -> None:
    program = ProgramRunner()
    program.engine.rules.network.limit_stored(20)
    program.engine.load(rules="d <- p without r(_).")
    program.feed(" ".join(f"r({number})@{number}" for number in range(22)))
    (rule,) = program.engine.rules.rules
    assert (rule.stored_match_count, rule.dropped_count) == (20, 2)
    text = program.warnings[-1].message
    assert "rule d has more than 20 partial matches; 2 of the oldest have been dropped" in text
    assert "the last one is a negated event r(1): results that it excludes may be emitted" in text


def test_nested_events_of_without_are_stored_once() -> None:
    intervals = [(start, start + length) for start in range(9) for length in range(9)]
    for seed in range(5):
        sample = random.Random(seed).sample(intervals, 40)
        outer = {
            end
            for start, end in sample
            if not any(s <= start and end <= e and (s, e) != (start, end) for s, e in sample)
        }
        program = ProgramRunner("d <- p without r.")
        program.feed(" ".join(f"r@{start}-{end}" for start, end in sample))
        (buffer,) = _overlap_buffers(program)
        assert {match.end // SECOND for match in buffer.buffer.stored_matches()} == outer
        for start, end in intervals:
            is_excluded = any(s < end and start < e for s, e in sample)
            assert program.feed(f"p@{start}-{end}") == ("" if is_excluded else f"d@{start}-{end}")


def test_first_sides_of_without_are_bounded() -> None:
    program = ProgramRunner("d(X) <- (a(X) seq b(X)) without r.")
    for number in range(12_000):
        program.feed(f"a({number})@{number} r@{number}.5")
    assert program.engine.rules.rules[0].match_count < 10_000
    assert program.engine.rules.rules[0].dropped_count == 0
    assert program.feed("a(1)@30000 b(1)@30001 b(11999)@30002") == "d(1)@30000-30001"
