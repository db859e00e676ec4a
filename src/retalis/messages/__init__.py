"""ROS 1 messages: definitions, bytes to event terms, event terms to bytes. Works without ROS.

A message of type ``pkg/Type`` is the term ``pkg__0__Type(Slot1, Slot2, ...)``. See `Decoder` and `Encoder`
for the forms of the slots, `Definitions` for where types come from.
"""

from .decoding import Decoder
from .definition import Definition, Field, functor_name, type_name
from .encoding import Encoder
from .eventtexts import text_without, text_writer
from .installed import Installed
from .layout import BARE
from .open import fault_of
from .registry import Definitions
from .ros2 import Ros2Type, ros2_type
from .slotnames import SlotNames
from .stamps import FrameStamp, frame_text, watched
from .templates import by_names, positional, zero

__all__ = [
    "BARE",
    "by_names",
    "Decoder",
    "Definition",
    "Definitions",
    "Encoder",
    "fault_of",
    "Field",
    "FrameStamp",
    "frame_text",
    "functor_name",
    "Installed",
    "positional",
    "Ros2Type",
    "ros2_type",
    "SlotNames",
    "text_without",
    "text_writer",
    "type_name",
    "watched",
    "zero",
]
