"""Events ``exceptionAlarm`` and ``exceptionAlarmAbsoluteDatime``: their times, and alarms that are retracted."""

from typing import Sequence

import pytest
from events.program_runner import ProgramRunner, format_events

from retalis import StreamClock
from retalis.prolog.terms.timestamps import SECOND


def output_of_alarms(rules: str, stream: str, until: int, flags: Sequence[str] = ()) -> str:
    clock = StreamClock(0)
    program = ProgramRunner(rules, flags, clock=clock)
    program.feed(stream)
    del program.events[:]
    clock.move_to(until * SECOND)
    program.engine.advance()
    return format_events(program.events)


def test_alarm_is_emitted_after_its_delay() -> None:
    rules = "exceptionAlarm(ding(X),5) <- a(X). c(X) <- ding(X)."
    assert output_of_alarms(rules, "a(1)@1-2", 6) == ""
    assert output_of_alarms(rules, "a(1)@1-2", 7) == "ding(1)@1-7 c(1)@1-7"


def test_alarm_is_emitted_at_its_instant() -> None:
    assert output_of_alarms("exceptionAlarmAbsoluteDatime(ding,7) <- a.", "a@1", 8) == "ding@1-7"


def test_alarm_is_emitted_after_deletion_of_rule() -> None:
    rules = "l : exceptionAlarm(ding, 5) <- a. gone do del_event_rule(l) <- b."
    assert output_of_alarms(rules, "a@1 b@2 a@3", 10) == "ding@1-6"


@pytest.mark.parametrize(
    ("rules", "events"),
    [
        ("exceptionAlarm(ding, 5) <- a.", "ding@1-6"),
        ("exceptionAlarmAbsoluteDatime(ding, 7) <- a. c <- ding.", "ding@1-7 c@1-7"),
        ("exceptionAlarm(ding, 5) <- a seq b. c <- ding.", "ding@1-7 c@1-7"),
        ("exceptionAlarm(ding, N) <- a seq b where N = 5.", "ding@1-7"),
    ],
)
def test_retraction_cancels_pending_alarm(rules: str, events: str) -> None:
    assert output_of_alarms(rules, "a@1 b@2", 20, ["revision_flag"]) == events
    assert output_of_alarms(rules, "a@1 b@2 rev(a)@3", 20, ["revision_flag"]) == ""


def test_emitted_alarm_is_retracted() -> None:
    clock = StreamClock(0)
    program = ProgramRunner("exceptionAlarm(ding, 5) <- a. c <- ding.", ["revision_flag"], clock=clock)
    program.feed("a@1")
    clock.move_to(6 * SECOND)
    assert program.feed("rev(a)@7").endswith("rev(ding)@7-7 rev(c)@7-7")


def test_alarm_precedes_event_of_same_instant() -> None:
    clock = StreamClock(0)
    program = ProgramRunner("exceptionAlarm(ding, 5) <- a. c <- b fnot ding.", clock=clock)
    program.feed("a@1")
    clock.move_to(6 * SECOND)
    del program.events[:]
    program.engine.event("b", 6, 6)
    assert format_events(program.events) == "ding@1-6 b@6-6 c@6-6"


def test_alarm_without_delay_is_reported() -> None:
    program = ProgramRunner("exceptionAlarm(ding,N) <- a(N).")
    assert program.feed("a(0)@1") == ""
    assert "positive number" in str(program.errors[0])
