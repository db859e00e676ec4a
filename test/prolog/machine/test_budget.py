"""Budgets: remaining limits, nested entries, and limits of calls."""

import threading
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Limits, atom
from retalis.prolog.machine import resource_limits as _budget
from retalis.prolog.machine.resource_limits import (
    LOOP,
    MEGABYTE,
    SLICE,
    Budget,
    CallLimitError,
    LimitError,
    RemainingLimits,
)


class Executor:
    """An executor in which one entry is at work."""

    def __init__(self):
        self.thread, self.entry, self.following = threading.get_ident(), ("outer",), []

    def replace_entry(self, entry):
        """Set the entry; return the previous one."""
        previous, self.entry = self.entry, entry
        return previous

    def call_next(self, work):
        """Note what is to be done after the entry."""
        self.following.append(work)


@pytest.fixture
def budget():
    return Budget()


def test_nothing_is_left_to_look_at_without_limits(budget):
    assert budget.remaining_limits() is None


def test_what_is_left_of_inferences(budget):
    budget.set_limits(Limits(inferences=1000))
    assert budget.remaining_limits() == RemainingLimits(None, 1000, None)
    budget.check_limits(400)
    assert budget.remaining_limits() == RemainingLimits(None, 600, None)


def test_what_is_left_up_to_the_nearest_ceiling_of_a_call(budget):
    budget.check_limits(5000)
    for most in (300, 200):
        budget.add_ceiling(budget.ceiling_after(most), CallLimitError("inference", atom("ball")))
    assert budget.remaining_limits() == RemainingLimits(None, 200, None)
    budget.check_limits(150)
    assert budget.remaining_limits() == RemainingLimits(None, 50, None)
    with pytest.raises(CallLimitError):
        budget.check_limits(51)


def test_what_is_left_up_to_the_nearest_alarm(budget):
    for instant in (1e12, 1e11):
        budget.add_alarm(instant, CallLimitError("time", atom("ball")))
    assert budget.remaining_limits() == RemainingLimits(1e11, None, None)


def test_no_two_ceilings_are_the_same(budget):
    ceilings = []
    for _ in range(3):
        ceilings.append(budget.ceiling_after(10))
        budget.add_ceiling(ceilings[-1], CallLimitError("inference", atom("ball")))
    assert ceilings == [10, 11, 12]


def test_memory_may_grow_by_just_its_limit(budget, monkeypatch):
    used, now = [50 * MEGABYTE], [1.0]
    monkeypatch.setattr(_budget, "resident_bytes", lambda: used[0])
    monkeypatch.setattr(_budget, "monotonic", lambda: now[0])
    budget.set_limits(Limits(megabytes=2))
    for used[0] in (50 * MEGABYTE, 52 * MEGABYTE):
        now[0] += 1.0
        budget.check_limits(1)
    now[0] += 1.0
    used[0] += 1
    with pytest.raises(LimitError, match="memory"):
        budget.check_limits(1)


@pytest.mark.parametrize("now", [0.0, 1.0])
def test_what_is_left_of_memory_is_counted_from_now(budget, monkeypatch, now):
    """At 0 the memory has been measured just before, as far as the budget knows."""
    monkeypatch.setattr(_budget, "resident_bytes", lambda: 50 * MEGABYTE)
    monkeypatch.setattr(_budget, "monotonic", lambda: now)
    budget.set_limits(Limits(megabytes=2))
    assert budget.remaining_limits() == RemainingLimits(None, None, 52 * MEGABYTE)


def test_past_its_seconds_an_entry_gets_as_many_again_once(budget, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(_budget, "monotonic", lambda: now[0])
    budget.set_limits(Limits(seconds=10.0))
    budget.check_limits(1)
    for final in (False, True):
        now[0] += 10.5
        with pytest.raises(LimitError, match="seconds") as caught:
            budget.check_limits(1)
        assert caught.value.is_final == final
        if not final:
            budget.check_limits(1)  # begins the time of the handler
            now[0] += 9.5
            budget.check_limits(1)


def test_an_error_that_is_kept_back_in_a_later_entry_refuses_goals_of_that_one_only(budget):
    budget.set_limits(Limits(inferences=10))
    with pytest.raises(LimitError) as caught:
        budget.check_limits(11)
    budget.reset()
    saved = budget.enter()
    budget.refuse_goals(caught.value)
    with pytest.raises(LimitError):
        budget.check_entry()
    budget.leave(saved)
    budget.check_entry()


@pytest.fixture
def executor():
    made = Executor()
    yield made
    made.thread = None  # what comes after is no work of this entry


def test_each_step_of_pattern_work_that_is_left_out_is_counted_once(budget, executor):
    reports = []
    budget.on_stopped.add(lambda rule, limit, steps, entry: reports.append((rule, limit, steps)))
    budget.set_limits(Limits(inferences=100))
    budget.attach_executor(executor)
    meter = budget.meter("rule")
    while not meter(10):
        pass
    assert meter(10) and meter(10)
    budget.end()
    assert reports == [("rule", "inferences", 3)]


def test_an_entry_inside_of_another_has_limits_of_its_own(budget, executor):
    budget.attach_executor(executor)
    budget.set_limits(Limits(inferences=1000))
    budget.goal = outer = object()
    budget.check_limits(900)

    def inner():
        assert executor.entry == ("inner",) and budget.goal is None
        budget.goal = object()
        budget.check_limits(900)
        return budget.remaining_limits()

    assert budget.run_as_entry(("inner",), inner) == RemainingLimits(None, 100, None)
    assert executor.entry == ("outer",) and budget.goal is outer
    assert budget.remaining_limits() == RemainingLimits(None, 100, None)


def test_output_is_limited_for_each_entry(budget, executor):
    budget.attach_executor(executor)
    budget.set_limits(Limits(output_megabytes=1))
    budget.count_output(MEGABYTE)
    with pytest.raises(LimitError, match="output") as caught:
        budget.count_output(1)
    assert not caught.value.is_final
    budget.count_output(MEGABYTE // 10)  # a handler may write a tenth more
    with pytest.raises(LimitError, match="output") as caught:
        budget.count_output(1)
    assert caught.value.is_final
    (end,) = executor.following
    end()
    budget.count_output(MEGABYTE)


def test_what_no_entry_writes_is_not_limited(budget):
    budget.set_limits(Limits(output_megabytes=1))
    for _ in range(3):
        budget.count_output(MEGABYTE)


def test_a_system_that_does_not_tell_has_no_memory_limit(budget, monkeypatch):
    def missing(*_):
        raise FileNotFoundError

    monkeypatch.setattr(_budget, "open", missing, raising=False)
    budget.set_limits(Limits(megabytes=0))
    assert _budget.resident_bytes() == 0
    budget.check_limits(1)
    budget.check_limits(1)


STEPS = st.one_of(
    st.tuples(st.sampled_from(["check_limits", "count_last_steps"]), st.integers(0, 1500)),
    st.tuples(
        st.sampled_from(["count_slice", "count_loops", "check_entry", "remaining_limits", "end", "inner"])
    ),
    st.tuples(st.just("wait"), st.integers(0, 8)),
    st.tuples(st.just("write"), st.integers(0, 600_000)),
)


class Model:
    """What an entry with a goal may use: its methods return the error that those of a budget raise, or None.

    Attributes:
        spent: inferences, less the tenth that a handler gets.
        pending: steps of which nobody has looked what they use.
        deadline: when its seconds are over; None before somebody has looked.
        printed: bytes of output.
        rounds: 1, or 2 once an error was raised.
    """

    LIMITS = Limits(inferences=4000, seconds=10, output_megabytes=1)

    def __init__(self):
        self.now = 100.0
        self.pending = 0
        self.end()

    def end(self):
        self.spent = self.printed = 0
        self.deadline = None
        self.rounds = 1

    def count(self, steps):
        """Count steps; return the limit that is passed."""
        self.spent += self.pending + steps
        self.pending = 0
        if self.spent > self.LIMITS.inferences:
            return "inferences"
        if self.deadline is None:
            self.deadline = self.now + self.LIMITS.seconds
        return "seconds" if self.now > self.deadline else None

    def raised(self, limit):
        """Return the error for a limit: its name, and whether no program can catch it."""
        if limit is None:
            return None
        final = self.rounds == 2
        if not final:
            self.rounds = 2
            self.spent -= self.LIMITS.inferences // 10
            self.deadline = None
        return limit, final

    def check_limits(self, steps):
        return self.raised(self.count(steps))

    def count_slice(self):
        return self.check_limits(len(SLICE))

    def remaining_limits(self):
        return self.check_limits(0)

    def count_loops(self):
        self.pending += len(LOOP)
        return self.check_limits(0) if self.pending >= len(SLICE) else None

    def count_last_steps(self, steps):
        self.pending += steps
        if self.pending >= len(SLICE):
            self.count(0)

    def check_entry(self):
        pending, self.pending = self.pending, 0  # steps are counted when the next ones are
        error = self.check_limits(0)
        self.pending = pending
        return error

    def inner(self):
        self.pending = 0  # an entry in the midst of another takes over the steps that nobody has looked at

    def write(self, size):
        if self.printed + size > MEGABYTE * (1.0 if self.rounds == 1 else 1.1):
            return self.raised("output")
        self.printed += size
        return None


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.lists(STEPS, max_size=25))
def test_a_goal_may_use_what_the_limits_say_and_once_a_little_more_after_an_error(steps):
    model, budget, executor = Model(), Budget(), Executor()
    budget.set_limits(Model.LIMITS)
    budget.attach_executor(executor)
    budget.goal = object()
    budget.inner = lambda: budget.run_as_entry(("inner",), lambda: budget.check_limits(0))
    budget.write = budget.count_output
    try:
        with patch.object(_budget, "monotonic", lambda: model.now):
            for name, *number in steps:
                if name == "wait":
                    model.now += number[0]
                    continue
                wanted = getattr(model, name)(*number)
                try:
                    found = getattr(budget, name)(*number)
                except LimitError as error:
                    assert (error.limit_name, error.is_final) == wanted
                    assert error.budget is budget and not error.was_refused and not budget.needs_check
                else:
                    assert wanted is None
                    if name == "remaining_limits":
                        assert found == RemainingLimits(
                            model.deadline, Model.LIMITS.inferences - model.spent, None
                        )
    finally:
        executor.thread = None
