"""Replacement of rospy and message packages: a script receives messages in simulated time, in one thread."""

import heapq
import sys
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Dict, Iterator, List

SECOND = 10**9
START = 1_700_000_000 * SECOND
"""Start of the bags in ns; times in slots are relative to it."""


class Duration:
    """A duration as in rospy; `Time` has the same arithmetic."""

    def __init__(self, secs: int = 0, nsecs: int = 0) -> None:
        self.ns = round(secs * SECOND) + nsecs

    @classmethod
    def of(cls, nanoseconds: Any) -> Any:
        return cls(0, int(nanoseconds))

    @classmethod
    def from_sec(cls, seconds: Any) -> Any:
        return cls(seconds)

    @property
    def secs(self) -> Any:
        return self.ns // SECOND

    @property
    def nsecs(self) -> Any:
        return self.ns % SECOND

    def to_sec(self) -> Any:
        return self.secs + self.nsecs / 1e9

    def is_zero(self) -> bool:
        return self.ns == 0

    def __add__(self, other: Any) -> Any:
        return type(self).of(self.ns + other.ns)

    def __sub__(self, other: Any) -> Any:
        result_class = Duration if type(self) is type(other) else type(self)
        return result_class.of(self.ns - other.ns)

    def __abs__(self) -> Any:
        return type(self).of(abs(self.ns))

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Duration) and self.ns == other.ns

    def __lt__(self, other: Any) -> bool:
        return self.ns < other.ns

    def __le__(self, other: Any) -> bool:
        return self.ns <= other.ns

    def __gt__(self, other: Any) -> bool:
        return self.ns > other.ns

    def __ge__(self, other: Any) -> bool:
        return self.ns >= other.ns

    def __hash__(self) -> int:
        return hash(self.ns)


class Time(Duration):
    """An instant; `RobotWorld` defines the subclass that returns the present time."""


CLASSES: Dict[Any, Any] = {}


def message_class(definition: Any) -> Any:
    """Return the class for a message, always the same one."""
    return CLASSES.get(definition.name) or CLASSES.setdefault(definition.name, new_class(definition))


def new_class(definition: Any) -> Any:
    """Return a class for a message: slots by name or in order, zero by default."""
    slots = {field.name: field for field in definition.fields}

    def initialize(self: Any, *positional_values: Any, **values: Any) -> None:
        values = {**dict(zip(slots, positional_values)), **values}
        assert len(positional_values) in (0, len(slots)), (
            f"{definition.name} takes all slots or none by position"
        )
        assert set(values) <= set(slots), f"{definition.name} has no slot {set(values) - set(slots)}"
        for name, field in slots.items():
            setattr(self, name, values[name] if name in values else default(field))

    constants = {constant.name: constant.value for constant in definition.constants}
    return type(
        definition.name.rpartition("/")[2],
        (),
        {"__init__": initialize, "definition": definition, **constants},
    )


def default(field: Any) -> Any:
    if field.length is not None:
        return [default(field._replace(length=None)) for _ in range(max(field.length, 0))]
    if field.definition is not None:
        return message_class(field.definition)()
    return {"time": Time(), "duration": Duration(), "string": "", "bool": False}.get(field.type, 0)


def from_slots(definition: Any, slots: Any, time: Any) -> Any:
    """Return a message of slots by name; a header without a time has that of the message."""
    message = message_class(definition)()
    for field in definition.fields:
        value = slots.get(field.name)
        if field.definition is not None and field.length is None:
            setattr(message, field.name, from_slots(field.definition, value or {}, time))
        elif field.definition is not None:
            setattr(message, field.name, [from_slots(field.definition, item, time) for item in value or []])
        elif field.type == "time":
            setattr(message, field.name, Time.of(time if value is None else START + round(value * SECOND)))
        elif value is not None:
            setattr(message, field.name, value)
    return message


def to_slots(value: Any) -> Any:
    """Return a message as nested dictionaries of slots."""
    if isinstance(value, Duration):
        return (value.ns - (START if isinstance(value, Time) else 0)) / SECOND
    if isinstance(value, (list, tuple)):
        return [to_slots(item) for item in value]
    if hasattr(value, "definition"):
        return {field.name: to_slots(getattr(value, field.name)) for field in value.definition.fields}
    return value


class RobotWorld:
    """Replacement of rospy for the script of a node.

    Attributes:
        published: published messages as tuples of time, topic and message.
    """

    def __init__(self, definitions: str) -> None:
        self._definitions = definitions
        self._order = count()
        self.now = 0
        self.messages: List[Any] = []
        self.published: List[Any] = []
        self._callbacks: Dict[Any, Any] = {}
        self._timers: List[Any] = []

    def run(self, script: Path, messages: Any) -> Any:
        """Run the script of a node over messages: tuples of time, topic, definition and slots by name."""
        self.messages = messages
        code = compile(script.read_text(encoding="utf-8"), str(script), "exec")
        with self._modules():
            exec(code, {"__name__": "__main__", "__file__": str(script)})
        return self.published

    def spin(self) -> None:
        for time, topic, definition, slots in self.messages:
            self._fire_timers_until(time)
            self.now = time
            for callback in self._callbacks.get(topic.lstrip("/"), ()):
                callback(from_slots(definition, slots, time))

    def _fire_timers_until(self, instant: Any) -> None:
        while self._timers and self._timers[0][0] <= instant:
            self.now, _, timer = heapq.heappop(self._timers)
            if timer.running:
                timer.running = timer.period is not None
                timer.callback(SimpleNamespace(current_real=self.time.of(self.now)))
                if timer.running:
                    heapq.heappush(self._timers, (self.now + timer.period, next(self._order), timer))

    @contextmanager
    def _modules(self) -> Iterator[None]:
        """Replace the modules that scripts import, and restore them afterwards."""
        world = self

        class Clock(Time):
            @staticmethod
            def now() -> Any:
                return Time.of(world.now)

        self.time = Clock
        rospy = ModuleType("rospy")
        for name, value in {
            "Duration": Duration,
            "Time": Clock,
            "Subscriber": self._subscribe,
            "Publisher": self._publisher,
            "Timer": self._timer,
            "init_node": lambda name: None,
            "spin": self.spin,
        }.items():
            setattr(rospy, name, value)
        replacements = {"rospy": rospy}
        for package in PACKAGES:
            replacements[package] = ModuleType(package)
            replacements[f"{package}.msg"] = Messages(package, self._definitions)
        original_modules = {name: sys.modules.get(name) for name in replacements}
        sys.modules.update(replacements)
        try:
            yield
        finally:
            for name, module in original_modules.items():
                if module is None:
                    del sys.modules[name]
                else:
                    sys.modules[name] = module

    def _subscribe(self, topic: Any, message_type: Any, callback: Any, queue_size: Any = None) -> None:
        self._callbacks.setdefault(topic, []).append(callback)

    def _publisher(self, topic: Any, message_type: Any, queue_size: Any = None, latch: bool = False) -> Any:
        def publish(*values: Any, **slots: Any) -> None:
            is_message = bool(values) and isinstance(values[0], message_type)
            message = values[0] if is_message else message_type(*values, **slots)
            self.published.append((self.now, topic, message))

        return SimpleNamespace(publish=publish)

    def _timer(self, period: Any, callback: Any, oneshot: bool = False) -> Any:
        timer = SimpleNamespace(callback=callback, period=None if oneshot else period.ns, running=True)
        timer.shutdown = lambda: setattr(timer, "running", False)
        heapq.heappush(self._timers, (self.now + period.ns, next(self._order), timer))
        return timer


class Messages(ModuleType):
    """The module ``package.msg``, which creates classes from definitions when they are imported."""

    def __init__(self, package: str, definitions: Any) -> None:
        super().__init__(f"{package}.msg")
        self._package, self._definitions = package, definitions

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        message_class_by_name = message_class(self._definitions.find(f"{self._package}/{name}"))
        setattr(self, name, message_class_by_name)
        return message_class_by_name


PACKAGES = ("std_msgs", "sensor_msgs", "geometry_msgs", "nav_msgs", "actionlib_msgs", "tf2_msgs")
