"""What rules say that was hardly meant: a warning at its place, and none for what may be meant."""

import pytest
from events.refusals import errors_of, warnings_of
from events.running import Program

COMPARISONS = ["X > 1", "X =< 1", "X == 1", "X = 1", "X \\== 1", "Y is X + 1", "X @< 1", "X =:= 1"]


@pytest.mark.parametrize("text", COMPARISONS)
def test_a_comparison_in_the_place_of_a_pattern_is_an_event(text):
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
def test_warned_of_at_its_place(rule, column, part):
    ((_, at, message),) = warnings_of(rule)
    assert part in message
    assert at == column


@pytest.mark.parametrize(
    "rules",
    [
        "c <- a(X) where X > 1. d <- (a where true) and b.",
        "c <- (a seq b) cnot d. c <- (a seq b where true) cnot d. c <- ((a seq b) within 3) cnot d.",
        "c <- a ntimes 3 cnot d. c <- a fnot b.",
        "c <- (b <- a). c <- a seq (b <- a seq d). c <-\n ( b <- a ).",
        "c <- starts(a). d <- meets(a, b, c). e <- where(cup). f <- timestamp(5). g <- check(door).",
        "c <- a(X) where X within 3. within(X, Y) :- X < Y. c :- starts(a, b). starts(a, b).",
        "c <- (a(X) where X > 1) within 3. c <- a seq b(_). c <- E where E. c <- [_|_].",
        "and(1, 1). or(a, b). a : b.",
        "c <- aggregated(a, b, c). d <- agregate(a). e <- absents(a, b) or abscent(a).",
        "c <- a seq E. E do g(E). g(_).",
    ],
)
def test_what_may_be_meant_is_not_warned_of(rules):
    assert warnings_of(rules) == []


def test_rules_that_come_at_run_time_are_warned_of_by_what_they_are():
    program = Program(
        "g do ins_event_rule((c <- a, b)) <- a. h do compile_event_rules([(d <- e), (d <- (e ; f))]) <- b."
    )
    program.feed("a@1 b@2")
    assert [str(warning) for warning in program.warnings] == [
        "c<-a,b: a comma between patterns makes them a single event; use and or seq (for a condition, where)",
        "d<-e;f: a semicolon between patterns makes them a single event; use or",
    ]
    assert program.errors == []


def test_errors_of_rules_that_come_at_run_time_name_the_rule():
    program = Program("g do compile_event_rules([(d <- e), (3 : d <- e), (d seq e <- f)]) <- a.")
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
def test_the_interval_is_known_in_check_only(rule, columns):
    found = errors_of(rule)
    assert [column for _, column, _ in found] == columns
    assert all("write check" in message for _, _, message in found)


@pytest.mark.parametrize(
    "rules",
    [
        "c <- a check (t1(S), t2(E), E > S). c <- a timestamp t1(_).",
        "c <- a where (findall(T, t1(T), L), L == []). c <- a where \\+ t1(_). c <- a where (t1(_) ; true).",
        ":- dynamic(t1/1).\nt1(5). c <- a where t1(_).",
        "c <- a where t1(_). t1(X) :- X = 5.",
    ],
)
def test_where_the_interval_may_be_asked_for_it_may(rules):
    program = Program(rules)
    assert program.warnings == []
    assert "c@1" in program.feed("a@1-2")
