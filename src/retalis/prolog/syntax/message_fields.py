"""Slots by name: ``std_msgs__0__Header{frame_id: F}`` is that message with a variable for each slot not named.

Where the term is made and not matched, slots that are not named are zero or empty: in heads of rules, formats, and
events that a goal makes.

Integers where a message has floats: ``{x: 0}`` means 0.0, as no message has an integer there.
"""

from math import copysign
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ...foundation.bounded_caches import Cache
from ..terms.types import CONS, CompoundTerm, Functor, Term, Var, deref, functor

_ARROW = functor("<-", 2)
_DO = functor("do", 2)
_HEADS = {
    functor(name, arity): 1
    for name, arity in (
        ("exceptionAlarm", 2),
        ("exceptionAlarmAbsoluteDatime", 2),
        ("synchronized", 3),
        ("synchronized", 4),
        ("syncronized", 3),
        ("syncronized", 4),
    )
}
"""Heads around an event, and which argument that is; the others are no part of what is made."""

_REV = functor("rev", 1)

_MADE: Dict[Functor, int] = {
    functor(name, arity): number
    for name, arity, number in (
        ("subscribe", 5, 3),
        ("memorize", 5, 3),
        ("memorize", 6, 3),
        ("memorize_diactive", 5, 3),
        ("event", 1, 1),
        ("event", 2, 1),
        ("new_event", 2, 1),
        ("new_event", 3, 1),
        ("new_event", 5, 1),
    )
}
"""Goals that make something, and of which argument."""

_ASKING = frozenset((functor("stored_event", 1), functor("fired_event", 2), functor("justify_event", 3)))
"""Goals in which ``event/2`` makes nothing."""


class MessageSlot(NamedTuple):
    """A slot of a message.

    Attributes:
        name: its name.
        type: its type, as errors show it.
        message: what terms of its messages are called, "" where it has none.
        array: whether it is an array.
        zero: its value where nobody gives it one.
        real: whether its numbers are floats.
    """

    name: str
    type: str
    message: str
    array: bool
    zero: Term
    real: bool = False


class NamedForm(NamedTuple):
    """A way of writing messages.

    Attributes:
        functor: of the message.
        named: the slots that are named, by their numbers.
        made: whether the others are zero.
        whole: the slots of floats that were given as integers.
    """

    functor: Functor
    named: Tuple[int, ...]
    made: bool
    whole: Tuple[int, ...] = ()


class Slots(Protocol):
    """Gives the slots of messages, and remembers how they were written."""

    forms: "Cache[NamedForm, bool]"

    def find(self, name: str) -> Optional[Sequence[MessageSlot]]:
        """Return the slots of the messages that are called so; None where no messages are.

        Raises:
            RetalisError: where they are not known.
        """

    def meant(self, name: str) -> "Meant":
        """Return which messages were probably meant by a name that none are called."""


class Meant(NamedTuple):
    """Messages that a name probably means.

    Attributes:
        names: what their terms are called, the likeliest first.
        other: whether the name is one of theirs in another notation, not a misspelt one.
    """

    names: Tuple[str, ...] = ()
    other: bool = False


class Expanded(NamedTuple):
    """A message as it was read: its term, the slots that were named, the values of the others if it is made.

    ``whole`` are the slots of floats that were given as integers.
    """

    term: CompoundTerm
    named: Tuple[int, ...]
    zeros: Dict[Var, Term]
    whole: Tuple[int, ...]


def made_in(term: Term) -> Iterator[Term]:
    """Yield the parts of a clause or goal that are made, each with all that is in it."""
    stack: List[Term] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is not tuple or part[0] in _ASKING:
            continue
        if part[0] is _ARROW:
            yield from _made_by_head(part[1])
            stack.append(part[2])
            continue
        number = _MADE.get(part[0], 0)
        if number:
            yield part[number]
        stack += [one for at, one in enumerate(part) if at and at != number]


def _made_by_head(head: Term) -> Iterator[Term]:
    head = deref(head)
    if head.__class__ is tuple and head[0] is _DO:
        yield from made_in(head[2])
        head = deref(head[1])
    if head.__class__ is tuple and head[0] in _HEADS:
        head = head[_HEADS[head[0]]]
    elif head.__class__ is tuple and head[0] is _REV:
        return
    yield head


def parts_in(term: Term) -> Iterator[CompoundTerm]:
    """Yield the compound terms in a term, itself included."""
    stack: List[Term] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is tuple:
            yield part
            stack += part[:0:-1]


def complete(term: Term, expanded: Sequence[Expanded], slots: Slots, made: bool) -> None:
    """Give slots that were not named their values, in the parts of a term that are made, and note how it was written.

    Args:
        term: what was read.
        expanded: the messages in it whose slots were named.
        slots: where it is noted.
        made: whether all of the term is made.
    """
    found: Set[int] = set()
    for part in [term] if made else made_in(term):
        found.update(map(id, parts_in(part)))
    for one in expanded:
        is_made = id(one.term) in found
        if is_made:
            for var, zero in one.zeros.items():
                var.ref = zero
        form = NamedForm(one.term[0], one.named, is_made, one.whole)
        if form not in slots.forms:
            slots.forms.keep(form, True, 8 * len(one.named))


_MAX_EXACT_INTEGER = 1 << 53
"""Whole floats below it are integers, each of its own."""


def as_floats(value: Term, array: bool) -> Term:
    """Return the value of a slot of floats with its integers as floats; the same term where it has none.

    Args:
        value: as it was read.
        array: whether the slot is an array: the integers are elements of a list.
    """
    return _with_elements(value, _float) if array else _float(value)


def as_integers(value: Term, array: bool) -> Term:
    """Return the value of a slot of floats with its whole numbers as integers, which read as the same floats."""
    return _with_elements(value, _integer) if array else _integer(value)


def _float(value: Term) -> Term:
    if value.__class__ is not int:
        return value
    try:
        return float(value)
    except OverflowError:  # no float is as large: it matches no message, as it is written
        return value


def _integer(value: Term) -> Term:
    if value.__class__ is not float or not value.is_integer() or abs(value) >= _MAX_EXACT_INTEGER:
        return value
    return value if value == 0 and copysign(1, value) < 0 else int(value)


def _with_elements(value: Term, change: Callable[[Term], Term]) -> Term:
    elements: List[Term] = []
    rest = value
    while rest.__class__ is tuple and rest[0] is CONS:
        elements.append(deref(rest[1]))
        rest = deref(rest[2])
    changed = [change(one) for one in elements]
    if all(new is old for new, old in zip(changed, elements)):
        return value
    for one in reversed(changed):
        rest = (CONS, one, rest)
    return rest
