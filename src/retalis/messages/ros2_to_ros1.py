"""ROS 2 message types: their definitions in ROS 1 form, and conversion of CDR messages to ROS 1 serialization.

Definitions of ROS 2 extend those of ROS 1 (https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html) by
bounds of strings and arrays (``string<=10[<=5] names``), default values (``int32 x 5``), quoted string constants,
``wstring``, and ``pkg/msg/Type`` for ``pkg/Type``. Bounds and default values do not change the bytes of a message, so
they are omitted from the ROS 1 definition. A ``byte`` is an octet (``uint8``), a ``wstring`` a ``string`` in UTF-8.
The lines are parsed here instead of with ``get_types_from_msg`` of rosbags: that does not know ``wstring``, rejects
``wstring<=4``, gives errors no position, and in version 0.9.20 renames slots that are keywords of Python and rejects
default values of strings without quotes. `idl_definitions` converts definitions in IDL.

The events of a service (``pkg/srv/Type_Event``) are defined by the text of the ``.srv`` file: rosidl generates a
type with the slot ``info``, and with at most one ``request`` and one ``response``. The text that ``ros2 bag`` stores
begins with a heading ``SRV: pkg/srv/Type``.

CDR (OMG, Common Object Request Broker Architecture, 9.3; "plain CDR", which ROS 2 uses) aligns each number to its
size, counted from the end of the four bytes that encode the byte order. A function is generated for each type and
byte order: numbers between values of variable size are copied as a run by one `struct` format for each of the eight
alignments at which the run can begin. Strings end in a zero byte, which their length includes; a type without slots
has one byte; a header has no ``seq``, which becomes 0.

A ``wstring`` is a count and as many characters, without a zero at the end. Fast DDS and Cyclone DDS write characters
in four bytes, other implementations in two, and the message does not encode the width. Four bytes are tried first,
then two.
"""

import re
from array import array
from collections import deque
from struct import Struct
from struct import error as StructError
from sys import byteorder
from typing import Callable, Deque, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple

from ..foundation import codegen
from ..foundation.errors import MessageError, place_at_offset, quote_shortened, shorten
from ..foundation.ros_names import name_fault, ros1_type_name
from .idl_definitions import convert_idl
from .type_definition import (
    EXPECTED_CONSTANT_TYPE,
    HEADER,
    PRIMITIVES,
    TIMES,
    VARIABLE_LENGTH,
    Definition,
    Field,
    lines_with_offsets,
    measure_of,
    parse_constant,
    split_sections,
    warn_of_ignored_constants,
)
from .type_registry import MAX_DEFINITION_CHARACTERS, Definitions, InstalledTypes

FindText = Callable[[str], Optional[str]]
"""Function that returns the definition of ``pkg/Type`` with its nested types, in ROS 2 or ROS 1 form, or None."""

_LINE = re.compile(
    r"\s*(?P<type>[\w/]+)(?P<bound><=[0-9]+)?(?P<array>\[(?:<=)?[0-9]*\])?\s+(?P<name>\w+)(?P<rest>(?:[\s=#].*)?)$"
)
_QUOTED = re.compile(r"""\s*(?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')\s*(?:#.*)?$""")

_ROS1_TYPES = {
    "byte": "uint8",
    "octet": "uint8",
    "wstring": "string",
    "Header": HEADER,
    "builtin_interfaces/Time": "time",
    "builtin_interfaces/Duration": "duration",
}
"""Names of types in ROS 1."""

_STRING_TYPES = ("string", "wstring")

_INSTANT = "int32 sec\nuint32 nanosec\n"
_SERVICE_EVENT_INFO = """\
uint8 REQUEST_SENT=0
uint8 REQUEST_RECEIVED=1
uint8 RESPONSE_SENT=2
uint8 RESPONSE_RECEIVED=3
uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
"""
_BUILTIN_DEFINITIONS = {
    "builtin_interfaces/Time": _INSTANT,
    "builtin_interfaces/Duration": _INSTANT,
    "service_msgs/ServiceEventInfo": _SERVICE_EVENT_INFO,
}
"""Types that definitions use without containing them."""


class Ros2Type(NamedTuple):
    """A message type of ROS 2 and its conversion to ROS 1.

    Attributes:
        definition: the type in ROS 1 form.
        to_ros1: the function from a CDR message, including the four bytes of its encapsulation, to the serialized
            ROS 1 message. Raises `MessageError` if the bytes are not a message of this type.
    """

    definition: Definition
    to_ros1: Callable[[bytes], bytes]


_EVENT_SUFFIX = "_Event"

_HEADING = re.compile(r"^={20,}[ \t\r]*\n(MSG|SRV|IDL):[ \t]*(\S*)", re.MULTILINE)
"""Beginning of the definition of another type in a text."""


def parse_ros2_type(name: str, text: str, find: FindText, is_idl: bool = False) -> Ros2Type:
    """Parse a definition of ROS 2.

    Args:
        name: ``pkg/Type``, ``pkg/msg/Type``, or ``pkg/srv/Type_Event`` for the events of a service.
        text: the definition, including all nested types that ``find`` does not know; of a service the ``.srv`` file.
        find: returns the definitions of nested types.
        is_idl: whether the text before the first heading is in IDL.

    Raises:
        MessageError: if the text is not a valid definition, is too long, or names an unknown type.
    """
    is_service_event = "/srv/" in name and name.endswith(_EVENT_SUFFIX)
    name = ros1_type_name(name)
    if len(text) > MAX_DEFINITION_CHARACTERS:
        raise MessageError(
            f"the definition of {shorten(name)} has {len(text)} characters: "
            f"at most {MAX_DEFINITION_CHARACTERS} are allowed"
        )
    types = _read_nested_types(name, _split_by_type(name, text, is_idl, is_service_event), find)
    warn_of_ignored_constants(
        [problem for section in types.values() for problem in section.ignored_constants]
    )
    parts = [types[name].text]
    parts += [f"{'=' * 80}\nMSG: {nested}\n{types[nested].text}" for nested in types if nested != name]
    # A registry without installed types: the nested types must be those of CDR, not types of ROS 1 with equal names.
    registry = Definitions(InstalledTypes([], [], include_rosbags=False))
    definition = registry.add(name, "".join(parts))
    wide_slots = frozenset(
        (type_name, slot) for type_name, section in types.items() for slot in section.wide_slots
    )
    return Ros2Type(definition, _make_converter(definition, wide_slots))


class _Ros2Section(NamedTuple):
    """Definition of one type, without its nested types.

    Attributes:
        text: the definition in ROS 1 form.
        wide_slots: names of the slots that are wide strings or arrays of wide strings.
        nested_types: types of slots.
        ignored_constants: reasons why constants are ignored.
    """

    text: str
    wide_slots: List[str]
    nested_types: List[str]
    ignored_constants: List[str]


def _split_by_type(
    name: str, text: str, is_idl: bool = False, is_service_event: bool = False
) -> Dict[str, str]:
    """Return the definitions in a concatenated text by their types, ``pkg/Type``, in the syntax of ``.msg`` files."""
    sections = _list_sections(name, text, "IDL" if is_idl else "SRV" if is_service_event else "MSG")
    if all(section.syntax == "MSG" for section in sections):
        return {
            ros1_type_name(type_name): section for type_name, section in split_sections(name, text).items()
        }
    service = name[: -len(_EVENT_SUFFIX)] if is_service_event else name
    texts: Dict[str, str] = {}
    for section in sections:
        if section.syntax == "SRV" and section.text.strip():
            texts.update(_split_service(service if section.type == name else section.type, section.text))
        elif section.syntax == "MSG":
            texts.setdefault(section.type, section.text)
    if is_idl:
        # Types that this one does not use may be unreadable.
        requested = [f"{service}_Request", f"{service}_Response"] if is_service_event else [name]
    else:
        requested = [section.type for section in sections if section.syntax == "IDL"]
    if requested:
        # The other sections are replaced by empty lines, so that line numbers stay the same.
        idl_text = "".join(
            section.text if section.syntax == "IDL" else "\n" * section.line_count for section in sections
        )
        for type_name, type_text in convert_idl(name, idl_text, requested).items():
            texts.setdefault(type_name, type_text)
    if is_service_event:
        service_name = service.rpartition("/")[2]
        texts.setdefault(
            name,
            "service_msgs/ServiceEventInfo info\n"
            f"{service_name}_Request[<=1] request\n{service_name}_Response[<=1] response\n",
        )
    return texts


class _TextSection(NamedTuple):
    """Definition of one type in a concatenated text.

    Attributes:
        syntax: ``MSG``, ``SRV`` or ``IDL``.
        type: name of the type or service.
        text: the definition.
        line_count: number of lines, including those of the heading.
    """

    syntax: str
    type: str
    text: str
    line_count: int


def _list_sections(name: str, text: str, syntax: str) -> List[_TextSection]:
    """Return the definitions in a text; that before the first heading has the given name and syntax."""
    headings = list(_HEADING.finditer(text))
    ends = [*(heading.start() for heading in headings), len(text)]
    sections = [_TextSection(syntax, name, text[: ends[0]], text.count("\n", 0, ends[0]))]
    for heading, end in zip(headings, ends[1:]):
        # The grammar of IDL includes the heading.
        start = heading.start() if heading[1] == "IDL" else heading.end()
        line_count = text.count("\n", heading.start(), end)
        sections.append(_TextSection(heading[1], ros1_type_name(heading[2]), text[start:end], line_count))
    return sections


def _split_service(service: str, text: str) -> Dict[str, str]:
    """Return the types of the request and the response of a service, from the text of its ``.srv`` file."""
    lines = text.splitlines(keepends=True)
    separators = [number for number, line in enumerate(lines) if line.strip() == "---"]
    if len(separators) != 1:
        raise MessageError(
            f"the definition of service {shorten(service)} has {len(separators)} lines '---': expected one, between "
            "request and response"
        )
    return {
        f"{service}_Request": "".join(lines[: separators[0]]),
        f"{service}_Response": "".join(lines[separators[0] + 1 :]),
    }


def _read_nested_types(name: str, texts: Dict[str, str], find: FindText) -> Dict[str, _Ros2Section]:
    """Parse the definitions of a type and of all types nested in it."""
    types: Dict[str, _Ros2Section] = {}
    pending: Deque[str] = deque([name])
    while pending:
        type_name = pending.popleft()
        if type_name in types:
            continue
        if type_name not in texts:
            text = _BUILTIN_DEFINITIONS.get(type_name) or find(type_name)
            if text is None:
                raise MessageError(
                    f"the type {shorten(type_name)} is not defined in the bag or on this system"
                )
            # Definitions that came with the bag have priority over installed ones.
            for nested, section_text in _split_by_type(type_name, text).items():
                texts.setdefault(nested, section_text)
        types[type_name] = section = _Ros2DefinitionReader(type_name, texts).read()
        pending += section.nested_types
    return types


class _Ros2DefinitionReader:
    """Parser of the definition of one type.

    Args:
        name: ``pkg/Type``.
        texts: the definitions of all types in the same text.

    Attributes:
        lines: the lines of the definition in ROS 1 form.
        wide_slots: names of the slots that are wide strings.
        slot_types: message types of slots.
        constants: names of the constants.
        ignored_constants: reasons why constants are ignored.
        by_short_name: the types in ``texts`` by their names without package.
    """

    def __init__(self, name: str, texts: Dict[str, str]):
        self.name = name
        self.texts = texts
        # CDR has no `seq`, but the event terms of headers have the slots of ROS 1.
        self.lines: List[str] = ["uint32 seq"] if name == HEADER else []
        self.wide_slots: List[str] = []
        self.slot_types: List[str] = []
        self.constants: Set[str] = set()
        self.ignored_constants: List[str] = []
        self.by_short_name: Dict[str, List[str]] = {}
        for full_name in texts:
            self.by_short_name.setdefault(full_name.rpartition("/")[2], []).append(full_name)

    def read(self) -> _Ros2Section:
        """Return the definition in ROS 1 form."""
        text = self.texts[self.name]
        for offset, line in lines_with_offsets(text):
            content = line.strip()
            if not content or content.startswith("#"):
                continue
            match = _LINE.match(line)
            if match is None or (match["bound"] and match["type"] not in _STRING_TYPES):
                problem = f"expected 'type name' or 'type NAME=value', found {quote_shortened(content)}"
            else:
                problem = self._read_line(match)
            if problem:
                place = place_at_offset(self.name, text, offset + len(line) - len(line.lstrip()))
                raise MessageError(problem, place)
        return _Ros2Section(
            "".join(f"{line}\n" for line in self.lines),
            self.wide_slots,
            self.slot_types,
            self.ignored_constants,
        )

    def _read_line(self, match: "re.Match[str]") -> str:
        """Add a slot or a constant; return an error text, or an empty string."""
        rest = match["rest"].lstrip()
        if not rest.startswith("="):
            self._add_slot(match)
            return ""
        type_name = _ROS1_TYPES.get(match["type"], match["type"])
        if type_name not in PRIMITIVES and type_name != "string":
            return f"a constant cannot be of type {quote_shortened(type_name)}: {EXPECTED_CONSTANT_TYPE}"
        self._add_constant(type_name, match["name"], rest[1:])
        return ""

    def _add_constant(self, type_name: str, name: str, text: str) -> None:
        """Add a constant. One that ROS 1 cannot express is ignored: constants are not part of messages."""
        quoted = _QUOTED.match(text) if type_name == "string" else None
        if quoted is not None:
            value = re.sub(r"\\(.)", r"\1", quoted[1] if quoted[1] is not None else quoted[2])
        else:
            value = text.partition("#")[0].strip()
        problem = f"{quote_shortened(name)} is defined twice" if name in self.constants else name_fault(name)
        if problem is None:
            try:
                parse_constant(type_name, value)
            except ValueError:
                problem = f"{quote_shortened(value)} is not a value of type {type_name}"
        if problem is not None:
            self.ignored_constants.append(f"{self.name}: {problem}")
            return
        self.constants.add(name)
        self.lines.append(f"{type_name} {name}={value}")

    def _add_slot(self, match: "re.Match[str]") -> None:
        """Add a slot in ROS 1 form; the match is one of `_LINE`."""
        type_name, name = match["type"], match["name"]
        if self.name == HEADER and name == "seq":
            return
        # Recorded separately, because the ROS 1 definition has no wide strings.
        if type_name == "wstring":
            self.wide_slots.append(name)
        type_name = ros1_type_name(type_name)
        type_name = _ROS1_TYPES.get(type_name, type_name)
        if type_name not in PRIMITIVES and type_name not in TIMES and type_name != "string":
            type_name = self._qualify_name(type_name)
            self.slot_types.append(type_name)
        # A bounded array is one of variable length.
        length = (match["array"] or "").replace("<=", "]")
        self.lines.append(f"{type_name}{length.partition(']')[0] + ']' if length else ''} {name}")

    def _qualify_name(self, type_name: str) -> str:
        """Return the name of a nested type with its package."""
        if "/" in type_name:
            return type_name
        # Definitions in bags may name a type of another package without the package, if only one has that name.
        local_name = f"{self.name.partition('/')[0]}/{type_name}"
        candidates = self.by_short_name.get(type_name, [])
        return candidates[0] if local_name not in self.texts and len(candidates) == 1 else local_name


# ---- CDR ---------------------------------------------------------------------------------------------------

_Write = Callable[[bytes], object]
_Converter = Callable[[bytes, int, _Write], int]
"""Function from a CDR message and an offset in it to the offset after the value; it writes the value for ROS 1."""

_WideSlots = FrozenSet[Tuple[str, str]]
"""Wide strings, as pairs of a type's name and a slot's name."""

_CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}
"""Codes by which numbers are copied, by size: integers, because they preserve every bit of a float."""


class _RunItem(NamedTuple):
    """Bytes of a fixed number that are copied together with those around them.

    Attributes:
        size: number of bytes.
        is_in_cdr: whether CDR has them.
        is_in_ros1: whether ROS 1 has them.
        is_seconds: whether they are the seconds of a time; negative ones would be a time after 2106 in ROS 1.
    """

    size: int
    is_in_cdr: bool = True
    is_in_ros1: bool = True
    is_seconds: bool = False

    @property
    def is_number(self) -> bool:
        """True if the bytes are a number that is copied; otherwise they are skipped, or written as zeros."""
        return self.is_in_cdr and self.is_in_ros1


_SECONDS = _RunItem(4, is_seconds=True)
_HEADER_SEQ = _RunItem(4, is_in_cdr=False)
_EMPTY_MESSAGE = _RunItem(1, is_in_ros1=False)
"""The byte that CDR has for a type without slots."""

_MAX_SECONDS = (1 << 31) - 1

_MAX_INLINE_NUMBERS = 8
"""Arrays of at most this many numbers are copied together with the slots around them."""

_MAX_PADDING_BYTES = 3
"""Maximum number of bytes after a message: some implementations pad messages to a multiple of four bytes."""


def _make_converter(definition: Definition, wide_slots: _WideSlots) -> Callable[[bytes], bytes]:
    """Return the function `Ros2Type.to_ros1` of a type."""
    widths = (4, 2) if wide_slots else (4,)
    converters: Dict[str, List[_Converter]] = {}

    def to_ros1(raw: bytes) -> bytes:
        order = {b"\0\0": ">", b"\0\1": "<"}.get(bytes(raw[:2]), "")
        # Parameter-list CDR and XCDR2 have other representation identifiers and layouts.
        if not order or len(raw) < 4:
            raise MessageError(
                f"a message of {definition.name} is not plain CDR: expected 00 00 or 00 01 at its beginning, "
                f"found {raw[:2].hex(' ') or 'nothing'}"
            )
        data = bytes(raw[4:])
        if order not in converters:
            converters[order] = [
                _ConverterGenerator(order, width, wide_slots).compile(definition) for width in widths
            ]
        negative_time: Optional[_NegativeTimeError] = None
        # The message does not say how wide its characters are: the first width that consumes all bytes is right.
        for convert in converters[order]:
            chunks: List[bytes] = []
            try:
                end = convert(data, 0, chunks.append)
            except (StructError, UnicodeDecodeError):
                continue
            except _NegativeTimeError as error:
                negative_time = error
                continue
            if 0 <= len(data) - end <= _MAX_PADDING_BYTES:
                return b"".join(chunks)
        if negative_time is not None:
            raise MessageError(f"a {definition.name} has {negative_time}")
        raise MessageError(f"{len(data)} bytes of CDR are not a {definition.name}")

    return to_ros1


class _NegativeTimeError(ValueError):
    """A time before 1970, which ROS 1 cannot express."""

    def __init__(self, seconds: int):
        super().__init__(f"a time of {seconds - (1 << 32)} s: expected at least 0 s")


class _ConverterGenerator:
    """Generator of the function that converts messages of one type.

    Args:
        order: byte order, as a `struct` prefix.
        width: bytes of a wide character.
        wide_slots: the slots that are wide strings.
    """

    def __init__(self, order: str, width: int, wide_slots: _WideSlots):
        self.order, self.width, self.wide_slots = order, width, wide_slots
        self.lines: List[str] = []
        self.bound_names = codegen.BoundNames(
            {
                "StructError": StructError,
                "NegativeTimeError": _NegativeTimeError,
                "check_seconds": _make_seconds_check(order),
                "unpack_count": Struct(f"{order}I").unpack_from,
                "pack": Struct("<I").pack,
                "swapped": _swap_bytes,
                "text": _make_string_converter(order),
                "wide": _make_wide_string_converter(order, width),
            }
        )
        self.run: List[_RunItem] = []
        """Numbers since the last value of variable size."""

    def compile(self, definition: Definition) -> _Converter:
        """Return the function for a type: from bytes and an offset, to the offset after the message."""
        self.add_message(definition)
        self.end_run()
        lines = [
            "def convert(data, offset, write):",
            *(f"  {line}" for line in self.lines),
            "  return offset",
        ]
        convert: _Converter = codegen.function(
            lines, self.bound_names.values, f"convert {definition.name}", "convert"
        )
        return convert

    def add_message(self, definition: Definition) -> None:
        """Add a message."""
        fields = definition.fields
        if not fields:
            self.run.append(_EMPTY_MESSAGE)
        if definition.name == HEADER:
            self.run.append(_HEADER_SEQ)
            fields = fields[1:]
        for slot in fields:
            is_wide = (definition.name, slot.name) in self.wide_slots
            if slot.length is None:
                self.add_value(slot, is_wide)
            else:
                self.add_array(slot, is_wide, slot.length)

    def add_value(self, slot: Field, is_wide: bool) -> None:
        """Add a slot with a single value."""
        if slot.definition is not None:
            self.add_message(slot.definition)
        elif slot.type == "string":
            self.end_run()
            self.lines.append(self.copy_string(is_wide))
        else:
            self.run += _list_numbers(slot)

    @staticmethod
    def copy_string(is_wide: bool) -> str:
        """Return the statement that copies a string."""
        return f"offset = {'wide' if is_wide else 'text'}(data, offset, write)"

    def add_array(self, slot: Field, is_wide: bool, length: int) -> None:
        """Add an array."""
        numbers = _list_numbers(slot)
        if numbers and 0 <= length <= _MAX_INLINE_NUMBERS:
            self.run += numbers * length
            return
        self.end_run()
        count = str(length)
        if length == VARIABLE_LENGTH:
            count = "count"
            self.lines += [
                "offset = offset + 3 & -4",
                "count, = unpack_count(data, offset)",
                "offset += 4",
                "write(pack(count))",
                # Each element has at least one byte in CDR.
                "if count > len(data) - offset: raise StructError",
            ]
        if numbers:
            self.add_numbers(count, numbers)
        elif slot.type == "string":
            self.lines += [f"for _ in range({count}):", f"  {self.copy_string(is_wide)}"]
        elif slot.definition is not None:
            element = _ConverterGenerator(self.order, self.width, self.wide_slots).compile(slot.definition)
            name = self.bound_names.name("element", element)
            self.lines += [f"for _ in range({count}):", f"  offset = {name}(data, offset, write)"]

    def add_numbers(self, count: str, numbers: List[_RunItem]) -> None:
        """Add an array, given the numbers of an element, which have equal sizes: there is no padding between them."""
        size = numbers[0].size
        self.lines += [
            f"if {count}:",
            f"  offset = offset + {size - 1} & -{size}",
            f"  end = offset + {size * len(numbers)} * {count}",
            "  if end > len(data): raise StructError",
            *(
                f"  check_seconds(data[offset:end], {index}, {len(numbers)})"
                for index in _find_seconds(numbers)
            ),
            f"  write({f'swapped(data[offset:end], {size})' if self.order == '>' else 'data[offset:end]'})",
            "  offset = end",
        ]

    def end_run(self) -> None:
        """End the run: add the statements that copy it."""
        if not self.run:
            return
        output_layout = Struct("<" + _make_output_format(self.run))
        # Padding depends on the offset modulo 8 at which the run begins, which is only known when a message is read.
        input_layouts = [Struct(self.order + _make_input_format(self.run, phase)) for phase in range(8)]
        layouts = self.bound_names.name(
            "layouts", [(layout.unpack_from, layout.size) for layout in input_layouts]
        )
        pack = self.bound_names.name("pack", output_layout.pack)
        values = [item for item in self.run if item.is_number]
        self.lines += [
            f"read, size = {layouts}[offset & 7]",
            "values = read(data, offset)",
            *(
                f"if values[{index}] > {_MAX_SECONDS}: raise NegativeTimeError(values[{index}])"
                for index in _find_seconds(values)
            ),
            f"write({pack}(*values))",
            "offset += size",
        ]
        self.run = []


def _find_seconds(numbers: List[_RunItem]) -> List[int]:
    """Return the indexes of the seconds of times."""
    return [index for index, number in enumerate(numbers) if number.is_seconds]


def _list_numbers(slot: Field) -> List[_RunItem]:
    """Return the numbers in one element of a slot if all have the same size, otherwise an empty list."""
    if slot.definition is None:
        if slot.type in TIMES:
            return [_SECONDS if slot.type == "time" else _RunItem(4), _RunItem(4)]
        return [] if slot.type == "string" else [_RunItem(measure_of(slot).min_size)]
    numbers: List[_RunItem] = []
    if slot.definition.name == HEADER:
        return numbers
    for inner in slot.definition.fields:
        inner_numbers = (
            _list_numbers(inner) if inner.length is None or 0 < inner.length <= _MAX_INLINE_NUMBERS else []
        )
        if not inner_numbers or inner_numbers[0].size != (numbers or inner_numbers)[0].size:
            return []
        numbers += inner_numbers * (inner.length or 1)
    return numbers if len(numbers) <= _MAX_INLINE_NUMBERS else []


def _make_output_format(run: List[_RunItem]) -> str:
    """Return the `struct` format of a run in ROS 1, without its byte order; a pad byte is written as zero."""
    return "".join(
        _CODES[item.size] if item.is_in_cdr else f"{item.size}x" for item in run if item.is_in_ros1
    )


def _make_input_format(run: List[_RunItem], phase: int) -> str:
    """Return the `struct` format of a run in CDR that begins at an offset, given modulo 8, without its byte order."""
    codes, offset = [], phase
    for item in run:
        if item.is_in_cdr:
            padding = -offset % item.size
            codes.append(f"{padding}x{_CODES[item.size]}" if item.is_in_ros1 else f"{padding + item.size}x")
            offset += padding + item.size
    return "".join(codes)


def _make_seconds_check(order: str) -> Callable[[bytes, int, int], None]:
    """Return the function that checks the seconds of times in an array."""

    def check(data: bytes, first: int, step: int) -> None:
        numbers = array("I", data)
        if (order == ">") == (byteorder == "little"):
            numbers.byteswap()
        seconds = max(numbers[first::step])
        if seconds > _MAX_SECONDS:
            raise _NegativeTimeError(seconds)

    return check


def _swap_bytes(data: bytes, size: int) -> bytes:
    """Reverse the byte order of numbers of equal size."""
    numbers = array(_CODES[size], data)
    # `array` uses the machine's byte order, which is that of ROS 1 messages.
    numbers.byteswap()
    return numbers.tobytes()


def _make_string_converter(order: str) -> _Converter:
    """Return the function that copies a string."""
    unpack_count, pack = Struct(f"{order}I").unpack_from, Struct("<I").pack

    def convert(data: bytes, offset: int, write: _Write) -> int:
        offset = offset + 3 & -4
        # The end can be after the end of the data; `to_ros1` compares the final offset.
        end: int = offset + 4 + unpack_count(data, offset)[0]
        raw = data[offset + 4 : end]
        if raw.endswith(b"\0"):
            raw = raw[:-1]
        write(pack(len(raw)) + raw)
        return end

    return convert


def _make_wide_string_converter(order: str, width: int) -> _Converter:
    """Return the function that copies a wide string, with characters of ``width`` bytes, as UTF-8."""
    unpack_count, pack = Struct(f"{order}I").unpack_from, Struct("<I").pack
    names = {"<": "le", ">": "be"}
    coding, units = f"utf-{8 * width}-{names[order]}", f"utf-16-{names[order]}"

    def convert(data: bytes, offset: int, write: _Write) -> int:
        offset = offset + 3 & -4
        end: int = offset + 4 + width * unpack_count(data, offset)[0]
        text = data[offset + 4 : end].decode(coding, "surrogatepass")
        # Characters of four bytes are code units of UTF-16, too: a surrogate pair is one character.
        raw = (
            text.encode(units, "surrogatepass")
            .decode(units, "surrogatepass")
            .encode("utf-8", "surrogatepass")
        )
        write(pack(len(raw)) + raw)
        return end

    return convert
