"""The program whose events are kept, as far as what keeps them looks at it.

Events as they are remembered: what they came from, what came from them, what they kept from firing.

What is kept, written or shown of all events, where flags or facts ask for it.
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
    Protocol,
    Sequence,
    Tuple,
    Union,
)

from ...foundation.errors import RetalisError, UsageError
from ...prolog.database.control_constructs import functor_of
from ...prolog.database.predicate import Predicate
from ...prolog.machine.machine import Machine
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.timestamps import interval_term
from ...prolog.terms.types import SLASH, Atom, Frame, Functor, Term, Trail, Values, Var, deref, functor
from ...prolog.terms.unification import undo, unify
from ..dispatch.listeners import Listener, ListenerPhase
from ..matches.partial_matches import Holder, PartialMatch, TrackedMatch, leaves, sources, taken_back

if TYPE_CHECKING:
    from ..network.event_rule import EventRule
    from ..rules.rule_base import RuleBase


class Occurrence:
    """An event that was dispatched.

    Attributes:
        term, start, end: the event.
        rule: the rule that fired it, or None.
        match: what its rule, or the goal that made it, had matched; None for an event from outside.
        derived: the events that came from it, while it is remembered.
        forgotten: whether it is too old to be remembered; what waits may still hold it.
        held: partial matches that hold it.
        gone: whether it was taken back.
        reported: whether that has been said: by the ``rev`` that named it, or by one that was derived for it.
        takes_back: the occurrences that it takes back, for an event ``rev(E)`` that was derived.
        suppressed: what it has kept from firing, with the node to try again.
        number: the larger, the later it was dispatched; 0 for what has not happened: an alarm that is pending, or
            an event that was refused.
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
        "held",
        "gone",
        "reported",
        "takes_back",
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
        self.derived: List[Tracked] = []
        self.forgotten = False
        self.held: List[Holder] = []
        self.gone = False
        self.reported = False
        self.takes_back: Optional[List[Occurrence]] = None
        self.suppressed: List[Suppressed] = []
        self.number = 0

    def follows(self, found: "Sequence[Tracked]") -> None:
        """Have what it came from know it."""
        for source in found:
            if not source.forgotten:
                source.derived.append(self)

    def sources(self) -> List["Occurrence"]:
        """Return the occurrences that it came from."""
        return [] if self.match is None else occurrences_in(self.match)


Tracked = Union[Occurrence, TrackedMatch]
Tried = Union[PartialMatch, Tuple[PartialMatch, PartialMatch]]
"""A match, or two that are to be joined."""


def following(source: Tracked) -> Iterator[Occurrence]:
    """Yield the events that came from one and that nobody has been told of; what has been is not gone into.

    Nor is what has not happened: nobody knows of it.
    """
    stack = source.derived[::-1]
    while stack:
        one = stack.pop()
        if not one.reported:
            one.reported = True
            if isinstance(one, TrackedMatch):
                stack.extend(reversed(one.derived))
            elif one.number:
                yield one


class TriesAgain(Protocol):
    """A node that tries again what something kept from firing."""

    @property
    def rule(self) -> "EventRule":
        """The rule it belongs to."""

    def retry(self, what: Any, after: Frame, /) -> Frame:
        """Return the frame that fires what is tried, if it still does, and goes on with ``after``."""


class Suppressed:
    """A match, or two that were to be joined, which a negated match has kept from firing.

    Several occurrences may make up the negated match: taking back any of them sets it free, once.
    """

    __slots__ = ("node", "what", "number", "freed")

    def __init__(self, node: TriesAgain, what: Tried, number: int):
        self.node = node
        self.what = what
        self.number = number
        self.freed = False

    def free(self) -> bool:
        """Tell whether it can be tried again now: not yet set free, and none of its own events taken back."""
        if self.freed:
            return False
        self.freed = True
        matches = (self.what,) if isinstance(self.what, PartialMatch) else self.what
        return not any(taken_back(match) for match in matches)


def occurrences_in(match: PartialMatch) -> List[Occurrence]:
    """Return the events of a match, as far as they were tracked."""
    return [token for token in leaves(match) if isinstance(token, Occurrence)]


def known_in(match: PartialMatch) -> List[Tracked]:
    """Return the events of a match, as far as they were tracked; for repetitions the last linked `TrackedMatch`."""
    found: List[Tracked] = []
    for one in sources(match):
        if isinstance(one, TrackedMatch):
            _link(one)
            found.append(one)
        elif isinstance(one, Occurrence):
            found.append(one)
    return found


def _link(last: TrackedMatch) -> None:
    """Have what repetitions came from know them, and each of them the next one."""
    new = []
    one: Any = last
    while one.match is not None and not one.linked:
        one.linked = True
        new.append(one)
        one = one.earlier
    for one in reversed(new):
        known = known_in(one.match)
        if one.earlier.match is not None:
            known.append(one.earlier)
        for source in known:
            one.gone = one.gone or source.gone
            if not source.forgotten:
                source.derived.append(one)


log = logging.getLogger("retalis.events")

_EVENT2 = functor("event", 2)
_KEPT = 100_000
_FILE = "persistent.txt"
_PERSISTENT = functor("persistent_event", 1)
_SHOWN = tuple(functor(name, 1) for name in ("external_trigger", "print_trigger", "spy_event"))


class EventList(Predicate):
    """A predicate whose facts name events: as soon as it has one, all events are looked at."""

    def __init__(self, rules: "RuleBase", store: "EventLog", key: Functor):
        super().__init__(rules.logic.database, key)
        self.dynamic = True
        self._store = store

    def changed(self) -> None:
        """Do what has to be done when a clause comes or goes."""
        super().changed()
        self._store.watch()


class EventLog:
    """Looks on at all events; what is not asked for costs nothing."""

    def __init__(self, rules: "RuleBase"):
        self._rules = rules
        self._events: Deque[Tuple[Term, int, int]] = deque(maxlen=_KEPT)
        self._storing: Optional[Listener] = None
        self._watching: Optional[Listener] = None
        self._unwritten = 0

    def keep_all(self, on: bool) -> None:
        """Store events from now on, or no more."""
        dispatcher = self._rules.dispatcher
        if on and self._storing is None:
            self._storing = dispatcher.listen(ListenerPhase.TRACE, Var(), self._keep)
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
            self._watching = self._rules.dispatcher.listen(ListenerPhase.TRACE, Var(), self._look)

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
