"""What is kept, written or shown of all events, where flags or facts ask for it."""

import logging
import os
from collections import deque
from typing import Deque, Iterator, List, Optional, Tuple

from ...foundation import RetalisError, UsageError
from ...prolog.database import Predicate, functor_of
from ...prolog.machine import Frame, Machine
from ...prolog.terms import (
    SLASH,
    Atom,
    Functor,
    Term,
    Trail,
    Values,
    Var,
    copy,
    deref,
    functor,
    interval_term,
    undo,
    unify,
)
from ..dispatch import Listener, Stage
from .owners import Remembered

log = logging.getLogger("retalis.events")

_EVENT2 = functor("event", 2)
_KEPT = 100_000
_FILE = "persistent.txt"
_PERSISTENT = functor("persistent_event", 1)
_SHOWN = tuple(functor(name, 1) for name in ("external_trigger", "print_trigger", "spy_event"))


class EventList(Predicate):
    """A predicate whose facts name events: as soon as it has one, all events are looked at."""

    def __init__(self, rules: Remembered, store: "Store", key: Functor):
        super().__init__(rules.logic.database, key)
        self.dynamic = True
        self._store = store

    def changed(self) -> None:
        """Do what has to be done when a clause comes or goes."""
        super().changed()
        self._store.watch()


class Store:
    """Looks on at all events; what is not asked for costs nothing."""

    def __init__(self, rules: Remembered):
        self._rules = rules
        self._events: Deque[Tuple[Term, int, int]] = deque(maxlen=_KEPT)
        self._storing: Optional[Listener] = None
        self._watching: Optional[Listener] = None
        self._unwritten = 0

    def keep_all(self, on: bool) -> None:
        """Store events from now on, or no more."""
        dispatcher = self._rules.dispatcher
        if on and self._storing is None:
            self._storing = dispatcher.listen(Stage.TRACE, Var(), self._keep)
        elif not on and self._storing is not None:
            dispatcher.remove(self._storing)
            self._storing = None

    def _keep(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        self._events.append((term, start, end))
        return after

    def stored(self) -> List[Tuple[Term, int, int]]:
        """Return what was stored, oldest first."""
        return list(self._events)

    def restore(self, events: List[Tuple[Term, int, int]]) -> None:
        """Have stored what another one had."""
        self._events.extend(events)

    def clear(self) -> None:
        """Forget what was stored."""
        self._events.clear()

    def define(self) -> None:
        """Have the facts that name events be noticed."""
        for key in (_PERSISTENT, *_SHOWN):
            self._rules.logic.database.predicates[key] = EventList(self._rules, self, key)

    def watch(self) -> None:
        """Write and log the events that facts of the program name, from now on."""
        if self._watching is None:
            self._watching = self._rules.dispatcher.listen(Stage.TRACE, Var(), self._look)

    def _look(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        if self._is_named(_PERSISTENT, term):
            self._write((_EVENT2, term, interval_term(start, end)))
        if any(self._is_named(key, term) for key in _SHOWN):
            shown = (_EVENT2, term, interval_term(start, end))
            log.info("%s", self._rules.logic.show(shown))
        return after

    def _write(self, event: Term) -> None:
        """Write a persistent event; what cannot be written is counted and reported at 1, 2, 4, 8 ... of them."""
        rules = self._rules
        try:
            door = rules.files.door
            door.append(os.path.join(door.output, _FILE), f"{rules.logic.show(event)}.\n")
        except RetalisError as error:
            self._unwritten += 1
            if self._unwritten & (self._unwritten - 1) == 0:
                rules.on_warning(
                    UsageError(f"{self._unwritten} persistent events could not be written: {error.message}")
                )

    def _is_named(self, key: Functor, term: Term) -> bool:
        predicate = self._rules.logic.database.predicates.get(key)
        if predicate is None or predicate.kind != "user":
            return False
        heads = (clause.head for clause in predicate.live())
        return any(_names(deref(head[1]), term) for head in heads if head.__class__ is tuple)


def _names(pattern: Term, event: Term) -> bool:
    """Tell whether ``Name/Arity`` (either may be open) or an event pattern fits an event."""
    if pattern.__class__ is tuple and pattern[0] is SLASH:
        key = functor_of(event)
        name, arity = deref(pattern[1]), deref(pattern[2])
        return (name.__class__ is Var or (name.__class__ is Atom and name.name == key.name)) and (
            arity.__class__ is Var or arity == key.arity
        )
    trail: Trail = []
    result = unify(copy(pattern), event, trail)
    undo(trail, 0)
    return result


def solutions(
    found: List[Tuple[Term, int, int]], machine: Machine, event: Term, interval: Term
) -> Iterator[bool]:
    """Unify an event and its interval with one stored event after the other."""
    for term, start, end in found:
        mark = len(machine.trail)
        if machine.unify(event, copy(term)) and machine.unify(interval, interval_term(start, end)):
            yield True
        undo(machine.trail, mark)
