"""Slots of messages by name, and suggestions for misspelt message names.

Programs may write a message with named slots (``T{a: X}``). `SlotNames` supplies the slots of the type and their
default values. If the name is not a message, it suggests the messages that the name is another spelling of
(``Temperature``, ``sensor_msgs/Temperature``, ``sensor_msgs_Temperature``) or that are spelt like it.
"""

from difflib import get_close_matches
from typing import Any, Dict, Iterable, List, Optional, Tuple

from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, UsageError, format_count
from ..prolog.syntax.slot_defaults import MessageNotation, MessageSlot, MessageSuggestions
from ..prolog.terms.term_traversal import copy
from .type_definition import FLOATS, Definition, Field, functor_name, type_name
from .type_registry import Definitions

_MIN_SIMILARITY = 0.75
"""Minimum similarity of a suggested name, from 0 to 1, as `difflib` measures it."""

_MAX_NAME_CHARACTERS = 200
"""Names longer than this are not compared with similar names."""


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

    Attributes:
        events: message types by the event names that the program has given them.
        notations: the slots that messages were written with.
    """

    def __init__(self, definitions: Optional[Definitions] = None):
        self._definitions = definitions
        self.events: Dict[str, str] = {}
        self.notations: Cache[MessageNotation, bool] = Cache(1000, 1 << 20)
        self._installed: Optional[TypeSpellings] = None

    @property
    def definitions(self) -> Definitions:
        """The known message types, loaded on first access."""
        if self._definitions is None:
            self._definitions = Definitions()
        return self._definitions

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
            # A misspelt type is more likely than one that is not installed, so it is suggested first.
            suggestion = self.definitions.misspelt(message_type)
            if suggestion:
                raise UsageError(
                    f"there is no message type {message_type}; did you mean {suggestion}?"
                ) from error
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
