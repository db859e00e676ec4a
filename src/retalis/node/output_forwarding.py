"""Forwarding of the outputs of a program to a broker, and its status on ``/diagnostics``."""

from fnmatch import fnmatchcase
from typing import Callable, Iterable, List, Sequence, Tuple

from ..engine.runtime.problem_reports import Reports
from ..forwarding.disk_queue import ForwardedEvent
from ..forwarding.event_forwarder import EventForwarder, ForwardingStatus
from ..forwarding.forwarding_options import ForwardingOptions
from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import format_count, format_duration, printable, shorten
from ..foundation.errors import RetalisError, UsageError
from ..foundation.similar_names import did_you_mean
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.types import Term
from .diagnostics import CounterTrends, Health, Level
from .text_exchange import WATCH


class OutputForwarding:
    """Outputs of chosen topics, which are forwarded.

    Args:
        options: topics, destination and queue.
        reports: receives a warning for lost events.
        resolve_topic: returns the full name of a topic.
        find_interval: returns start and end in ns of the event whose output is published.

    Raises:
        UsageError: if the queue cannot be used, or paho is not installed.
    """

    def __init__(
        self,
        options: ForwardingOptions,
        reports: Reports,
        resolve_topic: Callable[[str], str],
        find_interval: Callable[[], Tuple[int, int]],
    ):
        self._resolve_topic = resolve_topic
        self._patterns = {topic: self._full_name(topic) for topic in options.topics}
        self._unused_topics: Tuple[str, ...] = ()
        """Topics of the parameter that no subscription of the program has, until there is an output."""
        self._find_interval = find_interval
        self._decisions: Cache[str, bool] = Cache(1000, 1 << 20)
        self._trends = CounterTrends()
        self._forwarder = EventForwarder(options, reports)
        self.stop = self._forwarder.stop
        self.status = self._forwarder.status

    def includes(self, topic: str) -> bool:
        """Return whether the outputs of a topic are forwarded."""
        is_included = self._decisions.get(topic)
        if is_included is None:
            name = self._full_name(topic)
            # Temporary subscriptions of `retalis watch` are not outputs of the program.
            is_included = not topic.startswith(WATCH) and any(
                fnmatchcase(name, pattern) for pattern in self._patterns.values()
            )
            if is_included and self._unused_topics:
                # A rule has added the subscription.
                self._unused_topics = self._find_unused([name], self._unused_topics)
            self._decisions.store(topic, is_included, len(topic))
        return is_included

    def forward(self, term: Term, topic: str, name: Term) -> None:
        """Forward an output if its topic is included; called in the engine's turn."""
        if self.includes(topic):
            # Receivers read terms, in which infinity differs from that of event text.
            # Strings of messages may contain bytes that are not UTF-8.
            text = canonical_text(term).encode("utf-8", "replace").decode()
            start, end = self._find_interval()
            self._forwarder.put(ForwardedEvent(start / 1e9, end / 1e9, text))

    def check_topics(self, topics: List[str]) -> List[RetalisError]:
        """Return a warning for each topic of the parameter that no subscription of the loaded program has."""
        # The next output of a topic shows again that there is a subscription.
        self._decisions.clear()
        self._unused_topics = self._find_unused(map(self._full_name, topics), self._patterns)
        return [
            RetalisError(
                f"parameter ~forward_topics: no subscription has the topic {topic}{did_you_mean(topic, topics)}"
            )
            for topic in self._unused_topics
        ]

    def _find_unused(self, names: Iterable[str], candidates: Iterable[str]) -> Tuple[str, ...]:
        """Return the candidates that match none of the full names."""
        full_names = list(names)
        return tuple(
            topic
            for topic in candidates
            if not any(fnmatchcase(name, self._patterns[topic]) for name in full_names)
        )

    def _full_name(self, topic: str) -> str:
        try:
            return self._resolve_topic(topic)
        except UsageError:
            # A pattern, which is absolute, or a topic of a subscription that is no valid name.
            return topic

    def describe(self) -> str:
        """Return the state and the counters as one line."""
        return describe_forwarding(self.status())

    def evaluate(self, now: float) -> List[Health]:
        """Return the status of the forwarding at an instant of the monotonic clock."""
        health = evaluate_forwarding(now, self._trends, self.status(), self._unused_topics)
        self._trends.remove_unrecorded()
        return [health]


def describe_forwarding(status: ForwardingStatus) -> str:
    """Return the state and the counters of a forwarder as one line."""
    duration = format_duration(round(status.state_seconds))
    reason = f" ({printable(shorten(status.problem))})" if status.problem else ""
    state = (
        f"connected to {status.broker}"
        if status.is_connected
        else f"not connected to {status.broker}{reason}"
    )
    size = f"{status.used_bytes / 1e6:.1f} of {status.max_bytes / 1e6:.0f} MB"
    storage = status.storage_problem
    storage_text = f"; events cannot be stored: {printable(shorten(storage))}" if storage else ""
    return (
        f"{state} for {duration}, {format_count(status.queued, 'event')} queued ({size}), "
        f"{status.confirmed} forwarded, {status.lost} lost{storage_text}"
    )


def evaluate_forwarding(
    now: float, trends: CounterTrends, status: ForwardingStatus, unused_topics: Sequence[str] = ()
) -> Health:
    """Return the status of a forwarder; ``unused_topics`` are those that no subscription has."""
    rate = trends.record(now, "confirmed", status.confirmed).rate
    is_losing = trends.record(now, "lost", status.lost + status.damaged_files).is_recent(now)
    values = [
        ("broker", status.broker),
        ("connected", str(status.is_connected).lower()),
        ("queued", str(status.queued)),
        ("queue (MB)", f"{status.used_bytes / 1e6:.1f} of {status.max_bytes / 1e6:.0f}"),
        ("confirmed", str(status.confirmed)),
        ("rate (1/s)", f"{rate:.1f}"),
        ("sent again", str(status.repeated)),
        ("dropped (queue full)", str(status.dropped)),
        ("dropped (not stored)", str(status.unstored)),
        ("dropped (too long)", str(status.oversized)),
        ("connections", str(status.connections)),
        ("damaged files", str(status.damaged_files)),
        ("problem", "; ".join(filter(None, (status.storage_problem, status.problem)))),
    ]
    queued = f"{format_count(status.queued, 'event')} queued"
    if is_losing:
        reason = status.storage_problem or ("the queue is full" if status.dropped else "see the log")
        return Health("forwarding", Level.ERROR, f"events are lost: {reason}; {queued}", values)
    if not status.is_connected:
        reason = f": {status.problem}" if status.problem else ""
        return Health("forwarding", Level.WARN, f"not connected{reason}; {queued}", values)
    if unused_topics:
        names = ", ".join(unused_topics)
        return Health("forwarding", Level.WARN, f"no subscription has the topic {names}; {queued}", values)
    if 2 * status.used_bytes >= status.max_bytes:
        return Health("forwarding", Level.WARN, f"the queue is half full: {queued}", values)
    return Health("forwarding", Level.OK, f"{rate:.1f} events/s; {queued}", values)
