"""ROS 2 message types: definitions as those of ROS 1, and messages from CDR to the bytes of ROS 1.

The format of definitions is that of ROS 1 with more in it (https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html):
bounds of strings and arrays (``string<=10[<=5] names``), default values (``int32 x 5``), quoted strings as constants,
``wstring``, and ``pkg/msg/Type`` for ``pkg/Type``. Bounds and default values do not change the bytes of a message, so
they are left out of the ROS 1 definition. A ``byte`` is an octet (``uint8``), a ``wstring`` a ``string`` in UTF-8.

CDR (OMG, Common Object Request Broker Architecture, 9.3; in the plain form that ROS 2 uses) aligns each number to its
size, counted from the end of the four bytes that tell the byte order. Numbers between values of variable size are
copied as a run by one `struct` format for each of the eight alignments in which the run can begin. Strings end in a
zero byte, which is counted; a type without slots has one byte; a header has no ``seq``, which is 0 here.

A ``wstring`` is a count and as many characters without a zero at the end. Fast DDS and Cyclone DDS write characters
in four bytes, other implementations in two, and nothing in the message tells which. Two bytes are tried if four do
not fit.
"""

import re
from array import array
from collections import deque
from struct import Struct
from struct import error as StructError
from typing import Callable, Deque, Dict, FrozenSet, List, NamedTuple, Optional, Tuple

from ..foundation import codegen
from ..foundation.errors import MessageError, beginning, place_at, shortened
from ..foundation.ros_names import plain_type
from .type_definition import (
    HEADER,
    PRIMITIVES,
    TIMES,
    VARIABLE,
    Definition,
    Field,
    constant_value,
    lines_of,
    measure_of,
    split_sections,
)
from .type_registry import MAX_DEFINITION_CHARACTERS, Definitions, Installed

FindText = Callable[[str], Optional[str]]
"""Returns the definition of ``pkg/Type`` in the form of ROS 2 or ROS 1, those of nested types included; or None."""

_LINE = re.compile(
    r"\s*(?P<type>[\w/]+)(?P<bound><=[0-9]+)?(?P<array>\[(?:<=)?[0-9]*\])?\s+(?P<name>\w+)(?P<rest>(?:[\s=#].*)?)$"
)
_QUOTED = re.compile(r"""\s*(?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')\s*(?:#.*)?$""")

_TYPES = {
    "byte": "uint8",
    "octet": "uint8",
    "wstring": "string",
    "Header": HEADER,
    "builtin_interfaces/Time": "time",
    "builtin_interfaces/Duration": "duration",
}
"""ROS 1's names of types."""

_TEXTS = ("string", "wstring")

_INSTANT = "int32 sec\nuint32 nanosec\n"
_USUAL = {"builtin_interfaces/Time": _INSTANT, "builtin_interfaces/Duration": _INSTANT}
"""Types that definitions name and do not contain."""


class Ros2Type(NamedTuple):
    """A message type of ROS 2.

    Attributes:
        definition: the type as one of ROS 1.
        to_ros1: the function from a message in CDR, with the four bytes before it, to that of ROS 1. Raises
            `MessageError` if the bytes are not such a message.
    """

    definition: Definition
    to_ros1: Callable[[bytes], bytes]


def ros2_type(name: str, text: str, find: FindText) -> Ros2Type:
    """Read a definition of ROS 2.

    Args:
        name: ``pkg/Type`` or ``pkg/msg/Type``.
        text: the definition, with those of all nested types that ``find`` does not know.
        find: looks up nested types.

    Raises:
        MessageError: for a text that is not a definition or too long, or that names a type found nowhere.
    """
    name = plain_type(name)
    if len(text) > MAX_DEFINITION_CHARACTERS:
        raise MessageError(
            f"the definition of {beginning(name)} has {len(text)} characters: "
            f"at most {MAX_DEFINITION_CHARACTERS} are allowed"
        )
    types = _reachable(name, _sections(name, text), find)
    parts = [types[name].text]
    parts += [f"{'=' * 80}\nMSG: {other}\n{types[other].text}" for other in types if other != name]
    alone = Definitions(Installed([], [], rosbags=False))  # nested types as in CDR, not as in ROS 1
    definition = alone.add(name, "".join(parts))
    wide = frozenset((kind, slot) for kind, found in types.items() for slot in found.wide)
    return Ros2Type(definition, _converter(definition, wide))


class _Ros2Section(NamedTuple):
    """The definition of one type, without those of others.

    Attributes:
        text: in the form of ROS 1.
        wide: names of the slots that are wide strings or arrays of them.
        nested: names of the types of slots.
    """

    text: str
    wide: List[str]
    nested: List[str]


def _sections(name: str, text: str) -> Dict[str, str]:
    return {plain_type(kind): part for kind, part in split_sections(name, text).items()}


def _reachable(name: str, texts: Dict[str, str], find: FindText) -> Dict[str, _Ros2Section]:
    """Read the definitions of a type and of those nested in it."""
    types: Dict[str, _Ros2Section] = {}
    waiting: Deque[str] = deque([name])
    while waiting:
        kind = waiting.popleft()
        if kind in types:
            continue
        if kind not in texts:
            text = _USUAL.get(kind) or find(kind)
            if text is None:
                raise MessageError(f"the type {beginning(kind)} is not defined in the bag or on this system")
            for other, part in _sections(kind, text).items():
                texts.setdefault(other, part)
        types[kind] = section = _Ros2DefinitionReader(kind, texts).read()
        waiting += section.nested
    return types


class _Ros2DefinitionReader:
    """Reads the definition of one type.

    Args:
        name: ``pkg/Type``.
        texts: the definitions of all types that came with it.
    """

    def __init__(self, name: str, texts: Dict[str, str]):
        self.name = name
        self.texts = texts
        self.lines: List[str] = ["uint32 seq"] if name == HEADER else []
        self.wide: List[str] = []
        self.slot_types: List[str] = []
        self.by_kind: Dict[str, List[str]] = {}
        for other in texts:
            self.by_kind.setdefault(other.rpartition("/")[2], []).append(other)

    def read(self) -> _Ros2Section:
        text = self.texts[self.name]
        for offset, line in lines_of(text):
            body = line.strip()
            if not body or body.startswith("#"):
                continue
            found = _LINE.match(line)
            if found is None or (found["bound"] and found["type"] not in _TEXTS):
                problem = f"expected 'type name' or 'type NAME=value', found {shortened(body)}"
            else:
                problem = self._line(found)
            if problem:
                place = place_at(self.name, text, offset + len(line) - len(line.lstrip()))
                raise MessageError(problem, place)
        return _Ros2Section("".join(f"{line}\n" for line in self.lines), self.wide, self.slot_types)

    def _line(self, found: "re.Match[str]") -> str:
        """Take a slot or a constant; return what is wrong with it, or an empty text."""
        rest = found["rest"].lstrip()
        if not rest.startswith("="):
            self._slot(found)
            return ""
        kind = _TYPES.get(found["type"], found["type"])
        if kind not in PRIMITIVES and kind != "string":
            return f"a constant cannot be of type {shortened(kind)}"
        self._constant(kind, found["name"], rest[1:])
        return ""

    def _constant(self, kind: str, name: str, text: str) -> None:
        """Add a constant; one whose value ROS 1 cannot express is left out, as it is in no message."""
        quoted = _QUOTED.match(text) if kind == "string" else None
        if quoted is not None:
            value = re.sub(r"\\(.)", r"\1", quoted[1] if quoted[1] is not None else quoted[2])
        else:
            value = text.partition("#")[0].strip()
        try:
            constant_value(kind, value)
        except ValueError:
            return
        self.lines.append(f"{kind} {name}={value}")

    def _slot(self, found: "re.Match[str]") -> None:
        kind, name = found["type"], found["name"]
        if self.name == HEADER and name == "seq":
            return
        if kind == "wstring":
            self.wide.append(name)
        kind = plain_type(kind)
        kind = _TYPES.get(kind, kind)
        if kind not in PRIMITIVES and kind not in TIMES and kind != "string":
            kind = self._full_name(kind)
            self.slot_types.append(kind)
        length = (found["array"] or "").replace("<=", "]")  # a bounded array is one of variable length
        self.lines.append(f"{kind}{length.partition(']')[0] + ']' if length else ''} {name}")

    def _full_name(self, kind: str) -> str:
        """Return the name of a nested type with its package."""
        if "/" in kind:
            return kind
        own = f"{self.name.partition('/')[0]}/{kind}"
        others = self.by_kind.get(kind, [])
        return others[0] if own not in self.texts and len(others) == 1 else own


# ---- CDR ---------------------------------------------------------------------------------------------------

_Put = Callable[[bytes], object]
_Convert = Callable[[bytes, int, _Put], int]

_WideSlots = FrozenSet[Tuple[str, str]]
"""Slots that are wide strings: names of type and slot."""

_CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}
"""Formats by which numbers are copied, by size: integers, which keep every bit of a float."""

_SHORT = 8
"""Numbers of an array up to which it is copied with the slots around it."""

_PADDING = 3
"""Bytes that may follow a message: some implementations fill the last four."""


def _converter(definition: Definition, wide: _WideSlots) -> Callable[[bytes], bytes]:
    """Return `Ros2Type.to_ros1` of a type."""
    widths = (4, 2) if wide else (4,)
    made: Dict[str, List[_Convert]] = {}

    def to_ros1(raw: bytes) -> bytes:
        order = {b"\0\0": ">", b"\0\1": "<"}.get(bytes(raw[:2]), "")
        if not order or len(raw) < 4:
            raise MessageError(
                f"a message of {definition.name} is not plain CDR: expected 00 00 or 00 01 at its beginning, "
                f"found {raw[:2].hex(' ') or 'nothing'}"
            )
        data = bytes(raw[4:])
        if order not in made:
            made[order] = [_ConverterSource(order, width, wide).compile(definition) for width in widths]
        for convert in made[order]:
            chunks: List[bytes] = []
            try:
                end = convert(data, 0, chunks.append)
            except (StructError, UnicodeDecodeError):
                continue
            if 0 <= len(data) - end <= _PADDING:
                return b"".join(chunks)
        raise MessageError(f"{len(data)} bytes of CDR are not a {definition.name}")

    return to_ros1


class _ConverterSource:
    """Source of the function that converts one type, in the making.

    Args:
        order: the byte order, as in `struct`.
        width: the bytes of a wide character.
        wide: the slots that are wide strings.
    """

    def __init__(self, order: str, width: int, wide: _WideSlots):
        self.order, self.width, self.wide = order, width, wide
        self.lines: List[str] = []
        self.given = codegen.BoundNames(
            {
                "StructError": StructError,
                "number": Struct(f"{order}I").unpack_from,
                "pack": Struct("<I").pack,
                "swapped": _swapped,
                "text": _text_reader(order),
                "wide": _wide_reader(order, width),
            }
        )
        self.sizes: List[int] = []
        """Sizes of the numbers of the run; 0 for four bytes that only ROS 1 has, -1 for a byte that only CDR has."""

    def compile(self, definition: Definition) -> _Convert:
        """Return the function for a type: from the bytes and a place in them to the place behind the message."""
        self.message(definition)
        self.flush()
        lines = ["def convert(data, at, put):", *(f"  {line}" for line in self.lines), "  return at"]
        made: _Convert = codegen.function(lines, self.given.values, f"convert {definition.name}", "convert")
        return made

    def message(self, definition: Definition) -> None:
        fields = definition.fields
        if not fields:
            self.sizes.append(-1)
        if definition.name == HEADER:
            self.sizes.append(0)
            fields = fields[1:]
        for slot in fields:
            is_wide = (definition.name, slot.name) in self.wide
            if slot.length is None:
                self.single(slot, is_wide)
            else:
                self.array(slot, is_wide, slot.length)

    def single(self, slot: Field, is_wide: bool) -> None:
        if slot.definition is not None:
            self.message(slot.definition)
        elif slot.type == "string":
            self.flush()
            self.lines.append(self.string(is_wide))
        else:
            self.sizes += _sizes(slot)

    @staticmethod
    def string(is_wide: bool) -> str:
        return f"at = {'wide' if is_wide else 'text'}(data, at, put)"

    def array(self, slot: Field, is_wide: bool, length: int) -> None:
        numbers = _sizes(slot)
        if numbers and 0 <= length <= _SHORT:
            self.sizes += numbers * length
            return
        self.flush()
        count = str(length)
        if length == VARIABLE:
            count = "n"
            self.lines += [
                "at = at + 3 & -4",
                "n, = number(data, at)",
                "at += 4",
                "put(pack(n))",
                "if n > len(data) - at: raise StructError",  # an element has a byte at least
            ]
        if numbers:
            self.numbers(count, numbers)
        elif slot.type == "string":
            self.lines += [f"for _ in range({count}):", f"  {self.string(is_wide)}"]
        elif slot.definition is not None:
            element = _ConverterSource(self.order, self.width, self.wide).compile(slot.definition)
            name = self.given.name("element", element)
            self.lines += [f"for _ in range({count}):", f"  at = {name}(data, at, put)"]

    def numbers(self, count: str, sizes: List[int]) -> None:
        """Copy the numbers of an array, which are all of one size: nothing lies between them."""
        size = sizes[0]
        self.lines += [
            f"if {count}:",
            f"  at = at + {size - 1} & -{size}",
            f"  end = at + {size * len(sizes)} * {count}",
            "  if end > len(data): raise StructError",
            f"  put({f'swapped(data[at:end], {size})' if self.order == '>' else 'data[at:end]'})",
            "  at = end",
        ]

    def flush(self) -> None:
        """End the run: add the lines that copy it."""
        if not self.sizes:
            return
        out = Struct("<" + "".join("4x" if not size else _CODES.get(size, "") for size in self.sizes))
        read = [Struct(self.order + _aligned(self.sizes, phase)) for phase in range(8)]
        layouts = self.given.name("layouts", [(layout.unpack_from, layout.size) for layout in read])
        pack = self.given.name("pack", out.pack)
        self.lines += [f"read, size = {layouts}[at & 7]", f"put({pack}(*read(data, at)))", "at += size"]
        self.sizes = []


def _sizes(slot: Field) -> List[int]:
    """Return the sizes of the numbers of one element if these are all alike; otherwise an empty list."""
    if slot.definition is None:
        if slot.type in TIMES:
            return [4, 4]
        return [] if slot.type == "string" else [measure_of(slot).least]
    sizes: List[int] = []
    if slot.definition.name == HEADER:
        return sizes
    for inner in slot.definition.fields:
        found = _sizes(inner) if inner.length is None or 0 < inner.length <= _SHORT else []
        if not found or found[0] != (sizes or found)[0]:
            return []
        sizes += found * (inner.length or 1)
    return sizes if len(sizes) <= _SHORT else []


def _aligned(sizes: List[int], phase: int) -> str:
    """Return the format of numbers that begin at a place, given modulo 8."""
    codes, at = [], phase
    for size in sizes:
        if size > 0:
            padding = -at % size
            codes.append(f"{padding}x{_CODES[size]}")
            at += padding + size
        elif size < 0:
            codes.append("x")
            at += 1
    return "".join(codes)


def _swapped(data: bytes, size: int) -> bytes:
    numbers = array(_CODES[size] if size != 4 else "I", data)
    numbers.byteswap()
    return numbers.tobytes()


def _text_reader(order: str) -> _Convert:
    number, pack = Struct(f"{order}I").unpack_from, Struct("<I").pack

    def text(data: bytes, at: int, put: _Put) -> int:
        at = at + 3 & -4
        end: int = at + 4 + number(data, at)[0]  # behind the data, too, where `to_ros1` finds it
        raw = data[at + 4 : end]
        if raw.endswith(b"\0"):
            raw = raw[:-1]
        put(pack(len(raw)) + raw)
        return end

    return text


def _wide_reader(order: str, width: int) -> _Convert:
    number, pack = Struct(f"{order}I").unpack_from, Struct("<I").pack
    names = {"<": "le", ">": "be"}
    coding, units = f"utf-{8 * width}-{names[order]}", f"utf-16-{names[order]}"

    def wide(data: bytes, at: int, put: _Put) -> int:
        at = at + 3 & -4
        end: int = at + 4 + width * number(data, at)[0]
        text = data[at + 4 : end].decode(coding, "surrogatepass")
        # In four bytes, too, there are units of UTF-16: pairs of surrogates make a character.
        raw = (
            text.encode(units, "surrogatepass")
            .decode(units, "surrogatepass")
            .encode("utf-8", "surrogatepass")
        )
        put(pack(len(raw)) + raw)
        return end

    return wide
