"""Topics between the nodes, resolution of topic names, and output topics without a type.

The nodes exchange events and outputs as text and control data as JSON. Any node may publish on these topics, so a
receiver validates what it reads.
"""

import json
from typing import Any, Iterable

import rospy

from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TOPICS
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, UsageError, beginning
from ..foundation.ros_names import topic_fault

INPUT = "retalisInputEvents"
OUTPUT = "retalisOutputEvents"
"""Topics of event texts: input from the interface to node retalis, and output in the other direction."""

WATCH = "retalis_watch_"
"""Beginning of the names of topics whose outputs exist only as text, for ``retalis watch``."""


def resolve(topic: str) -> str:
    """Return the full name of a topic, after remapping and in its namespace.

    Raises:
        UsageError: if the name is invalid.
    """
    # rospy accepts names that the master or other clients reject, so the package's own check comes first.
    fault = topic_fault(topic.strip())
    if fault is not None or not topic.strip(" /"):
        raise UsageError(fault or f'"{topic}" is not a topic name')
    try:
        return str(rospy.resolve_name(topic.strip()))
    except (ValueError, rospy.ROSException) as error:
        raise UsageError(f'"{topic}" is not a topic name: {error}') from error


MAX_CONTROL_CHARACTERS = 1_000_000
"""Limit for the characters of control data."""


def read_control_json(text: str, malformed: MessageError) -> Any:
    """Return the data of a JSON text; None if it is too long.

    Raises:
        MessageError: the error ``wrong``, if the text is not JSON.
    """
    try:
        return json.loads(text) if len(text) <= MAX_CONTROL_CHARACTERS else None
    except (ValueError, RecursionError):
        raise malformed from None


class UntypedTopicWarnings:
    """Warns once about each output topic without a type, whose outputs are published only as text.

    Args:
        published: topics with a type.
        reports: receives the warnings.
    """

    def __init__(self, published: Iterable[str], reports: Reports):
        self._reports = reports
        self._published = {rospy.resolve_name(topic) for topic in published}
        self._checked: Cache[str, bool] = Cache(1000, 1 << 20)

    def check(self, topic: str) -> None:
        """Check a topic to which outputs are sent or will be sent."""
        if topic not in self._checked and not topic.startswith(WATCH):
            self._checked.store(topic, True, len(topic))
            if not self._has_type(topic):
                name = beginning(topic)
                self._reports.warning(
                    f"topic {name} has no type: its events are published only as text on {OUTPUT}; "
                    f'<publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one',
                    "topics without a type",
                    texts=20,
                )

    def mark_reported(self, topics: Iterable[str]) -> None:
        """Record topics whose warning has been given elsewhere."""
        for topic in topics:
            self._checked.store(topic, True, len(topic))

    def _has_type(self, topic: str) -> bool:
        try:
            return resolve(topic) in self._published
        except UsageError:
            # Not a valid topic name: its outputs exist only as text.
            return False
