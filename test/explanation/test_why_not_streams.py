"""Explanations of rules with windows, steps and aggregates that did not fire."""

from typing import Any, List

import pytest

from retalis import Engine, Operators, explain, record_origins
from retalis.explanation import why_not_matched
from retalis.prolog.syntax.term_reader import read_term

STREAM = (("in(1)", 1), ("in(2)", 2), ("no", 3), ("tick", 4))
NOT_FIRED = {
    "w(N) <- aggregate(count, in(_), N, last(5)).": "other results: 1 at 1; 2 [1,2]",
    "w(X) <- aggregate(count, never, X, every(5)).": "aggregate over every(5.0): nothing was measured",
    "w(N) <- aggregate(count, in(_), N, session(5)).": "aggregate over session(5.0): no window has ended",
    "w(N) <- aggregate(count, in(_), N, session(1.5)).": "aggregate over session(1.5): other results: 2 [1,2]",
    "w(A) <- aggregate(avg(X), in(X), A, held(every(5))).": "aggregate over held(every(5.0)): no window has ended",
    "w(A) <- aggregate(max(X), in(X), A, held(every(1))).": "aggregate over held(every(1.0)): other results: ",
    "w(X) <- never(X) with throttle(5).": "? with throttle(5.0): not tested",
    "w(X) <- (in(_) with debounce(5)) seq in(X).": "debounce(5.0): the 5 seconds after the last one are not over",
    "w(9) <- (in(X) with change(X)) where X > 2.": "where X > 2: false for X = 1 at 1; X = 2 at 2",
    "w(9) <- (in(2) with throttle(1)) where false.": "where false: false at 2",
    "w(9) <- tick with not_preceded(no, 2).": "with not_preceded 2: ruled out by what must not happen",
    "w(9) <- in(2) seq absent(no, 5).": "absent 5: the time after it is not over ('until' of a "
    "test case sets a later end)",
    "w(9) <- in(2) seq absent(no, 1234567).": "absent 1234567: the time after it is not over",
    "w(9) <- (in(_) with debounce(1234567)) seq in(X).": "the 1234567 seconds after the last one are not over",
    "w(9) <- in(2) seq absent(no, 1.5).": "absent 1.5: ruled out by what must not happen",
    "w(9) <- (in(2) where N = 1.5) seq absent(no, N).": "absent N: ruled out by what must not happen",
    "w(9) <- (in(2) where N = x) seq absent(no, N).": "absent N: its time is not a positive number of seconds",
    "w(9) <- never seq absent(no, 1.5).": "? absent 1.5: not tested",
    "w(9) <- (in(1) seq tick) without no.": "without: ruled out by what must not happen",
    "w(9) <- never without no.": "? without: not tested",
    "w(9) <- at_end(never).": "? at_end: not tested",
    "w(9) <- at_start(in(_) seq in(_)) where false.": "where false: false at 1",
    "w(9) <- in(_) with throttle(5) do fail.": "throttle dropped it because of earlier events",
}


@pytest.mark.parametrize("rule", NOT_FIRED)
def test_explanation_has_reason_of_operator(rule: str) -> None:
    engine = Engine()
    record_origins(engine)
    engine.load(rules=rule)
    for event, end in STREAM:
        engine.event(event, end)
    assert NOT_FIRED[rule] in str(explain(engine, "w(9)"))


def explanation_lines(rules: str, events: Any, pattern: str, origin: Any = None) -> List[str]:
    """Return the lines of an explanation below the line of the rule, stripped."""
    engine = Engine()
    record_origins(engine)
    engine.load(rules=rules)
    for event, end in events:
        engine.event(event, end)
    (line, *_) = explain(engine, pattern, origin=origin).lines
    return [text.strip() for text in line.indented()][1:]


def test_goal_of_timed_condition_may_be_long() -> None:
    numbers = ",".join(map(str, range(100, 3100)))
    lines = explanation_lines(f"w <- in(_) check (t1(S), memberchk(S, [{numbers}])).", STREAM, "w")
    assert lines[0].startswith("- check t1(S),memberchk(S,[100,101,")
    assert lines[0].endswith("]): false at 1; at 2")


def test_newest_matches_of_alternatives_are_shown() -> None:
    events = [(f"a({second})", second) for second in range(11, 15)]
    events = [(f"b({second})", second) for second in range(1, 4)] + events
    lines = explanation_lines("w <- (a(X) or b(X)) where X > 100.", events, "w")
    assert (
        lines[0]
        == "- where X > 100: false for 7 times, the last ones X = 12 at 12; X = 13 at 13; X = 14 at 14"
    )


def test_newest_matches_of_pairs_are_shown() -> None:
    events = [("a(1)", 1), ("a(2)", 2), ("b(3)", 3), ("b(4)", 4)]
    lines = explanation_lines("w <- (a(X) seq b(Y)) where fail.", events, "w")
    assert lines[1] == "+ seq: 4 times, the last ones [2,3], [1,4], [2,4]"


def test_matches_of_alternatives_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(why_not_matched, "MAX_CANDIDATES", 5)
    events = [*((f"a({second})", second) for second in range(1, 6)), ("b", 9)]
    lines = explanation_lines("w <- ((a(X) or a(X) or a(X)) seq b) where fail.", events, "w")
    assert lines[1].startswith("+ seq: 5 times")


STEPS = (
    "o(L) <- aggregate(list(I), a(T,I), L, steps([up(2) where T > 0, down where T < 0, end where T =:= 9]))."
)


def test_rejected_values_of_condition_are_shown() -> None:
    lines = explanation_lines(
        "hot(N) <- aggregate(count, b, N, last(10)) where N >= 3.", [("b", 1), ("b", 2)], "hot(_)"
    )
    assert lines == [
        "- where N >= 3: false for N = 1 at 1; N = 2 [1,2]",
        "+ aggregate over last(10.0): N = 1 at 1; N = 2 [1,2]",
        "+ b: at 1, at 2",
    ]


def test_steps_show_longest_sequence() -> None:
    lines = explanation_lines(STEPS, [("a(1,1)", 1), ("a(2,2)", 2), ("a(3,3)", 3)], "o(_)")
    assert lines[0].endswith(": no events took all steps")
    assert lines[2:] == [
        "+ step up(2) where T > 0: took 2 events",
        "- step down where T < 0: took 0 events of 1",
        "? step end where T =:= 9: not reached",
    ]


def test_steps_show_options_and_stamps() -> None:
    steps = "[up,later((down where t2(E),E-first(up,t1) < 3,T < avg(up,T)))]"
    lines = explanation_lines(
        f"o(L) <- aggregate(last(t2), a(T), L, steps({steps},[after_match(skip_to_last(down))])).",
        [("a(1)", 1), ("a(9)", 2)],
        "o(_)",
    )
    assert (
        lines[0]
        == f"- aggregate over steps({steps},[after_match(skip_to_last(down))]): no events took all steps"
    )
    assert lines[3] == (
        "- step later((down where t2(E),E-first(up,t1) < 3,T < avg(up,T))): took 0 events of 1"
    )


def test_groups_of_steps_are_shown() -> None:
    steps = "[group([(a where T > 5),(b where T < 5)],1,many),permute([(c where T =:= 5),d]),(e or [f,g])]"
    lines = explanation_lines(
        f"o(N) <- aggregate(count, v(T), N, steps({steps})).", [("v(6)", 1), ("v(1)", 2), ("v(7)", 3)], "o(_)"
    )
    assert lines[0] == f"- aggregate over steps({steps}): no events took all steps"
    assert lines[2:6] == [
        "+ step a where T > 5: took 1 event",
        "+ step b where T < 5: took 1 event",
        "- step c where T =:= 5: took 0 events of 1",
        "+ step d: took 1 event",
    ]


def test_timed_out_steps_are_shown() -> None:
    rule = "o(N) <- aggregate(count, v(T), N, timed_out(steps([a, b where T > 5]), 10))."
    lines = explanation_lines(rule, [("v(1)", 1), ("v(9)", 2)], "o(_)")
    assert lines[0] == "- aggregate over timed_out(steps([a,(b where T > 5)]),10.0): no match has timed out"


def test_incomplete_step_shows_event_count() -> None:
    lines = explanation_lines(STEPS, [("a(1,1)", 1)], "o(_)")
    assert lines[2] == "- step up(2) where T > 0: took 1 event of 2"


@pytest.mark.parametrize(
    ("aggregate", "values"),
    [
        ("count", "N = 0 at 1; N = 1 [1,2]; N = 2 [1,3]"),
        ("sum(V)", "N = 0 at 1; N = 2 [1,2]; N = 5 [1,3]"),
        ("max(V)", "N = 2 [1,2]; N = 3 [1,3]"),
        ("median(V)", "N = 2 [1,2]; N = 2.5 [1,3]"),
        ("quantile(0, V)", "N = 2 [1,2]; N = 2 [1,3]"),
        ("changes(V)", "N = 0 at 1; N = 0 [1,2]; N = 1 [1,3]"),
        ("rate", "N = 1.0 [1,2]; N = 1.0 [1,3]"),
        ("stddev(V)", "N = 0.7071067811865476 [1,3]"),
    ],
)
def test_rejected_results_of_aggregate_are_shown(aggregate: str, values: str) -> None:
    events = [("start", 1), ("v(2)", 2), ("v(3)", 3)]
    lines = explanation_lines(
        f"o(N) <- (start seq aggregate({aggregate}, v(V), N)) where N > 9.", events, "o(_)"
    )
    assert lines[0] == f"- where N > 9: false for {values}"


def test_rejected_values_of_repetition_are_shown() -> None:
    events = [("start", 1), ("v(2)", 2)]
    lines = explanation_lines("o(V) <- (start seq (v(V) star_times)) where V > 9.", events, "o(_)")
    assert "V = 2 [1,2]" in lines[0]


def test_error_of_aggregate_is_shown() -> None:
    lines = explanation_lines(
        "o(N) <- start seq aggregate(max(V), v(V), N).", [("start", 1), ("v(x)", 2)], "o(_)"
    )
    assert lines[0].startswith("- max: nothing was collected, ")
    assert "x" in lines[0]


def test_condition_of_absent_event_is_not_shown() -> None:
    events = [("start", 1), ("stop", 2)]
    lines = explanation_lines("o <- ((start seq stop) cnot (v(V) where V > 3)) where false.", events, "o")
    assert "+ must not happen: v(V): did not happen" in lines


def test_instant_is_shown_once() -> None:
    events = [("v(2)", read_term("datime(2024,1,1,10,0,0,0)", Operators.prolog(), "test").term)]
    lines = explanation_lines("o <- v(V) where V > 3.", events, "o")
    assert lines == [
        "- where V > 3: false for V = 2 at datime(2024,1,1,10,0,0,0)",
        "+ v(V): V = 2 at datime(2024,1,1,10,0,0,0)",
    ]


def test_times_are_relative_to_an_origin() -> None:
    events = [("v(1)", 100), ("v(2)", 100.25)]
    lines = explanation_lines("o <- v(A) seq v(B) where B > 3.", events, "o", origin=99 * 10**9)
    assert lines[0] == "- where B > 3: false for B = 2 [1,1.25] s"
    assert lines[-1] == "+ v(B): B = 1 at 1 s; B = 2 at 1.25 s"


def test_long_value_is_shortened() -> None:
    lines = explanation_lines("o <- v(V) where V == 0.", [(f"v('{'x' * 500}')", 1)], "o")
    assert len(lines[0]) < 150
    assert lines[0].endswith(" ... at 1")


def test_windows_of_many_events_have_their_intervals() -> None:
    rule = "w(N) <- aggregate(count, in(_), N, last(250)) where N > 900."
    lines = explanation_lines(rule, [(f"in({second})", second) for second in range(260)], "w(_)")
    assert lines[1].endswith("; N = 250 [9,258]; N = 250 [10,259]")


def test_windows_of_omitted_events_are_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(why_not_matched, "MAX_MATCHES", 6)
    rule = "w(N) <- aggregate(count, in(_), N, last(5)) where N > 9."
    events = [(f"in({second})", second) for second in range(8)]
    assert "matches only" not in explanation_lines(rule, events[:6], "w(_)")[1]
    lines = explanation_lines(rule, events, "w(_)")
    assert lines[1] == "+ aggregate over last(5.0) (run again over the newest 6 matches only): N = 5 [3,7]"
    lines = explanation_lines(rule.replace("last(5)", "every(2, events)"), events, "w(_)")
    assert "not tested, because the omitted ones" in lines[1]


def test_first_false_goal_of_conjunction_is_shown() -> None:
    rules = ":- state(on, from(start), until(stop)).\n"
    rules += "w <- in(X) check (t1(S), Y is X * 2, Y > 2, holds(on), S > 9)."
    lines = explanation_lines(rules, STREAM, "w")
    assert lines[1:3] == [
        "- Y > 2: false for Y = 2 at 1",
        "- holds(on): false at 2 (with the states that hold now)",
    ]


@pytest.mark.slow
def test_explanation_does_not_change_counters() -> None:
    engine = Engine()
    record_origins(engine)
    steps = (
        "a(1, many) where T >= 0, b(1, many) where T >= 0, c where T =:= first(b, T), later(d) where T = 500"
    )
    engine.load(rules=f"o(L) <- aggregate(list(T), e(T), L, steps([{steps}])).")
    for number in range(1, 151):
        engine.event(f"e({number})", number)
    before = engine.status()
    assert before.rules[0].dropped
    explain(engine, "o(_)")
    assert engine.status().rules[0].dropped == before.rules[0].dropped
    assert engine.status().warnings == before.warnings
