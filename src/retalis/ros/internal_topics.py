"""Names of topics: those between the nodes, and as programs and people write them.

What one node tells the other as JSON, read by the one that is told: anybody may have sent it.

Outputs that stay text, because their topics have no type.
"""

import json
from typing import Any, Iterable

import rospy

from ..engine.runtime.problem_reports import Reports
from ..events.program.program_folder import TOPICS
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, UsageError, beginning
from ..foundation.ros_names import topic_fault

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


MAX_CONTROL_CHARACTERS = 1_000_000
"""Characters of what is told at most."""


def read_told_json(text: str, wrong: MessageError) -> Any:
    """Return the data of a text.

    Raises:
        MessageError: ``wrong``, where it is no JSON or too long.
    """
    try:
        return json.loads(text) if len(text) <= MAX_CONTROL_CHARACTERS else None
    except (ValueError, RecursionError):
        raise wrong from None


class TextOnly:
    """Says once of each topic without a type that nothing but text will come of its outputs.

    Args:
        published: the topics that have a type.
        reports: takes the warnings.
    """

    def __init__(self, published: Iterable[str], reports: Reports):
        self._reports = reports
        self._published = {rospy.resolve_name(topic) for topic in published}
        self._seen: Cache[str, bool] = Cache(1000, 1 << 20)

    def look(self, topic: str) -> None:
        """Look at a topic to which something is sent, or will be."""
        if topic not in self._seen and not topic.startswith(WATCH):
            self._seen.keep(topic, True, len(topic))
            if not self._has_type(topic):
                name = beginning(topic)
                self._reports.warning(
                    f"topic {name} has no type: its events are published only as text on {OUTPUT}; "
                    f'<publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one',
                    "topics without a type",
                    texts=20,
                )

    def told(self, topics: Iterable[str]) -> None:
        """Note that of these topics it was said already."""
        for topic in topics:
            self._seen.keep(topic, True, len(topic))

    def _has_type(self, topic: str) -> bool:
        try:
            return resolve(topic) in self._published
        except UsageError:  # a name for other nodes only
            return False
