"""Types of ROS 2 from texts and from rosbags, and CDR messages from `struct` layouts."""

import struct
from typing import Any, Optional

from rosbags.typesys import Stores, get_typestore

from retalis import Definition, Definitions
from retalis.messages.cdr_decoder import CdrDecoder
from retalis.messages.ros2_definitions import FindText
from retalis.messages.type_registry import parse_ros2_type
from retalis.prolog.syntax.event_text import to_text

STORE = get_typestore(Stores.LATEST)


def find_text(name: str) -> Optional[str]:
    """Return the definition of ``pkg/Type`` in rosbags' newest types of ROS 2."""
    full_name = name.replace("/", "/msg/")
    return STORE.generate_msgdef(full_name, ros_version=2)[0] if full_name in STORE.types else None


def read_type(
    text: str, name: str = "my_msgs/msg/Kind", find: FindText = find_text, is_idl: bool = False
) -> Definition:
    return parse_ros2_type(name, text, find, is_idl)


def cdr(layout: str, *values: Any, order: str = "<") -> bytes:
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + struct.pack(order + layout, *values)


def decode_text(definition: Definition, message: bytes) -> str:
    """Return the text of a CDR message's event."""
    return to_text(CdrDecoder(definition).decode(message))


def to_ros1(definition: Definition, message: bytes) -> bytes:
    """Return a CDR message in the format of ROS 1."""
    return Definitions().encoder(definition).encode(CdrDecoder(definition).decode(message))
