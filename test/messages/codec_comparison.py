"""Comparison of this package with genpy or rosbags: random messages of many types are decoded and encoded.

For each message of each type: the decoded term denotes the values that the reference has deserialized, and the bytes
that are encoded from it, before and after its lazy terms are read, and from the terms of the reference's values are
those that the reference serializes.

    PYTHONPATH=src:test python3 -m messages.codec_comparison --messages 1000 rosbags
    PYTHONPATH=src:test python3 -m messages.codec_comparison --messages 1000 genpy  (in a shell that has sourced ROS)

The types of genpy are those of the installed packages, and those of all stores of rosbags, from whose texts genpy
generates classes. Three known differences are excluded: genpy replaces bytes that are no UTF-8 in a string; it
carries nanoseconds over a second; and both references set a bit in signalling NaNs, which arrays keep here.
"""

import argparse
import io
import random
import re
import struct
import sys
import time
from base64 import b64encode
from itertools import islice
from pathlib import Path
from typing import Any, Iterator, List, NamedTuple, Set

from message_registries import empty_registry

from messages.reference_wire_format import CODES, serialize
from retalis import Atom, Definitions, MessageError, Term, atom, functor
from retalis.messages.type_definition import VARIABLE_LENGTH
from retalis.prolog.terms.types import CONS, NIL, deref

TEXT_PIECES = (
    "base_link", "Jürgen", "日本", "🤖", "'", '"', "\\", "\n", "\r", "\t", "\0", "\x1b", "\x7f", "\u0085", "\u2028",
    "FFFFFFFFFF", "////", " ", "%", "é", "x" * 300, "ü" * 600,
)  # fmt: skip
BYTE_PIECES = (
    b"", b"\0", b"\xff", b"abc", b"\t\n", b"FFFFFFFFFF", bytes(range(256)), b"x" * 1100, b"\x80" * 1500,
)  # fmt: skip


def floats(code: str, integer_code: str, *patterns: Any) -> List[Any]:
    return [struct.unpack(code, struct.pack(integer_code, bits))[0] for bits in patterns]


SPECIAL_FLOATS = {
    # Infinities, quiet NaNs, zeros, the smallest and the largest numbers.
    "float32": floats(
        "<f", "<I", 0x7F80 << 16, 0xFF80 << 16, 0x7FC0 << 16, (0xFFC0 << 16) + 1, 0, 1 << 31, 1, (0x7F80 << 16) - 1,
        0x0080 << 16,
    ),
    "float64": floats(
        "<d", "<Q", 0x7FF0 << 48, 0xFFF0 << 48, 0x7FF8 << 48, (0xFFF8 << 48) + 1, 0, 1 << 63, 1, (0x7FF0 << 48) - 1,
        0x0010 << 48,
    ),
}  # fmt: skip
LENGTHS = (0, 0, 1, 1, 2, 3, 4, 5, 8, 9, 17, 200)

BUDGETS = (*[20] * 12, *[200] * 3, 3000)
"""Numbers of slots in the arrays of a message; large messages are rare, since they take long."""


class RandomMessages:
    """Random values of a type, in the form of `reference_wire_format`; extreme values are frequent."""

    def __init__(self, definition: Any, seed: Any) -> None:
        self.definition = definition
        self.random = random.Random(f"{definition.name} {definition.md5sum} {seed}")
        self.budget = 0

    def values(self) -> Any:
        """Return the values of the next message."""
        self.budget = self.random.choice(BUDGETS)
        return self.message(self.definition)

    def message(self, definition: Any) -> List[Any]:
        return [self.slot(slot) for slot in definition.fields]

    def slot(self, slot: Any) -> Any:
        if slot.length is None:
            return self.single(slot)
        if slot.type in ("uint8", "char"):
            return self.blob(slot.length)
        count = slot.length
        if count == VARIABLE_LENGTH:
            # Arrays in arrays would otherwise multiply to millions of elements.
            slots = 1 if slot.definition is None else max(1, slot.definition.measure.slot_count)
            count = min(self.random.choice(LENGTHS), max(0, self.budget // slots))
            self.budget -= count * slots
        return [self.single(slot) for _ in range(count)]

    def blob(self, length: Any) -> bytes:
        if self.random.random() < 0.5:
            data = self.random.choice(BYTE_PIECES)
        else:
            data = bytes(self.random.choices(range(32, 127), k=self.random.choice(LENGTHS)))
        return (
            data
            if length == VARIABLE_LENGTH
            else data[:length].ljust(length, self.random.choice((b" ", b"\0")))
        )

    def single(self, slot: Any) -> Any:
        if slot.definition is not None:
            return self.message(slot.definition)
        return getattr(self, f"_{slot.type}", self._integer)(slot.type)

    def _string(self, type_name: Any) -> bytes:
        return "".join(self.random.choices(TEXT_PIECES, k=self.random.choice((0, 1, 1, 2)))).encode()

    def _bool(self, type_name: Any) -> bool:
        return self.random.random() < 0.5

    def _time(self, type_name: str) -> List[Any]:
        return [self._integer("uint32"), self.random.choice((0, 999_999_999, self.random.randrange(10**9)))]

    def _duration(self, type_name: Any) -> List[Any]:
        return [self._integer("int32"), self._time("time")[1]]

    def _float32(self, type_name: Any) -> Any:
        return self._float(type_name, "<f", "<I", 0x7F800000, 0x400000)

    def _float64(self, type_name: Any) -> Any:
        return self._float(type_name, "<d", "<Q", 0x7FF << 52, 1 << 51)

    def _float(self, type_name: Any, code: str, integer_code: str, exponent: int, quiet: int) -> Any:
        choice = self.random.random()
        if choice < 0.2:
            return self.random.choice(SPECIAL_FLOATS[type_name])
        if choice < 0.6:
            return struct.unpack(code, struct.pack(code, self.random.uniform(-1000, 1000)))[0]
        bits = self.random.getrandbits(8 * struct.calcsize(code))
        if bits & exponent == exponent and bits & (quiet - 1):
            bits |= quiet
        return struct.unpack(code, struct.pack(integer_code, bits))[0]

    def _integer(self, type_name: str) -> int:
        code = CODES[type_name]
        bits = 8 * struct.calcsize(code)
        low, high = (0, (1 << bits) - 1) if code.isupper() else (-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
        choice = self.random.random()
        if choice < 0.3:
            return self.random.choice((low, high, 0, 1, high - 1))
        return (
            self.random.randint(max(low, -100), min(high, 100))
            if choice < 0.6
            else self.random.randint(low, high)
        )


# ---- Values of terms, and terms of the references' values ----


def check_same(term: Any, expected: Any, path: str = "") -> None:
    """Compare a term with one without lazy terms; floats are equal if all bits are.

    Raises:
        AssertionError: with the path of arguments and elements to the difference.
    """
    term = deref(term)
    if expected.__class__ is float:
        assert term.__class__ is float, (path, term, expected)
        assert PACK(term) == PACK(expected), (path, term, expected)
    elif expected.__class__ is not tuple:
        assert term.__class__ is expected.__class__, (path, term, expected)
        assert term == expected, (path, term, expected)
    elif expected[0] is not CONS:
        assert term.__class__ is tuple, (path, term, expected)
        assert term[0] is expected[0], (path, term, expected)
        for index, (argument, expected_argument) in enumerate(zip(term[1:], expected[1:])):
            check_same(argument, expected_argument, f"{path}({index}")
    else:
        index = 0
        while expected is not NIL:
            assert term.__class__ is tuple, (path, index, term, expected)
            assert term[0] is CONS, (path, index, term, expected)
            check_same(term[1], expected[1], f"{path}[{index}")
            term, expected, index = deref(term[2]), expected[2], index + 1
        assert term is NIL, (path, index, term)


PACK = struct.Struct("<d").pack


def prolog_list(items: List[Any]) -> Any:
    term: Term = NIL
    for item in reversed(items):
        term = (CONS, item, term)
    return term


CONTROL = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


def text_atom(text: Any) -> Any:
    """Return the atom of a string, as `docs/reference/messages.md` defines it."""
    is_text = CONTROL.search(text) is None and not text.startswith("FFFFFFFFFF")
    return atom(f'"{text}"') if is_text else encoded_atom(text.encode())


def blob_atom(data: Any) -> Any:
    """Return the atom of a byte array."""
    is_text = all(32 <= byte < 127 or 9 <= byte <= 13 for byte in data) and not data.startswith(b"FFFFFFFFFF")
    return atom(f'"{data.decode("ascii")}"') if is_text else encoded_atom(data)


def encoded_atom(data: bytes) -> Atom:
    digits = b64encode(data).decode()
    lines = [digits[start : start + 76] + "////" for start in range(0, len(digits), 76)]
    return atom(f'"FFFFFFFFFF{"".join(lines)}"')


def term_of(definition: Any, message: Any) -> Any:
    """Return the term of a deserialized message of a reference."""
    name = definition.name.replace("/", "__0__")
    if not definition.fields:
        return atom(name)
    values = [_attribute(message, slot.name) for slot in definition.fields]
    arguments = [_slot_term(slot, value) for slot, value in zip(definition.fields, values)]
    return functor(name, len(arguments))(*arguments)


def _attribute(message: Any, name: Any) -> Any:
    # rosbags and genpy append "_" to the keywords of Python; headers of ROS 2 have no number.
    return getattr(message, name) if hasattr(message, name) else getattr(message, f"{name}_", 0)


def _slot_term(slot: Any, value: Any) -> Any:
    if slot.length is None:
        return _single_term(slot, value)
    if slot.type in ("uint8", "char"):
        # rclpy has the elements of an array of bytes as objects of this type.
        is_split = isinstance(value, list) and value and isinstance(value[0], bytes)
        return blob_atom(b"".join(value) if is_split else bytes(bytearray(value)))
    return prolog_list([_single_term(slot, item) for item in getattr(value, "tolist", lambda: value)()])


def _single_term(slot: Any, value: Any) -> Any:
    if slot.definition is not None:
        return term_of(slot.definition, value)
    if slot.type == "string":
        return text_atom(value if isinstance(value, str) else value.decode())
    if slot.type in ("time", "duration"):
        if hasattr(value, "secs"):
            return prolog_list([value.secs, value.nsecs])
        # The seconds of rosbags are those of ROS 2, with a sign.
        return prolog_list([value.sec % 2**32 if slot.type == "time" else value.sec, value.nanosec])
    if slot.type == "bool":
        return atom("true" if value else "false")
    if slot.type in ("float32", "float64"):
        return float(value)
    # rclpy has bytes as objects of this type.
    if isinstance(value, bytes):
        return value[0]
    # rosbags has no signed bytes in ROS 1, and no unsigned ones in ROS 2.
    if slot.type == "byte" and value > 127:
        return int(value) - 256
    return int(value) % 256 if slot.type == "uint8" else int(value)


# ---- The references ----


class Reference(NamedTuple):
    """A type with functions of a reference.

    Attributes:
        definition: the type as this package has read it.
        deserialize: from bytes to a message of the reference.
        serialize: from such a message to bytes.
        md5sum: the reference's checksum, or "".
    """

    definition: object
    deserialize: object
    serialize: object
    md5sum: str = ""


def rosbags_types() -> Iterator[Any]:
    """Yield each type of the stores of rosbags once, with its name there, its store and its definition."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - takes a second

    yielded: Set[Any] = set()
    for name in Stores:
        store = get_typestore(name)
        for type_name in sorted(store.types):
            text = store.generate_msgdef(type_name, ros_version=1)[0]
            # Bounds and wide strings are of ROS 2; the form in ROS 1 is the same without bounds.
            if (type_name, text) in yielded or "wstring" in text:
                continue
            yielded.add((type_name, text))
            text = re.sub(r"<=[0-9]+", "", text).replace("octet", "byte")
            package, _, last = type_name.split("/")
            yield (
                type_name,
                store,
                empty_registry().add(f"{package}/{last}", text),
            )


def rosbags_references() -> Iterator[Any]:
    """Yield the types of all stores of rosbags."""
    for type_name, store, definition in rosbags_types():
        yield Reference(
            definition,
            lambda data, store=store, name=type_name: store.deserialize_ros1(data, name),
            lambda message, store=store, name=type_name: bytes(store.serialize_ros1(message, name)),
        )


def installed_names() -> List[Any]:
    """Return the names of the types that have a generated class on the module path."""
    paths = [path for folder in sys.path for path in Path(folder or ".").glob("*/msg/_*.py")]
    names = {f"{path.parts[-3]}/{path.stem[1:]}" for path in paths if not path.stem.startswith("__")}
    return sorted(names)


def genpy_references(with_stores: bool = True) -> Iterator[Any]:
    """Yield the installed types, then those of the stores of rosbags, from which genpy generates classes."""
    from genpy.dynamic import generate_dynamic  # noqa: PLC0415 - needs ROS
    from roslib.message import get_message_class  # noqa: PLC0415

    from retalis.ros1.installed_message_classes import installed_types  # noqa: PLC0415

    registry = Definitions(installed_types(include_rosbags=False))
    for name in installed_names():
        yield _genpy_reference(registry.find(name), get_message_class(name))
    for _, _, definition in rosbags_types() if with_stores else ():
        classes = generate_dynamic(definition.name, definition.full_text)
        yield _genpy_reference(definition, classes[definition.name])


def _genpy_reference(definition: Any, message_class: Any) -> Reference:
    def write(message: Any) -> bytes:
        buffer = io.BytesIO()
        message.serialize(buffer)
        return buffer.getvalue()

    return Reference(definition, lambda data: message_class().deserialize(data), write, message_class._md5sum)


# ---- The comparison ----


def compare_messages(reference: Any, messages: Any, seed: int = 0) -> None:
    """Compare a type with its reference for a number of random messages."""
    definition = reference.definition
    registry = empty_registry()
    decode, encode = registry.decoder(definition).decode, registry.encoder(definition).encode
    if reference.md5sum:
        assert definition.md5sum == reference.md5sum, definition.name
    source = RandomMessages(definition, seed)
    for number in range(messages):
        data = serialize(definition, source.values())
        message = reference.deserialize(data)
        expected = reference.serialize(message)
        where = f"{definition.name}, seed {seed}, message {number}"
        assert expected == data, f"{where}: the reference does not write what it has read"
        assert encode(decode(data)) == data, f"{where}: lazy terms"
        term = decode(data)
        expected_term = term_of(definition, message)
        try:
            check_same(term, expected_term)
        except AssertionError as error:
            raise AssertionError(f"{where}: term: {str(error)[:1000]}") from None
        assert encode(term) == data, f"{where}: lazy terms that were read"
        assert encode(expected_term) == data, (
            f"{where}: the terms of the reference's values, none of them lazy"
        )


def main() -> Any:
    """Compare all types; print a line for each difference, and the number of types and messages.

    The progress goes to stderr.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reference", choices=("genpy", "rosbags"))
    parser.add_argument("--messages", type=int, default=1000, help="messages of each type (1000)")
    parser.add_argument("--seed", default="0")
    parser.add_argument(
        "--skip", type=int, default=0, help="number of types to skip, to resume a comparison (0)"
    )
    options = parser.parse_args()
    references = genpy_references() if options.reference == "genpy" else rosbags_references()
    references = islice(references, options.skip, None)
    start, types, failed = time.time(), 0, 0
    for reference in references:
        types += 1
        if types % 20 == 0:
            print(f"{types} types, {time.process_time():.0f} s", file=sys.stderr, flush=True)
        try:
            compare_messages(reference, options.messages, options.seed)
        except (AssertionError, MessageError) as error:
            failed += 1
            print(str(error)[:2000], flush=True)
    print(
        f"{types} types, {options.messages} messages each, {failed} types differ, {time.time() - start:.0f} s"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
