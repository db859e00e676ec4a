"""Events written as goals: ``event/1,2`` and ``new_event/2,3,5``, in programs and on the String topics."""

from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence

from . import timestamps
from .logic import instant_of, instantiation_error, type_error
from .terms import Atom, Functor, Term, Var, deref, functor, list_items


class Input(NamedTuple):
    """An event and the two instants of its interval; None where the clock is to stamp it."""

    term: Term
    start: Any
    end: Any


def event_of(goal: Term) -> Optional[Input]:
    """Return the event that a goal makes, or None where it is another goal.

    Raises:
        PrologError: where it is such a goal with arguments that make no event.
    """
    goal = deref(goal)
    if goal.__class__ is not tuple:
        return None
    reader = READERS.get(goal[0])
    return None if reader is None else reader(goal[1:])


def _event1(arguments: Sequence[Term]) -> Input:
    return Input(_event(arguments[0]), None, None)


def _with_interval(arguments: Sequence[Term]) -> Input:
    stamps = list_items(arguments[1])
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", arguments[1])
    return _checked(arguments, instant_of(stamps[0]), instant_of(stamps[1]))


def _with_instant(arguments: Sequence[Term]) -> Input:
    instant = timestamps.from_parts(_integer(arguments[1]), _integer(arguments[2]))
    return _checked(arguments, instant, instant)


def _with_instants(arguments: Sequence[Term]) -> Input:
    start = timestamps.from_parts(_integer(arguments[1]), _integer(arguments[2]))
    end = timestamps.from_parts(_integer(arguments[3]), _integer(arguments[4]))
    return _checked(arguments, start, end)


READERS: Dict[Functor, Callable[[Sequence[Term]], Input]] = {
    functor("event", 1): _event1,
    functor("event", 2): _with_interval,
    functor("new_event", 2): _with_interval,
    functor("new_event", 3): _with_instant,
    functor("new_event", 5): _with_instants,
}


def _checked(arguments: Sequence[Term], start: int, end: int) -> Input:
    if end < start or not (timestamps.in_range(start) and timestamps.in_range(end)):
        raise type_error("interval", arguments[1])
    return Input(_event(arguments[0]), start, end)


def _event(term: Term) -> Term:
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ not in (tuple, Atom):
        raise type_error("callable", term)
    return term


def _integer(term: Term) -> int:
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ is not int:
        raise type_error("integer", term)
    return term
