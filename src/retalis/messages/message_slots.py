"""Slots of messages by name, and suggestions for misspelt message names.

Programs may write a message with named slots (``T{a: X}``). `SlotNames` supplies the slots of the type and their
default values. If the name is not a message, it suggests the messages that the name is another spelling of
(``Temperature``, ``sensor_msgs/Temperature``, ``sensor_msgs_Temperature``) or that are spelt like it.

Constants of definitions (``T{NAME}``) are replaced by their values when a program is read. The definition of a type
that is not installed may come from its publishers later; until the program is loaded again, a constant in its folder
is an atom that equals no value, and its type is `SlotNames.awaited`.
"""

from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, Dict, Iterable, Iterator, List, Optional, Set, Tuple

from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import format_count
from ..foundation.errors import MessageError, UsageError
from ..foundation.similar_names import did_you_mean
from ..foundation.source_places import Place
from ..prolog.syntax.named_slots import MessageNotation, MessageSlot, MessageSuggestions
from ..prolog.terms.byte_texts import plain_text_atom, text_atom
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import FALSE, TRUE, Term, atom
from .type_definition import (
    FLOATS,
    PLAIN_STRINGS,
    QUOTED_STRINGS,
    ConstantValue,
    Definition,
    Field,
    functor_name,
    type_name,
)
from .type_registry import Definitions

_MIN_SIMILARITY = 0.75
"""Minimum similarity of a suggested name, from 0 to 1, as `difflib` measures it."""

_MAX_NAME_CHARACTERS = 200
"""Names longer than this are not compared with similar names."""


_MAX_LISTED_CONSTANTS = 5
"""Maximum number of constants that an error lists."""


class TypeSpellings:
    """Index of message names by their letters and digits in lower case, which are equal for all spellings of a name.

    Args:
        names: pairs of a message's name in programs and its type (or the name again).
    """

    def __init__(self, names: Iterable[Tuple[str, str]]):
        self._names: Dict[str, List[str]] = {}
        # `difflib` is slow, so candidates are restricted to names with the same first letter.
        self._by_first_letter: Dict[str, List[str]] = {}
        for name, message_type in names:
            for normalized in dict.fromkeys(map(_normalize, (message_type, message_type.rpartition("/")[2]))):
                self._names.setdefault(normalized, []).append(name)
        for normalized in self._names:
            self._by_first_letter.setdefault(normalized[:1], []).append(normalized)

    def find_other_spellings(self, name: str) -> List[str]:
        """Return the names of the messages that ``name`` is another spelling of."""
        return self._names.get(_normalize(name.replace("__0__", "/")), [])

    def find_similar(self, name: str) -> List[str]:
        """Return the names of the messages with the closest spelling that begin with the same letter as ``name``."""
        if len(name) > _MAX_NAME_CHARACTERS:
            return []
        normalized = _normalize(name)
        matches = get_close_matches(
            normalized, self._by_first_letter.get(normalized[:1], ()), 1, _MIN_SIMILARITY
        )
        return self._names[matches[0]] if matches else []


def _normalize(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()


MAX_DEFAULT_MESSAGE_BYTES = 1 << 20
"""Maximum size in bytes of a message with default values.

Messages of types above it cannot be written with named slots, because each omitted slot gets its default value.
"""


class SlotNames:
    """Slots of messages, by the names of their event terms.

    Args:
        definitions: the known message types; the installed types by default.
        strings: form of strings in messages, until a program states its form.

    Attributes:
        strings: form of strings in messages: `QUOTED_STRINGS` or `PLAIN_STRINGS`.
        events: message types by the event names that the program has given them.
        notations: the slots that messages were written with.
        awaited: message types whose constants a program names, and whose definitions were not known when it was
            loaded; see `awaiting`.
    """

    def __init__(self, definitions: Optional[Definitions] = None, strings: str = QUOTED_STRINGS):
        self._definitions = definitions
        self.strings = strings if definitions is None or strings == PLAIN_STRINGS else definitions.strings
        self._is_form_fixed = False
        self.events: Dict[str, str] = {}
        self.notations: Cache[MessageNotation, bool] = Cache(1000, 1 << 20)
        self.awaited: Set[str] = set()
        self._places: Optional[Dict[str, Place]] = None
        """Result of `awaiting` while that context is active."""
        self._installed: Optional[TypeSpellings] = None

    @property
    def definitions(self) -> Definitions:
        """The known message types with the program's form of strings, loaded on first access."""
        if self._definitions is None:
            self._definitions = Definitions()
        return self._definitions.with_strings(self.strings)

    def fix_strings(self, strings: str) -> None:
        """Set the form of strings that a program has, or the state of an engine.

        Raises:
            UsageError: if another program or state has fixed the other form: terms in memories and rules have it.
        """
        if self._is_form_fixed and strings != self.strings:
            raise UsageError(
                f'the strings of messages are "{strings}" in pub_sub.xml, but the program was loaded with '
                f'"{self.strings}": start it again without its state to change the form'
            )
        self.strings, self._is_form_fixed = strings, True

    def set_events(self, events: Dict[str, str]) -> None:
        """Set the message types by the event names that the program has given them."""
        self.events = events

    def find(self, name: str) -> Optional[List[MessageSlot]]:
        """Return the slots of the messages with this name, or None if it is not a message.

        Raises:
            UsageError: if the message type is unknown, or too large for named slots.
        """
        message_type = self.events.get(name) or type_name(name)
        if message_type is None:
            return None
        try:
            definition = self.definitions.find(message_type)
        except MessageError as error:
            self._check_spelling(message_type)
            raise UsageError(
                f"the slots of {message_type} are not known when this is read: {error.message}; install its package, "
                "put its folder on ROS_PACKAGE_PATH, or write all slots in their order: a definition that publishers "
                "send arrives too late"
            ) from error
        if definition.measure.min_size > MAX_DEFAULT_MESSAGE_BYTES:
            raise UsageError(
                f"messages of {message_type} have {format_count(definition.measure.min_size, 'byte')} at least: "
                "write all slots in their order"
            )
        return self._make_slots(definition)

    def _check_spelling(self, message_type: str) -> None:
        """Raise an error if an unknown type is probably misspelt, which is more likely than a missing package."""
        suggestion = self.definitions.misspelt(message_type)
        if suggestion:
            raise UsageError(f"there is no message type {message_type}; did you mean {suggestion}?")

    def find_constant(self, name: str, constant: str, place: Place) -> Optional[Term]:
        """Return the value of a constant of the messages with this name, or None if it is not a message.

        If the definition is not known and `awaiting` is active, the value is an atom that equals no value of a
        message.

        Raises:
            UsageError: if the message type is unknown, or has no such constant.
        """
        message_type = self.events.get(name) or type_name(name)
        if message_type is None:
            return None
        try:
            definition = self.definitions.find(message_type)
        except MessageError as error:
            self._check_spelling(message_type)
            if self._places is None:
                raise UsageError(
                    f"the constants of {message_type} are not known when this is read: {error.message}; install its "
                    "package, put its folder on ROS_PACKAGE_PATH, or name the constant in a file of the program"
                ) from error
            self.awaited.add(message_type)
            self._places.setdefault(message_type, place)
            return atom(f"{name}{{{constant}}}")
        values = {item.name: item.value for item in definition.constants}
        if constant not in values:
            # A slot without a value, which has an error of its own.
            if any(slot.name == constant for slot in definition.fields):
                return None
            raise UsageError(_unknown_constant_message(name, constant, list(values)), place)
        return scalar_term(values[constant], self.strings)

    @contextmanager
    def awaiting(self) -> Iterator[Dict[str, Place]]:
        """Accept constants of types that are not known yet, while the files of a program are read.

        Yields:
            The place of the first constant of each of these types.
        """
        before, self._places = self._places, {}
        try:
            yield self._places
        finally:
            self._places = before

    def pop_known(self) -> List[str]:
        """Remove the awaited types whose definitions are known by now, and return them."""
        # A copy: the engine may load a program in another thread.
        known = sorted(
            message_type for message_type in tuple(self.awaited) if message_type in self.definitions
        )
        self.awaited.difference_update(known)
        return known

    def suggest(self, name: str) -> MessageSuggestions:
        """Return suggestions for a name that is not a message."""
        if self._installed is None:
            self._installed = TypeSpellings(
                (functor_name(message_type), message_type) for message_type in self.definitions.installed()
            )
        declared = TypeSpellings((event, event) for event in self.events)
        added = TypeSpellings(
            (functor_name(message_type), message_type) for message_type in self.definitions.added()
        )
        # Names that the program declares come first: they are most likely meant.
        indexes = (declared, added, self._installed)
        same_message = [match for index in indexes for match in index.find_other_spellings(name)]
        if same_message:
            return MessageSuggestions(tuple(dict.fromkeys(same_message)), True)
        similar_names = [match for index in indexes for match in index.find_similar(name)]
        return MessageSuggestions(tuple(dict.fromkeys(similar_names)))

    def _make_slots(self, definition: Definition) -> List[MessageSlot]:
        """Return the slots of a type with their default values."""
        # A message of zero bytes contains the default value of every slot. It is copied, because terms of a program
        # must not be lazy: they would refer to functions of the decoder.
        data = bytes(definition.measure.min_size)
        default_message: Any = copy(self.definitions.decoder(definition).decode(data))
        return [
            _make_slot(slot, default_message[position]) for position, slot in enumerate(definition.fields, 1)
        ]


def _make_slot(slot: Field, default: object) -> MessageSlot:
    message = "" if slot.definition is None else functor_name(slot.type)
    is_float = slot.type in FLOATS
    return MessageSlot(slot.name, slot.describe(), message, slot.length is not None, default, is_float)  # type: ignore[arg-type]


def _unknown_constant_message(message: str, name: str, constants: List[str]) -> str:
    """Return the error message for the name of a constant that does not exist."""
    # Constants often begin with the name of a slot, which is omitted by mistake.
    ends = [constant for constant in constants if constant.endswith(f"_{name}")]
    hint = f"; did you mean {ends[0]}?" if len(ends) == 1 else did_you_mean(name, constants)
    shown_constants = constants[:_MAX_LISTED_CONSTANTS]
    omitted = f" and {len(constants) - len(shown_constants)} more" if shown_constants != constants else ""
    known_names = f"{', '.join(shown_constants)}{omitted}" if constants else "none"
    return f"{message} has no constant {name}{hint or f'; it has {known_names}'}"


def scalar_term(value: ConstantValue, strings: str) -> Term:
    """Return the term of a number, boolean or text, as that of a slot with this value in events.

    Args:
        value: the value.
        strings: form of texts: `QUOTED_STRINGS` or `PLAIN_STRINGS`.
    """
    if isinstance(value, bool):
        return TRUE if value else FALSE
    if isinstance(value, str):
        data = value.encode("utf-8", "surrogateescape")
        return plain_text_atom(data) if strings == PLAIN_STRINGS else text_atom(data)
    return value
