"""Names of topics: those between the nodes, and as programs and people write them."""

import rospy

from ..foundation import UsageError, topic_fault

INPUT = "retalisInputEvents"
OUTPUT = "retalisOutputEvents"
"""The topics on which events go between the nodes as text."""

WATCH = "retalis_watch_"
"""How a topic is called whose outputs somebody watches as text, and wants no other way."""


def resolve(topic: str) -> str:
    """Return the full name of a topic, remapping and namespace applied.

    Raises:
        UsageError: where it is not a name.
    """
    fault = topic_fault(topic.strip())
    if fault is not None or not topic.strip(" /"):
        raise UsageError(fault or f'"{topic}" is not a topic name')
    try:
        return str(rospy.resolve_name(topic.strip()))
    except (ValueError, rospy.ROSException) as error:
        raise UsageError(f'"{topic}" is not a topic name: {error}') from error
