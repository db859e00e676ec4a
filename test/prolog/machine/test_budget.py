"""Budgets: what is left of the limits, entries inside of others, and ceilings of calls."""

import threading

import pytest

from retalis.prolog.machine import MEGABYTE, Budget, Left, LimitError, LimitPassed, Limits
from retalis.prolog.machine import budget as _budget
from retalis.prolog.terms import atom


class Turn:
    """A turn in which one entry is at work."""

    def __init__(self):
        self.thread, self.entry, self.following = threading.get_ident(), ("outer",), []

    def follow(self, work):
        """Note what is to be done after the entry."""
        self.following.append(work)


@pytest.fixture
def budget():
    return Budget()


def test_nothing_is_left_to_look_at_without_limits(budget):
    assert budget.left() is None


def test_what_is_left_of_inferences(budget):
    budget.allow(Limits(inferences=1000))
    assert budget.left() == Left(None, 1000, None)
    budget.look(400)
    assert budget.left() == Left(None, 600, None)


def test_what_is_left_up_to_the_nearest_ceiling_of_a_call(budget):
    budget.look(5000)
    for most in (300, 200):
        budget.warn_past(budget.cap(most), LimitPassed("inference", atom("ball")))
    assert budget.left() == Left(None, 200, None)
    budget.look(150)
    assert budget.left() == Left(None, 50, None)
    with pytest.raises(LimitPassed):
        budget.look(51)


def test_what_is_left_up_to_the_nearest_alarm(budget):
    for instant in (1e12, 1e11):
        budget.warn_at(instant, LimitPassed("time", atom("ball")))
    assert budget.left() == Left(1e11, None, None)


def test_no_two_ceilings_are_the_same(budget):
    ceilings = []
    for _ in range(3):
        ceilings.append(budget.cap(10))
        budget.warn_past(ceilings[-1], LimitPassed("inference", atom("ball")))
    assert ceilings == [10, 11, 12]


def test_memory_may_grow_by_just_its_limit(budget, monkeypatch):
    used, now = [50 * MEGABYTE], [1.0]
    monkeypatch.setattr(_budget, "resident_bytes", lambda: used[0])
    monkeypatch.setattr(_budget, "monotonic", lambda: now[0])
    budget.allow(Limits(megabytes=2))
    for used[0] in (50 * MEGABYTE, 52 * MEGABYTE):
        now[0] += 1.0
        budget.look(1)
    now[0] += 1.0
    used[0] += 1
    with pytest.raises(LimitError, match="memory"):
        budget.look(1)


def test_what_is_left_of_memory_is_counted_from_now(budget, monkeypatch):
    monkeypatch.setattr(_budget, "resident_bytes", lambda: 50 * MEGABYTE)
    budget.allow(Limits(megabytes=2))
    assert budget.left() == Left(None, None, 52 * MEGABYTE)


def test_past_its_seconds_an_entry_gets_as_many_again_once(budget, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(_budget, "monotonic", lambda: now[0])
    budget.allow(Limits(seconds=10.0))
    budget.look(1)
    for final in (False, True):
        now[0] += 10.5
        with pytest.raises(LimitError, match="seconds") as caught:
            budget.look(1)
        assert caught.value.final == final
        if not final:
            budget.look(1)  # begins the time of the handler
            now[0] += 9.5
            budget.look(1)


def test_an_error_that_is_kept_back_in_a_later_entry_refuses_goals_of_that_one_only(budget):
    budget.allow(Limits(inferences=10))
    with pytest.raises(LimitError) as caught:
        budget.look(11)
    budget.start_anew()
    saved = budget.enter()
    budget.close(caught.value)
    with pytest.raises(LimitError):
        budget.admit()
    budget.leave(saved)
    budget.admit()


@pytest.fixture
def turn():
    made = Turn()
    yield made
    made.thread = None  # what comes after is no work of this entry


def test_each_step_of_pattern_work_that_is_left_out_is_counted_once(budget, turn):
    reports = []
    budget.on_stopped = lambda rule, limit, steps, entry: reports.append((rule, limit, steps))
    budget.allow(Limits(inferences=100))
    budget.count_for(turn)
    meter = budget.meter("rule")
    while not meter(10):
        pass
    assert meter(10) and meter(10)
    budget.end()
    assert reports == [("rule", "inferences", 3)]


def test_an_entry_inside_of_another_has_limits_of_its_own(budget, turn):
    budget.count_for(turn)
    budget.allow(Limits(inferences=1000))
    budget.goal = outer = object()
    budget.look(900)

    def inner():
        assert turn.entry == ("inner",) and budget.goal is None
        budget.goal = object()
        budget.look(900)
        return budget.left()

    assert budget.apart(("inner",), inner) == Left(None, 100, None)
    assert turn.entry == ("outer",) and budget.goal is outer
    assert budget.left() == Left(None, 100, None)


def test_output_is_limited_for_each_entry(budget, turn):
    budget.count_for(turn)
    budget.allow(Limits(output_megabytes=1))
    budget.count_output(MEGABYTE)
    with pytest.raises(LimitError, match="output") as caught:
        budget.count_output(1)
    assert not caught.value.final
    budget.count_output(MEGABYTE // 10)  # a handler may write a tenth more
    with pytest.raises(LimitError, match="output") as caught:
        budget.count_output(1)
    assert caught.value.final
    (end,) = turn.following
    end()
    budget.count_output(MEGABYTE)


def test_what_no_entry_writes_is_not_limited(budget):
    budget.allow(Limits(output_megabytes=1))
    for _ in range(3):
        budget.count_output(MEGABYTE)
