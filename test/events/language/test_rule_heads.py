"""Errors in rule heads: events, alarms and synchronized queries."""

import pytest
from asserting_accessors import stream_clock
from events.load_problems import assert_refused, warnings_of
from events.program_runner import ProgramRunner, format_events

from retalis import StreamClock
from retalis.prolog.terms.timestamps import SECOND


@pytest.mark.parametrize(
    ("rule", "column", "part"),
    [
        ("a seq b <- c.", 3, "seq is a pattern operator"),
        ("l : a and b <- c.", 7, "and is a pattern operator"),
        ("a 'SEQ' b <- c.", 3, "seq is a pattern operator"),
        ("a, b <- c.", 2, "write one rule for each"),
        ("a(X) <- b(X), c(X) <- d(X).", 13, "write one rule for each"),
        ("a ; b <- c.", 3, "not one of two"),
        ("(a <- b) <- c.", 4, "not a rule"),
        ("a do f do g <- c.", 3, "one do"),
        ("exceptionAlarm(5, 5) <- a.", 16, "the head of a rule is an event"),
        ("exceptionAlarm(a seq b, 5) <- a.", 18, "pattern operator"),
        ("exceptionAlarm(E, 5) <- a.", 1, "event of this alarm a value"),
        ("exceptionAlarm(e, 1.0Inf) <- a.", 19, "not a number of seconds"),
        ("exceptionAlarmAbsoluteDatime(e, datime(2020,13,1,0,0,0,0)) <- a.", 33, "no such date"),
        ("exceptionAlarmAbsoluteDatime(e, datime(2019,2,29,0,0,0)) <- a.", 33, "no such date"),
        ("exceptionAlarmAbsoluteDatime(e, datime(Y,2,30,0,0,0)) <- a(Y).", 33, "no such date"),
        ("exceptionAlarmAbsoluteDatime(e, datime(2020,1,1,24,0,0)) <- a.", 33, "no such date"),
        ("exceptionAlarmAbsoluteDatime(e, tomorrow) <- a.", 33, "expected datime"),
        ("exceptionAlarmAbsoluteDatime(e, [1,2,3]) <- a.", 33, "two integers"),
        ("synchronized(5, q, []) <- a.", 14, "the head of a rule is an event"),
        ("synchronized(e, (true, 5), []) <- a.", 24, "needs a goal"),
        ("syncronized(e, true, m) <- a.", 22, "list of [Memory, Time]"),
        ("synchronized(e, true, [m]) <- a.", 23, "list of [Memory, Time]"),
    ],
)
def test_invalid_head_is_refused(rule: str, column: int, part: str) -> None:
    assert_refused(rule, column, part)


@pytest.mark.parametrize(
    ("rule", "part"),
    [
        ("synchronised(x, true, []) <- a.", "did you mean synchronized(Event, Query, Memories)?"),
        ("exceptionAlarmAbsoluteDatetime(e, 5) <- a.", "did you mean exceptionAlarmAbsoluteDatime("),
        ("exception_alarm(e, 5) <- a.", "did you mean exceptionAlarm("),
        ("a meets b <- c.", "in patterns meets is an operator"),
        ("a(X) where X > 1 <- c(X).", "in patterns where is an operator"),
        ("X > 1 <- c(X).", "after where"),
        ("synchronized(x, no_such(1), []) <- a.", "no predicate no_such/1"),
        ("rev(a(X)) <- b.", "exactly the event that it names"),
    ],
)
def test_suspicious_head_is_reported(rule: str, part: str) -> None:
    ((_, _, message),) = warnings_of(rule)
    assert part in message


@pytest.mark.parametrize(
    "rules",
    [
        "exceptionAlarmAbsoluteDatime(e, datime(Y,2,29,0,0,0,0)) <- a(Y).",
        "exceptionAlarmAbsoluteDatime(e, [S|R]) <- a(S, R). exceptionAlarmAbsoluteDatime(e, [S,N]) <- a(S,N).",
        "exceptionAlarmAbsoluteDatime(E, T) <- a(E, T). exceptionAlarm(E, T) <- a(E, T).",
        "exceptionAlarmAbsoluteDatime(e, 5) <- a. exceptionAlarmAbsoluteDatime(e, datime(2020,2,29,0,0,0)) <- a.",
        "synchronized(E, Q, L) <- a(E, Q, L). synchronized(x, true, [[m,T]|R]) <- a(T, R).",
        "synchronized(x, true, [P, [m|R]]) <- a(P, R). synchronised(robot, clock) <- a. rev(a(X)) <- b(X).",
        "starts(robot) <- a. and(a, b, c) <- a. aggregate(x) <- a. h(a seq b) <- c. f(x) - g <- a.",
    ],
)
def test_valid_heads_have_no_warnings(rules: str) -> None:
    assert warnings_of(rules) == []


def test_alarm_in_the_past_is_reported_seldom() -> None:
    program = ProgramRunner("exceptionAlarmAbsoluteDatime(e, 3) <- a.")
    program.feed(" ".join(f"a@{second}" for second in range(1, 11)))
    messages = [str(warning).split("\n")[0] for warning in program.warnings]
    assert [text.rsplit(" ", 3)[1] for text in messages] == ["1", "2", "4", "8"]
    assert "so it fires at once; 2 so far" in messages[1]
    assert "so it is an ordinary event; 8 so far" in messages[3]
    assert messages[0].startswith("text:1:1: rule e: the instant of its alarm is in the past")


def test_alarm_in_the_future_is_not_reported() -> None:
    program = ProgramRunner(
        "exceptionAlarmAbsoluteDatime(e, 3) <- a. exceptionAlarm(f, 1) <- a.", clock=StreamClock(0)
    )
    program.feed("a@1")
    program.events.clear()
    stream_clock(program.engine).move_to(4 * SECOND)
    program.engine.advance()
    assert format_events(program.events) == "f@1-2 e@1-3"
    assert program.warnings == []


def test_retraction_of_unknown_event_is_throttled() -> None:
    program = ProgramRunner("rev(a(X)) <- b(X). c(X) <- a(X).", ["revision_flag"])
    program.feed("a(1)@1 b(1)@2")
    assert program.warnings == []
    program.feed(" ".join(f"b(1)@{second}" for second in range(3, 12)) + " rev(z)@20")
    messages = [str(warning).split("\n")[0] for warning in program.warnings]
    assert [text.rsplit(" ", 3)[1] for text in messages] == ["1", "2", "4", "8"]
    assert messages[0] == (
        "text:1:1: rule rev(a(X)): rev retracts nothing: no event a(1) that still holds is known; 1 so far"
    )


def test_rev_is_plain_event_without_revision() -> None:
    program = ProgramRunner("rev(a) <- b.")
    assert program.feed("b@1") == "rev(a)@1-1"
    assert program.warnings == []
