"""Connections of ROS 2 bags: the topics of a file, with their types and definitions."""

from typing import NamedTuple


class Connection(NamedTuple):
    """A topic of a file of a ROS 2 bag.

    Attributes:
        id: its number in the file.
        topic: name of the topic.
        type: message type, ``pkg/msg/Type``.
        encoding: format of the definition: ``ros2msg``, ``ros2idl``, or empty.
        definition: text of the definition, if the file contains it.
        format: serialization format of the messages, ``cdr``.
        messages: number of messages.
    """

    id: int
    topic: str
    type: str
    encoding: str
    definition: str
    format: str
    messages: int
