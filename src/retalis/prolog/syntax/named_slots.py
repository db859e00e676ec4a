"""Messages with named slots: description of slots, default values, and numbers in float slots.

``std_msgs__0__Header{frame_id: F}`` denotes the message with a variable for each slot that is not named. If the term
is constructed and not matched (in heads of rules, formats, and events that a goal creates), these slots have default
values instead: zero or empty. `constructed_parts` yields the constructed parts of a clause, and `bind_defaults` binds
the variables in them.

The parser records the notation of each message (`MessageNotation`), so that listings and explanations show the
message as it was written, with the names of constants.

An integer in a float slot denotes a float: ``{x: 0}`` matches 0.0, because ROS messages never have an integer there.
"""

from math import copysign
from typing import (
    Callable,
    ContextManager,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Set,
    Tuple,
)

from ...foundation.bounded_caches import Cache
from ...foundation.source_places import Place
from ..terms.types import CONS, CompoundTerm, Functor, Term, Var, deref, functor

_ARROW = functor("<-", 2)
_DO = functor("do", 2)
_HEAD_WRAPPERS = {
    functor("exceptionAlarm", 2): 1,
    functor("exceptionAlarmAbsoluteDatime", 2): 1,
    functor("synchronized", 3): 1,
    functor("synchronized", 4): 1,
    functor("syncronized", 3): 1,
    functor("syncronized", 4): 1,
}
"""Index of the event argument, for functors that wrap the event of a head.

Their other arguments are not constructed."""

_REV = functor("rev", 1)

_CONSTRUCTING_GOALS: Dict[Functor, int] = {
    functor("subscribe", 5): 3,
    functor("memorize", 5): 3,
    functor("memorize", 6): 3,
    functor("memorize_diactive", 5): 3,
    functor("event", 1): 1,
    functor("event", 2): 1,
    functor("new_event", 2): 1,
    functor("new_event", 3): 1,
    functor("new_event", 5): 1,
}
"""Index of the constructed argument, for goals that construct a term."""

_MATCHING_GOALS = frozenset(
    (functor("stored_event", 1), functor("fired_event", 2), functor("justify_event", 3))
)
"""Goals in which ``event/2`` is a pattern, not a constructed event."""


class MessageSlot(NamedTuple):
    """A slot of a message.

    Attributes:
        type: the type, as error messages show it.
        message_functor: functor name of the nested message; empty if the type is not a message type.
        is_array: whether it is an array.
        default: its default value.
        is_float: whether its numbers are floats.
    """

    name: str
    type: str
    message_functor: str
    is_array: bool
    default: Term
    is_float: bool = False


class MessageNotation(NamedTuple):
    """The notation of a message.

    Attributes:
        named_slots: numbers of the named slots, in their written order.
        is_constructed: whether the message is constructed, so that the other slots have default values.
        integer_slots: numbers of the float slots that were written as integers.
        constants: numbers of the slots whose value was written as a constant, with its text and value.
    """

    functor: Functor
    named_slots: Tuple[int, ...]
    is_constructed: bool
    integer_slots: Tuple[int, ...] = ()
    constants: Tuple[Tuple[int, str, Term], ...] = ()


class MessageSuggestions(NamedTuple):
    """Messages that a name probably denotes.

    Attributes:
        names: functor names, the likeliest first.
        is_other_notation: whether the name is not misspelt but valid in another notation, such as that of ROS.
    """

    names: Tuple[str, ...] = ()
    is_other_notation: bool = False


class MessageTypes(Protocol):
    """The message types that a program may name.

    Attributes:
        notations: the slots that messages were written with.
    """

    notations: Cache[MessageNotation, bool]

    def find(self, name: str) -> Optional[List[MessageSlot]]:
        """Return the slots of the messages with a name, or None if it is not a message."""

    def find_constant(self, name: str, constant: str, place: Place) -> Optional[Term]:
        """Return the value of a constant of the messages with a name, or None if it is not a message.

        Raises:
            RetalisError: if the type has no such constant, or its definition cannot be read.
        """

    def awaiting(self) -> ContextManager[Dict[str, Place]]:
        """Return a context that accepts constants of unknown types, and collects the place of the first of each."""

    def suggest(self, name: str) -> MessageSuggestions:
        """Return suggestions for a name that is not a message."""


class ParsedMessage(NamedTuple):
    """A message with named slots as it was read.

    Attributes:
        named_slots: numbers of the named slots.
        default_values: the variables of the other slots, with the values that they get in a constructed message.
        integer_slots: numbers of the float slots that were written as integers.
        constants: see `MessageNotation`.
    """

    term: CompoundTerm
    named_slots: Tuple[int, ...]
    default_values: Dict[Var, Term]
    integer_slots: Tuple[int, ...]
    constants: Tuple[Tuple[int, str, Term], ...]


def constructed_parts(term: Term) -> Iterator[Term]:
    """Yield the constructed parts of a clause or goal, each with its subterms."""
    # Iterative, because a clause may be nested deeper than Python's stack.
    stack: List[Term] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is not tuple or part[0] in _MATCHING_GOALS:
            continue
        if part[0] is _ARROW:
            # The head constructs an event. The pattern only matches, but goals within it may construct terms.
            yield from _constructed_by_head(part[1])
            stack.append(part[2])
            continue
        argument_index = _CONSTRUCTING_GOALS.get(part[0], 0)
        # A constructed part is yielded as a whole, so it is not searched for further ones.
        if argument_index:
            yield part[argument_index]
        stack += [argument for index, argument in enumerate(part) if index and index != argument_index]


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


def bind_defaults(
    term: Term, messages: Sequence[ParsedMessage], message_types: MessageTypes, is_constructed: bool
) -> None:
    """Bind unnamed slots to their default values in constructed messages, and store the notations of all messages.

    Args:
        term: the clause or term.
        messages: the messages with named slots in it.
        message_types: stores the notations.
        is_constructed: whether the whole term is constructed.
    """
    # Terms are compared by identity: equal messages may stand in a head and in a pattern.
    constructed: Set[int] = set()
    for part in [term] if is_constructed else constructed_parts(term):
        constructed.update(map(id, compound_subterms(part)))
    for message in messages:
        is_message_constructed = id(message.term) in constructed
        if is_message_constructed:
            for var, default in message.default_values.items():
                var.ref = default
        notation = MessageNotation(
            message.term[0],
            message.named_slots,
            is_message_constructed,
            message.integer_slots,
            message.constants,
        )
        if notation not in message_types.notations:
            message_types.notations.store(notation, True, 8 * len(message.named_slots))


_MAX_EXACT_INTEGER = 1 << 53
"""Bound below which each integral float equals exactly one integer."""


def integers_to_floats(value: Term, is_array: bool) -> Term:
    """Return the value of a float slot with its integers converted to floats; the same term if there are none.

    Args:
        value: the value as it was read.
        is_array: whether the slot is an array, so that the integers are items of a list.
    """
    return _convert_elements(value, _integer_to_float) if is_array else _integer_to_float(value)


def floats_to_integers(value: Term, is_array: bool) -> Term:
    """Return the value of a float slot with integral floats as integers; the inverse of `integers_to_floats`."""
    return _convert_elements(value, _float_to_integer) if is_array else _float_to_integer(value)


def _integer_to_float(value: Term) -> Term:
    if value.__class__ is not int:
        return value
    try:
        return float(value)
    except OverflowError:
        # An integer that is too large for a float is not converted, and matches no message.
        return value


def _float_to_integer(value: Term) -> Term:
    if value.__class__ is not float or not value.is_integer() or abs(value) >= _MAX_EXACT_INTEGER:
        return value
    # -0.0 is not converted, because the integer 0 reads back as 0.0.
    return value if value == 0 and copysign(1, value) < 0 else int(value)


def _convert_elements(value: Term, convert: Callable[[Term], Term]) -> Term:
    elements: List[Term] = []
    rest = value
    while rest.__class__ is tuple and rest[0] is CONS:
        elements.append(deref(rest[1]))
        rest = deref(rest[2])
    # The same list is returned if nothing changes, because source positions are recorded by the identity of terms.
    converted = [convert(element) for element in elements]
    if all(new is old for new, old in zip(converted, elements)):
        return value
    for element in reversed(converted):
        rest = (CONS, element, rest)
    return rest
