"""ROS 1 message definitions: parsing, sizes, checksums, and skipping of serialized fields.

A definition is the text of a ``.msg`` file, optionally followed by those of nested types after lines of ``=``
(https://wiki.ros.org/msg). `parse` reads one definition; nested types are resolved by a callback (see
`type_registry`). Each definition knows its `Measure`: the size of its messages and the number of its slots. The
limits on both are checked while a definition is parsed, because definitions come from publishers and are not trusted.

The MD5 sum is that of ROS: of the constants and slots without comments and spacing, in which nested types are
replaced by their MD5 sums.

The lines are parsed here instead of with ``get_types_from_msg`` of rosbags, whose versions 0.9.20 and 0.11 read some
definitions differently than genmsg:

* The text of constants is lost, but it is part of the MD5 sum: ``0.50`` becomes 0.5, and ``010``, which is ten, 8.
* Version 0.9.20 reads ``byte`` as ``octet`` and ``char`` as ``uint8``, and renames slots that are keywords of Python.
  Its MD5 sums of ``diagnostic_msgs/DiagnosticArray`` and ``rosgraph_msgs/Log`` are therefore not those of ROS.
* Version 0.11 rejects constants with lower-case names, empty strings, packages with capital letters, and lines that
  end in CRLF, and removes quotes from constants.
* Both accept bounds, default values, negative lengths, duplicate names, and constants that are out of range.
* Errors have no position, and a definition takes 10 times the instructions (29 million for ``nav_msgs/Odometry``).
  A grammar for lark, as that of IDL, takes 6 times as long, and its import lengthens the start of each program.
  Publishers determine the definition, and its size limit allows 125,000 lines.
"""

import logging
import re
from enum import Enum
from struct import calcsize, unpack_from
from struct import error as StructError
from typing import (
    Callable,
    Container,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    Union,
)

from ..foundation.displayed_text import MAX_SHOWN_CHARACTERS, format_count, quote_shortened, shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import name_fault, ros1_type_name, type_fault
from ..foundation.source_places import Place, place_at_column, place_at_offset

log = logging.getLogger("retalis")

PRIMITIVES: Dict[str, str] = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "byte": "b",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Number types and their `struct` codes; ``byte`` and ``char`` are old names of int8 and uint8."""

FLOATS = frozenset(name for name, code in PRIMITIVES.items() if code in "efd")
"""Types of floats; the other number types are ``bool`` and integers."""

TIMES: Dict[str, str] = {"time": "II", "duration": "ii"}
BUILTIN = frozenset(PRIMITIVES) | frozenset(TIMES) | {"string"}


class SerializationFormat(Enum):
    """A serialization of messages, with the name that bags have for it."""

    ROS1 = "ros1"
    """That of ROS 1: little-endian numbers without padding."""
    CDR = "cdr"
    """Plain CDR, that of ROS 2; see `cdr_decoder`."""


QUOTED_STRINGS, PLAIN_STRINGS = STRING_FORMS = ("quoted", "plain")
"""Forms of strings in terms: atoms with double quotes inside, as in the original, and atoms without them."""

WIDE_STRING_COMMENT = "# wstring"
"""Comment of a ``string`` that is a ``wstring`` in ROS 2, in definitions that were converted from ROS 2."""

VARIABLE_LENGTH = -1
"""Length of an array whose number of elements is part of the message."""

MAX_SLOTS = 10_000
"""Maximum number of slots of a type including nested types; generated functions have a variable for each of them."""

MAX_TYPE_DEPTH = 50
"""Maximum nesting depth of types."""

MAX_MESSAGE_BYTES = (1 << 32) - 1
"""Maximum size of a message: its size is a 32-bit number on the wire."""


HEADER = "std_msgs/Header"
SEPARATOR = "=" * 80


ConstantValue = Union[bool, int, float, str]


class Constant(NamedTuple):
    """A named value of a definition.

    Attributes:
        text: the value as written.
        problem: why the constant is ignored, with its place; "" for a valid one. Other tools write definitions with
            repeated names or invalid values, and these are part of the checksum.
    """

    type: str
    name: str
    text: str
    value: ConstantValue
    problem: str = ""


class Field(NamedTuple):
    """A slot of a message; ROS calls it a field.

    Attributes:
        name: the slot's name.
        type: the type of the slot or of its elements: a built-in one, or ``pkg/Type``.
        length: None for a single value, `VARIABLE_LENGTH` or the number of elements for an array.
        definition: the definition of a ``pkg/Type``, None for built-in types.
        is_wide: whether strings are of type ``wstring`` in ROS 2.
        is_plain: whether strings are atoms without double quotes; see `Definition.with_strings`.
    """

    name: str
    type: str
    length: Optional[int] = None
    definition: Optional["Definition"] = None
    is_wide: bool = False
    is_plain: bool = False

    @property
    def is_bytes(self) -> bool:
        """True if the slot is a byte array, which events represent as text."""
        return self.length is not None and self.type in ("uint8", "char")

    def describe(self) -> str:
        """Return the type in the syntax of definitions, for example ``float64[36]``."""
        if self.length is None:
            return self.type
        return f"{self.type}[{'' if self.length == VARIABLE_LENGTH else self.length}]"


class Measure(NamedTuple):
    """Size limits of the messages of a type, and the complexity of the type.

    Attributes:
        min_size: minimum size of a message in bytes.
        is_fixed_size: whether all messages have that size.
        slot_count: number of slots, including those of nested types.
        depth: nesting depth of types.
        empty_element_count: number of zero-byte elements in arrays of fixed length.
        may_have_empty_elements: whether there is an array, of fixed or variable length, whose elements have no bytes.
    """

    min_size: int = 0
    is_fixed_size: bool = True
    slot_count: int = 0
    depth: int = 0
    empty_element_count: int = 0
    may_have_empty_elements: bool = False

    def plus(self, slot: Field) -> "Measure":
        """Return the measure of messages with one additional slot."""
        element = measure_of(slot)
        count = 1 if slot.length is None else slot.length
        # A variable array adds the four bytes of its count; its elements may be missing.
        is_variable = count == VARIABLE_LENGTH
        elements_are_empty = slot.length is not None and not element.min_size
        return Measure(
            self.min_size + (4 if is_variable else element.min_size * count),
            self.is_fixed_size and element.is_fixed_size and not is_variable,
            self.slot_count + element.slot_count + 1,
            max(self.depth, element.depth + 1),
            self.empty_element_count
            + (0 if is_variable else count * (element.empty_element_count + elements_are_empty)),
            self.may_have_empty_elements or element.may_have_empty_elements or elements_are_empty,
        )

    def exceeded_limit(self) -> str:
        """Return a description of the exceeded limit, or an empty string."""
        if self.slot_count > MAX_SLOTS:
            return f"a type cannot have more than {MAX_SLOTS} slots, including those of the types it contains"
        if self.depth > MAX_TYPE_DEPTH:
            return f"types cannot be nested more than {MAX_TYPE_DEPTH} deep"
        if self.min_size > MAX_MESSAGE_BYTES:
            return f"a message cannot have more than {MAX_MESSAGE_BYTES} bytes"
        return ""


def measure_of(slot: Field) -> Measure:
    """Return the measure of one element of a slot."""
    if slot.definition is not None:
        return slot.definition.measure
    if slot.type == "string":
        return Measure(4, False)
    return Measure(calcsize("<" + (TIMES.get(slot.type) or PRIMITIVES[slot.type])))


def measure_of_slots(fields: Iterable[Field]) -> Measure:
    """Return the measure of messages with these slots."""
    measure = Measure()
    for slot in fields:
        measure = measure.plus(slot)
    return measure


class Definition:
    """A message type with its nested types.

    >>> text = Definitions().find("std_msgs/String")
    >>> text.name, [slot.name for slot in text.fields], text.md5sum
    ('std_msgs/String', ['data'], '992ce8a1687cec8c8bd883ec73ca41d1')

    Attributes:
        name: ``pkg/Type``.
        fields: the slots in order.
        constants: the valid constants in order.
        text: the text of the definition, without those of nested types.
        event: name of its event terms if it differs from ``pkg__0__Type``.
        md5sum: checksum that identifies the version of the type in ROS.
        has_plain_strings: whether strings, also those of nested types, are atoms without double quotes.
        measure: sizes of its messages, and its complexity.

    Raises:
        MessageError: if ``name`` is not a valid type name.
    """

    def __init__(
        self,
        name: str,
        fields: Tuple[Field, ...],
        constants: Tuple[Constant, ...] = (),
        text: str = "",
        event: str = "",
    ):
        from hashlib import md5  # noqa: PLC0415 - loads OpenSSL, and many programs have no messages

        fault = type_fault(name)
        if fault is not None:
            raise MessageError(fault)
        self.name = name
        self.fields = fields
        self.constants = tuple(constant for constant in constants if not constant.problem)
        self._all_constants = constants
        self.text = text
        self.event = event
        self.measure = measure_of_slots(fields)
        self.has_plain_strings: bool = any(
            slot.is_plain if slot.definition is None else slot.definition.has_plain_strings for slot in fields
        )
        self._twin: Optional[Definition] = None
        """The same definition with the other form of strings, when it has been needed."""
        self.md5sum = md5(_checksum_text(self).encode()).hexdigest()

    def describe_constants(self) -> List[str]:
        """Return the lines of all constants without comments, including those that are ignored.

        >>> Definitions().add("my_robot/Door", "uint8 OPEN=1 # wide").describe_constants()
        ['uint8 OPEN=1']
        """
        return [f"{constant.type} {constant.name}={constant.text}" for constant in self._all_constants]

    def ignored_constants(self) -> List[str]:
        r"""Return why constants are ignored, each with its place.

        >>> len(Definitions().add("my_robot/Gate", "uint8 OPEN=1\nuint8 OPEN=2").ignored_constants())
        1
        """
        return [constant.problem for constant in self._all_constants if constant.problem]

    @property
    def functor_name(self) -> str:
        """The name of the type's event terms: ``pkg__0__Type``.

        >>> Definitions().find("std_msgs/String").functor_name
        'std_msgs__0__String'
        """
        return self.event or functor_name(self.name)

    @property
    def full_text(self) -> str:
        """The definition with those of all nested types, as in connection headers and bags.

        >>> definitions = Definitions()
        >>> seen = definitions.add("my_robot/Seen", "Header header")
        >>> "MSG: std_msgs/Header" in seen.full_text
        True
        """
        parts = [self.text]
        for nested in self.dependencies():
            parts.append(f"{SEPARATOR}\nMSG: {nested.name}\n{nested.text}")
        return "\n".join(parts)

    def dependencies(self) -> List["Definition"]:
        """Return the definitions of all nested types in the order of their first use, without duplicates.

        >>> definitions = Definitions()
        >>> seen = definitions.add("my_robot/Seen", "Header header")
        >>> [nested.name for nested in seen.dependencies()]
        ['std_msgs/Header']
        """
        definitions: Dict[str, Definition] = {}
        _collect_nested(self, definitions)
        return list(definitions.values())

    def renamed(self, name: str) -> "Definition":
        """Return the same definition under another name (``tf/tfMessage`` for ``tf2_msgs/TFMessage``).

        >>> Definitions().find("std_msgs/String").renamed("my_robot/Text").functor_name
        'my_robot__0__Text'
        """
        return Definition(name, self.fields, self._all_constants, self.text)

    def as_event(self, event: str) -> "Definition":
        """Return the same definition with event terms of another name; "" restores the type's name.

        >>> Definitions().find("std_msgs/Bool").as_event("bumper_left").functor_name
        'bumper_left'
        """
        if event == self.event:
            return self
        return Definition(self.name, self.fields, self._all_constants, self.text, event)

    def with_strings(self, strings: str) -> "Definition":
        """Return the same definition with another form of strings, also of those in nested types.

        Each call returns the same object.

        >>> definitions = Definitions()
        >>> text = definitions.find("std_msgs/String").with_strings("plain")
        >>> definitions.decoder(text).decode(bytes([4, 0, 0, 0]) + b"anna")[1]
        atom('anna')

        Args:
            strings: `QUOTED_STRINGS` or `PLAIN_STRINGS`.
        """
        if self.has_plain_strings == (strings == PLAIN_STRINGS):
            return self
        if self._twin is None:
            fields = tuple(_with_strings(slot, strings) for slot in self.fields)
            # A type without strings is the same in both forms.
            if fields == self.fields:
                return self
            self._twin = Definition(self.name, fields, self._all_constants, self.text, self.event)
        return self._twin

    def __repr__(self) -> str:
        return f"Definition({self.name!r}, md5sum={self.md5sum!r})"


def _with_strings(slot: Field, strings: str) -> Field:
    """Return a slot with another form of strings."""
    if slot.definition is not None:
        return slot._replace(definition=slot.definition.with_strings(strings))
    return slot._replace(is_plain=strings == PLAIN_STRINGS) if slot.type == "string" else slot


def functor_name(type_name: str) -> str:
    """Return the functor name of a message type: ``pkg__0__Type`` for ``pkg/Type``."""
    return type_name.replace("/", "__0__")


def type_name(functor_name: str) -> Optional[str]:
    """Return ``pkg/Type`` for ``pkg__0__Type``, or None if the name does not have that form."""
    package, mark, rest = functor_name.partition("__0__")
    return f"{package}/{rest}" if mark and package and rest else None


def _collect_nested(definition: Definition, definitions: Dict[str, Definition]) -> None:
    for slot in definition.fields:
        nested = slot.definition
        # A type that is nested several times is listed once, as in the definitions of connection headers.
        if nested is not None and nested.name not in definitions:
            definitions[nested.name] = nested
            _collect_nested(nested, definitions)


def _checksum_text(definition: Definition) -> str:
    """Return the text whose MD5 sum is that of the type: constants, then slots, with nested types as checksums.

    As in genmsg, comments, spacing and the array length of nested types do not count.
    """
    lines = definition.describe_constants()
    for slot in definition.fields:
        if slot.definition is None:
            lines.append(f"{slot.describe()} {slot.name}")
        else:
            # genmsg leaves the array length of a nested type out of the checksum.
            lines.append(f"{slot.definition.md5sum} {slot.name}")
    return "\n".join(lines).strip()


def service_checksum(request: Definition, response: Definition) -> str:
    """Return the checksum of the service with these types, as genmsg computes it.

    >>> find = Definitions().find
    >>> service_checksum(find("std_srvs/Trigger_Request"), find("std_srvs/Trigger_Response"))
    '937c9679a518e3a18d831e57125ea522'
    """
    from hashlib import md5  # noqa: PLC0415 - see `Definition`

    return md5((_checksum_text(request) + _checksum_text(response)).encode()).hexdigest()


MAX_EMPTY_ELEMENTS = 10_000
"""Default limit for the zero-byte elements of a message: elements of arrays whose type has no slots."""


def element_size(slot: Field) -> Optional[int]:
    """Return the size of one element of a slot in bytes, or None if it varies."""
    measure = measure_of(slot)
    return measure.min_size if measure.is_fixed_size else None


def describe_mismatch(definition: Definition, data: bytes) -> str:
    """Return an error text that says why the bytes are not a message of a type."""
    size = len(data)
    try:
        end = _SlotSkipper(data).skip_message(definition, 0, "")
    except _Truncated as truncated:
        return f"{_format_byte_count(size)} not a {definition.name}: they end inside slot {shorten(truncated.path)}"
    return f"{_format_byte_count(size)} not a {definition.name}: {size - end} left over"


def _format_byte_count(size: int) -> str:
    return f"{format_count(size, 'byte')} {'is' if size == 1 else 'are'}"


def check_empty_elements(definition: Definition, data: bytes, limit: int) -> None:
    """Check the number of zero-byte elements in a message, which the message's size does not limit.

    Raises:
        MessageError: if there are more than ``limit``, or the bytes are not a message of this type.
    """
    skipper = _SlotSkipper(data)
    try:
        skipper.skip_message(definition, 0, "")
    except _Truncated:
        raise MessageError(describe_mismatch(definition, data)) from None
    if skipper.empty_element_count > limit:
        count = skipper.empty_element_count
        raise MessageError(
            f"a {definition.name} has {count} zero-byte elements in its arrays: at most {limit} are allowed"
        )


def find_slot_end(data: bytes, slot: Field, offset: int) -> int:
    """Return the end offset of a slot that begins at ``offset``.

    Raises:
        struct.error: if the bytes end before.
    """
    try:
        return _SlotSkipper(data).skip_slot(slot, offset, slot.name)
    except _Truncated as truncated:
        raise StructError(truncated.path) from None


class _Truncated(Exception):
    """Raised if the bytes end inside the slot ``path``."""

    def __init__(self, path: str):
        super().__init__(path)
        self.path = path


class _SlotSkipper:
    """Traversal of a serialized message that skips its slots without decoding, and counts zero-byte elements.

    Each method returns the offset after what it has skipped.
    """

    def __init__(self, data: bytes):
        self.data = data
        self.empty_element_count = 0

    def skip_message(self, definition: Definition, offset: int, prefix: str) -> int:
        """Skip a message that begins at ``offset``; ``prefix`` is put before the names of its slots in errors."""
        for slot in definition.fields:
            offset = self.skip_slot(slot, offset, prefix + slot.name)
        return offset

    def skip_slot(self, slot: Field, offset: int, path: str) -> int:
        """Skip a slot that begins at ``offset``; ``path`` is its name in errors."""
        count = 1 if slot.length is None else slot.length
        if slot.length == VARIABLE_LENGTH:
            offset, count = offset + 4, self.read_count(offset, path)
        element = measure_of(slot)
        # Elements of fixed size are skipped with one multiplication, however many there are.
        if not element.is_fixed_size:
            return self.skip_elements(slot, count, offset, path)
        offset += count * element.min_size
        self.empty_element_count += count * (
            element.empty_element_count + (slot.length is not None and not element.min_size)
        )
        if offset > len(self.data):
            raise _Truncated(path)
        return offset

    def skip_elements(self, slot: Field, count: int, offset: int, path: str) -> int:
        """Skip ``count`` elements that differ in size."""
        for index in range(count):
            place = path if slot.length is None else f"{path}[{index}]"
            if slot.definition is not None:
                offset = self.skip_message(slot.definition, offset, place + ".")
            else:
                offset += 4 + self.read_count(offset, place)
                if offset > len(self.data):
                    raise _Truncated(place)
        return offset

    def read_count(self, offset: int, path: str) -> int:
        """Return the 32-bit count at an offset."""
        if offset + 4 > len(self.data):
            raise _Truncated(path)
        count: int = unpack_from("<I", self.data, offset)[0]
        return count


HEADER_NAMES = ("Header", "std_msgs/Header", "roslib/Header")
"""Names by which definitions refer to `HEADER`."""

MAX_SECTIONS = 1000
"""Maximum number of types in a definition, including nested ones."""

_MIN_SEPARATOR_CHARACTERS = 20
"""Minimum length of a separator; old definitions have shorter ones than `SEPARATOR`."""

_COMMENT = re.compile(r"#.*")
_STRING_CONSTANT = re.compile(r"\s*string\s+(?P<name>\w+)\s*=(?P<value>.*)")
_CONSTANT = re.compile(r"\s*(?P<type>[\w/]+)\s+(?P<name>\w+)\s*=(?P<value>.*)")
_FIELD = re.compile(r"\s*(?P<type>[\w/]+)(?P<array>\[\s*(?:[0-9]+\s*)?\])?\s+(?P<name>\w+)\s*$")

_MAX_INTEGER_CHARACTERS = 100
"""Maximum number of characters of an integer, including leading zeros: Python parses long integers slowly."""


def split_sections(name: str, text: str) -> Dict[str, str]:
    """Return the texts of a concatenated definition by type name, the first under ``name``.

    The parts are separated by a line of ``=`` and a line ``MSG: pkg/Type``.

    Raises:
        MessageError: if a type does not follow a separator, or a type has two different texts.
    """
    sections: Dict[str, str] = {}
    # The line number of a separator, directly after it; otherwise 0.
    current, separator_line = name, 0
    lines: List[str] = []
    for line_number, line in enumerate(text.splitlines(), 1):
        if separator_line:
            if not line.startswith("MSG:"):
                raise MessageError(
                    "expected 'MSG: pkg/Type' after the line of '='",
                    place_at_column(name, line_number, 1, line),
                )
            current, lines, separator_line = ros1_type_name(line[4:].strip()), [], 0
        elif len(line) >= _MIN_SEPARATOR_CHARACTERS and not line.strip("="):
            _add_section(sections, current, lines)
            separator_line = line_number
        else:
            lines.append(line)
    if separator_line:
        place = Place(name, separator_line, 1, SEPARATOR)
        raise MessageError("expected 'MSG: pkg/Type' after the line of '='", place)
    _add_section(sections, current, lines)
    return sections


def _add_section(sections: Dict[str, str], name: str, lines: List[str]) -> None:
    """Add the text of a type to the sections.

    Raises:
        MessageError: if the type has another text already, or there are too many types.
    """
    text = "\n".join(lines) + "\n" if lines else ""
    known = sections.setdefault(name, text)
    # Whitespace is ignored: copies of a definition differ in line ends and trailing spaces.
    if known.split() != text.split():
        raise MessageError(f"{name[:MAX_SHOWN_CHARACTERS]} is defined twice with different contents")
    if len(sections) > MAX_SECTIONS:
        raise MessageError(f"a definition cannot contain more than {MAX_SECTIONS} types")


def parse(name: str, text: str, find: Callable[[str, str], Definition], source: str = "") -> Definition:
    """Parse the definition of one type.

    Args:
        name: ``pkg/Type``.
        text: its text, without those of nested types.
        find: returns the definition of a nested type, given its name as written and the package of this type.
        source: file of the text, for errors; the type's name by default.

    Raises:
        MessageError: with its place, if a line is neither a slot nor a constant, a limit is exceeded, or ``find``
            raises it.
    """
    return Definition(name, *_DefinitionReader(name, text, find, source or name).read(), text)


class _DefinitionReader:
    """Parser of the definition of one type; the arguments are those of `parse`.

    Attributes:
        fields: the slots that have been parsed, by name.
        constants: the constants that have been parsed.
        constant_names: names of the valid ones.
        measure: the measure of the slots.
    """

    def __init__(self, name: str, text: str, find: Callable[[str, str], Definition], source: str):
        self.package = name.split("/")[0]
        self.text = text
        self.find = find
        self.source = source
        self.fields: Dict[str, Field] = {}
        self.constants: List[Constant] = []
        self.constant_names: Set[str] = set()
        self.measure = Measure()

    def read(self) -> Tuple[Tuple[Field, ...], Tuple[Constant, ...]]:
        """Return the slots and the constants."""
        try:
            self.text.encode()
        except UnicodeEncodeError as error:
            raise self._make_error(
                "an unpaired surrogate is not allowed: expected text that can be encoded in UTF-8",
                error.start,
            ) from None
        for offset, line in lines_with_offsets(self.text):
            self._read_line(offset, line)
        return tuple(self.fields.values()), tuple(self.constants)

    def _read_line(self, offset: int, line: str) -> None:
        """Add the constant or the slot of a line, which begins at ``offset``."""
        # A string constant takes the rest of the line literally: `#` does not begin a comment in it.
        match = _STRING_CONSTANT.match(line)
        if match:
            self._add_constant("string", match, offset)
            return
        comment = _COMMENT.search(line)
        line = _COMMENT.sub("", line)
        if not line.strip():
            return
        match = _FIELD.match(line)
        if match:
            self._add_field(match, offset, comment is not None and comment[0].strip() == WIDE_STRING_COMMENT)
            return
        match = _CONSTANT.match(line)
        if match:
            self._add_constant(match["type"], match, offset)
            return
        start = offset + len(line) - len(line.lstrip())
        raise self._make_error(
            f"expected 'type name' or 'type NAME=value', found {quote_shortened(line.strip())}", start
        )

    def _add_constant(self, type_name: str, match: "re.Match[str]", offset: int) -> None:
        # Definitions come from other nodes: limits are checked per line, before the rest of the text is read.
        text, name = match["value"].strip(), match["name"]
        if len(self.constants) >= MAX_SLOTS:
            raise self._make_error(
                f"a type cannot have more than {MAX_SLOTS} constants", offset + match.start("name")
            )
        value: ConstantValue = ""
        try:
            self._check_name(match, offset, self.constant_names)
            value = self._parse_constant(type_name, text, match, offset)
        except MessageError as error:
            # Constants are not part of messages, so an invalid one does not prevent reading them.
            problem = str(error).partition("\n")[0]
            self.constants.append(Constant(type_name, name, text, value, problem))
        else:
            self.constants.append(Constant(type_name, name, text, value))
            self.constant_names.add(name)

    def _parse_constant(
        self, type_name: str, text: str, match: "re.Match[str]", offset: int
    ) -> ConstantValue:
        """Return the value of a constant.

        Raises:
            MessageError: if it is not one of the type.
        """
        if type_name not in PRIMITIVES and type_name != "string":
            raise self._make_error(
                f"a constant cannot be of type {type_name[:MAX_SHOWN_CHARACTERS]}: {EXPECTED_CONSTANT_TYPE}",
                offset + match.start(),
            )
        try:
            return parse_constant(type_name, text)
        except ValueError:
            position = offset + match.start("value")
            expected = _describe_expected_value(type_name)
            problem = f"{quote_shortened(text)} is not a value of type {type_name}: {expected}"
            raise self._make_error(problem, position) from None

    def _add_field(self, match: "re.Match[str]", offset: int, is_wide: bool) -> None:
        self._check_name(match, offset, self.fields)
        type_name, array, length = ros1_type_name(match["type"]), match["array"], None
        if array is not None:
            length = self._parse_array_length(array[1:-1].strip(), offset + match.start("array"))
        if type_name in BUILTIN:
            definition = None
        else:
            definition = self._find_nested(type_name, offset + match.start("type"))
            type_name = definition.name
        slot = self.fields[match["name"]] = Field(
            match["name"], type_name, length, definition, is_wide and type_name == "string"
        )
        self.measure = self.measure.plus(slot)
        exceeded_limit = self.measure.exceeded_limit()
        if exceeded_limit:
            raise self._make_error(exceeded_limit, offset + match.start("type"))

    def _parse_array_length(self, digits: str, position: int) -> int:
        if len(digits) > len(str(MAX_MESSAGE_BYTES)) or (digits and int(digits) > MAX_MESSAGE_BYTES):
            raise self._make_error(f"an array cannot have more than {MAX_MESSAGE_BYTES} elements", position)
        return int(digits) if digits else VARIABLE_LENGTH

    def _find_nested(self, type_name: str, position: int) -> Definition:
        # `Header` without a package always means std_msgs/Header, as in genmsg.
        try:
            return self.find(HEADER if type_name in HEADER_NAMES else type_name, self.package)
        except MessageError as error:
            if error.place is not None:
                raise
            raise self._make_error(error.message, position) from None

    def _check_name(self, match: "re.Match[str]", offset: int, names: Container[str]) -> None:
        name = match["name"]
        fault = name_fault(name)
        if fault is not None:
            raise self._make_error(fault, offset + match.start("name"))
        if name in names:
            raise self._make_error(
                f"{name[:MAX_SHOWN_CHARACTERS]} is defined twice", offset + match.start("name")
            )

    def _make_error(self, message: str, offset: int) -> MessageError:
        return MessageError(message, place_at_offset(self.source, self.text, offset))


def warn_of_ignored_constants(problems: List[str]) -> None:
    """Log one warning for the constants of a definition that are ignored, given the reasons."""
    if problems:
        log.warning(
            "%s: %s ignored",
            problems[0],
            "the constant is" if len(problems) == 1 else f"this and {len(problems) - 1} more constants are",
        )


def lines_with_offsets(text: str) -> Iterator[Tuple[int, str]]:
    """Yield the lines of a text with the offset of their first character."""
    offset = 0
    for line in text.splitlines(keepends=True):
        yield offset, line.rstrip("\r\n")
        offset += len(line)


_BOOL_TEXTS = {"true": True, "True": True, "1": True, "false": False, "False": False, "0": False}


def parse_constant(type_name: str, text: str) -> ConstantValue:
    """Return the value of a constant.

    Raises:
        ValueError: if the text is not a value of that type.
    """
    if type_name == "string":
        return text
    if type_name == "bool":
        if text not in _BOOL_TEXTS:
            raise ValueError(text)
        return _BOOL_TEXTS[text]
    if type_name in FLOATS:
        return float(text)
    if len(text) > _MAX_INTEGER_CHARACTERS:
        raise ValueError(text)
    # Leading zeros are decimal in ROS, but an error for `int` with base 0, which is needed for hexadecimal numbers.
    value = int(text) if text.lstrip("+-").isdigit() else int(text, 0)
    low, high = integer_range(PRIMITIVES[type_name])
    if not low <= value <= high:
        raise ValueError(text)
    return value


EXPECTED_CONSTANT_TYPE = "expected bool, string, or a type of integers or floats"
"""End of the error for a constant of another type."""


def _describe_expected_value(type_name: str) -> str:
    if type_name == "bool":
        return "expected True, False, 1 or 0"
    if type_name in FLOATS:
        return "expected a number"
    low, high = integer_range(PRIMITIVES[type_name])
    return f"expected an integer from {low} to {high}"


def integer_range(code: str) -> Tuple[int, int]:
    """Return the minimum and the maximum integer of a `struct` code."""
    bits = {"b": 8, "h": 16, "i": 32, "q": 64}[code.lower()]
    return (0, (1 << bits) - 1) if code.isupper() else (-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
