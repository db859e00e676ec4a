"""Warnings about likely mistakes in rules: positions, texts, and no false warnings."""

from itertools import combinations, product
from typing import Any, List

import pytest
from events.load_problems import errors_of, warnings_of
from events.program_runner import ProgramRunner

COMPARISONS = ["X > 1", "X =< 1", "X == 1", "X = 1", "X \\== 1", "Y is X + 1", "X @< 1", "X =:= 1"]


@pytest.mark.parametrize("text", COMPARISONS)
def test_comparison_as_pattern_is_reported(text: str) -> None:
    ((line, column, message),) = warnings_of(f"% first\nc <- a(X) and {text}.")
    assert (line, column) == (2, 17)
    assert message == "this is an event; a condition is written after where"


@pytest.mark.parametrize(
    ("rule", "column", "part"),
    [
        ("c <- a and true.", 12, "true is an event here"),
        ("c <- fail or a.", 6, "fail is an event here"),
        ("c <- [a, b(1)].", 6, "list of patterns is a single event"),
        ("c <- a, b.", 7, "use and or seq"),
        ("c <- a(X), X > 1.", 10, "for a condition, where"),
        ("c <- a ; b.", 8, "use or"),
        (
            "c <- a seq aggregate(count, b).",
            12,
            "aggregate(Kind, Pattern, Result), or 4: aggregate(Kind, Pattern, Result, Window)",
        ),
        (
            "c(N) <- agregate(count, a, N, last(5)).",
            9,
            "did you mean aggregate(Kind, Pattern, Result, Window)?",
        ),
        ("c(N) <- a seq aggregat(count, b, N).", 15, "did you mean aggregate(Kind, Pattern, Result)?"),
        ("c <- a seq abscent(b, 5).", 12, "did you mean absent(Pattern, Seconds)?"),
        ("c <- E.", 6, "E is any event, those of this rule included"),
        ("c do true <- _.", 14, "_ is any event"),
        ("null_event do write(E) <- E.", 27, "E is any event"),
        ("c <- seq(a, b, c).", 6, "seq takes 2 arguments"),
        ("c <- a and cnot(b).", 12, "cnot takes 2 arguments"),
        ("c <- a seq exceptionAlarm(e, 5).", 12, "an alarm is a head"),
        ("c <- a cnot b.", 8, "no R ended before P started"),
        ("c <- (a and b) cnot d.", 16, "no R ended before P started"),
        ("c <- a seq (b cnot d).", 15, "no R ended before P started"),
        ("c <- b <- a.", 8, "put it in brackets"),
        ("l : c do true <- b <- a.", 20, "put it in brackets"),
        ("a seq b.", 3, "an event rule has <-"),
        ("c :- a seq b.", 8, "the arrow of an event rule is <-"),
        ("c :- a where X > 1.", 8, "the arrow of an event rule is <-"),
        ("c <- a(X) where X > 1 within 3.", 23, "(Pattern where Goal) within"),
        ("c <- a(X) where X > 1 or b.", 23, "(Pattern where Goal) or"),
        ("c do ins_event_rule(d <- a, b) <- a.", 6, "needs brackets of its own"),
    ],
)
def test_likely_mistake_is_reported_at_position(rule: str, column: int, part: str) -> None:
    ((_, actual_column, message),) = warnings_of(rule)
    assert part in message
    assert actual_column == column


@pytest.mark.parametrize(
    "rules",
    [
        "c <- a(X) where X > 1. d <- (a where true) and b.",
        "c <- (a seq b) cnot d. c <- (a seq b where true) cnot d. c <- ((a seq b) within 3) cnot d.",
        "c <- a ntimes 2 cnot d. c <- a fnot b.",
        "c <- (b <- a). c <- a seq (b <- a seq d). c <-\n ( b <- a ).",
        "c <- starts(a). d <- meets(a, b, c). e <- where(cup). f <- timestamp(5). g <- check(door).",
        "c <- a(X) where X within 3. within(X, Y) :- X < Y. c :- starts(a, b). starts(a, b).",
        "c <- (a(X) where X > 1) within 3. c <- a seq b(_). c <- E where E. c <- [_|_].",
        "and(1, 1). or(a, b). a : b.",
        "c <- aggregated(a, b, c). d <- agregate(a). e <- absents(a, b) or abscent(a).",
        "c <- a seq E. E do g(E). g(_).",
    ],
)
def test_valid_rules_have_no_warnings(rules: str) -> None:
    assert warnings_of(rules) == []


def test_rules_added_at_run_time_are_checked() -> None:
    program = ProgramRunner(
        "g do ins_event_rule((c <- a, b)) <- a. h do compile_event_rules([(d <- e), (d <- (e ; f))]) <- b."
    )
    program.feed("a@1 b@2")
    assert [str(warning) for warning in program.warnings] == [
        "c<-a,b: a comma between patterns makes them a single event; use and or seq (for a condition, where)",
        "d<-e;f: a semicolon between patterns makes them a single event; use or",
    ]
    assert program.errors == []


def test_error_of_added_rule_names_rule() -> None:
    program = ProgramRunner("g do compile_event_rules([(d <- e), (3 : d <- e), (d seq e <- f)]) <- a.")
    program.feed("a@1")
    (error,) = program.errors
    assert "3 'rule:' d<-e: a label is an atom" in str(error)
    assert "d seq e<-f: the head of a rule is one event" in str(error)


@pytest.mark.parametrize(
    ("rule", "columns"),
    [
        ("c <- a where t1(S).", [14]),
        ("c(S) <- a where (t1(S), t2(E), E > S).", [18, 25]),
        ("c do t1(_) <- a.", [6]),
        ("c <- a seq prolog(t2(_)).", [19]),
        ("c <- a event_multiply once(t1(_)).", [28]),
        ("c <- b seq (a check t1(_)) where call(t2(_)).", [39]),
    ],
)
def test_interval_outside_check_is_refused(rule: str, columns: List[int]) -> None:
    errors = errors_of(rule)
    assert [column for _, column, _ in errors] == columns
    assert all("write check" in message for _, _, message in errors)


@pytest.mark.parametrize(
    "rules",
    [
        "c <- a check (t1(S), t2(E), E > S). c <- a timestamp t1(_).",
        "c <- a where (findall(T, t1(T), L), L == []). c <- a where \\+ t1(_). c <- a where (t1(_) ; true).",
        ":- dynamic(t1/1).\nt1(5). c <- a where t1(_).",
        "c <- a where t1(_). t1(X) :- X = 5.",
    ],
)
def test_interval_may_be_read_in_check(rules: str) -> None:
    program = ProgramRunner(rules)
    assert program.warnings == []
    assert "c@1" in program.feed("a@1-2")


EARLIER_GAP_ADVICE = "in an earlier gap does not prevent a match"
WITHOUT_ADVICE = "; for none during the whole sequence write without in place of cnot"


@pytest.mark.parametrize(
    ("rule", "column", "last_gap"),
    [
        ("o <- ((f seq f seq f) cnot d) within 600.", 23, "((f seq f) seq f) cnot d"),
        ("o <- a * b * c cnot d.", 16, "((a seq b) seq c) cnot d"),
        (
            "o(X) <- (f(X) seq (g or h) seq f(_) seq e) cnot d('A b',X).",
            44,
            "((f(X) seq (g or h) seq f(_)) seq e) cnot d('A b',X)",
        ),
        (
            "o(X) <- ((f(X) seq g seq h(Y) where X > Y) within 5) cnot d.",
            54,
            "((f(X) seq g) seq h(Y)) cnot d",
        ),
        ("o <- (f ntimes 3) cnot d.", 19, "((f ntimes 2) seq f) cnot d"),
        ("o <- (f(_) ntimes 3) cnot d(_).", 22, "((f(_) ntimes 2) seq f(_)) cnot d(_)"),
        ("o(X) <- (f(X) ntimes 30) cnot d(X).", 26, "((f(X) ntimes 29) seq f(X)) cnot d(X)"),
        ("o <- (a seq b seq c(X)) cnot d(X).", 25, "((a seq b) seq c(X)) cnot d(X)"),
    ],
)
def test_cnot_over_long_sequence_is_reported(rule: str, column: int, last_gap: str) -> None:
    ((_, actual_column, message),) = warnings_of(rule)
    assert actual_column == column
    assert message.startswith("cnot covers only the gap before the last part of the sequence, ")
    assert EARLIER_GAP_ADVICE in message
    assert WITHOUT_ADVICE in message
    assert message.endswith(f"; if only the last gap is meant, write {last_gap}")
    assert warnings_of(f"o <- {last_gap}.") == []
    assert warnings_of(rule.replace(" cnot ", " without ")) == []


@pytest.mark.parametrize(
    "rule",
    [
        "o <- (f seq f) cnot d.",
        "o <- (f ntimes 2) cnot d.",
        "o <- (f seq (f seq g)) cnot d.",
        "o <- (((f or g) seq f) seq f) cnot d.",
        "o <- (((f seq f) cnot d) seq f) cnot d.",
        "o <- (a seq b seq c) fnot d.",
        "o <- ((a seq b) cnot d) seq c seq e.",
    ],
)
def test_cnot_between_two_parts_is_not_reported(rule: str) -> None:
    assert warnings_of(rule) == []


@pytest.mark.parametrize("name", ["a" * 100, "a" * 3000])
@pytest.mark.parametrize(
    "pattern", ["(NAME seq f seq f) cnot d", "(f seq f seq NAME) cnot d", "(f seq f seq f) cnot NAME"]
)
def test_warning_omits_long_parts(pattern: str, name: str) -> None:
    ((_, _, message),) = warnings_of(f"o <- {pattern.replace('NAME', name)}.")
    assert message.endswith(WITHOUT_ADVICE)
    assert len(message) < 500


def intervals_without_d(events: Any, times: Any) -> List[Any]:
    """Return the intervals of all sequences of f without a d between the first and the last."""
    instants = [instant for instant, name in enumerate(events) if name == "f"]
    intervals: List[Any] = []
    for positions in combinations(instants, times):
        if "d" not in events[positions[0] : positions[-1]]:
            intervals.append((positions[0], positions[-1]))
    return sorted(intervals)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "times"),
    [("f seq f seq f", 3), ("f ntimes 3", 3), ("f ntimes 4", 4), ("f seq f seq f seq f", 4)],
)
def test_without_excludes_event_in_all_gaps(pattern: str, times: int) -> None:
    advised, original = (
        ProgramRunner(f"o <- ({pattern}) {operator} d.", policy="unrestricted")
        for operator in ("without", "cnot")
    )
    difference_count = 0
    for events in product("fd", repeat=6):
        stream = " ".join(f"{name}@{instant}" for instant, name in enumerate(events))
        outputs = advised.feed(stream)
        intervals = sorted(tuple(map(int, output[2:].split("-"))) for output in outputs.split())
        assert intervals == intervals_without_d(events, times)
        difference_count += len(original.feed(stream).split()) > len(intervals)
        assert advised.engine.call("reset_db")
        assert original.engine.call("reset_db")
    assert difference_count
