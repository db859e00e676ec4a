"""Messages as bytes: subscribing to any type, publishing any type, without generated classes."""

from io import BytesIO
from typing import Any, Type

import rospy

from ..messages import Definition


def raw_class(definition: Definition) -> Type[rospy.AnyMsg]:
    """Return the class with which rospy publishes ready bytes as messages of a type."""
    members = {
        "_type": definition.name,
        "_md5sum": definition.md5sum,
        "_full_text": definition.full_text,
        # rospy overwrites the sequence number of a message with a header; ours are whole as they are.
        "_has_header": False,
        "__slots__": ["_buff"],
        "_slot_types": [],
    }
    return type(definition.functor_name, (rospy.AnyMsg,), members)


def raw_bytes(message: Any) -> bytes:
    """Return the bytes of a message that rospy received.

    It is no `rospy.AnyMsg` where the node had subscribed the topic by its class before (``/clock``, by rospy itself).
    """
    if isinstance(message, rospy.AnyMsg):
        data: bytes = message._buff
        return data
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()
