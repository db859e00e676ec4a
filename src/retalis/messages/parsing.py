"""The text of a ``.msg`` file, read and checked."""

import re
from typing import Callable, Container, Dict, Iterator, List, Tuple

from ..foundation import SHOWN, MessageError, Place, place_at, place_in, plain_fault, plain_type, shortened
from .definition import HEADER, SEPARATOR, Constant, ConstantValue, Definition, Field, Measure
from .slots import BUILTIN, LARGEST, MOST_SLOTS, PRIMITIVES, VARIABLE

_HEADER_NAMES = ("Header", "std_msgs/Header", "roslib/Header")

MOST_SECTIONS = 1000

_COMMENT = re.compile(r"#.*")
_STRING_CONSTANT = re.compile(r"\s*string\s+(?P<name>\w+)\s*=(?P<value>.*)")
_CONSTANT = re.compile(r"\s*(?P<type>[\w/]+)\s+(?P<name>\w+)\s*=(?P<value>.*)")
_FIELD = re.compile(r"\s*(?P<type>[\w/]+)(?P<array>\[\s*(?:[0-9]+\s*)?\])?\s+(?P<name>\w+)\s*$")

_LONGEST_INTEGER = 100
"""Characters of the longest text of an integer, with all its zeros; Python takes long for long ones."""


def split_sections(name: str, text: str) -> Dict[str, str]:
    """Return the texts of a concatenated definition by type name, the first under ``name``.

    The parts are separated by a line of ``=`` and a line ``MSG: pkg/Type``.

    Raises:
        MessageError: for a separator without a type, or a type that comes twice with different texts.
    """
    sections: Dict[str, str] = {}
    current, start = name, 0
    lines: List[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        if start:
            if not line.startswith("MSG:"):
                raise MessageError(
                    "expected 'MSG: pkg/Type' after the line of '='", place_in(name, number, 1, line)
                )
            current, lines, start = plain_type(line[4:].strip()), [], 0
        elif len(line) >= 20 and not line.strip("="):
            _add_section(sections, current, lines)
            start = number
        else:
            lines.append(line)
    if start:
        raise MessageError("expected 'MSG: pkg/Type' after the line of '='", Place(name, start, 1, SEPARATOR))
    _add_section(sections, current, lines)
    return sections


def _add_section(sections: Dict[str, str], name: str, lines: List[str]) -> None:
    text = "\n".join(lines) + "\n" if lines else ""
    known = sections.setdefault(name, text)
    if known.split() != text.split():
        raise MessageError(f"{name[:SHOWN]} is defined twice with different contents")
    if len(sections) > MOST_SECTIONS:
        raise MessageError(f"a definition cannot contain more than {MOST_SECTIONS} types")


def parse(name: str, text: str, find: Callable[[str, str], Definition], source: str = "") -> Definition:
    """Read the definition of one type.

    Args:
        name: ``pkg/Type``.
        text: its text, without those of nested types.
        find: called with the name of a nested type as written and the package of this one;
            returns the definition.
        source: where the text comes from, for errors; the type's name by default.

    Raises:
        MessageError: with its place, for a line that is neither slot nor constant, and for what
            ``find`` raises.
    """
    return Definition(name, *_DefinitionReader(name, text, find, source or name).read(), text)


class _DefinitionReader:
    def __init__(self, name: str, text: str, find: Callable[[str, str], Definition], source: str):
        self.package = name.split("/")[0]
        self.text = text
        self.find = find
        self.source = source
        self.fields: Dict[str, Field] = {}
        self.constants: Dict[str, Constant] = {}
        self.measure = Measure()

    def read(self) -> Tuple[Tuple[Field, ...], Tuple[Constant, ...]]:
        try:
            self.text.encode()
        except UnicodeEncodeError as error:
            raise self._error(
                "half a surrogate pair, which cannot be stored in a file", error.start
            ) from None
        for offset, line in lines_of(self.text):
            self._line(offset, line)
        return tuple(self.fields.values()), tuple(self.constants.values())

    def _line(self, offset: int, line: str) -> None:
        found = _STRING_CONSTANT.match(line)
        if found:
            self._constant("string", found, offset)
            return
        line = _COMMENT.sub("", line)
        if not line.strip():
            return
        found = _FIELD.match(line)
        if found:
            self._field(found, offset)
            return
        found = _CONSTANT.match(line)
        if found:
            self._constant(found["type"], found, offset)
            return
        at = offset + len(line) - len(line.lstrip())
        raise self._error(f"expected 'type name' or 'type NAME=value', found {shortened(line.strip())}", at)

    def _constant(self, kind: str, found: "re.Match[str]", offset: int) -> None:
        text = found["value"].strip()
        self._new_name(found, offset, self.constants)
        if len(self.constants) >= MOST_SLOTS:
            raise self._error(
                f"a type cannot have more than {MOST_SLOTS} constants", offset + found.start("name")
            )
        if kind not in PRIMITIVES and kind != "string":
            raise self._error(f"a constant cannot be of type {kind[:SHOWN]}", offset + found.start())
        try:
            value = constant_value(kind, text)
        except ValueError:
            at = offset + found.start("value")
            raise self._error(f"{shortened(text)} is not a value of type {kind}", at) from None
        self.constants[found["name"]] = Constant(kind, found["name"], text, value)

    def _field(self, found: "re.Match[str]", offset: int) -> None:
        self._new_name(found, offset, self.fields)
        kind, array, length = plain_type(found["type"]), found["array"], None
        if array is not None:
            length = self._length(array[1:-1].strip(), offset + found.start("array"))
        if kind in BUILTIN:
            definition = None
        else:
            definition = self._nested(kind, offset + found.start("type"))
            kind = definition.name
        slot = self.fields[found["name"]] = Field(found["name"], kind, length, definition)
        self.measure = self.measure.plus(slot)
        problem = self.measure.problem()
        if problem:
            raise self._error(problem, offset + found.start("type"))

    def _length(self, digits: str, at: int) -> int:
        if len(digits) > len(str(LARGEST)) or (digits and int(digits) > LARGEST):
            raise self._error(f"an array cannot have more than {LARGEST} elements", at)
        return int(digits) if digits else VARIABLE

    def _nested(self, kind: str, at: int) -> Definition:
        try:
            return self.find(HEADER if kind in _HEADER_NAMES else kind, self.package)
        except MessageError as error:
            if error.place is not None:
                raise
            raise self._error(error.message, at) from None

    def _new_name(self, found: "re.Match[str]", offset: int, known: Container[str]) -> None:
        name = found["name"]
        fault = plain_fault(name)
        if fault is not None:
            raise self._error(fault, offset + found.start("name"))
        if name in known:
            raise self._error(f"{name[:SHOWN]} is defined twice", offset + found.start("name"))

    def _error(self, message: str, offset: int) -> MessageError:
        return MessageError(message, place_at(self.source, self.text, offset))


def lines_of(text: str) -> Iterator[Tuple[int, str]]:
    """Yield the lines of a text, each with the offset at which it begins."""
    offset = 0
    for line in text.splitlines(keepends=True):
        yield offset, line.rstrip("\r\n")
        offset += len(line)


_BOOLS = {"true": True, "True": True, "1": True, "false": False, "False": False, "0": False}


def constant_value(kind: str, text: str) -> ConstantValue:
    """Return the value of a constant.

    Raises:
        ValueError: if the text is not a value of that type.
    """
    if kind == "string":
        return text
    if kind == "bool":
        if text not in _BOOLS:
            raise ValueError(text)
        return _BOOLS[text]
    if kind in ("float32", "float64"):
        return float(text)
    if len(text) > _LONGEST_INTEGER:
        raise ValueError(text)
    value = int(text) if text.lstrip("+-").isdigit() else int(text, 0)
    low, high = integer_range(PRIMITIVES[kind])
    if not low <= value <= high:
        raise ValueError(text)
    return value


def integer_range(code: str) -> Tuple[int, int]:
    """Return the least and the greatest integer of a `struct` code."""
    bits = {"b": 8, "h": 16, "i": 32, "q": 64}[code.lower()]
    return (0, (1 << bits) - 1) if code.isupper() else (-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
