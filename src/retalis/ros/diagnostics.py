"""How a node is: what `Diagnostics` tells, each with a level that says whether somebody has to look.

``/diagnostics``: how a node is, once in a while.
"""

import threading
import time
from enum import Enum, IntEnum
from typing import Any, Callable, Collection, Dict, List, NamedTuple, Optional, Sequence, Tuple

import rospy

from ..engine.engine_status import RuleStatus, Status
from ..foundation.errors import beginning, counted, printable
from ..prolog.machine.resource_limits import resident_bytes
from .topic_statistics import InputStatus, OutputStatus

LISTED = 20
"""Rules, queries and warnings that are named at most."""
LARGEST_RULES_NAMED = 5
"""Rules that hold most, which are named with what they hold."""

RECENT = 10.0
"""Seconds for which an error or a loss keeps its level."""

MAX_REPORTED_TOPICS = 200
"""Topics in each direction that are told of."""

STALE_AFTER_SECONDS = 5.0
"""Seconds without a message after which a topic may be stale."""

USUAL = 10
"""A topic is stale where nothing has come for so many times its usual interval."""

LATE = 10.0
"""Seconds after which work should have ended, where no limit says so."""

LONG = 10.0
"""Seconds after which a query that waits is worth a warning."""

SCARCE = 0.05
"""Part of the machine's memory that is left when that is worth a warning."""


class InputRole(Enum):
    """The use that a program has for a subscribed topic.

    Attributes:
        NEEDED: a topic that somebody has named: without a publisher, or if it becomes silent, somebody has to look.
        LINK: the events between the two nodes: it needs a publisher, but not events all the time.
        OPTIONAL: a topic to which others may publish, or not.
        UNREAD: a topic that the node subscribes by default, and whose messages the program does not read.
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
    """How one thing of a node is.

    Attributes:
        name: what it is.
        level: whether somebody has to look.
        message: says why, in a few words.
        values: more of it, by name.
    """

    name: str
    level: Level
    message: str
    values: List[Tuple[str, str]]


class Change:
    """A number that grows: how fast, and how long ago it last did."""

    def __init__(self) -> None:
        self._before: Optional[Tuple[float, int]] = None
        self._grew: Optional[float] = None
        self.rate = 0.0

    def note(self, now: float, number: int) -> "Change":
        """Note the number at an instant of the monotonic clock."""
        if self._before is None:
            if number:
                self._grew = now
        elif now > self._before[0]:
            self.rate = max(0, number - self._before[1]) / (now - self._before[0])
            if number > self._before[1]:
                self._grew = now
        self._before = now, number
        return self

    def is_recent(self, now: float) -> bool:
        """Tell whether it has grown lately."""
        return self._grew is not None and now - self._grew < RECENT


class Changes:
    """The changes of many numbers, by name; those that nobody notes any more are forgotten."""

    def __init__(self) -> None:
        self._all: Dict[object, Change] = {}
        self._noted: Dict[object, Change] = {}

    def note(self, now: float, name: object, number: int) -> Change:
        """Note a number; return its change."""
        known = self._noted.get(name) or self._all.get(name)
        change = self._noted[name] = known or Change()
        return change.note(now, number)

    def end(self) -> None:
        """Forget what was not noted since the last time."""
        self._all, self._noted = self._noted, {}


class InputHealth:
    """Judges a subscribed topic.

    Args:
        changes: the rates of its numbers.
        role: gives the use that the program has for a topic at this time.
    """

    def __init__(self, changes: Changes, role: Callable[[str], InputRole] = lambda topic: InputRole.NEEDED):
        self._changes = changes
        self._role = role
        self._intervals: Dict[str, Tuple[int, float]] = {}

    def of(self, now: float, one: InputStatus) -> Health:
        """Return how it is."""
        rate = self._changes.note(now, ("in", one.topic), one.messages).rate
        lost = self._changes.note(now, ("lost", one.topic), one.dropped + one.refused)
        values = [
            ("type", one.type),
            ("publishers", str(one.publishers)),
            ("messages", str(one.messages)),
            ("rate (1/s)", f"{rate:.1f}"),
            ("last message (s ago)", "never" if one.age is None else f"{one.age:.1f}"),
            ("lag (s)", "unknown" if one.lag is None else f"{one.lag / 1e9:.3f}"),
            ("dropped", str(one.dropped)),
            ("refused", str(one.refused)),
        ]
        level, message = self._judge(now, one, lost, rate)
        return Health(f"input {one.topic}", level, message, values)

    def forget_others(self, topics: Collection[str]) -> None:
        """Forget all topics but these, which are subscribed."""
        self._intervals = {topic: known for topic, known in self._intervals.items() if topic in topics}

    def _judge(self, now: float, one: InputStatus, lost: Change, rate: float) -> Tuple[Level, str]:
        interval, role = self._interval(now, one), self._role(one.topic)
        if role is InputRole.UNREAD:
            publisher = "" if one.publishers else "no publisher; "
            return Level.OK, f"{publisher}the program reads no message of it"
        if lost.is_recent(now):
            return Level.ERROR, "messages are dropped or refused"
        if not one.publishers:
            if role is InputRole.OPTIONAL:
                return Level.OK, "no publisher, and none is needed"
            return Level.WARN, "no publisher"
        silent = (
            one.age is not None
            and interval is not None
            and one.age > max(STALE_AFTER_SECONDS, USUAL * interval)
        )
        if silent and role is InputRole.NEEDED:
            return Level.STALE, f"no message for {one.age:.0f} s"
        return Level.OK, "no message yet" if one.age is None else f"{rate:.1f} messages/s"

    def _interval(self, now: float, one: InputStatus) -> Optional[float]:
        """Return the usual interval between messages: the mean from the second one on; None before."""
        if one.age is None:
            self._intervals.pop(one.topic, None)
            return None
        first, since = self._intervals.get(one.topic, (one.messages, now - one.age))
        if one.messages < first:  # it has been subscribed anew
            first, since = one.messages, now - one.age
        self._intervals[one.topic] = first, since
        later = one.messages - first
        return (now - one.age - since) / later if later > 0 else None


def output_health(now: float, changes: Changes, one: OutputStatus) -> Health:
    """Return how a published topic is."""
    rate = changes.note(now, ("out", one.topic), one.sent).rate
    lost = changes.note(now, ("slow", one.topic), one.dropped).is_recent(now)
    values = [
        ("type", one.type),
        ("subscribers", str(one.subscribers)),
        ("sent", str(one.sent)),
        ("rate (1/s)", f"{rate:.1f}"),
        ("dropped", str(one.dropped)),
    ]
    if lost:
        return Health(f"output {one.topic}", Level.WARN, "a subscriber does not keep up", values)
    return Health(f"output {one.topic}", Level.OK, f"{rate:.1f} messages/s", values)


class EngineHealth:
    """Judges an engine.

    Args:
        slow: seconds after which work is long.
        late: seconds after which it should have ended.
    """

    def __init__(self, slow: float, late: float):
        self._changes = Changes()
        self._slow = slow
        self._late = late
        self._waiting: Dict[Tuple[str, int], float] = {}

    def of(self, now: float, status: Status) -> List[Health]:
        """Return how its parts are."""
        found = [
            self._queue(now, status),
            self._work(status),
            self._rules(now, status),
            self._queries(now, status),
        ]
        self._changes.end()
        return found

    def _queue(self, now: float, status: Status) -> Health:
        note = self._changes.note
        events, firings = note(now, "taken", status.taken).rate, note(now, "fired", status.fired).rate
        lost = note(now, "dropped", status.dropped).is_recent(now)
        values = [
            ("queued events", f"{status.queued} of {status.queue}"),
            ("waiting calls", str(status.callers)),
            ("events", str(status.taken)),
            ("events (1/s)", f"{events:.1f}"),
            ("firings of rules", str(status.fired)),
            ("firings (1/s)", f"{firings:.1f}"),
            ("dropped events", str(status.dropped)),
            ("partial matches", str(status.matches)),
            ("alarms", str(status.alarms)),
            ("errors", str(status.errors)),
            ("warnings", str(status.warnings)),
        ]
        if lost:
            return Health("queue", Level.ERROR, "events are dropped: the queue is full", values)
        if 2 * status.queued >= status.queue:
            return Health("queue", Level.WARN, f"{status.queued} events wait", values)
        return Health("queue", Level.OK, f"{events:.1f} events/s", values)

    def _work(self, status: Status) -> Health:
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
        if work.seconds < self._slow:
            return Health("work", Level.OK, "busy", values)
        level = Level.WARN if work.seconds < self._late else Level.ERROR
        return Health("work", level, f"{work.what} has taken {work.seconds:.1f} s so far", values)

    def _rules(self, now: float, status: Status) -> Health:
        wrong = [rule for rule in status.rules if rule.errors]
        number = sum(rule.errors for rule in wrong)
        recent = self._changes.note(now, "errors", number).is_recent(now)
        values = [(_name_of(rule), counted(rule.errors, "error")) for rule in wrong[:LISTED]]
        if len(wrong) > LISTED:
            values.append(("further rules", str(len(wrong) - LISTED)))
        largest = sorted(status.rules, key=lambda rule: -rule.bytes)[:LARGEST_RULES_NAMED]
        values += [(f"held by {_name_of(rule)}", _held_by(rule)) for rule in largest if rule.waiting]
        total = len(status.rules) + status.left_out.rules
        if not wrong:
            return Health("rules", Level.OK, f"{counted(total, 'rule')} without errors", values)
        more = " or more" if len(wrong) == len(status.rules) < total else ""
        text = f"{counted(number, 'error')} in {counted(len(wrong), 'rule')}{more}"
        return Health("rules", Level.ERROR if recent else Level.WARN, text, values)

    def _queries(self, now: float, status: Status) -> Health:
        seen = {(one.event, one.since): one for one in status.waiting}
        self._waiting = {key: self._waiting.get(key, now) for key in seen}
        longest = max((now - since for since in self._waiting.values()), default=0.0)
        values = []
        for key, one in list(seen.items())[:LISTED]:
            behind = [f"{memory.id} {_behind(memory.behind)}" for memory in one.memories]
            since = f"since {one.since / 1e9:.3f}, for {now - self._waiting[key]:.0f} s"
            values.append((one.event, f"{since}: waits for {', '.join(behind)}"))
        number = len(status.waiting) + status.left_out.waiting
        if number > len(values):
            values.append(("further queries", str(number - len(values))))
        if longest > LONG:
            return Health(
                "waiting queries",
                Level.WARN,
                f"{number} wait, the oldest for {longest:.0f} s or longer",
                values,
            )
        return Health("waiting queries", Level.OK, f"{number} wait", values)


def _held_by(rule: RuleStatus) -> str:
    return f"{counted(rule.waiting, 'item')}, {counted(rule.keys, 'key')}, about {rule.bytes / 1e6:.1f} MB"


def _name_of(rule: RuleStatus) -> str:
    return " ".join(part for part in (rule.label, rule.place) if part) or rule.text


def _behind(nanoseconds: Optional[int]) -> str:
    return "(has no record)" if nanoseconds is None else f"({nanoseconds / 1e9:.3f} s behind)"


def memory_health() -> Health:
    """Return how the process and the machine are with memory."""
    used = resident_bytes()
    total, available = _machine_memory()
    values = [("resident (MB)", f"{used / 1e6:.0f}")]
    if total:
        values.append(("available on the machine (MB)", f"{available / 1e6:.0f} of {total / 1e6:.0f}"))
        if available < SCARCE * total:
            return Health("process memory", Level.WARN, "the machine's memory is nearly used up", values)
    return Health("process memory", Level.OK, f"{used / 1e6:.0f} MB", values)


def _machine_memory() -> Tuple[int, int]:
    """Return the bytes that the machine has in all and to give; zeros where it does not tell."""
    found = {"MemTotal": 0, "MemAvailable": 0}
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                name, _, rest = line.partition(":")
                if name in found:
                    found[name] = 1024 * int(rest.split()[0])
    except OSError:  # a system without /proc
        pass
    return found["MemTotal"], found["MemAvailable"]


def program_health(errors: Sequence[str], warnings: Sequence[str]) -> Health:
    """Return how the program was when it was loaded."""
    told = [("error", text) for text in errors] + [("warning", text) for text in warnings]
    values = told[:LISTED]
    if len(told) > LISTED:
        values.append(("further ones", str(len(told) - LISTED)))
    if errors:
        return Health("program", Level.ERROR, f"{counted(len(errors), 'error')} when it was loaded", values)
    if warnings:
        return Health(
            "program", Level.WARN, f"{counted(len(warnings), 'warning')} when it was loaded", values
        )
    return Health("program", Level.OK, "loaded without warnings", values)


class NodeHealth:
    """Judges a node.

    Args:
        inputs: gives what has come on its subscribed topics.
        outputs: gives what has gone out.
        further: gives how the rest is.
        role: gives the use that the program has for a subscribed topic at this time.
    """

    def __init__(
        self,
        inputs: Callable[[], Sequence[InputStatus]],
        outputs: Callable[[], Sequence[OutputStatus]],
        further: Callable[[], List[Health]],
        role: Callable[[str], InputRole] = lambda topic: InputRole.NEEDED,
    ):
        self._inputs = inputs
        self._outputs = outputs
        self._further = further
        self._changes = Changes()
        self._of_inputs = InputHealth(self._changes, role)

    def look(self) -> List[Health]:
        """Return how everything is."""
        now = time.monotonic()
        inputs = self._inputs()
        self._of_inputs.forget_others({one.topic for one in inputs})
        taken = [self._of_inputs.of(now, one) for one in inputs]
        sent = [output_health(now, self._changes, one) for one in self._outputs()]
        self._changes.end()
        return [*_worst(taken, "inputs"), *_worst(sent, "outputs"), *self._further(), memory_health()]


def _worst(found: List[Health], what: str) -> List[Health]:
    """Return those that somebody has to look at first, and how many are left out."""
    if len(found) <= MAX_REPORTED_TOPICS:
        return found
    chosen = sorted(found, key=lambda one: (one.level is not Level.ERROR, -one.level))[:MAX_REPORTED_TOPICS]
    left = f"{len(found) - MAX_REPORTED_TOPICS} are not told of, none of them worse than those"
    return [*chosen, Health(f"further {what}", Level.OK, left, [])]


TOPIC = "/diagnostics"

HARDWARE = "retalis"
"""The hardware id if parameter ``~hardware_id`` gives no other; ``diagnostic_aggregator`` may group by it."""


class Diagnostics:
    """Publishes the health of a node, from a thread of its own by the system's time: simulated time may stand still.

    Args:
        period: seconds from one message to the next; None for none at all.
        health: is looked at.
        hardware_id: of each status.
    """

    def __init__(self, period: Optional[float], health: NodeHealth, hardware_id: str = HARDWARE):
        self._health = health
        self._hardware_id = hardware_id
        self._ended = threading.Event()
        if period is None:
            return
        try:
            from diagnostic_msgs import msg  # noqa: PLC0415 - a node runs without it
        except ImportError:
            rospy.logwarn("%s is not published: the package diagnostic_msgs is not installed", TOPIC)
            return
        self._msg = msg
        self._publisher = rospy.Publisher(TOPIC, msg.DiagnosticArray, queue_size=2)
        rospy.on_shutdown(self._ended.set)
        threading.Thread(target=self._run, args=(period,), name="retalis diagnostics", daemon=True).start()

    def _run(self, period: float) -> None:
        while not self._ended.wait(period):
            try:
                self._publisher.publish(self._array(self._health.look()))
            except rospy.ROSException:  # it is just being taken down
                if not rospy.is_shutdown():
                    raise
            except Exception as error:  # what is looked at is in use; the next look finds it in order
                rospy.logerr_throttle(60, f"{TOPIC}: {error!r}")

    def _array(self, found: List[Health]) -> Any:
        message = self._msg.DiagnosticArray()
        message.header.stamp = rospy.get_rostime()
        node = rospy.get_name().strip("/")
        message.status = [
            self._msg.DiagnosticStatus(
                level=int(one.level),
                name=f"{node}: {one.name}",
                message=_line(one.message),
                hardware_id=self._hardware_id,
                values=[self._msg.KeyValue(key=_line(key), value=_line(value)) for key, value in one.values],
            )
            for one in found
        ]
        return message


def _line(text: str) -> str:
    """Return a text as one line without what a terminal would act on."""
    return " ".join(printable(beginning(text, MAX_VALUE_CHARACTERS)).split("\n"))


MAX_VALUE_CHARACTERS = 1000
"""Characters of one text."""
