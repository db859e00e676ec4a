"""Comparison of this package with rosbags or rclpy: random CDR messages of many types are decoded and encoded.

For each message of each type: the reference deserializes the bytes that are encoded from a term to the values of the
term, and the same term is decoded from them, and from the bytes that the reference serializes.

    PYTHONPATH=src:test python3 -m messages.cdr_codec_comparison --messages 1000 rosbags
    PYTHONPATH=src:test python3 -m messages.cdr_codec_comparison --messages 1000 rclpy  (with Python of ROS 2)

The types of rclpy are those of the ament index, except those with bounded arrays (`BOUNDED_TYPES`): definitions in
the form of ROS 1 have no bounds, and rclpy refuses longer arrays. Two known differences are excluded: rclpy ends a
string at a zero byte, and both references set a bit in signalling NaNs, which arrays keep here.
"""

import argparse
import os
import sys
import time
from functools import partial
from importlib import import_module
from typing import Any, Callable, Iterator, List, NamedTuple, Optional

from asserting_accessors import compound

from messages.codec_comparison import RandomMessages, check_same, term_of
from messages.reference_wire_format import serialize
from retalis import Definition
from retalis.messages.cdr_decoder import CdrDecoder
from retalis.messages.cdr_encoder import CdrEncoder
from retalis.messages.decoder import Decoder
from retalis.messages.type_definition import HEADER
from retalis.messages.type_registry import InstalledTypes, parse_ros2_type
from retalis.prolog.terms.types import CONS, Lazy, Term, deref

BOUNDED_TYPES = (
    "rcl_interfaces/ParameterDescriptor",
    "rcl_interfaces/ParameterEventDescriptors",
    "shape_msgs/SolidPrimitive",
)


class CdrReference(NamedTuple):
    """A type with functions of a reference.

    Attributes:
        definition: the type as this package has read it.
        deserialize: from CDR to a message of the reference.
        serialize: from such a message to CDR.
    """

    definition: Definition
    deserialize: Callable[[bytes], Any]
    serialize: Callable[[Any], Any]


class RandomRos2Messages(RandomMessages):
    """Random values with times before 2038, headers without a number, and texts without a zero byte."""

    def message(self, definition: Any) -> List[Any]:
        values = super().message(definition)
        if definition.name == HEADER:
            values[0] = 0
        return values

    def _string(self, type_name: Any) -> bytes:
        return super()._string(type_name).replace(b"\0", b"")

    def _time(self, type_name: str) -> List[Any]:
        second, nanosecond = super()._time(type_name)
        return [second % 2**31, nanosecond]


def rosbags_references() -> Iterator[CdrReference]:
    """Yield the types of rosbags' newest store of ROS 2."""
    from messages.ros2_types import STORE, find_text  # noqa: PLC0415 - takes a second

    for name in sorted(STORE.types):
        text = find_text(name.replace("/msg/", "/"))
        if text is not None:
            yield CdrReference(
                parse_ros2_type(name, text, find_text),
                partial(STORE.deserialize_cdr, typename=name),
                partial(STORE.serialize_cdr, typename=name),
            )


def rclpy_references() -> Iterator[CdrReference]:
    """Yield the installed types of ROS 2 without bounded arrays."""
    from rclpy.serialization import deserialize_message, serialize_message  # noqa: PLC0415 - needs ROS 2

    prefixes = os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(os.pathsep)
    installed = InstalledTypes([os.path.join(prefix, "share") for prefix in prefixes], [], False)

    def find(name: str) -> Optional[str]:
        definition = installed.find(name)
        return None if definition is None else definition.text

    for package in installed.packages():
        for type_name in installed.types(package):
            name = f"{package}/{type_name}"
            if name not in BOUNDED_TYPES:
                message_class = getattr(import_module(f"{package}.msg"), type_name)
                yield CdrReference(
                    parse_ros2_type(name, find(name) or "", find),
                    partial(deserialize_message, message_type=message_class),
                    serialize_message,
                )


def without_lazy_terms(term: Term) -> Term:
    """Return a term with all arrays and texts decoded."""
    term = deref(term)
    if isinstance(term, Lazy):
        term = term.term()
    if term.__class__ is not tuple:
        return term
    if compound(term)[0] is not CONS:
        return (compound(term)[0], *map(without_lazy_terms, compound(term)[1:]))
    # Lists are longer than the interpreter's stack is deep.
    items: List[Term] = []
    while isinstance(term, tuple) and term[0] is CONS:
        items.append(without_lazy_terms(term[1]))
        term = deref(term[2])
    while items:
        term = (CONS, items.pop(), term)
    return term


def compare_messages(reference: CdrReference, messages: int, seed: object = 0) -> None:
    """Compare a type with its reference for a number of random messages.

    Raises:
        AssertionError: if they differ.
    """
    definition = reference.definition
    decode_ros1 = Decoder(definition).decode
    decode, encode = CdrDecoder(definition).decode, CdrEncoder(definition).encode
    source = RandomRos2Messages(definition, seed)
    for number in range(messages):
        place = f"{definition.name}, seed {seed}, message {number}"
        expected_term = without_lazy_terms(decode_ros1(serialize(definition, source.values())))
        data = encode(expected_term)
        message = reference.deserialize(data)
        written = bytes(reference.serialize(message))
        # rclpy pads messages to a multiple of four bytes, and reserves padding for empty arrays.
        assert len(data) <= len(written) <= 2 * len(data), f"{place}: {len(data)} bytes, not {len(written)}"
        try:
            check_same(decode(data), expected_term)
            # rclpy does not clear its padding, so its bytes may differ.
            check_same(decode(written), expected_term)
            check_same(term_of(definition, message), expected_term)
        except AssertionError as error:
            raise AssertionError(f"{place}: term: {str(error)[:1000]}") from None
        assert encode(decode(data)) == data, f"{place}: lazy terms"


def main() -> int:
    """Compare all types; print a line for each difference, and the number of types and messages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("reference", choices=("rosbags", "rclpy"))
    parser.add_argument("--messages", type=int, default=1000, help="messages of each type (1000)")
    parser.add_argument("--seed", default="0")
    options = parser.parse_args()
    references = rosbags_references() if options.reference == "rosbags" else rclpy_references()
    begin, types, failed = time.time(), 0, 0
    for reference in references:
        types += 1
        try:
            compare_messages(reference, options.messages, options.seed)
        except Exception as error:  # the references raise arbitrary exceptions
            failed += 1
            print(f"{reference.definition.name}: {str(error)[:2000]}", flush=True)
    seconds = time.time() - begin
    print(f"{types} types, {options.messages} messages each, {failed} types differ, {seconds:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
