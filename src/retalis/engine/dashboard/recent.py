"""The last events of an engine, watched only while somebody looks at them."""

from collections import deque
from itertools import count
from typing import Any, Deque, Dict, List, NamedTuple, Optional, Tuple

from ...events.dispatch import NOT_READ, Listener, Stage
from ...foundation import beginning
from ...prolog.syntax import read_term
from ...prolog.terms import (
    CONS,
    NIL,
    Frame,
    Functor,
    Lazy,
    Term,
    Var,
    atom,
    deref,
    functor,
    make_list,
    timestamps,
)
from .. import Engine, parts_of

LONGEST = 800
"""Characters of an event's text."""

MOST_PARTS = 60
"""Parts of an event that are written out, and elements of a list."""

DEEPEST = 8
"""How deep in an event they may stand."""

MOST_KINDS = 200
"""Functors of events that are told apart."""

MOST_OF_A_KIND = 8
"""Events of one functor that are kept: rare ones stay beside thousands of transforms."""

AT_A_LOOK = 3
"""Events of one functor that are written out from one look to the next; the others are counted."""

MOST_SHOWN = 60
"""Events that are shown."""

_CUT = atom("...")
_UPDATED = functor("memory_updated", 2)
"""Events that tell of others, which are shown themselves."""
_NO_EVENT = atom("null_event")
"""The head of rules that are there for what they do."""
_ASKED = functor("event", 2)


class RecentEvent(NamedTuple):
    """An event that has happened.

    Attributes:
        serial: its own number.
        text: its text.
        whole: whether that is all of it.
        start: its interval, in nanoseconds.
        end: the same.
    """

    serial: int
    text: str
    whole: bool
    start: int
    end: int


class EventCount(NamedTuple):
    """How many events of a functor there were while somebody looked, and the end of the last one."""

    number: int
    end: int


class _Kind:
    """The events of one functor."""

    __slots__ = ("number", "end", "shown", "kept")

    def __init__(self) -> None:
        self.number = self.end = self.shown = 0
        self.kept: Deque[RecentEvent] = deque(maxlen=MOST_OF_A_KIND)


class RecentEvents:
    """Counts events by their functors and keeps the last ones as text, while that is wanted.

    A listener for all events disables fused actions and gates (`Audience.fused`, `Gate`), so it is there only while
    it is wanted. What it does for an event is bounded, and nobody waits for the engine here.

    Args:
        engine: whose events they are.
    """

    def __init__(self, engine: Engine):
        self._engine = engine
        parts = parts_of(engine)
        self._dispatcher, self._runner, self._show = parts.dispatcher, parts.runner, parts.logic.show
        self._listener: Optional[Listener] = None
        self._wanted = False
        self._serial = count(1)
        self._kinds: Dict[Optional[Functor], _Kind] = {}

    @property
    def watching(self) -> bool:
        """Whether events are being watched, or will be when the engine comes to it."""
        return self._wanted

    def watch(self, wanted: bool) -> None:
        """Begin or end watching, as soon as the engine has time; what is kept stays."""
        if wanted != self._wanted:
            self._wanted = wanted
            self._runner.post(self._set)

    def _set(self) -> None:
        if self._wanted and self._listener is None:
            event = Var()
            self._listener = self._dispatcher.listen(
                Stage.TRACE, event, self._see, unused={event}
            )  # what is not read stays out of the texts between the nodes
        elif not self._wanted and self._listener is not None:
            self._dispatcher.remove(self._listener)
            self._listener = None

    def _see(self, term: Term, values: Tuple[Term, ...], start: int, end: int, after: Frame) -> Frame:
        """Count an event, and keep its text where not many of its kind have been."""
        if term is _NO_EVENT:
            return after
        key = term[0] if term.__class__ is tuple else getattr(term, "functor", None)
        kind = self._kinds.get(key)
        if kind is None:
            if len(self._kinds) >= MOST_KINDS:
                key = None  # all others
            kind = self._kinds.setdefault(key, _Kind())
        kind.number += 1
        kind.end = end
        if kind.shown < AT_A_LOOK and key is not _UPDATED:
            kind.shown += 1
            text, whole = event_beginning(self._show, term)
            kind.kept.append(RecentEvent(next(self._serial), text, whole, int(start), int(end)))
        return after

    def look(self) -> List[RecentEvent]:
        """Return the last events, the newest first; others are written out after that."""
        found: List[RecentEvent] = []
        for kind in list(self._kinds.values()):
            kind.shown = 0
            found += kind.kept.copy()
        found.sort(reverse=True)
        return found[:MOST_SHOWN]

    def counts(self) -> Dict[str, EventCount]:
        """Return the counts by functor."""
        return {
            "others" if key is None else str(key): EventCount(kind.number, int(kind.end))
            for key, kind in list(self._kinds.items())
        }

    def find(self, serial: int) -> Optional[Term]:
        """Return an event as a term to explain, ``event(Term,[T1,T2])``; None where it is no longer kept."""
        for kind in list(self._kinds.values()):
            for event in kind.kept.copy():
                if event.serial == serial and event.whole:
                    term = read_term(event.text, self._engine.operators, "event").term
                    stamps = make_list([timestamps.datime(event.start), timestamps.datime(event.end)])
                    return (_ASKED, term, stamps)
        return None


def event_beginning(show: Any, term: Term) -> Tuple[str, bool]:
    """Return the beginning of an event's text, and whether it is all of it; long lists are not even made."""
    left = [MOST_PARTS]
    text = show(_cut(term, left, DEEPEST))
    return beginning(text, LONGEST), left[0] > 0 and len(text) <= LONGEST


def _cut(term: Term, left: List[int], depth: int) -> Term:
    """Return a term with dots in place of what is too much; ``left`` is 0 then."""
    if term.__class__ is Lazy and term.made is None and term.functor is CONS:
        left[0] = 0  # the numbers of an array
        return _CUT
    term = deref(term)
    if term is NOT_READ:
        return _dots(left)
    if term.__class__ is not tuple:
        return term if _is_short(term) else _dots(left)
    if left[0] <= 0 or depth == 0 or len(term) > MOST_PARTS:
        return _dots(left)
    if term[0] is CONS:
        return _cut_list(term, left, depth)
    left[0] -= 1
    return (term[0], *[_cut(part, left, depth - 1) for part in term[1:]])


def _is_short(term: Any) -> bool:
    """Tell whether an atom, a text or a number is one that can be written out."""
    if term.__class__ is int:
        return bool(term.bit_length() <= LONGEST)
    return len(getattr(term, "name", "")) <= LONGEST and len(getattr(term, "text", "")) <= LONGEST


def _cut_list(term: Any, left: List[int], depth: int) -> Term:
    items: List[Term] = []
    while term.__class__ is tuple and term[0] is CONS and left[0] > 0:
        left[0] -= 1
        items.append(_cut(term[1], left, depth - 1))
        term = deref(term[2])
    if term.__class__ is tuple and term[0] is CONS:
        return make_list([*items, _CUT])
    found = term if term is NIL else _cut(term, left, depth - 1)
    for item in reversed(items):
        found = (CONS, item, found)
    return found


def _dots(left: List[int]) -> Term:
    left[0] = 0
    return _CUT
