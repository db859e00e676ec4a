"""Outputs that stay text, because their topics have no type."""

from typing import Iterable

import rospy

from ..engine.runtime import Reports
from ..events.program import TOPICS
from ..foundation import Cache, UsageError, beginning
from .names import OUTPUT, WATCH, resolve


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
