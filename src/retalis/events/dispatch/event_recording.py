"""Recording of events: stores, writes or logs them if flags or facts of the program request it."""

import logging
import os
from collections import deque
from typing import Callable, Deque, Iterable, Iterator, List, NamedTuple, Optional

from ...foundation.errors import RetalisError, UsageError
from ...prolog.database.goal_terms import functor_of
from ...prolog.database.predicate import Predicate
from ...prolog.database.predicate_database import Database
from ...prolog.files.file_sandbox import FileSandbox
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.timestamps import interval_term
from ...prolog.terms.types import SLASH, Atom, Frame, Functor, Term, Trail, Values, Var, deref, functor
from ...prolog.terms.unification import undo, unify
from ...serialization.state_fields import StateFields, StateOwner, field, rows_of
from ...serialization.stored_field_types import CALLABLE_TERM, INSTANT
from .dispatcher import Dispatcher
from .listeners import Listener, ListenerPhase

log = logging.getLogger("retalis.events")

_EVENT2 = functor("event", 2)
_MAX_STORED_EVENTS = 100_000
"""Maximum number of events that the flag ``store_fired_events`` keeps; the oldest are dropped."""

_PERSISTENT_FILE = "persistent.txt"
_PERSISTENCE_SELECTOR = functor("persistent_event", 1)
_LOG_SELECTORS = tuple(functor(name, 1) for name in ("external_trigger", "print_trigger", "spy_event"))


class EventSelector(Predicate):
    """Predicate whose facts select events to be logged or written; its first fact starts the recording."""

    def __init__(self, database: Database, key: Functor, start_recording: Callable[[], None]):
        super().__init__(database, key)
        self.dynamic = True
        self._start_recording = start_recording

    def record_change(self) -> None:
        """Start the recording when a clause is added or removed."""
        super().record_change()
        self._start_recording()


class StoredEvent(NamedTuple):
    """An event that the flag ``store_fired_events`` has stored, with its interval in ns."""

    term: Term
    start: int
    end: int


class EventLog(StateOwner):
    """Log of all events.

    A listener exists only while a flag or fact requires it; without one, the log costs nothing.

    Args:
        dispatcher: dispatches the events.
        logic: contains the facts that select events.
        sandbox: writes the file of persistent events.
        on_warning: called with each warning.
    """

    STATE = StateFields(
        field(
            "stored_events",
            rows_of(
                StoredEvent,
                term=CALLABLE_TERM,
                start=INSTANT,
                end=INSTANT,
            ),
        ),
    )

    def __init__(
        self,
        dispatcher: Dispatcher,
        logic: PrologSystem,
        sandbox: FileSandbox,
        on_warning: Callable[[RetalisError], None],
    ):
        self._dispatcher, self._logic = dispatcher, logic
        self._sandbox, self._on_warning = sandbox, on_warning
        self._events: Deque[StoredEvent] = deque(maxlen=_MAX_STORED_EVENTS)
        self._storing_listener: Optional[Listener] = None
        self._recording_listener: Optional[Listener] = None
        self._failed_write_count = 0

    def set_storing(self, is_on: bool) -> None:
        """Start or stop storing events."""
        dispatcher = self._dispatcher
        if is_on and self._storing_listener is None:
            self._storing_listener = dispatcher.listen(ListenerPhase.TRACE, Var(), self._store_event)
        elif not is_on and self._storing_listener is not None:
            dispatcher.remove(self._storing_listener)
            self._storing_listener = None

    def _store_event(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        self._events.append(StoredEvent(term, start, end))
        return frame

    @property
    def stored_events(self) -> List[StoredEvent]:
        """The stored events, the oldest first."""
        return list(self._events)

    @stored_events.setter
    def stored_events(self, events: Iterable[StoredEvent]) -> None:
        self._events.extend(events)

    def clear(self) -> None:
        """Remove all stored events."""
        self._events.clear()

    def define_predicates(self) -> None:
        """Define the predicates whose facts select events."""
        database = self._logic.database
        for key in (_PERSISTENCE_SELECTOR, *_LOG_SELECTORS):
            database.predicates[key] = EventSelector(database, key, self._start_recording)

    def _start_recording(self) -> None:
        """Start to write and log the events that facts of the program select."""
        if self._recording_listener is None:
            self._recording_listener = self._dispatcher.listen(ListenerPhase.TRACE, Var(), self._record)

    def _record(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        if self._is_selected(_PERSISTENCE_SELECTOR, term):
            self._write((_EVENT2, term, interval_term(start, end)))
        if any(self._is_selected(key, term) for key in _LOG_SELECTORS):
            event_term = (_EVENT2, term, interval_term(start, end))
            log.info("%s", self._logic.show(event_term))
        return frame

    def _write(self, event: Term) -> None:
        """Append an event to the file of persistent events; failures are counted, and some of them reported."""
        sandbox, text = self._sandbox, self._logic.show(event)
        try:
            sandbox.append(os.path.join(sandbox.default_output_folder, _PERSISTENT_FILE), f"{text}.\n")
        except RetalisError as error:
            self._failed_write_count += 1
            # Reported at the counts 1, 2, 4, 8 and so on: a full disk must not produce one warning per event.
            if self._failed_write_count & (self._failed_write_count - 1) == 0:
                self._on_warning(
                    UsageError(
                        f"{self._failed_write_count} persistent events could not be written: {error.message}"
                    )
                )

    def _is_selected(self, key: Functor, term: Term) -> bool:
        predicate = self._logic.database.predicates.get(key)
        # A program may redefine or abolish the predicate.
        if predicate is None or predicate.kind != "user":
            return False
        # Facts may be added and removed at any time, so they are read for each event.
        heads = (clause.head for clause in predicate.active_clauses())
        return any(_is_selected_by(deref(head[1]), term) for head in heads if head.__class__ is tuple)


def _is_selected_by(pattern: Term, event: Term) -> bool:
    """Return whether ``Name/Arity`` (both may be variables) or an event pattern matches an event."""
    if pattern.__class__ is tuple and pattern[0] is SLASH:
        key = functor_of(event)
        name, arity = deref(pattern[1]), deref(pattern[2])
        return (name.__class__ is Var or (name.__class__ is Atom and name.name == key.name)) and (
            arity.__class__ is Var or arity == key.arity
        )
    # A copy of the pattern is unified, because facts are shared.
    trail: Trail = []
    try:
        return unify(copy(pattern), event, trail)
    finally:
        undo(trail, 0)


def enumerate_stored_events(
    stored_events: List[StoredEvent], machine: Machine, event: Term, interval: Term
) -> Iterator[bool]:
    """Unify an event and its interval with each stored event."""
    for term, start, end in stored_events:
        mark = len(machine.trail)
        if machine.unify(event, copy(term)) and machine.unify(interval, interval_term(start, end)):
            yield True
        undo(machine.trail, mark)
