"""The slots of messages by name, for those who read programs."""

from typing import Dict, List, Optional

from ..foundation import Cache, MessageError, UsageError, counted
from ..prolog.syntax import Meant, MessageSlot, NamedForm
from ..prolog.terms import copy
from .definition import Definition, Field, functor_name, type_name
from .notations import Notations
from .registry import Definitions

LARGEST_ZERO = 1 << 20
"""Bytes that a message may have at least for its slots to be given by name: zeros are made of all of them."""


class SlotNames:
    """Slots of messages by the names of their terms.

    Args:
        definitions: the message types that are known; by default those that are installed.

    Attributes:
        events: the types of events that a program calls by names of their own.
        forms: how messages were written.
    """

    def __init__(self, definitions: Optional[Definitions] = None):
        self._definitions = definitions
        self.events: Dict[str, str] = {}
        self.forms: Cache[NamedForm, bool] = Cache(1000, 1 << 20)
        self._installed: Optional[Notations] = None

    @property
    def definitions(self) -> Definitions:
        """The message types that are known; looked for where they are first asked for."""
        if self._definitions is None:
            self._definitions = Definitions()
        return self._definitions

    def find(self, name: str) -> Optional[List[MessageSlot]]:
        """Return the slots of the messages that are called so; None where no messages are.

        Raises:
            UsageError: where they are not known.
        """
        kind = self.events.get(name) or type_name(name)
        if kind is None:
            return None
        try:
            definition = self.definitions.find(kind)
        except MessageError as error:
            meant = self.definitions.misspelt(kind)
            if meant:
                raise UsageError(f"there is no message type {kind}; did you mean {meant}?") from error
            raise UsageError(
                f"the slots of {kind} are not known when this is read: {error.message}; install its package, "
                "put its folder on ROS_PACKAGE_PATH, or write all slots in their order: what only publishers "
                "bring comes too late"
            ) from error
        if definition.measure.least > LARGEST_ZERO:
            raise UsageError(
                f"messages of {kind} have {counted(definition.measure.least, 'byte')} at least: write all slots in "
                "their order"
            )
        return self._slots(definition)

    def meant(self, name: str) -> Meant:
        """Return which messages were probably meant by a name that none are called."""
        if self._installed is None:
            self._installed = Notations((functor_name(one), one) for one in self.definitions.installed())
        own = Notations((event, event) for event in self.events)
        added = Notations((functor_name(one), one) for one in self.definitions.added())
        notations = (own, added, self._installed)
        same = [found for one in notations for found in one.same(name)]
        if same:
            return Meant(tuple(dict.fromkeys(same)), True)
        near = [found for one in notations for found in one.near(name)]
        return Meant(tuple(dict.fromkeys(near)))

    def _slots(self, definition: Definition) -> List[MessageSlot]:
        zero = copy(self.definitions.decoder(definition).decode(bytes(definition.measure.least)))
        return [_slot(slot, zero[at]) for at, slot in enumerate(definition.fields, 1)]  # type: ignore[index]


def _slot(slot: Field, zero: object) -> MessageSlot:
    message = "" if slot.definition is None else functor_name(slot.type)
    real = slot.type in ("float32", "float64")
    return MessageSlot(slot.name, slot.describe(), message, slot.length is not None, zero, real)  # type: ignore[arg-type]
