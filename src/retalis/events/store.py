"""What is kept, written or shown of all events, where flags or facts ask for it."""

import logging
from collections import deque
from pathlib import Path
from typing import Any, Deque, Iterator, List, Optional, Tuple

from ..terms import SLASH, Atom, Term, Var, copy, deref, functor, undo, unify
from ..timestamps import interval_term
from .dispatch import Listener, Stage

log = logging.getLogger("retalis.events")

_EVENT2 = functor("event", 2)
_KEPT = 100_000
_PERSISTENT = functor("persistent_event", 1)
_SHOWN = (functor("external_trigger", 1), functor("spy_event", 1))


class Store:
    """Looks on at all events; what is not asked for costs nothing.

    Attributes:
        file: where persistent events are written.
    """

    def __init__(self, rules: Any):
        self._rules = rules
        self._events: Deque[Tuple[Term, int, int]] = deque(maxlen=_KEPT)
        self._storing: Optional[Listener] = None
        self._watching: Optional[Listener] = None
        self.file = Path("persistent.txt")

    def keep_all(self, on: bool) -> None:
        """Store events from now on, or no more."""
        dispatcher = self._rules.dispatcher
        if on and self._storing is None:
            self._storing = dispatcher.listen(Stage.TRACE, Var(), self._keep)
        elif not on and self._storing is not None:
            dispatcher.remove(self._storing)
            self._storing = None

    def _keep(self, term: Term, values: Any, start: int, end: int, after: Any) -> Any:
        self._events.append((term, start, end))
        return after

    def stored(self) -> List[Tuple[Term, int, int]]:
        """Return what was stored, oldest first."""
        return list(self._events)

    def clear(self) -> None:
        """Forget what was stored."""
        self._events.clear()

    def watch(self) -> None:
        """Write and log the events that facts of the program name, from now on."""
        if self._watching is None:
            self._watching = self._rules.dispatcher.listen(Stage.TRACE, Var(), self._look)

    def _look(self, term: Term, values: Any, start: int, end: int, after: Any) -> Any:
        if self._is_named(_PERSISTENT, term):
            event = (_EVENT2, term, interval_term(start, end))
            with self.file.open("a", encoding="utf-8") as file:
                file.write(f"{self._rules.logic.show(event)}.\n")
        if any(self._is_named(key, term) for key in _SHOWN):
            shown = (_EVENT2, term, interval_term(start, end))
            log.info("%s", self._rules.logic.show(shown))
        return after

    def _is_named(self, key: Any, term: Term) -> bool:
        predicate = self._rules.logic.database.predicates.get(key)
        if predicate is None or predicate.kind != "user":
            return False
        return any(_names(deref(clause.head[1]), term) for clause in predicate.live())


def _names(pattern: Term, event: Term) -> bool:
    """Tell whether ``Name/Arity`` (either may be open) or an event pattern fits an event."""
    if pattern.__class__ is tuple and pattern[0] is SLASH:
        key = event.functor if event.__class__ is Atom else event[0]
        name, arity = deref(pattern[1]), deref(pattern[2])
        return (name.__class__ is Var or (name.__class__ is Atom and name.name == key.name)) and (
            arity.__class__ is Var or arity == key.arity
        )
    trail: List[Any] = []
    result = unify(copy(pattern), event, trail)
    undo(trail, 0)
    return result


def solutions(
    found: List[Tuple[Term, int, int]], machine: Any, event: Term, interval: Term
) -> Iterator[bool]:
    """Unify an event and its interval with one stored event after the other."""
    for term, start, end in found:
        mark = len(machine.trail)
        if machine.unify(event, copy(term)) and machine.unify(interval, interval_term(start, end)):
            yield True
        undo(machine.trail, mark)
