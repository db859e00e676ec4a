"""Messages with named fields: their description, completion, and float fields.

``std_msgs__0__Header{frame_id: F}`` denotes the message with a variable for each field that is not named. If the term
is constructed and not matched, such fields are zero or empty instead: in heads of rules, formats, and events that a
goal creates. `constructed_parts` finds the constructed parts of a clause, and `complete` binds the variables in them.

The names in the code and error messages call a field a *slot*.

The parser records the notation of each message (`NamedForm`), so that listings and explanations can show it as
written.

Integers in float fields: ``{x: 0}`` denotes 0.0, because no message has an integer in such a field.
"""

from math import copysign
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ...foundation.bounded_caches import Cache
from ..terms.types import CONS, CompoundTerm, Functor, Term, Var, deref, functor

_ARROW = functor("<-", 2)
_DO = functor("do", 2)
_HEAD_WRAPPERS = {
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
"""Functors around the event in a head, with the number of the argument that is the event; other arguments are not
constructed."""

_REV = functor("rev", 1)

_CONSTRUCTING_GOALS: Dict[Functor, int] = {
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
"""Goals that construct a term, with the number of the argument that is the term."""

_MATCHING_GOALS = frozenset(
    (functor("stored_event", 1), functor("fired_event", 2), functor("justify_event", 3))
)
"""Goals within which ``event/2`` matches and constructs nothing."""


class MessageSlot(NamedTuple):
    """A field of a message.

    Attributes:
        name: the name.
        type: the type, as error messages show it.
        message: the functor name of the field's messages; empty if the type is no message type.
        array: whether it is an array.
        zero: its default value.
        real: whether its numbers are floats.
    """

    name: str
    type: str
    message: str
    array: bool
    zero: Term
    real: bool = False


class NamedForm(NamedTuple):
    """The notation of a message.

    Attributes:
        functor: the functor of the message.
        named: numbers of the named fields, in their written order.
        made: whether the other fields are zero.
        whole: numbers of float fields that were written as integers.
    """

    functor: Functor
    named: Tuple[int, ...]
    made: bool
    whole: Tuple[int, ...] = ()


class Slots(Protocol):
    """Provides the fields of messages, and stores the notations that programs use."""

    forms: "Cache[NamedForm, bool]"

    def find(self, name: str) -> Optional[Sequence[MessageSlot]]:
        """Return the fields of a message by its functor name; None if no message has the name.

        Raises:
            RetalisError: if the definition cannot be read.
        """

    def meant(self, name: str) -> "Meant":
        """Return the messages that a misspelt name probably denotes."""


class Meant(NamedTuple):
    """Messages that a name probably denotes.

    Attributes:
        names: functor names, the likeliest first.
        other: whether the name is valid in another notation, and not misspelt.
    """

    names: Tuple[str, ...] = ()
    other: bool = False


class Expanded(NamedTuple):
    """A message with named fields as it was read.

    Attributes:
        term: the message.
        named: numbers of the named fields.
        zeros: the variables of the other fields, with their values if the message is constructed.
        whole: numbers of float fields that were written as integers.
    """

    term: CompoundTerm
    named: Tuple[int, ...]
    zeros: Dict[Var, Term]
    whole: Tuple[int, ...]


def constructed_parts(term: Term) -> Iterator[Term]:
    """Yield the constructed parts of a clause or goal, each with its subterms."""
    stack: List[Term] = [term]
    while stack:
        part = deref(stack.pop())
        # Iterative, because a clause may be nested deeper than Python's stack. Each constructed part is yielded
        # once and is not searched again.
        if part.__class__ is not tuple or part[0] in _MATCHING_GOALS:
            continue
        if part[0] is _ARROW:
            # The head constructs an event. The pattern only matches, but goals within it may construct terms.
            yield from _constructed_by_head(part[1])
            stack.append(part[2])
            continue
        number = _CONSTRUCTING_GOALS.get(part[0], 0)
        if number:
            yield part[number]
        stack += [argument for index, argument in enumerate(part) if index and index != number]


def _constructed_by_head(head: Term) -> Iterator[Term]:
    head = deref(head)
    if head.__class__ is tuple and head[0] is _DO:
        yield from constructed_parts(head[2])
        head = deref(head[1])
    if head.__class__ is tuple and head[0] in _HEAD_WRAPPERS:
        head = head[_HEAD_WRAPPERS[head[0]]]
    elif head.__class__ is tuple and head[0] is _REV:
        return
    yield head


def compound_subterms(term: Term) -> Iterator[CompoundTerm]:
    """Yield the compound terms within a term, the term included."""
    stack: List[Term] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is tuple:
            yield part
            stack += part[:0:-1]


def complete(term: Term, expanded: Sequence[Expanded], slots: Slots, made: bool) -> None:
    """Bind fields that were not named to their default values in constructed messages, and store the notations.

    Args:
        term: the clause or term.
        expanded: the messages with named fields within it.
        slots: stores the notations.
        made: whether the whole term is constructed.
    """
    # Terms are compared by identity: equal messages may stand in a head and in a pattern.
    constructed: Set[int] = set()
    for part in [term] if made else constructed_parts(term):
        constructed.update(map(id, compound_subterms(part)))
    for message in expanded:
        is_made = id(message.term) in constructed
        if is_made:
            for var, zero in message.zeros.items():
                var.ref = zero
        form = NamedForm(message.term[0], message.named, is_made, message.whole)
        if form not in slots.forms:
            slots.forms.store(form, True, 8 * len(message.named))


_MAX_EXACT_INTEGER = 1 << 53
"""Whole floats below this bound correspond to exactly one integer."""


def as_floats(value: Term, array: bool) -> Term:
    """Return the value of a float field with its integers as floats; the same term if there are none.

    Args:
        value: the value as it was read.
        array: whether the field is an array, so that the integers are items of a list.
    """
    return _with_elements(value, _float) if array else _float(value)


def as_integers(value: Term, array: bool) -> Term:
    """Return the value of a float field with its whole numbers as integers that read back as the same floats."""
    return _with_elements(value, _integer) if array else _integer(value)


def _float(value: Term) -> Term:
    if value.__class__ is not int:
        return value
    try:
        return float(value)
    except OverflowError:  # too large for a float: kept as an integer, which matches no message
        return value


def _integer(value: Term) -> Term:
    if value.__class__ is not float or not value.is_integer() or abs(value) >= _MAX_EXACT_INTEGER:
        return value
    # -0.0 has no integer that reads back as it.
    return value if value == 0 and copysign(1, value) < 0 else int(value)


def _with_elements(value: Term, change: Callable[[Term], Term]) -> Term:
    elements: List[Term] = []
    rest = value
    while rest.__class__ is tuple and rest[0] is CONS:
        elements.append(deref(rest[1]))
        rest = deref(rest[2])
    # The old list is returned if nothing changes: positions are recorded by the identity of terms.
    changed = [change(element) for element in elements]
    if all(new is old for new, old in zip(changed, elements)):
        return value
    for element in reversed(changed):
        rest = (CONS, element, rest)
    return rest
