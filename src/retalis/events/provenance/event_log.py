"""Occurrences of events, which are the nodes of their lineage, and the log of all events.

An `Occurrence` is an event that was dispatched, with links in both directions: to the match that it was derived from,
and to the occurrences derived from it. These links are the derivation graph (why-provenance). Negation adds links of
a third kind: a `Suppressed` match would have fired if a negated event had not occurred; if that event is retracted,
the match is tried again.

Repetitions of a pattern share their events as linked lists of `RepetitionChain`. These are nodes of the derivation
graph as well, so an occurrence has one link for all results of a run, not one per result.

`EventLog` stores, writes or logs all events if flags or facts of the program request it.
"""

import logging
import os
from collections import deque
from typing import (
    TYPE_CHECKING,
    Any,
    Deque,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ...foundation.errors import RetalisError, UsageError
from ...prolog.database.goal_interpreter import functor_of
from ...prolog.database.predicate import Predicate
from ...prolog.machine.machine import Machine
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.timestamps import interval_term
from ...prolog.terms.types import SLASH, Atom, Frame, Functor, Term, Trail, Values, Var, deref, functor
from ...prolog.terms.unification import undo, unify
from ..dispatch.listeners import Listener, ListenerPhase
from ..matches.match_types import (
    Dependent,
    PartialMatch,
    RepetitionChain,
    event_tokens,
    is_retracted,
    lineage_sources,
)

if TYPE_CHECKING:
    from ..network.event_rule import EventRule
    from ..network.join_node import JoinNode
    from ..network.kleene_node import KleeneNode
    from ..network.pattern_nodes import EarlyTestNode, NotNode
    from ..rules.rule_base import RuleBase

    # Nodes that try a match again when the negated match that suppressed it was retracted.
    SuppressingNode = Union[EarlyTestNode, JoinNode, KleeneNode, NotNode]


class Occurrence:
    """Event that was dispatched.

    Attributes:
        term, start, end: the event.
        rule: the rule that raised it, or None.
        match: match of the rule, or of the goal that created it; None for an input event, and if it is forgotten.
        derived: occurrences and repetitions derived from it, as long as it is remembered.
        forgotten: whether it is too old to be remembered; partial matches may still use it, but it has no links.
        dependents: partial matches that use it, and repetitions in runs and stream operators; see `Dependent`.
        retracted: whether it was retracted.
        reported: whether the retraction was reported, by the ``rev`` event that named it or by a derived one.
        retracts: for a derived event ``rev(E)``, the occurrences that it retracts.
        suppressed: matches that it has prevented, with the nodes that try them again.
        number: order of dispatch; 0 if it has not occurred: a pending alarm, or a rejected event.
    """

    __slots__ = (
        "number",
        "term",
        "start",
        "end",
        "rule",
        "match",
        "derived",
        "forgotten",
        "dependents",
        "retracted",
        "reported",
        "retracts",
        "suppressed",
    )

    def __init__(
        self, term: Term, start: int, end: int, rule: Optional["EventRule"], match: Optional[PartialMatch]
    ):
        self.term = term
        self.start = start
        self.end = end
        self.rule = rule
        self.match = match
        self.derived: List[LineageNode] = []
        self.forgotten = False
        self.dependents: List[Dependent] = []
        self.retracted = False
        self.reported = False
        self.retracts: Optional[List[Occurrence]] = None
        self.suppressed: List[Suppressed] = []
        self.number = 0

    def derive_from(self, sources: "Sequence[LineageNode]") -> None:
        """Register the occurrence with those that it is derived from."""
        for source in sources:
            if not source.forgotten:
                source.derived.append(self)

    def sources(self) -> List["Occurrence"]:
        """Return the occurrences that it is derived from, each one once."""
        # A result of ``with`` or ``absent`` refers to its event twice: as element of the operator and as match.
        return [] if self.match is None else list(dict.fromkeys(occurrences_in(self.match)))


LineageNode = Union[Occurrence, RepetitionChain]
"""Node of the derivation graph."""

MatchOrPair = Union[PartialMatch, Tuple[PartialMatch, PartialMatch]]
"""Match, or two matches that are to be joined."""


def take_unreported_derived(source: LineageNode) -> Iterator[Occurrence]:
    """Yield the occurrences derived from a source whose retraction was not reported yet, and mark them as reported.

    Occurrences that were not dispatched are skipped, because no rule has received them.
    """
    # Marked nodes are not visited again, so the traversal is linear and each occurrence is reported once.
    stack = source.derived[::-1]
    while stack:
        derived = stack.pop()
        if not derived.reported:
            derived.reported = True
            if isinstance(derived, RepetitionChain):
                stack.extend(reversed(derived.derived))
            elif derived.number:
                yield derived


class Suppressed:
    """Match, or two matches to be joined, that a negated match has prevented from firing.

    A negated match may consist of several occurrences; the first retraction of an occurrence releases the suppressed
    match.
    """

    __slots__ = ("node", "match_or_pair", "number", "is_released")

    def __init__(self, node: "SuppressingNode", match_or_pair: MatchOrPair, number: int):
        self.node = node
        self.match_or_pair = match_or_pair
        self.number = number
        self.is_released = False

    def release(self) -> bool:
        """Return whether it can be tried now: it was not released before, and its own events are not retracted."""
        if self.is_released:
            return False
        self.is_released = True
        matches = (
            (self.match_or_pair,) if isinstance(self.match_or_pair, PartialMatch) else self.match_or_pair
        )
        return not any(is_retracted(match) for match in matches)


def occurrences_in(match: PartialMatch) -> List[Occurrence]:
    """Return the tracked events of a match."""
    return [token for token in event_tokens(match) if isinstance(token, Occurrence)]


def lineage_nodes_of(match: PartialMatch) -> List[LineageNode]:
    """Return the nodes from which an event or result of a match is derived.

    These are its tracked events, and for repetitions the last `RepetitionChain`, whose links are completed first.
    """
    tracked: List[LineageNode] = []
    for source in lineage_sources(match):
        if isinstance(source, RepetitionChain):
            _link_repetitions(source)
            tracked.append(source)
        elif isinstance(source, Occurrence):
            tracked.append(source)
    return tracked


def _link_repetitions(last: RepetitionChain) -> None:
    """Register repetitions with the events they are made of, and each repetition with its predecessor."""
    new_repetitions = []
    # A run is linked when its first result fires. Links of earlier repetitions exist already, so the walk stops at
    # the first linked one.
    repetition: Any = last
    while repetition.match is not None and not repetition.linked:
        repetition.linked = True
        new_repetitions.append(repetition)
        repetition = repetition.earlier
    for repetition in reversed(new_repetitions):
        origins = lineage_nodes_of(repetition.match)
        if repetition.earlier.match is not None:
            origins.append(repetition.earlier)
        for source in origins:
            # Repetitions are visited from the oldest to the newest, so that the mark of a retracted one reaches all
            # that follow it.
            repetition.retracted = repetition.retracted or source.retracted
            if not source.forgotten:
                source.derived.append(repetition)


log = logging.getLogger("retalis.events")

_EVENT2 = functor("event", 2)
_MAX_STORED_EVENTS = 100_000
"""Maximum number of events that the flag ``store_fired_events`` keeps; the oldest are dropped."""

_PERSISTENT_FILE = "persistent.txt"
_PERSISTENCE_SELECTOR = functor("persistent_event", 1)
_LOG_SELECTORS = tuple(functor(name, 1) for name in ("external_trigger", "print_trigger", "spy_event"))


class EventSelector(Predicate):
    """Predicate whose facts select events to be logged or written; its first fact starts the recording."""

    def __init__(self, rules: "RuleBase", event_log: "EventLog", key: Functor):
        super().__init__(rules.logic.database, key)
        self.dynamic = True
        self._log = event_log

    def record_change(self) -> None:
        """Start the recording when a clause is added or removed."""
        super().record_change()
        self._log.start_recording()


class EventLog:
    """Log of all events.

    A listener exists only while a flag or fact requires it; without one, the log costs nothing.
    """

    def __init__(self, rules: "RuleBase"):
        self._rules = rules
        self._events: Deque[Tuple[Term, int, int]] = deque(maxlen=_MAX_STORED_EVENTS)
        self._storing_listener: Optional[Listener] = None
        self._recording_listener: Optional[Listener] = None
        self._failed_write_count = 0

    def set_storing(self, is_on: bool) -> None:
        """Start or stop storing events."""
        dispatcher = self._rules.dispatcher
        if is_on and self._storing_listener is None:
            self._storing_listener = dispatcher.listen(ListenerPhase.TRACE, Var(), self._store_event)
        elif not is_on and self._storing_listener is not None:
            dispatcher.remove(self._storing_listener)
            self._storing_listener = None

    def _store_event(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        self._events.append((term, start, end))
        return frame

    def stored_events(self) -> List[Tuple[Term, int, int]]:
        """Return the stored events, the oldest first."""
        return list(self._events)

    def restore(self, events: List[Tuple[Term, int, int]]) -> None:
        """Set the stored events."""
        self._events.extend(events)

    def clear(self) -> None:
        """Remove all stored events."""
        self._events.clear()

    def define_predicates(self) -> None:
        """Define the predicates whose facts select events."""
        for key in (_PERSISTENCE_SELECTOR, *_LOG_SELECTORS):
            self._rules.logic.database.predicates[key] = EventSelector(self._rules, self, key)

    def start_recording(self) -> None:
        """Start to write and log the events that facts of the program select."""
        if self._recording_listener is None:
            self._recording_listener = self._rules.dispatcher.listen(ListenerPhase.TRACE, Var(), self._record)

    def _record(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        if self._is_selected(_PERSISTENCE_SELECTOR, term):
            self._write((_EVENT2, term, interval_term(start, end)))
        if any(self._is_selected(key, term) for key in _LOG_SELECTORS):
            event_term = (_EVENT2, term, interval_term(start, end))
            log.info("%s", self._rules.logic.show(event_term))
        return frame

    def _write(self, event: Term) -> None:
        """Append an event to the file of persistent events; failures are counted, and some of them reported."""
        rules = self._rules
        try:
            sandbox = rules.files.sandbox
            sandbox.append(
                os.path.join(sandbox.default_output_folder, _PERSISTENT_FILE), f"{rules.logic.show(event)}.\n"
            )
        except RetalisError as error:
            self._failed_write_count += 1
            # Reported at the counts 1, 2, 4, 8 and so on: a full disk must not produce one warning per event.
            if self._failed_write_count & (self._failed_write_count - 1) == 0:
                rules.on_warning(
                    UsageError(
                        f"{self._failed_write_count} persistent events could not be written: {error.message}"
                    )
                )

    def _is_selected(self, key: Functor, term: Term) -> bool:
        predicate = self._rules.logic.database.predicates.get(key)
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
    result = unify(copy(pattern), event, trail)
    undo(trail, 0)
    return result


def enumerate_stored_events(
    stored_events: List[Tuple[Term, int, int]], machine: Machine, event: Term, interval: Term
) -> Iterator[bool]:
    """Unify an event and its interval with each stored event."""
    for term, start, end in stored_events:
        mark = len(machine.trail)
        if machine.unify(event, copy(term)) and machine.unify(interval, interval_term(start, end)):
            yield True
        undo(machine.trail, mark)
