"""Budgets: remaining limits, nested entries, and limits of calls."""

import threading
from types import SimpleNamespace
from typing import Any, Dict, Iterator, List, Optional, Tuple
from unittest.mock import patch

import pytest
from asserting_accessors import required
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Limits, atom
from retalis.prolog.machine import resource_limits
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
    """An executor that executes an entry in this thread."""

    def __init__(self) -> None:
        self.thread: Optional[int] = threading.get_ident()
        self.entry = ("outer",)
        self.following: List[Any] = []

    def replace_entry(self, entry: Any) -> Any:
        """Set the entry; return the previous one."""
        previous, self.entry = self.entry, entry
        return previous

    def call_next(self, work: Any) -> None:
        """Record work that follows the entry."""
        self.following.append(work)


@pytest.fixture
def budget() -> Any:
    return Budget()


def test_budget_without_limits_has_no_remaining_ones(budget: Any) -> None:
    assert budget.remaining_limits() is None


def test_checked_inferences_are_subtracted(budget: Any) -> None:
    budget.set_limits(Limits(inferences=1000))
    assert budget.remaining_limits() == RemainingLimits(None, 1000, None)
    budget.check_limits(400)
    assert budget.remaining_limits() == RemainingLimits(None, 600, None)


def test_lowest_ceiling_limits_inferences(budget: Any) -> None:
    budget.check_limits(5000)
    for limit in (300, 200):
        budget.add_ceiling(budget.ceiling_after(limit), CallLimitError("inference", atom("ball")))
    assert budget.remaining_limits() == RemainingLimits(None, 200, None)
    budget.check_limits(150)
    assert budget.remaining_limits() == RemainingLimits(None, 50, None)
    with pytest.raises(CallLimitError):
        budget.check_limits(51)


def test_earliest_alarm_limits_seconds(budget: Any) -> None:
    for instant in (1e12, 1e11):
        budget.add_alarm(instant, CallLimitError("time", atom("ball")))
    assert budget.remaining_limits() == RemainingLimits(1e11, None, None)


def test_equal_ceilings_become_distinct(budget: Any) -> None:
    ceilings: List[Any] = []
    for _ in range(3):
        ceilings.append(budget.ceiling_after(10))
        budget.add_ceiling(ceilings[-1], CallLimitError("inference", atom("ball")))
    assert ceilings == [10, 11, 12]


def test_memory_growth_beyond_limit_is_error(budget: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    process = SimpleNamespace(size=50 * MEGABYTE, now=1.0)
    monkeypatch.setattr(resource_limits, "resident_bytes", lambda: process.size)
    monkeypatch.setattr(resource_limits, "monotonic", lambda: process.now)
    budget.set_limits(Limits(megabytes=2))
    for process.now, process.size in ((2.0, 50 * MEGABYTE), (3.0, 52 * MEGABYTE)):
        budget.check_limits(1)
    process.now, process.size = 4.0, 52 * MEGABYTE + 1
    with pytest.raises(LimitError, match="memory"):
        budget.check_limits(1)


@pytest.mark.parametrize("now", [0.0, 1.0])
def test_remaining_memory_counts_from_present_size(
    budget: Any, monkeypatch: pytest.MonkeyPatch, now: float
) -> None:
    """At time 0 the budget assumes that the memory has just been measured."""
    monkeypatch.setattr(resource_limits, "resident_bytes", lambda: 50 * MEGABYTE)
    monkeypatch.setattr(resource_limits, "monotonic", lambda: now)
    budget.set_limits(Limits(megabytes=2))
    assert budget.remaining_limits() == RemainingLimits(None, None, 52 * MEGABYTE)


def test_exceeded_seconds_are_granted_once_again(budget: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(resource_limits, "monotonic", lambda: clock.now)
    budget.set_limits(Limits(seconds=10.0))
    budget.check_limits(1)
    clock.now = 110.5
    with pytest.raises(LimitError, match="seconds") as error:
        budget.check_limits(1)
    assert not error.value.is_final
    budget.check_limits(1)  # begins the time of the handler
    clock.now = 120.0
    budget.check_limits(1)
    clock.now = 121.0
    with pytest.raises(LimitError, match="seconds") as error:
        budget.check_limits(1)
    assert error.value.is_final


def test_refusal_of_goals_ends_with_entry(budget: Any) -> None:
    budget.set_limits(Limits(inferences=10))
    with pytest.raises(LimitError) as error:
        budget.check_limits(11)
    budget.reset()
    saved = budget.enter()
    budget.refuse_goals(error.value)
    with pytest.raises(LimitError):
        budget.check_entry()
    budget.leave(saved)
    budget.check_entry()


@pytest.fixture
def executor() -> Iterator[Any]:
    busy_executor = Executor()
    yield busy_executor
    busy_executor.thread = None  # the entry has ended


def test_skipped_pattern_steps_are_counted_once(executor: Any) -> None:
    reports: List[Any] = []
    budget = Budget(Limits(inferences=100), executor)
    budget.on_stopped.add(lambda label, limit, steps, entry: reports.append((label, limit, steps)))
    meter = required(budget.meter("rule"))
    while not meter(10):
        pass
    assert meter(10)
    assert meter(10)
    budget.end()
    assert reports == [("rule", "inferences", 3)]


def test_nested_entry_has_its_own_limits(executor: Any) -> None:
    budget = Budget(Limits(inferences=1000), executor)
    budget.goal = outer = object()
    budget.check_limits(900)

    def inner() -> Any:
        assert executor.entry == ("inner",)
        assert budget.goal is None
        budget.goal = object()
        budget.check_limits(900)
        return budget.remaining_limits()

    assert budget.run_as_entry(("inner",), inner) == RemainingLimits(None, 100, None)
    assert executor.entry == ("outer",)
    assert budget.goal is outer
    assert budget.remaining_limits() == RemainingLimits(None, 100, None)


def test_output_is_limited_per_entry(executor: Any) -> None:
    budget = Budget(Limits(output_megabytes=1), executor)
    budget.count_output(MEGABYTE)
    with pytest.raises(LimitError, match="output") as error:
        budget.count_output(1)
    assert not error.value.is_final
    budget.count_output(MEGABYTE // 10)  # a handler may write a tenth more
    with pytest.raises(LimitError, match="output") as error:
        budget.count_output(1)
    assert error.value.is_final
    (end,) = executor.following
    end()
    budget.count_output(MEGABYTE)


def test_output_outside_entries_is_unlimited(budget: Any) -> None:
    budget.set_limits(Limits(output_megabytes=1))
    for _ in range(3):
        budget.count_output(MEGABYTE)


def test_unknown_memory_size_disables_limit(budget: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: Any) -> None:
        raise FileNotFoundError

    monkeypatch.setattr(resource_limits, "open", missing, raising=False)
    budget.set_limits(Limits(megabytes=0))
    assert resource_limits.resident_bytes() == 0
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


class BudgetModel:
    """A model of a budget for one entry with a goal.

    Its methods return the error that the methods of a budget raise, or None.

    Attributes:
        spent: inferences, less the tenth that a handler gets.
        pending: steps that have not been checked.
        deadline: time (s) at which the seconds are exceeded; None before the first check.
        printed: bytes of output.
        rounds: 1 before the first error, then 2.
    """

    INFERENCES = 4000
    SECONDS = 10.0
    LIMITS = Limits(inferences=INFERENCES, seconds=SECONDS, output_megabytes=1)

    def __init__(self) -> None:
        self.now = 100.0
        self.pending = 0
        self.end()

    def end(self) -> None:
        self.spent = self.printed = 0
        self.deadline: Optional[float] = None
        self.rounds = 1

    def count(self, steps: int) -> Any:
        """Count steps and return the exceeded limit, or None."""
        self.spent += self.pending + steps
        self.pending = 0
        if self.spent > self.INFERENCES:
            return "inferences"
        if self.deadline is None:
            self.deadline = self.now + self.SECONDS
        return "seconds" if self.now > self.deadline else None

    def raised(self, limit: str) -> Optional[Tuple[Any, ...]]:
        """Return the error for an exceeded limit: its name and whether it is final."""
        if limit is None:
            return None
        final = self.rounds == 2
        if not final:
            self.rounds = 2
            self.spent -= self.INFERENCES // 10
            self.deadline = None
        return limit, final

    def check_limits(self, steps: int) -> Any:
        return self.raised(self.count(steps))

    def count_slice(self) -> Any:
        return self.check_limits(len(SLICE))

    def remaining_limits(self) -> Any:
        return self.check_limits(0)

    def count_loops(self) -> Any:
        self.pending += len(LOOP)
        return self.check_limits(0) if self.pending >= len(SLICE) else None

    def count_last_steps(self, steps: Any) -> None:
        self.pending += steps
        if self.pending >= len(SLICE):
            self.count(0)

    def check_entry(self) -> Any:
        pending, self.pending = self.pending, 0  # steps are counted when the next ones are
        error = self.check_limits(0)
        self.pending = pending
        return error

    def inner(self) -> None:
        self.pending = 0  # a nested entry takes over the steps that have not been checked

    def write(self, size: Any) -> Any:
        if self.printed + size > MEGABYTE * (1.0 if self.rounds == 1 else 1.1):
            return self.raised("output")
        self.printed += size
        return None


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.lists(STEPS, max_size=25))
def test_budget_agrees_with_model_of_limits(steps: List[Any]) -> None:
    model = BudgetModel()
    executor: Any = Executor()
    budget = Budget(BudgetModel.LIMITS, executor)
    budget.goal = object()

    def inner() -> object:
        return budget.run_as_entry(("inner",), lambda: budget.check_limits(0))

    other_names: Dict[str, Any] = {"inner": inner, "write": budget.count_output}
    try:
        with patch.object(resource_limits, "monotonic", lambda: model.now):
            for name, *number in steps:
                if name == "wait":
                    model.now += number[0]
                    continue
                expected = getattr(model, name)(*number)
                result = raised = None
                try:
                    result = (other_names.get(name) or getattr(budget, name))(*number)
                except LimitError as error:
                    raised = error
                if raised is not None:
                    assert (raised.limit_name, raised.is_final) == expected
                    assert raised.budget is budget
                    assert not raised.was_refused
                    assert not budget.needs_check
                    continue
                assert expected is None
                if name == "remaining_limits":
                    assert result == RemainingLimits(
                        model.deadline, BudgetModel.INFERENCES - model.spent, None
                    )
    finally:
        executor.thread = None
