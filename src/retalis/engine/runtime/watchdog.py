"""Watchdog: a thread that samples the running work, warns about long durations and enforces time limits.

The engine stores its current entry (event, query or other call) anyway, so sampling costs the events nothing. Unlike
the inference counter of the machine, sampling also covers matching of patterns, many short goals, and slow callbacks.
An entry that exceeds its time limit is marked in its budget; the machine stops at the next check.
"""

import os
import threading
import time
from typing import Any, Callable, NamedTuple, Optional, Tuple
from weakref import WeakSet, ref

from ...events.dispatch.dispatcher import Dispatcher
from ...events.dispatch.listeners import TERM
from ...foundation.displayed_text import shorten
from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.resource_limits import Budget
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import COMMA, Atom, deref
from .problem_reports import Reports
from .serial_executor import UNNAMED_REQUEST, SerialExecutor

OnSlowWork = Callable[[float, object], None]
"""Takes the duration of an entry in seconds, and the entry."""

_SAMPLES_PER_LIMIT = 5
"""Minimum number of samples within the shortest configured time limit."""

_MAX_CONJUNCTION_DEPTH = 1000
"""Maximum depth of conjunctions for finding the first goal."""

_MIN_SAMPLE_INTERVAL_SECONDS = 0.005
_MAX_SAMPLE_INTERVAL_SECONDS = 0.5


class RunningWork(NamedTuple):
    """Description of the running work.

    Attributes:
        entry: event, goal or text that was received.
        goal: running goal and its rule; empty if none.
        event: event that is being processed; empty if none.
        place: position of the goal.
    """

    entry: str
    goal: str
    event: str
    place: Optional[Place]


class Watchdog:
    """Watchdog of entries: warns about an entry that runs for a long time, and ends it at its time limit.

    An entry is an event, a query or another call from outside, with everything that it starts.

    Args:
        executor: the executor, with the current ``thread`` and ``entry``.
        warn_after: seconds until the first warning; the interval doubles after each warning. None disables warnings.
        on_warning: called in the watchdog's thread with the duration in seconds and the entry.
    """

    def __init__(
        self, executor: SerialExecutor, budget: Budget, warn_after: Optional[float], on_warning: OnSlowWork
    ):
        self._executor = executor
        self._budget = budget
        self._warn_after = warn_after
        self._on_warning = on_warning
        self._measured_entry: object = None
        self._start_time = 0.0
        self._next_warning: Optional[float] = warn_after
        self._is_started = False

    def start(self) -> None:
        """Start the thread, unless it is running or has nothing to check: neither a warning nor a time limit."""
        if self._is_started or (self._warn_after is None and self._budget.limits.seconds is None):
            return
        self._is_started = True
        _start_thread(self)
        _STARTED_WATCHDOGS.add(self)

    def set_warning_time(self, warn_after: Optional[float]) -> None:
        """Set the seconds until the first warning, for work that starts after this, after the limits were set."""
        self._warn_after = warn_after
        self.start()

    def sample(self, now: float) -> None:
        """Sample the running work at a time of the monotonic clock."""
        budget = self._budget
        entry = None if self._executor.thread is None else self._executor.entry
        if entry is None or entry is not self._measured_entry:
            self._start_measurement(entry, now)
            return
        elapsed = now - self._start_time
        time_limit = budget.limits.seconds
        # After a goal has caught a resource error, the budget grants the time limit once more, and increments
        # `allowance_count`.
        if time_limit is not None and elapsed >= time_limit * budget.allowance_count:
            budget.expire(entry)
        if self._next_warning is not None and elapsed >= self._next_warning:
            self._next_warning *= 2
            self._on_warning(elapsed, entry)

    def find_running_entry(self, now: float) -> Optional[Tuple[object, float]]:
        """Return the running entry and its measured duration in seconds; None if nothing is running.

        The duration of a new entry is measured from this call on.
        """
        entry = None if self._executor.thread is None else self._executor.entry
        if entry is None:
            return None
        if entry is not self._measured_entry:
            self._start_measurement(entry, now)
        return entry, now - self._start_time

    def _start_measurement(self, entry: object, now: float) -> None:
        # The reference keeps the entry alive, so another entry cannot have the same identity.
        self._measured_entry = entry
        self._start_time = now
        self._next_warning = self._warn_after

    def compute_sample_interval(self) -> float:
        """Return the time until the next sample in seconds."""
        limits = [limit for limit in (self._warn_after, self._budget.limits.seconds) if limit is not None]
        return max(
            _MIN_SAMPLE_INTERVAL_SECONDS,
            min(
                _MAX_SAMPLE_INTERVAL_SECONDS,
                min(limits, default=_MAX_SAMPLE_INTERVAL_SECONDS) / _SAMPLES_PER_LIMIT,
            ),
        )


def start_watchdog(
    executor: SerialExecutor,
    logic: PrologSystem,
    dispatcher: Dispatcher,
    reports: Reports,
    warn_after: Optional[float],
) -> Watchdog:
    """Create the watchdog of an engine, and start its thread if it has a time to check."""
    budget = logic.machine.budget

    def warn(seconds: float, entry: object) -> None:
        try:
            reports.warning(*_make_slow_work_warning(logic, dispatcher, entry, seconds))
        except Exception as error:
            # The engine's thread may change the data while it is read here. Such an error must not end the watchdog.
            reports.error(error)

    watchdog = Watchdog(executor, budget, warn_after, warn)
    watchdog.start()
    return watchdog


def report_exceeded_limits(budget: Budget, reports: Reports) -> None:
    """Report goals and pattern work that a budget omits because an entry has exceeded a limit."""

    def warn_of_refusal(goal_count: int, limit: str, entry: object) -> None:
        text = f"{_describe_entry(entry)} has exceeded its limit of {limit}; goals refused: {goal_count}"
        reports.warning(text, ("refused goals", _describe_entry(entry)))

    def warn_of_stop(rule: Any, limit: str, omitted_count: int, entry: object) -> None:
        name = "retraction of events" if rule is None else f"rule {rule.name}"
        text = (
            f"{name}: {_describe_entry(entry)} has exceeded its limit of {limit} while patterns were matched:"
            f" {omitted_count} pairs, items or derived events were omitted, with all their consequences"
        )
        reports.warning(
            RuleError(text, getattr(rule, "place", None)), ("pattern work", name, _describe_entry(entry))
        )

    budget.on_refused.add(warn_of_refusal)
    budget.on_stopped.add(warn_of_stop)


def _start_thread(watchdog: Watchdog) -> None:
    threading.Thread(
        target=_sample_periodically, args=(ref(watchdog),), name="retalis watchdog", daemon=True
    ).start()


_STARTED_WATCHDOGS: "WeakSet[Watchdog]" = WeakSet()


def _restart_in_child() -> None:
    for watchdog in tuple(_STARTED_WATCHDOGS):
        _start_thread(watchdog)


# A forked process has none of the threads of its parent. Not available on Windows.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_restart_in_child)


def _sample_periodically(reference: "ref[Watchdog]") -> None:
    """Sample the running work until the watchdog is deleted."""
    while True:
        # A weak reference, so that the thread ends when the engine is deleted.
        watchdog = reference()
        if watchdog is None:
            return
        watchdog.sample(time.monotonic())
        pause = watchdog.compute_sample_interval()
        # The reference must not be held during the sleep, or the engine would never be deleted.
        del watchdog
        time.sleep(pause)


def _make_slow_work_warning(
    logic: PrologSystem, dispatcher: Dispatcher, entry: object, seconds: float
) -> Tuple[RuleError, Tuple[str, str]]:
    """Return a warning about the running work, and the key by which equal warnings are counted.

    Terms of events and queries are not shown, only named: they may be large, and the other thread may change them.
    """
    work = describe_work(logic, dispatcher, entry)
    goal_text = work.goal or "no goal"
    event = f" at event {work.event}" if work.event else ""
    text = f"{goal_text} is running{event}; {work.entry} has taken {seconds:.1f} s so far"
    return RuleError(text, work.place), ("held up", goal_text)


def describe_work(logic: PrologSystem, dispatcher: Dispatcher, entry: object) -> RunningWork:
    """Return a description of the running work; may be called from any thread."""
    goal, current = logic.machine.budget.goal, dispatcher.current
    place: Optional[Place] = getattr(entry, "place", None)
    goal_text = ""
    if isinstance(goal, CompiledGoal):
        place = goal.place
        goal_text = f"{goal.name}: goal {shorten(logic.show(goal.term))}"
    elif goal is not None:
        goal_text = f"goal {_describe_term(goal)}"
    return RunningWork(
        _describe_entry(entry), goal_text, "" if current is None else _describe_term(current[TERM]), place
    )


def _find_first_goal(term: Any) -> Any:
    """Return the first goal of a conjunction, because the functor ``,/2`` does not identify a goal; else the term."""
    term = deref(term)
    for _ in range(_MAX_CONJUNCTION_DEPTH):
        if term.__class__ is not tuple or term[0] is not COMMA:
            break
        term = deref(term[1])
    return term


def _describe_entry(entry: object) -> str:
    """Return a short name of an entry, a tuple that begins with a term or a text; other objects have no name."""
    return _describe_term(entry[0]) if isinstance(entry, tuple) and entry else UNNAMED_REQUEST.name


def _describe_term(term: Any) -> str:
    """Return a short name of a term or text: the functor of its first goal, or the beginning of the text."""
    goal = _find_first_goal(term)
    if isinstance(goal, str):
        return shorten(goal)
    if isinstance(goal, Atom):
        return shorten(goal.name)
    return shorten(str(goal[0])) if isinstance(goal, tuple) else UNNAMED_REQUEST.name
