"""Storage of negated events."""

import random

import pytest
from events.stream_programs import Program, fired

from retalis import Engine
from retalis.events.matches.expiration import SLICE_ENTRIES
from retalis.events.matches.negation import NegationBuffer


def _negations(program):
    (rule,) = program.engine.rules.rules
    return [
        negation
        for node, _, _ in rule.nodes
        for negation in getattr(node, "negations", ())
        if isinstance(negation, NegationBuffer)
    ]


def test_keys_under_which_nothing_waits_any_more_are_forgotten():
    program = Program("d(X) <- (a(X) seq b(X)) cnot c(X) within 5.")
    for number in range(3000):
        program.feed(f"c({number})@{number}")
    (negation,) = _negations(program)
    assert len(negation.buffer.newest) < 10
    assert len(negation.frontiers) < 1100
    assert program.feed("a(1)@3000 a(2)@3000 c(1)@3001 b(1)@3002 b(2)@3002") == "d(2)@3000-3002"


def test_what_an_interrupt_leaves_half_done_is_made_anew():
    program = Program("d(X) <- (a(X) seq b(X)) cnot c(X).")
    assert program.feed("a(1)@1 c(1)@2 c(1)@3 c(1)@4") == ""
    negation = _negations(program)[0]
    for border in negation.frontiers.values():
        del border.ends[:], border.starts[1:]
    negation.buffer.repair()
    assert program.feed("b(1)@5 a(1)@6 b(1)@7") == "d(1)@6-7"


def test_an_absence_inside_a_negated_pattern_may_look_at_what_is_outside():
    rule = "s(Y) <- (p(Y) seq b) cnot (x fnot q(Y))."
    assert fired(rule, "p(1)@1 b@5") == "s(1)@1-5"
    assert fired(rule, "p(1)@1 x@3 b@5") == ""
    assert fired(rule, "p(1)@1 q(2)@2 x@3 b@5") == ""
    assert fired(rule, "p(1)@1 q(1)@2 x@3 b@5") == "s(1)@1-5"
    rule = "s(Y) <- b(Y) fnot (x fnot q(Y))."
    assert fired(rule, "b(1)@5") == "s(1)@5-5"
    assert fired(rule, "x@3 b(1)@5") == ""
    assert fired(rule, "q(2)@2 x@3 b(1)@5") == ""
    assert fired(rule, "q(1)@2 x@3 b(1)@5") == "s(1)@5-5"


@pytest.mark.parametrize(
    ("rule", "stream", "answer"),
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
def test_what_must_not_happen_has_conditions_over_what_stands_outside(rule, stream, answer):
    assert fired(rule, stream, "chronological") == answer


@pytest.mark.parametrize(
    ("rule", "stream", "answer"),
    [
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "c(1)@1 d@2 b(0)@3", "o(0)@2-3"),
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "c(1)@1 d@2 b(1)@3", ""),
        ("o(X) <- b(X) and ((a(X) or d) fnot c(X)).", "d@1 c(1)@2 a(1)@3 b(1)@4", "o(1)@1-4"),
        ("o(X) <- b(X) seq (((a(X) or d) seq e) cnot c(X)).", "b(1)@1 b(2)@2 d@3 c(2)@4 e@5", "o(1)@1-5"),
        ("o(X) <- b(X) and ((s seq aggregate(sum(X), a(X), _)) cnot c(X)).", "c(1)@1 s@2 b(0)@3", "o(0)@2-3"),
    ],
)
def test_an_absence_waits_for_what_a_branch_or_a_run_without_repetitions_leaves_open(rule, stream, answer):
    assert fired(rule, stream) == answer


def test_conditions_of_what_must_not_happen_know_what_those_before_them_have_found():
    rule = "o(X) <- a(X) fnot ((b(Y) where Z = f(X, Y)) where (Z = f(A, B), A < B, X > 0))."
    assert fired(rule, "b(1)@1 a(0)@2 b(2)@3 a(1)@4 a(3)@5") == "o(0)@2-2 o(3)@5-5"


@pytest.mark.parametrize(
    "rule",
    [
        "l([property(window, 6)]) : o <- (a seq b) cnot c.",
        "o <- ((a seq b) cnot c) within 7.",
        "o <- ((a seq b) within 7) cnot c.",
        "l([property(window, 6)]) : o <- ((a seq b) cnot c) fnot d.",
    ],
)
def test_what_rules_out_is_kept_as_long_as_a_late_partner_can_come(rule):
    """By the rule's clock, 17, the window of c is over; that of b, which a late partner may fit, is not."""
    assert fired(rule, "b@12-14 c@17 a@8", flags=["out_of_order"]) == "o@8-14"
    assert fired(rule, "c@10 b@12-14 c@17 a@8", flags=["out_of_order"]) == ""


def test_the_parts_of_what_rules_out_are_kept_as_long():
    rule = "o <- ((a seq b) cnot (c seq d)) within 7."
    assert fired(rule, "c@10 b@14 c@18 d@12 a@8", "recent_2", ["out_of_order"]) == ""


def test_what_rules_out_is_kept_where_only_an_outer_pattern_is_bounded():
    """The pair, which is too long for the outer bound, would use b up."""
    rule = "o <- (((a seq b) cnot c) seq d) within 5."
    assert fired(rule, "c@2 b@9 c@12 a@1 a@8 d@10", flags=["out_of_order"]) == "o@8-10"


@pytest.mark.parametrize("flags", [(), ("out_of_order",)])
def test_what_rules_out_goes_when_no_partner_can_come_any_more(flags):
    program = Program("o <- ((a seq b) cnot (c seq d)) within 5.", flags)
    for number in range(0, 1000, 2):
        program.feed(f"c@{number} d@{number + 1}")
        assert program.engine.rules.match_count < 20


@pytest.mark.parametrize(
    ("stream", "answer"),
    [
        ("b@0 b@0.5 a@1 b@5 c@5", "x(1)@1-5"),
        ("b@0 b@0.5 a@1 b@4.999999999 c@5", ""),
        ("b@0 b@0.5 a@1 b@1 c@5", "x(1)@1-5"),
        ("b@0 b@0.5 a@1 b@1.000000001 c@5", ""),
    ],
)
def test_an_absent_event_among_others_that_touches_a_side_does_not_lie_between_them(stream, answer):
    """With two absent events waiting, the third is looked up by time, not compared on its own."""
    assert fired("x(1) <- (a seq c) cnot b.", stream) == answer


@pytest.mark.parametrize("policy", ["recent", "recent_2", "chronological", "chronological_2", "unrestricted"])
@pytest.mark.parametrize("value", ["1", "f(1)"])  # a plain key, and one that is looked up the general way
@pytest.mark.parametrize(
    ("stream", "answer"),
    [
        ("b(V)@10 a(V)@2", ""),
        ("b(V)@10 a(V)@5", ""),
        ("b(V)@10 a(V)@5.000000001", "o(V)@5.000000001-10"),
        ("b(V)@10 c(V)@7 a(V)@6", ""),
        ("b(V)@10 c(V)@5 a(V)@6", "o(V)@6-10"),
    ],
)
def test_a_late_first_side_is_within_the_window_of_a_sequence_with_an_absence(policy, value, stream, answer):
    rule = "o(X) <- ((a(X) seq b(X)) cnot c(X)) within 5."
    found = fired(rule, stream.replace("V", value), policy, ["out_of_order"])
    assert found == answer.replace("V", value)


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
def _eager_sweeps(monkeypatch):
    """Sweep after every few events, and keep nothing that is ruled out."""
    monkeypatch.setattr("retalis.events.matches.negation.MAX_RULED_OUT", 0)
    monkeypatch.setattr("retalis.events.matches.expiration.VISITED_SLICE_ENTRIES", 3)
    for name, value in (
        ("STALE_ARRIVALS_TOLERANCE", 0),
        ("VISITED_SLICE_ENTRIES", 3),
        ("_MATCHES_PER_SWEEP_STEP", 1),
    ):
        monkeypatch.setattr(f"retalis.events.network.event_rule.{name}", value)


@pytest.mark.usefixtures("_eager_sweeps")
@pytest.mark.parametrize("policy", ["recent", "recent_2", "chronological", "unrestricted"])
@pytest.mark.parametrize("rule", IN_ORDER)
def test_dropping_what_is_ruled_out_changes_nothing_while_events_come_in_order(rule, policy, monkeypatch):
    rng = random.Random(f"{rule} {policy}")
    dropping = Program(rule, policy=policy)
    with monkeypatch.context() as patched:
        patched.setattr("retalis.events.network.join_node.JoinNode.sweeps", lambda node, mode: ())
        keeping = Program(rule, policy=policy)
    dropped = 0
    for at in range(120):
        event = f"{rng.choice('aabbc')}({rng.randrange(4)})@{at}"
        assert dropping.feed(event) == keeping.feed(event)
        waiting, kept = (program.engine.rules.match_count for program in (dropping, keeping))
        assert waiting <= kept
        dropped = max(dropped, kept - waiting)
    assert dropped or "c(Y)" in rule or " and " in rule  # Y is known with b only; such pairs are few


@pytest.mark.usefixtures("_eager_sweeps")
def test_within_a_time_what_is_ruled_out_waits_until_the_time_is_over():
    program = Program("o(X) <- ((a(X) seq (b(X) seq d)) cnot c(X)) within 50.")
    program.feed("a(1)@1 b(1)@2 c(1)@3")
    program.feed(" ".join(f"a({at})@{at} c({at})@{at + 0.5}" for at in range(4, 30)))
    assert (
        program.feed("d@30") == "o(1)@1-30"
    )  # the second side overlaps c(1), which does not rule the pair out
    program.feed("a(0)@200")
    assert program.engine.rules.match_count < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "make"),
    [
        ("o(X, Y) <- (walk(X) seq walk(Y)) cnot temp.", lambda at: f"walk({at})" if at % 9 else "temp"),
        ("o(X, Y) <- (walk(X) seq door(Y)) cnot temp.", lambda at: f"walk({at})" if at % 9 else "temp"),
        ("o(X) <- (walk(X) seq door(X)) cnot temp.", lambda at: f"walk({at})" if at % 9 else "temp"),
        (
            "o(X) <- (walk(X) seq door(X)) cnot temp(X).",
            lambda at: f"{('walk', 'temp')[at % 2]}({at // 2})",
        ),
        ("o <- (walk seq door) cnot temp.", lambda at: "temp" if at else "walk"),
        ("o(X) <- (walk(X) seq door(X)) cnot temp(X).", lambda at: f"temp({at})"),
    ],
)
def test_what_is_ruled_out_and_what_rules_out_does_not_gather(rule, make):
    program = Program(rule)
    for at in range(20_000):
        program.engine.event(make(at), at)
        if at % 1000 == 0:
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
@pytest.mark.parametrize("first", [0, 9])
def test_the_index_of_absent_events_does_not_keep_those_that_have_left(rule, first):
    program = Program(rule)
    walk = "walk(1)" if "(X)" in rule else "walk"
    for at in range(20_000):
        program.engine.event(walk if first and at % first == 0 else "temp", at)
    (negation,) = _negations(program)
    (border,) = negation.frontiers.values()
    assert len(border.matches) < (1100 if "within" in rule else 12_000)


@pytest.mark.usefixtures("_eager_sweeps")
@pytest.mark.parametrize("value", ["_", "f(_)"])
def test_an_absent_event_stays_for_a_first_side_with_variables_that_it_rules_out(value):
    program = Program("o(X, Y) <- (a(X, Y) seq b) cnot c(X, Y).", policy="unrestricted")
    program.feed(f"a(1,{value})@1 c(1,f(1))@2 a(2,{value})@3")
    for at in range(4, 40):
        program.feed(f"c(3,{at})@{at}")
    assert program.feed("b@50").startswith("o(2,")


def test_after_many_matches_have_left_the_next_sweep_begins_earlier(monkeypatch):
    monkeypatch.setattr("retalis.events.matches.negation.MAX_RULED_OUT", 5)
    monkeypatch.setattr("retalis.events.matches.expiration.VISITED_SLICE_ENTRIES", 20)
    for name, value in (
        ("STALE_ARRIVALS_TOLERANCE", 10),
        ("VISITED_SLICE_ENTRIES", 20),
        ("_MATCHES_PER_SWEEP_STEP", 1),
    ):
        monkeypatch.setattr(f"retalis.events.network.event_rule.{name}", value)
    program = Program("o(X) <- (a(X) seq b(X)) cnot c.", policy="chronological")
    for at in range(600):
        program.engine.event(f"a({at})" if at < 300 else f"b({at - 300})", at)
    assert program.engine.rules.match_count < 20
    for at in range(600, 1000):
        program.engine.event("c" if at % 2 else f"a({at})", at)
        assert program.engine.rules.match_count < 150


@pytest.mark.slow
def test_no_single_event_forgets_many_matches_that_have_left():
    program = Program("o(X) <- (a(X) seq b(X)) cnot c(X).")
    rules = program.engine.rules
    number = 20_000
    rules.max_stored = number + 2 * SLICE_ENTRIES
    (rule,) = rules.rules
    before = 0
    for at in range(number + 5 * SLICE_ENTRIES):
        # First sides of the same values replace the oldest ones, until more matches wait than may.
        pair = (at - number) // 2
        program.engine.event(f"a({at})" if at < number else f"{'ca'[at % 2]}({pair})", at)
        assert before - len(rule.arrivals) <= SLICE_ENTRIES
        before = len(rule.arrivals)
    assert rule.stored_match_count == rules.max_stored
    assert rule.dropped_count


@pytest.mark.slow
def test_the_newest_that_are_ruled_out_wait_for_a_second_side_that_overlaps_or_is_late():
    program = Program("o(X, Y) <- (a(X) seq b(Y)) cnot c.", policy="recent_2")
    for at in range(0, 20_000, 2):
        program.engine.event(f"a({at})", at)
        program.engine.event("c", at + 1)
    assert program.feed("b(1)@19500.5-20000") == "o(19500,1)@19500-20000"
    assert program.feed("b(2)@19400.5") == "o(19400,2)@19400-19400.5"
    assert program.feed("b(3)@20001") == ""
    assert program.feed("a(0)@15000 b(4)@20002") == ""


@pytest.mark.parametrize(
    "rule", ["o(X) <- (a(X) seq b(X)) within 5.", "o(X) <- ((a(X) seq b(X)) cnot c(X)) within 5."]
)
def test_windows_expire_by_the_time_of_the_stream_where_the_clock_is_pinned(rule):
    engine = Engine()
    rules = engine.rules
    rules.clock.pin(0)
    engine.load(rules=rule)
    for at in range(1000):
        engine.event(f"{'ac'[at % 2]}({at})", at)
    assert rules.match_count < 10
