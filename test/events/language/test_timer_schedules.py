"""Schedules of timers."""

from typing import Optional

import pytest
from asserting_accessors import required
from hypothesis import given
from hypothesis import strategies as st
from parsing import parse_term

from retalis import UsageError
from retalis.events.language.timer_schedules import parse_schedule, schedule_error, sets_timer
from retalis.prolog.terms.timestamps import SECOND

DAY = 86_400


@given(st.integers(1, 10**6), st.integers(1, 4 * 10**18), st.booleans())
def test_next_instant_is_first_multiple_after_present(milliseconds: int, now: int, aligned: bool) -> None:
    period = milliseconds * 10**6
    schedule = parse_schedule(parse_term(f"every({milliseconds / 1000}{'' if aligned else ', from_now'})"))
    next_instant = required(schedule.next_instant(now))
    assert schedule.repeats
    assert schedule.period == period
    assert now < next_instant <= now + period
    assert next_instant % period == 0 if aligned else next_instant == now + period


@pytest.mark.parametrize(
    ("text", "now", "expected"),
    [
        ("at(8,30,0)", 0, 8.5 * 3600),
        ("at(8,30,0)", 8.5 * 3600, DAY + 8.5 * 3600),
        ("at(0,0,1.5)", 10 * DAY, 10 * DAY + 1.5),
        ("at(100)", 99, 100),
        ("at(100)", 100, None),
        ("at(datime(1970,1,1,0,1,0,0))", 5, 60),
        ("at([60,5])", 5, 60.000000005),
        ("after(2.5)", 7, 9.5),
    ],
)
def test_next_instant_of_day_and_of_single_schedules(
    text: str, now: float, expected: Optional[float]
) -> None:
    next_instant = parse_schedule(parse_term(text)).next_instant(int(now * SECOND))
    assert next_instant == (None if expected is None else round(expected * SECOND))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("evry(5)", "expected every(Seconds), every(Seconds, from_now), at("),
        ("every(5, soon)", "expected every(Seconds), every(Seconds, from_now), at("),
        ("5", "expected every(Seconds)"),
        ("every(0)", "every needs a number of seconds of at least 0.001"),
        ("every(0.0001)", "every needs a number of seconds of at least 0.001"),
        ("every(a)", "every needs a number of seconds"),
        ("after(0)", "after needs a number of seconds above 0"),
        ("after(-1)", "after needs a number of seconds above 0"),
        ("after(inf)", "after needs a number of seconds"),
        ("after(1.0e10)", "1000000000 at most"),
        ("at(24,0,0)", "at needs an hour from 0 to 23"),
        ("at(0,60,0)", "at needs an hour from 0 to 23"),
        ("at(0,0,60)", "at needs an hour from 0 to 23"),
        ("at(0.0,0,0)", "at needs an hour from 0 to 23"),
        ("at(noon)", "expected datime("),
        ("at(datime(2026,2,30,0,0,0,0))", "expected datime("),
    ],
)
def test_error_of_schedule_names_expected_form(text: str, message: str) -> None:
    with pytest.raises(UsageError) as raised:
        parse_schedule(parse_term(text))
    assert message in raised.value.message
    assert message in required(schedule_error(parse_term(text)))


@pytest.mark.parametrize("text", ["W", "every(N)", "at(H,0,0)", "every(2)", "at(datime(Y,1,1,0,0,0,0))"])
def test_schedule_with_variables_is_no_error(text: str) -> None:
    assert schedule_error(parse_term(text)) is None


@pytest.mark.parametrize(
    ("text", "is_schedule"),
    [("timer(a, every(1))", True), ("timer(a, W)", True), ("timer(a, 5)", False), ("timer", False)],
)
def test_timer_goals_are_distinguished_from_facts(text: str, is_schedule: bool) -> None:
    assert sets_timer(parse_term(text)) is is_schedule
