"""Who holds up the engine: a thread that looks once in a while at what is at work."""

import os
import threading
import time
from typing import Any, Callable, NamedTuple, Optional, Tuple
from weakref import WeakSet, ref

from ...events.dispatch.dispatcher import Dispatcher
from ...events.dispatch.listeners import TERM
from ...foundation.errors import Place, RuleError, beginning
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.resource_limits import Budget, Turn
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import COMMA, Atom, deref
from .problem_reports import Reports

Warn = Callable[[float, object], None]

_LOOKS = 5
"""Looks within the shortest of the times that matter."""

_MAX_CONJUNCTION_DEPTH = 1000
"""Conjunctions within another's first goal that are looked into."""

_SHORTEST = 0.005
_MAX_LOOK_SECONDS = 0.5


class AtWork(NamedTuple):
    """What is at work.

    Attributes:
        entry: what came in.
        goal: the goal that runs, with its rule; empty for none.
        event: the event that is being served; empty for none.
        place: where the goal stands.
    """

    entry: str
    goal: str
    event: str
    place: Optional[Place]


class Watchdog:
    """Warns of an entry (see `Budget`) that is at work for long, and ends it past its seconds.

    What is at work is noted by whoever works in any case, so looking from outside costs events nothing, and it finds
    also what no goal counts: patterns at work, many short goals, a receiver of outputs that waits.

    Args:
        turn: tells what is at work: its ``thread`` and ``entry``.
        budget: tells what it may use.
        patience: seconds after which is warned, and again after twice that time, and so on; None for never.
        warn: called in the watchdog's thread with the seconds and the entry, while that may still be at work.
    """

    def __init__(self, turn: Turn, budget: Budget, patience: Optional[float], warn: Warn):
        self._turn = turn
        self._budget = budget
        self._patience = patience
        self._warn = warn
        self._entry: object = None
        self._since = 0.0
        self._next: Optional[float] = patience

    def look(self, now: float) -> None:
        """Look what is at work at an instant of the monotonic clock."""
        budget = self._budget
        entry = None if self._turn.thread is None else self._turn.entry
        if entry is None or entry is not self._entry:  # it is held, so no other is taken for it
            self._entry = entry
            self._since = now
            self._next = self._patience
            return
        ran = now - self._since
        seconds = budget.limits.seconds
        if seconds is not None and ran >= seconds * budget.rounds:
            budget.expire(entry)
        if self._next is not None and ran >= self._next:
            self._next *= 2
            self._warn(ran, entry)

    def held(self, now: float) -> Optional[Tuple[object, float]]:
        """Return what is at work, and for how many seconds by the looks so far; None where nothing is."""
        entry = None if self._turn.thread is None else self._turn.entry
        if entry is None:
            return None
        if entry is not self._entry:
            self._entry = entry
            self._since = now
            self._next = self._patience
        return entry, now - self._since

    def pause(self) -> float:
        """Return the seconds to the next look."""
        times = [time for time in (self._patience, self._budget.limits.seconds) if time is not None]
        return max(_SHORTEST, min(_MAX_LOOK_SECONDS, min(times, default=_MAX_LOOK_SECONDS) / _LOOKS))


def watch(
    turn: Turn, logic: PrologSystem, dispatcher: Dispatcher, reports: Reports, patience: Optional[float]
) -> Watchdog:
    """Return what watches an engine as long as somebody holds it, and have it reported what it finds."""
    budget = logic.machine.budget

    def warn(seconds: float, entry: object) -> None:
        try:
            reports.warning(*_held_up(logic, dispatcher, entry, seconds))
        except Exception as error:  # it is at work in another thread; the watch goes on all the same
            reports.error(error)

    def refused(number: int, what: str, entry: object) -> None:
        text = f"{_name(entry)} has exceeded its limit of {what}; goals refused: {number}"
        reports.warning(text, ("refused goals", _name(entry)))

    def stopped(rule: Any, what: str, steps: int, entry: object) -> None:
        name = "taking events back" if rule is None else rule.name
        text = (
            f"{name}: {_name(entry)} has exceeded its limit of {what} while patterns were matched:"
            f" {steps} pairs, items or derived events were left out, with all that would have followed from them"
        )
        reports.warning(RuleError(text, getattr(rule, "place", None)), ("pattern work", name, _name(entry)))

    budget.on_refused = refused
    budget.on_stopped = stopped
    watchdog = Watchdog(turn, budget, patience, warn)
    if patience is not None or budget.limits.seconds is not None:
        _begin(watchdog)
        _BEGUN.add(watchdog)
    return watchdog


def _begin(watchdog: Watchdog) -> None:
    threading.Thread(target=_run, args=(ref(watchdog),), name="retalis watchdog", daemon=True).start()


_BEGUN: "WeakSet[Watchdog]" = WeakSet()


def _begin_in_child() -> None:
    for watchdog in tuple(_BEGUN):
        _begin(watchdog)


if hasattr(os, "register_at_fork"):  # not on Windows; a forked process has none of the threads
    os.register_at_fork(after_in_child=_begin_in_child)


def _run(known: "ref[Watchdog]") -> None:
    while True:
        watchdog = known()
        if watchdog is None:
            return
        watchdog.look(time.monotonic())
        pause = watchdog.pause()
        del watchdog
        time.sleep(pause)


def _held_up(
    logic: PrologSystem, dispatcher: Dispatcher, entry: object, seconds: float
) -> Tuple[RuleError, Tuple[str, str]]:
    """Return a warning of what is at work, and what tells it from others.

    Terms of events and questions are not shown but named: they may be large, and change in the other thread.
    """
    found = at_work(logic, dispatcher, entry)
    who = found.goal or "no goal"
    event = f" at event {found.event}" if found.event else ""
    text = f"{who} is running{event}; {found.entry} has taken {seconds:.1f} s so far"
    return RuleError(text, found.place), ("held up", who)


def at_work(logic: PrologSystem, dispatcher: Dispatcher, entry: object) -> AtWork:
    """Return what is at work in an engine, named by a thread that looks from outside."""
    goal, current = logic.machine.budget.goal, dispatcher.current
    place: Optional[Place] = getattr(entry, "place", None)
    who = ""
    if isinstance(goal, CompiledGoal):
        place = goal.place
        who = f"{goal.name}: goal {beginning(logic.show(goal.term))}"
    elif goal is not None:
        who = f"goal {_name((_first(goal),))}"
    return AtWork(_name(entry), who, "" if current is None else _name((current[TERM],)), place)


def _first(term: Any) -> Any:
    """Return a term, or the first goal of a conjunction: a name of the conjunction says nothing."""
    term = deref(term)
    for _ in range(_MAX_CONJUNCTION_DEPTH):
        if term.__class__ is not tuple or term[0] is not COMMA:
            break
        term = deref(term[1])
    return term


def _name(entry: object) -> str:
    """Name what came in: the functor of a term, the beginning of a text."""
    what = _first(entry[0]) if isinstance(entry, tuple) and entry else None
    if isinstance(what, str):
        return beginning(what)
    if isinstance(what, Atom):
        return beginning(what.name)
    return beginning(str(what[0])) if isinstance(what, tuple) else "a request"
