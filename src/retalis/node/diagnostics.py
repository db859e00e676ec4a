"""Publishing of a node's health as ``diagnostic_msgs/DiagnosticArray`` on ``/diagnostics``.

Each status has a level. Levels are derived from counters that only grow: a loss or an error within the last
`RECENT_SECONDS` seconds raises the level, and the level returns to OK afterwards. A topic is STALE after a silence of
several times its usual interval, so that slow topics need no configuration.
"""

import logging
import os
import threading
import time
from enum import Enum, IntEnum
from typing import Any, Callable, Collection, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..engine.engine_status import RuleStatus, Status
from ..engine.runtime.problem_reports import Reports
from ..events.language.rule_labels import rule_title
from ..foundation.displayed_text import format_count, printable, shorten
from ..foundation.errors import MessageError, RetalisError
from ..foundation.source_places import line_of
from ..messages.encoder import Encoder
from ..messages.message_dictionaries import make_message_term
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import resident_bytes
from .topic_statistics import InputStatus, OutputStatus
from .transport import TopicPublication, Transport

log = logging.getLogger("retalis")

MAX_STATUS_VALUES = 20
"""Maximum number of rules, queries and warnings that a status names."""

MAX_VALUE_CHARACTERS = 1000
"""Maximum number of characters of a text in a status."""

MAX_LARGEST_RULES = 5
"""Number of rules with the largest buffers that a status names."""

MAX_NAMED_RULES = 3
"""Maximum number of rules with errors that the message of a status names."""

RECENT_SECONDS = 10.0
"""Seconds for which an error or a loss raises the level."""

MAX_REPORTED_TOPICS = 200
"""Maximum number of topics that are reported in each direction."""

STALE_AFTER_SECONDS = 5.0
"""Seconds without a message after which a topic may be stale."""

STALE_AFTER_INTERVALS = 10
"""A topic is stale after a silence of this many times its usual interval."""

DEFAULT_LATE_SECONDS = 10.0
"""Seconds after which work counts as late if parameter ``~max_seconds`` sets no limit."""

LONG_WAIT_SECONDS = 10.0
"""Seconds after which a waiting query is reported with a warning."""

MIN_AVAILABLE_FRACTION = 0.05
"""Fraction of the machine's memory; if less is available, a warning is reported."""


class InputRole(Enum):
    """Role of a subscribed topic in a program.

    Attributes:
        NEEDED: a topic that a program or a user has named: a missing publisher or a silence is reported.
        LINK: the events between the two nodes, or those of an action: a publisher is required, but a silence is
            normal.
        OPTIONAL: a topic that needs no publisher.
        UNREAD: a topic that the program does not read, and has not named itself.
    """

    NEEDED = 0
    LINK = 1
    OPTIONAL = 2
    UNREAD = 3


class Level(IntEnum):
    """The levels of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Health(NamedTuple):
    """Status of one part of a node.

    Attributes:
        level: severity.
        message: reason for the level, in a few words.
        values: details, as pairs of name and value.
    """

    name: str
    level: Level
    message: str
    values: List[Tuple[str, str]]


class CounterTrend:
    """Growth of a counter: its rate, and the instant of its last increase."""

    def __init__(self) -> None:
        self._last_sample: Optional[Tuple[float, int]] = None
        self._last_increase: Optional[float] = None
        self.rate = 0.0

    def record(self, now: float, count: int) -> "CounterTrend":
        """Record the counter's value at an instant of the monotonic clock."""
        if self._last_sample is None:
            if count:
                self._last_increase = now
        elif now > self._last_sample[0]:
            self.rate = max(0, count - self._last_sample[1]) / (now - self._last_sample[0])
            if count > self._last_sample[1]:
                self._last_increase = now
        self._last_sample = now, count
        return self

    def is_recent(self, now: float) -> bool:
        """Return whether the counter has grown within the last `RECENT_SECONDS`."""
        return self._last_increase is not None and now - self._last_increase < RECENT_SECONDS


class CounterTrends:
    """Trends of several counters by name; `remove_unrecorded` removes counters that have disappeared."""

    def __init__(self) -> None:
        self._previous: Dict[object, CounterTrend] = {}
        self._recorded: Dict[object, CounterTrend] = {}

    def record(self, now: float, name: object, count: int) -> CounterTrend:
        """Record a counter's value at an instant; return its trend."""
        previous_trend = self._recorded.get(name) or self._previous.get(name)
        trend = self._recorded[name] = previous_trend or CounterTrend()
        return trend.record(now, count)

    def remove_unrecorded(self) -> None:
        """Remove the counters that were not recorded since the last call."""
        self._previous, self._recorded = self._recorded, {}


class InputHealth:
    """Status of subscribed topics.

    Args:
        trends: growth of the topics' counters.
        role: returns the present role of a topic.
    """

    def __init__(
        self, trends: CounterTrends, role: Callable[[str], InputRole] = lambda topic: InputRole.NEEDED
    ):
        self._trends = trends
        self._get_role = role
        self._first_samples: Dict[str, Tuple[int, float]] = {}

    def evaluate(self, now: float, status: InputStatus) -> Health:
        """Return the status of a topic."""
        rate = self._trends.record(now, ("in", status.topic), status.messages).rate
        lost_count = status.dropped + status.refused + status.missing
        loss = self._trends.record(now, ("lost", status.topic), lost_count)
        values = [
            ("type", status.type),
            ("publishers", str(status.publishers)),
            ("messages", str(status.messages)),
            ("rate (1/s)", f"{rate:.1f}"),
            ("last message (s ago)", "never" if status.age is None else f"{status.age:.1f}"),
            ("lag (s)", "unknown" if status.lag is None else f"{status.lag / 1e9:.3f}"),
            ("dropped", str(status.dropped)),
            ("refused", str(status.refused)),
            ("missing", str(status.missing)),
        ]
        level, message = self._determine_level(now, status, loss, rate)
        return Health(f"input {status.topic}", level, message, values)

    def retain_topics(self, topics: Collection[str]) -> None:
        """Remove the state of topics that are not in ``topics``."""
        self._first_samples = {
            topic: sample for topic, sample in self._first_samples.items() if topic in topics
        }

    def _determine_level(
        self, now: float, status: InputStatus, loss: CounterTrend, rate: float
    ) -> Tuple[Level, str]:
        """Return the level of a topic, and the reason for it."""
        interval, role = self._compute_mean_interval(now, status), self._get_role(status.topic)
        if role is InputRole.UNREAD:
            publisher = "" if status.publishers else "no publisher; "
            return Level.OK, f"{publisher}the program reads no message of it"
        if loss.is_recent(now):
            return Level.ERROR, "messages are dropped, refused or missing"
        if not status.publishers:
            if role is InputRole.OPTIONAL:
                return Level.OK, "no publisher, and none is needed"
            return Level.WARN, "no publisher"
        # A topic that has not had two messages has no usual interval, and is not stale.
        is_silent = (
            status.age is not None
            and interval is not None
            and status.age > max(STALE_AFTER_SECONDS, STALE_AFTER_INTERVALS * interval)
        )
        if is_silent and role is InputRole.NEEDED:
            return Level.STALE, f"no message for {status.age:.0f} s"
        return Level.OK, "no message yet" if status.age is None else f"{rate:.1f} messages/s"

    def _compute_mean_interval(self, now: float, status: InputStatus) -> Optional[float]:
        """Return the mean interval between messages in seconds; None before the second message."""
        if status.age is None:
            self._first_samples.pop(status.topic, None)
            return None
        # The instant of the last message is used, not the present: a silence must not lengthen the usual interval.
        first_count, first_instant = self._first_samples.get(
            status.topic, (status.messages, now - status.age)
        )
        if status.messages < first_count:
            # The topic was subscribed again, with new counters.
            first_count, first_instant = status.messages, now - status.age
        self._first_samples[status.topic] = first_count, first_instant
        further_messages = status.messages - first_count
        return (now - status.age - first_instant) / further_messages if further_messages > 0 else None


def evaluate_output(now: float, trends: CounterTrends, status: OutputStatus) -> Health:
    """Return the status of a published topic."""
    rate = trends.record(now, ("out", status.topic), status.sent).rate
    is_losing = trends.record(now, ("slow", status.topic), status.dropped).is_recent(now)
    values = [
        ("type", status.type),
        ("subscribers", str(status.subscribers)),
        ("sent", str(status.sent)),
        ("rate (1/s)", f"{rate:.1f}"),
        ("dropped", str(status.dropped)),
    ]
    if is_losing:
        return Health(f"output {status.topic}", Level.WARN, "a subscriber does not keep up", values)
    return Health(f"output {status.topic}", Level.OK, f"{rate:.1f} messages/s", values)


class EngineHealth:
    """Status of an engine.

    Args:
        warn_after: seconds after which work in progress is reported with a warning.
        error_after: seconds after which it is reported as an error.
    """

    def __init__(self, warn_after: float, error_after: float):
        self._trends = CounterTrends()
        self.set_work_limits(warn_after, error_after)
        self._first_seen: Dict[Tuple[str, int], float] = {}

    def set_work_limits(self, warn_after: float, error_after: float) -> None:
        """Set the seconds after which work in progress is a warning and an error; see `EngineHealth`."""
        self._warn_after = warn_after
        self._error_after = error_after

    def evaluate(self, now: float, status: Status, unstamped: Collection[str] = ()) -> List[Health]:
        """Return the status of each part of the engine.

        Args:
            now: time of the monotonic clock in seconds.
            status: status of the engine.
            unstamped: names of events whose messages have no stamp: they wait for the engine, and have no lag.
        """
        healths = [
            self._evaluate_queue(now, status),
            self._evaluate_work(status),
            self._evaluate_rules(now, status),
            self._evaluate_queries(now, status),
            *self._evaluate_transforms(now, status),
            *self._evaluate_services(now, status),
            *_evaluate_lags(status, unstamped),
        ]
        self._trends.remove_unrecorded()
        return healths

    def _evaluate_queue(self, now: float, status: Status) -> Health:
        record = self._trends.record
        event_rate, firing_rate = (
            record(now, "taken", status.taken).rate,
            record(now, "fired", status.fired).rate,
        )
        is_losing = record(now, "dropped", status.dropped).is_recent(now)
        values = [
            ("queued events", f"{status.queued} of {status.queue}"),
            ("waiting calls", str(status.callers)),
            ("events", str(status.taken)),
            ("events (1/s)", f"{event_rate:.1f}"),
            ("firings of rules", str(status.fired)),
            ("firings (1/s)", f"{firing_rate:.1f}"),
            ("dropped events", str(status.dropped)),
            ("partial matches", str(status.matches)),
            ("alarms", str(status.alarms)),
            ("errors", str(status.errors)),
            ("warnings", str(status.warnings)),
        ]
        if is_losing:
            return Health("queue", Level.ERROR, "events are dropped: the queue is full", values)
        if 2 * status.queued >= status.queue:
            return Health("queue", Level.WARN, f"{status.queued} events wait", values)
        return Health("queue", Level.OK, f"{event_rate:.1f} events/s", values)

    def _evaluate_work(self, status: Status) -> Health:
        work = status.work
        if work is None:
            return Health("work", Level.OK, "idle", [])
        values = [
            ("what", work.what),
            ("seconds", f"{work.seconds:.1f}"),
            ("goal", work.goal),
            ("event", work.event),
            ("place", work.place),
        ]
        if work.seconds < self._warn_after:
            return Health("work", Level.OK, "busy", values)
        level = Level.WARN if work.seconds < self._error_after else Level.ERROR
        return Health("work", level, f"{work.what} has taken {work.seconds:.1f} s so far", values)

    def _evaluate_rules(self, now: float, status: Status) -> Health:
        failing = [rule for rule in status.rules if rule.errors]
        errors = sum(rule.errors for rule in failing)
        has_recent_errors = self._trends.record(now, "errors", errors).is_recent(now)
        values = [
            (_rule_key(rule), format_count(rule.errors, "error")) for rule in failing[:MAX_STATUS_VALUES]
        ]
        if len(failing) > MAX_STATUS_VALUES:
            values.append(("further rules", str(len(failing) - MAX_STATUS_VALUES)))
        # Buffers of partial matches are the usual reason for growing memory.
        by_size = sorted(status.rules, key=lambda rule: -rule.bytes)
        largest = [rule for rule in by_size[:MAX_LARGEST_RULES] if rule.waiting]
        values += [(f"held by {_rule_key(rule)}", _format_buffers(rule)) for rule in largest]
        values += _name_unlabelled([*failing[:MAX_STATUS_VALUES], *largest])
        total = len(status.rules) + status.left_out.rules
        if not failing:
            return Health("rules", Level.OK, f"{format_count(total, 'rule')} without errors", values)
        bound = " or more" if len(failing) == len(status.rules) < total else ""
        text = f"{format_count(errors, 'error')} in {format_count(len(failing), 'rule')}{bound}"
        if len(failing) <= MAX_NAMED_RULES:
            titles = [rule_title(rule.name, os.path.basename(line_of(rule.place))) for rule in failing]
            text = f"{text}: {', '.join(titles)}"
        return Health("rules", Level.ERROR if has_recent_errors else Level.WARN, text, values)

    def _evaluate_queries(self, now: float, status: Status) -> Health:
        # Waiting is measured by the monotonic clock, from the first status that contains the query: simulated time
        # may stand still or jump.
        waiting_queries = {(query.event, query.since): query for query in status.waiting}
        self._first_seen = {key: self._first_seen.get(key, now) for key in waiting_queries}
        longest_wait = max((now - first_seen for first_seen in self._first_seen.values()), default=0.0)
        values = []
        for key, query in list(waiting_queries.items())[:MAX_STATUS_VALUES]:
            lags = [f"{memory.id} {_format_lag(memory.behind)}" for memory in query.memories]
            waiting_text = f"since {query.since / 1e9:.3f}, for {now - self._first_seen[key]:.0f} s"
            values.append((query.event, f"{waiting_text}: waits for {', '.join(lags)}"))
        query_count = len(status.waiting) + status.left_out.waiting
        if query_count > len(values):
            values.append(("further queries", str(query_count - len(values))))
        if longest_wait > LONG_WAIT_SECONDS:
            return Health(
                "waiting queries",
                Level.WARN,
                f"{query_count} wait, the oldest for {longest_wait:.0f} s or longer",
                values,
            )
        return Health("waiting queries", Level.OK, f"{query_count} wait", values)

    def _evaluate_transforms(self, now: float, status: Status) -> List[Health]:
        transforms = status.transforms
        if transforms is None:
            return []
        values = [
            ("frames", str(transforms.frames)),
            ("transforms", str(transforms.samples)),
            ("refused", str(transforms.refused)),
        ]
        if self._trends.record(now, "transforms", transforms.refused).is_recent(now):
            return [Health("transforms", Level.WARN, "transforms are refused", values)]
        return [Health("transforms", Level.OK, format_count(transforms.frames, "frame"), values)]

    def _evaluate_services(self, now: float, status: Status) -> List[Health]:
        services = status.services
        if services is None:
            return []
        values = [
            ("calls", str(services.calls)),
            ("under way", str(services.under_way)),
            ("failed", str(services.failed)),
            ("refused", str(services.refused)),
        ]
        if self._trends.record(now, "services", services.failed).is_recent(now):
            return [Health("services", Level.WARN, "calls of services fail", values)]
        return [Health("services", Level.OK, format_count(services.calls, "call"), values)]


def _evaluate_lags(status: Status, unstamped: Collection[str]) -> List[Health]:
    """Return the status of the lags that alarms wait for; none if no alarm of the program waits for a topic."""
    if not status.lags:
        return []
    lags = [lag for lag in status.lags if lag.event.rpartition("/")[0] not in unstamped]
    longest_first = sorted(lags, key=lambda status: -status.lag)[:MAX_STATUS_VALUES]
    values = [(f"lag of {event} (s)", f"{lag / 1e9:.3f}") for event, lag in longest_first]
    by_delay = sorted(status.rules, key=lambda rule: -rule.delay)
    delayed = [rule for rule in by_delay[:MAX_STATUS_VALUES] if rule.delay]
    values += [(f"delay of {_rule_key(rule)} (s)", f"{rule.delay / 1e9:.3f}") for rule in delayed]
    values += _name_unlabelled(delayed)
    longest_delay = max((rule.delay for rule in status.rules), default=0)
    return [Health("late events", Level.OK, f"alarms wait up to {longest_delay / 1e9:.3f} s", values)]


def _format_buffers(rule: RuleStatus) -> str:
    return f"{format_count(rule.waiting, 'item')}, {format_count(rule.keys, 'key')}, about {rule.bytes / 1e6:.1f} MB"


def _rule_key(rule: RuleStatus) -> str:
    """Return the key of a rule in values, which other programs look up; without a label, it is the place."""
    return " ".join(part for part in (rule.label, rule.place) if part) or rule.text


def _name_unlabelled(rules: Sequence[RuleStatus]) -> List[Tuple[str, str]]:
    """Return the names of the rules whose keys have none."""
    return [(f"name of {_rule_key(rule)}", rule.name) for rule in dict.fromkeys(rules) if not rule.label]


def _format_lag(nanoseconds: Optional[int]) -> str:
    return "(has no record)" if nanoseconds is None else f"({nanoseconds / 1e9:.3f} s behind)"


def evaluate_memory() -> Health:
    """Return the status of the memory of the process and the machine."""
    used = resident_bytes()
    total, available = _read_machine_memory()
    values = [("resident (MB)", f"{used / 1e6:.0f}")]
    if total:
        values.append(("available on the machine (MB)", f"{available / 1e6:.0f} of {total / 1e6:.0f}"))
        if available < MIN_AVAILABLE_FRACTION * total:
            return Health("process memory", Level.WARN, "the machine's memory is nearly used up", values)
    return Health("process memory", Level.OK, f"{used / 1e6:.0f} MB", values)


def _read_machine_memory() -> Tuple[int, int]:
    """Return the bytes of total and available memory of the machine; zeros if unknown."""
    sizes = {"MemTotal": 0, "MemAvailable": 0}
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                name, _, size_text = line.partition(":")
                if name in sizes:
                    sizes[name] = 1024 * int(size_text.split()[0])
    except OSError:
        # A system without /proc.
        pass
    return sizes["MemTotal"], sizes["MemAvailable"]


def evaluate_program(errors: Sequence[str], warnings: Sequence[str]) -> Health:
    """Return the status of the program's loading."""
    problems = [("error", text) for text in errors] + [("warning", text) for text in warnings]
    values = problems[:MAX_STATUS_VALUES]
    if len(problems) > MAX_STATUS_VALUES:
        values.append(("further ones", str(len(problems) - MAX_STATUS_VALUES)))
    if errors:
        return Health(
            "program", Level.ERROR, f"{format_count(len(errors), 'error')} when it was loaded", values
        )
    if warnings:
        return Health(
            "program", Level.WARN, f"{format_count(len(warnings), 'warning')} when it was loaded", values
        )
    return Health("program", Level.OK, "loaded without warnings", values)


class NodeHealth:
    """Status of a node.

    Args:
        inputs: returns the counters of subscribed topics.
        outputs: returns the counters of published topics.
        other_statuses: returns the status of the other parts.
        role: returns the present role of a subscribed topic.
    """

    def __init__(
        self,
        inputs: Callable[[], Sequence[InputStatus]],
        outputs: Callable[[], Sequence[OutputStatus]],
        other_statuses: Callable[[], List[Health]],
        role: Callable[[str], InputRole] = lambda topic: InputRole.NEEDED,
    ):
        self._inputs = inputs
        self._outputs = outputs
        self._other_statuses = other_statuses
        self._trends = CounterTrends()
        self._input_health = InputHealth(self._trends, role)

    def evaluate(self) -> List[Health]:
        """Return the status of all parts."""
        now = time.monotonic()
        inputs = self._inputs()
        self._input_health.retain_topics({status.topic for status in inputs})
        input_healths = [self._input_health.evaluate(now, status) for status in inputs]
        output_healths = [evaluate_output(now, self._trends, status) for status in self._outputs()]
        self._trends.remove_unrecorded()
        return [
            *_select_most_severe(input_healths, "inputs"),
            *_select_most_severe(output_healths, "outputs"),
            *self._other_statuses(),
            evaluate_memory(),
        ]


def _select_most_severe(healths: List[Health], direction: str) -> List[Health]:
    """Return the most severe statuses, errors first, and one that counts the omitted ones."""
    if len(healths) <= MAX_REPORTED_TOPICS:
        return healths
    # STALE has the highest number, but an error is more severe.
    chosen = sorted(healths, key=lambda health: (health.level is not Level.ERROR, -health.level))[
        :MAX_REPORTED_TOPICS
    ]
    message = f"{len(healths) - MAX_REPORTED_TOPICS} are omitted, none of them more severe than those above"
    return [*chosen, Health(f"further {direction}", Level.OK, message, [])]


DIAGNOSTICS_TOPIC = "/diagnostics"

DIAGNOSTICS_TYPE = "diagnostic_msgs/DiagnosticArray"

DEFAULT_HARDWARE_ID = "retalis"
"""Default of parameter ``~hardware_id``; ``diagnostic_aggregator`` may group by it."""

_QUEUE_SIZE = 2


class Diagnostics:
    """Periodic publisher of the health of a node, in a thread and by wall time: simulated time may stand still.

    Args:
        transport: the middleware.
        period: seconds between two messages; None disables publishing.
        health: status of the node.
        reports: receives the errors of single messages.
        hardware_id: hardware id of each status.
    """

    def __init__(
        self,
        transport: Transport,
        period: Optional[float],
        health: NodeHealth,
        reports: Reports,
        hardware_id: str = DEFAULT_HARDWARE_ID,
    ):
        self._transport = transport
        self._health = health
        self._reports = reports
        self._period: Optional[float] = None
        self._has_changed = threading.Event()
        self._is_shut_down = self._is_started = False
        self.set_options(period, hardware_id)

    def prepare(self, period: Optional[float]) -> None:
        """Publish the topic if a period needs it, so that `set_options` with this period cannot fail.

        Raises:
            RetalisError: if the topic cannot be published.
        """
        if period is not None and not self._is_started:
            self._start()
            self._is_started = True

    def set_options(self, period: Optional[float], hardware_id: str) -> None:
        """Set the period of the messages and the hardware id; see `Diagnostics`.

        Raises:
            RetalisError: see `prepare`.
        """
        self.prepare(period)
        self._hardware_id = hardware_id
        if period != self._period:
            self._period = period
            self._has_changed.set()

    def _start(self) -> None:
        transport = self._transport
        definitions = Definitions(transport.installed_types(include_rosbags=False))
        try:
            definition = definitions.find(DIAGNOSTICS_TYPE)
        except MessageError:
            log.warning(
                "%s is not published: the package diagnostic_msgs is not installed", DIAGNOSTICS_TOPIC
            )
            return
        publication = transport.advertise(DIAGNOSTICS_TOPIC, definition, _QUEUE_SIZE)
        transport.on_shutdown(self._shut_down)
        threading.Thread(
            target=self._run,
            args=(publication, definitions.encoder(definition, transport.format)),
            name="retalis diagnostics",
            daemon=True,
        ).start()

    def _shut_down(self) -> None:
        self._is_shut_down = True
        self._has_changed.set()

    def _run(self, publication: TopicPublication, encoder: Encoder) -> None:
        while not self._is_shut_down:
            if self._has_changed.wait(self._period):
                self._has_changed.clear()
                continue
            try:
                values = self._make_message(self._health.evaluate())
                publication.send(encoder.encode(make_message_term(encoder.definition, values)))
            # Counters are read without locks while other threads change them: a rare error affects one message only.
            except Exception as error:
                self._reports.error(RetalisError(f"{DIAGNOSTICS_TOPIC}: {error!r}"), DIAGNOSTICS_TOPIC)

    def _make_message(self, healths: List[Health]) -> Dict[str, Any]:
        node = self._transport.node_name.strip("/")
        return {
            "header": {"stamp": self._transport.now()},
            "status": [
                {
                    "level": int(health.level),
                    "name": f"{node}: {health.name}",
                    "message": _to_single_line(health.message),
                    "hardware_id": self._hardware_id,
                    "values": [
                        {"key": _to_single_line(key), "value": _to_single_line(value)}
                        for key, value in health.values
                    ],
                }
                for health in healths
            ],
        }


def _to_single_line(text: str) -> str:
    """Return a text as one line, without control characters."""
    return " ".join(printable(shorten(text, MAX_VALUE_CHARACTERS)).split("\n"))
