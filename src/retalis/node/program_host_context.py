"""Shared parts of a program host."""

from typing import Optional

from ..engine.runtime.clock_skew import ClockSkewMonitor
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TOPICS, Topics, read_topics
from ..foundation.errors import RetalisError
from ..messages.type_registry import Definitions
from .latched_deduplication import LatchedMessageDeduplicator
from .parameters import Parameters
from .transport import Transport
from .transport_time import SimulatedTime


class HostContext:
    """Transport, parameters and topics of a host, and what its parts share.

    Args:
        transport: the middleware.
        parameters: parameters of the node.
        reports: receives errors and warnings of single events and messages.

    Attributes:
        transport: see above.
        parameters: see above.
        reports: see above.
        time: time with its epochs.
        definitions: known message types.
        latched: recognizes repeated latched messages.
        topics: contents of ``pub_sub.xml``; empty if the file has errors.
        topics_error: the errors of the file; None if it has none.
    """

    def __init__(self, transport: Transport, parameters: Parameters, reports: Reports):
        self.transport = transport
        self.parameters = parameters
        self.reports = reports
        self.time = SimulatedTime(transport, reports)
        self.latched = LatchedMessageDeduplicator(self.time.epoch)
        self.topics_error: Optional[RetalisError] = None
        try:
            self.topics = read_topics(parameters.program / TOPICS)
        except RetalisError as error:
            self.topics, self.topics_error = Topics(), error
        self.definitions = Definitions(
            transport.installed_types(), parameters.max_empty_elements, self.topics.strings
        )

    def make_skew_monitor(self) -> ClockSkewMonitor:
        """Return the monitor of the stamps of messages; its counts, and those of reports, are logged at the end."""
        skew = ClockSkewMonitor(
            self.reports,
            self.time.now,
            max_distance_seconds=self.parameters.max_skew,
            buffers_early_messages=self.time.buffers_early_messages,
        )
        self.transport.on_shutdown(skew.log_counts)
        self.transport.on_shutdown(self.reports.sum_up)
        return skew
