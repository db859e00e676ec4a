"""Names of messages in other notations: ``Temperature``, ``sensor_msgs/Temperature``, ``sensor_msgs_Temperature``.

The slots of messages by name, for those who read programs.

A message type as a term to paste into a program: slots in their order, by name, or with zeros.
"""

from difflib import get_close_matches
from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, UsageError, counted
from ..prolog.syntax.event_text import to_text
from ..prolog.syntax.message_fields import Meant, MessageSlot, NamedForm
from ..prolog.syntax.term_writer import write_term
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import atom
from .type_definition import TIMES, Definition, Field, functor_name, type_name
from .type_registry import Definitions

_MAX_NAME_CHARACTERS = 200
"""Characters of a name for which others that are like it are looked for."""


class TypeNotations:
    """Finds the names of messages by how else they may be written.

    Args:
        names: what messages are called in programs, each with its type, or with itself.
    """

    def __init__(self, names: Iterable[Tuple[str, str]]):
        self._names: Dict[str, List[str]] = {}
        self._by_first: Dict[str, List[str]] = {}
        for name, kind in names:
            for written in dict.fromkeys(map(_letters, (kind, kind.rpartition("/")[2]))):
                self._names.setdefault(written, []).append(name)
        for written in self._names:
            self._by_first.setdefault(written[:1], []).append(written)

    def same(self, name: str) -> List[str]:
        """Return what the messages are called that a name is another notation of."""
        return self._names.get(_letters(name.replace("__0__", "/")), [])

    def near(self, name: str) -> List[str]:
        """Return what the messages are called whose names are like another one, from its first letter on."""
        if len(name) > _MAX_NAME_CHARACTERS:
            return []
        letters = _letters(name)
        close = get_close_matches(letters, self._by_first.get(letters[:1], ()), 1, 0.75)
        return self._names[close[0]] if close else []


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()


MAX_ZERO_BYTES = 1 << 20
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
        self._installed: Optional[TypeNotations] = None

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
        if definition.measure.least > MAX_ZERO_BYTES:
            raise UsageError(
                f"messages of {kind} have {counted(definition.measure.least, 'byte')} at least: write all slots in "
                "their order"
            )
        return self._slots(definition)

    def meant(self, name: str) -> Meant:
        """Return which messages were probably meant by a name that none are called."""
        if self._installed is None:
            self._installed = TypeNotations((functor_name(one), one) for one in self.definitions.installed())
        own = TypeNotations((event, event) for event in self.events)
        added = TypeNotations((functor_name(one), one) for one in self.definitions.added())
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


_INDENT = "    "


class _TemplateLine(NamedTuple):
    """A line of a template, and what is said of it."""

    text: str
    said: str = ""


def positional(definition: Definition) -> str:
    """Return the term of a type with a variable for each slot, and the slots as comments.

    >>> print(positional(Definitions().find("std_msgs/Header")), end="")
    std_msgs__0__Header(
        Seq,          % seq: uint32
        [Sec, NSec],  % stamp: time
        FrameId       % frame_id: string
    )
    """
    return _Template(named=False).text(definition)


def by_names(definition: Definition) -> str:
    """Return the same with slots by name, of which those that do not matter can be deleted.

    >>> print(by_names(Definitions().find("std_msgs/Header")), end="")
    std_msgs__0__Header{
        seq: Seq,            % uint32
        stamp: [Sec, NSec],  % time
        frame_id: FrameId    % string
    }
    """
    return _Template(named=True).text(definition)


def zero(definition: Definition, definitions: Definitions) -> str:
    """Return the message of a type that nobody has filled in, on a line.

    >>> definitions = Definitions()
    >>> print(zero(definitions.find("std_msgs/Header"), definitions), end="")
    std_msgs__0__Header(0,[0,0],'""')
    """
    return write_term(copy(definitions.decoder(definition).decode(bytes(definition.measure.least)))) + "\n"


class _Template:
    """The lines of a term.

    Args:
        named: whether slots are by name.
    """

    def __init__(self, named: bool):
        self.named = named
        self.used: Set[str] = set()

    def text(self, definition: Definition) -> str:
        lines = list(self.message(definition, "", "", [], ""))
        shown = _aligned(lines)
        elements = _elements(definition)
        for one in elements.values():
            shown += ["", f"% {one.name}, an element:"]
            inner = list(_Template(self.named).message(one, "", "", [], ""))
            shown += [f"% {line}" for line in _aligned(inner)]
        for one in (definition, *definition.dependencies()):
            if one.constants:
                shown += ["", f"% constants of {one.name}:"]
                texts = [f"{found.name} = {_plain(found.text)} ({found.type})" for found in one.constants]
                shown += [f"%   {text}" for text in texts]
        return "\n".join(shown) + "\n"

    def message(
        self, definition: Definition, indent: str, before: str, above: List[str], said: str, end: str = ""
    ) -> Iterator[_TemplateLine]:
        """Yield the lines of a message: what stands before it, how deep it is, what is said, what follows it."""
        name = to_text(atom(definition.functor_name))
        if not definition.fields:
            yield _TemplateLine(f"{indent}{before}{name}{end}", said)
            return
        opening, closing = ("{", "}") if self.named else ("(", ")")
        if self.named and before:  # the type of the slot says which message it is
            name = ""
        yield _TemplateLine(f"{indent}{before}{name}{opening}", said)
        for at, slot in enumerate(definition.fields, 1):
            comma = "," if at < len(definition.fields) else ""
            yield from self.slot(slot, indent + _INDENT, above, comma)
        yield _TemplateLine(f"{indent}{closing}{end}")

    def slot(self, slot: Field, indent: str, above: List[str], comma: str) -> Iterator[_TemplateLine]:
        before = f"{_slot_name(slot.name)}: " if self.named else ""
        said = slot.describe() if self.named else f"{slot.name}: {slot.describe()}"
        if slot.definition is not None and slot.length is None:
            yield from self.message(slot.definition, indent, before, [*above, slot.name], said, comma)
        elif slot.type in TIMES and slot.length is None:
            parts = [self.variable(name, [*above, slot.name]) for name in ("sec", "n_sec")]
            yield _TemplateLine(f"{indent}{before}[{', '.join(parts)}]{comma}", said)
        else:
            yield _TemplateLine(f"{indent}{before}{self.variable(slot.name, above)}{comma}", said)

    def variable(self, name: str, above: List[str]) -> str:
        """Return a variable for a slot, which has more of the names around it where others have taken its own."""
        for at in range(len(above), -1, -1):
            found = "".join(map(_capitalised, [*above[at:], name]))
            if not found[:1].isupper():
                found = f"V{found}"
            if found not in self.used:
                break
        number, plain = 1, found
        while found in self.used:
            number += 1
            found = f"{plain}_{number}"
        self.used.add(found)
        return found


def _capitalised(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _slot_name(name: str) -> str:
    return to_text(atom(name))


def _plain(text: str) -> str:
    """Return the text of a constant as it may stand in a comment of one line."""
    return text if text.isprintable() else ascii(text)


def _elements(definition: Definition) -> Dict[str, Definition]:
    """Return the types of the elements of arrays, each once: what stands in a list is written like that."""
    found: Dict[str, Definition] = {}
    left: List[Optional[Definition]] = [definition]
    while left:
        one = left.pop(0)
        for slot in one.fields if one is not None else ():
            if slot.definition is not None and slot.definition.name not in found:
                if slot.length is not None:
                    found[slot.definition.name] = slot.definition
                left.append(slot.definition)
    return found


def _aligned(lines: List[_TemplateLine]) -> List[str]:
    widest = max(len(line.text) for line in lines if line.said) if any(line.said for line in lines) else 0
    return [f"{line.text.ljust(widest)}  % {line.said}" if line.said else line.text for line in lines]
