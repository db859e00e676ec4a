"""Events written as goals: ``event/1,2`` and ``new_event/2,3,5``, in programs and on the String topics."""

import re
from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence

from ...foundation import Cache, SyntaxFault, UsageError
from ...prolog.builtins import callable_of, instant_of, integer
from ...prolog.machine import type_error
from ...prolog.syntax import EventReader, Operators
from ...prolog.terms import Functor, Term, WholeSeconds, deref, functor, list_items, timestamps

_SECOND = re.compile(r"datime\((\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),", re.ASCII)
_NANOSECOND = re.compile(r"\d{1,9}\)", re.ASCII)


class InputEvent(NamedTuple):
    """An event and the two instants of its interval; None where the clock is to stamp it.

    Attributes:
        ground: whether the event has no variables; None where nobody has looked.
    """

    term: Term
    start: Any
    end: Any
    ground: Optional[bool] = None


class InputReader:
    """Reads events from the text of their goals; not for use by two threads at once.

    Args:
        operators: those that hold in the texts.
    """

    def __init__(self, operators: Operators):
        self._reader = EventReader(operators)
        self._seconds: Cache[str, int] = Cache(64, 1 << 16)

    def goal(self, text: str) -> Term:
        """Return the goal of a text.

        Raises:
            SyntaxFault: where it is none.
        """
        return self._reader.read(text)

    def event(self, text: str) -> Optional[InputEvent]:
        """Return the event that a text makes, or None where it is another goal.

        Raises:
            SyntaxFault: where it is not a goal.
            PrologError: where it is such a goal with arguments that make no event.
        """
        if text.startswith("event("):
            found = self._stamped(text)
            if found is not None:
                return found
        return event_of(self._reader.read(text))

    def _stamped(self, text: str) -> Optional[InputEvent]:
        """Read ``event(E,[T,T])`` as other nodes write it, the two stamps by their own short way; None if it is not.

        That the text up to the stamps and ``)`` is ``event(E)`` makes sure that they stand where they seem to.
        """
        at = text.rfind(",[datime(")
        stamps = text[at + 2 :]
        middle = (len(stamps) - 3) // 2
        stamp = stamps[:middle]
        if at < 0 or stamps != f"{stamp},{stamp}])":
            return None
        last = stamp.rfind(",") + 1
        second = self._seconds.get(stamp[:last])
        if second is None:
            second = self._learn(stamp[:last])
        if second is None or not _NANOSECOND.fullmatch(stamp, last):
            return None
        try:
            goal = self._reader.read(text[:at] + ")")
        except SyntaxFault:  # for the one that names the place in the whole text
            return None
        if goal.__class__ is not tuple or goal[0] is not EVENT1:
            return None
        instant = WholeSeconds(second + int(stamp[last:-1]))
        return InputEvent(callable_of(goal[1]), instant, instant, self._reader.ground)

    def _learn(self, text: str) -> Optional[int]:
        """Return the instant of a datime's text up to its nanoseconds, and remember it; None where it is none."""
        found = _SECOND.fullmatch(text)
        if found is None:
            return None
        try:
            instant = timestamps.from_term((timestamps.DATIME7, *map(int, found.groups()), 0))
        except UsageError:
            return None
        return self._seconds.keep(text, instant, len(text))


def event_of(goal: Term) -> Optional[InputEvent]:
    """Return the event that a goal makes, or None where it is another goal.

    Raises:
        PrologError: where it is such a goal with arguments that make no event.
    """
    goal = deref(goal)
    if goal.__class__ is not tuple:
        return None
    reader = READERS.get(goal[0])
    return None if reader is None else reader(goal[1:])


def _event1(arguments: Sequence[Term]) -> InputEvent:
    term = callable_of(arguments[0])
    if term.__class__ is tuple and term[0] is _EVENT2:  # event(event(E,[T1,T2])) is event(E,[T1,T2])
        return _with_interval(term[1:])
    return InputEvent(term, None, None)


def _with_interval(arguments: Sequence[Term]) -> InputEvent:
    stamps = list_items(arguments[1])
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", arguments[1])
    return _checked(arguments, instant_of(stamps[0]), instant_of(stamps[1]))


def _with_instant(arguments: Sequence[Term]) -> InputEvent:
    instant = timestamps.from_parts(integer(arguments[1]), integer(arguments[2]))
    return _checked(arguments, instant, instant)


def _with_instants(arguments: Sequence[Term]) -> InputEvent:
    start = timestamps.from_parts(integer(arguments[1]), integer(arguments[2]))
    end = timestamps.from_parts(integer(arguments[3]), integer(arguments[4]))
    return _checked(arguments, start, end)


EVENT1 = functor("event", 1)
_EVENT2 = functor("event", 2)
READERS: Dict[Functor, Callable[[Sequence[Term]], InputEvent]] = {
    EVENT1: _event1,
    _EVENT2: _with_interval,
    functor("new_event", 2): _with_interval,
    functor("new_event", 3): _with_instant,
    functor("new_event", 5): _with_instants,
}


def _checked(arguments: Sequence[Term], start: int, end: int) -> InputEvent:
    if end < start or not (timestamps.in_range(start) and timestamps.in_range(end)):
        raise type_error("interval", arguments[1])
    return InputEvent(callable_of(arguments[0]), start, end)
