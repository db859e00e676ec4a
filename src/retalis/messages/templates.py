"""A message type as a term to paste into a program: slots in their order, by name, or with zeros."""

from typing import Dict, Iterator, List, NamedTuple, Optional, Set

from ..prolog.syntax import to_text, write_term
from ..prolog.terms import atom, copy
from .definition import Definition, Field
from .registry import Definitions
from .slots import TIMES

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
