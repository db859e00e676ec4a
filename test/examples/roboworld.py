"""A stand-in for rospy and message packages: a script gets messages in simulated time, in one thread."""

import heapq
import sys
from contextlib import contextmanager
from itertools import count
from types import ModuleType, SimpleNamespace

SECOND = 10**9
BEGAN = 1_700_000_000 * SECOND
"""When the bags begin: times among slots count from there."""


class Duration:
    """An amount of time, as rospy's; `Time` shares its arithmetic."""

    def __init__(self, secs=0, nsecs=0):
        self.ns = round(secs * SECOND) + nsecs

    @classmethod
    def of(cls, nanoseconds):
        return cls(0, int(nanoseconds))

    @classmethod
    def from_sec(cls, seconds):
        return cls(seconds)

    @property
    def secs(self):
        return self.ns // SECOND

    @property
    def nsecs(self):
        return self.ns % SECOND

    def to_sec(self):
        return self.secs + self.nsecs / 1e9

    def is_zero(self):
        return self.ns == 0

    def __add__(self, other):
        return type(self).of(self.ns + other.ns)

    def __sub__(self, other):
        kind = Duration if type(self) is type(other) else type(self)
        return kind.of(self.ns - other.ns)

    def __abs__(self):
        return type(self).of(abs(self.ns))

    def __eq__(self, other):
        return isinstance(other, Duration) and self.ns == other.ns

    def __lt__(self, other):
        return self.ns < other.ns

    def __le__(self, other):
        return self.ns <= other.ns

    def __gt__(self, other):
        return self.ns > other.ns

    def __ge__(self, other):
        return self.ns >= other.ns

    def __hash__(self):
        return hash(self.ns)


class Time(Duration):
    """An instant; `RobotWorld` gives the class that knows what time it is."""


CLASSES = {}


def message_class(definition):
    """Return the class for a message, always the same one."""
    return CLASSES.get(definition.name) or CLASSES.setdefault(definition.name, new_class(definition))


def new_class(definition):
    """Return a class for a message: slots by name or in order, zero where they are not given."""
    slots = {field.name: field for field in definition.fields}

    def __init__(self, *values, **named):
        given = {**dict(zip(slots, values)), **named}
        assert len(values) in (0, len(slots)), f"{definition.name} takes all slots or none by position"
        assert set(given) <= set(slots), f"{definition.name} has no slot {set(given) - set(slots)}"
        for name, field in slots.items():
            setattr(self, name, given[name] if name in given else default(field))

    constants = {constant.name: constant.value for constant in definition.constants}
    return type(
        definition.name.rpartition("/")[2], (), {"__init__": __init__, "kind": definition, **constants}
    )


def default(field):
    if field.length is not None:
        return [default(field._replace(length=None)) for _ in range(max(field.length, 0))]
    if field.definition is not None:
        return message_class(field.definition)()
    return {"time": Time(), "duration": Duration(), "string": "", "bool": False}.get(field.type, 0)


def from_slots(kind, slots, time):
    """Return a message of slots by name; a header has the message's time where it gives none."""
    message = message_class(kind)()
    for field in kind.fields:
        value = slots.get(field.name)
        if field.definition is not None and field.length is None:
            setattr(message, field.name, from_slots(field.definition, value or {}, time))
        elif field.definition is not None:
            setattr(message, field.name, [from_slots(field.definition, one, time) for one in value or []])
        elif field.type == "time":
            setattr(message, field.name, Time.of(time if value is None else BEGAN + round(value * SECOND)))
        elif value is not None:
            setattr(message, field.name, value)
    return message


def to_slots(value):
    """Return a message as slots by name, nested ones likewise."""
    if isinstance(value, Duration):
        return (value.ns - (BEGAN if isinstance(value, Time) else 0)) / SECOND
    if isinstance(value, (list, tuple)):
        return [to_slots(one) for one in value]
    if hasattr(value, "kind"):
        return {field.name: to_slots(getattr(value, field.name)) for field in value.kind.fields}
    return value


class RobotWorld:
    """What a node's script finds when it imports rospy; `published` has what it publishes, with the time."""

    def __init__(self, definitions):
        self._definitions = definitions
        self._order = count()
        self.now = 0
        self.messages = []
        self.published = []
        self._callbacks = {}
        self._timers = []

    def run(self, script, messages):
        """Run a node's script over messages: (time, topic, message class, slots by name)."""
        self.messages = messages
        code = compile(script.read_text(encoding="utf-8"), str(script), "exec")
        with self._modules():
            exec(code, {"__name__": "__main__", "__file__": str(script)})
        return self.published

    def spin(self):
        for time, topic, kind, slots in self.messages:
            self._ring_until(time)
            self.now = time
            for callback in self._callbacks.get(topic.lstrip("/"), ()):
                callback(from_slots(kind, slots, time))

    def _ring_until(self, instant):
        while self._timers and self._timers[0][0] <= instant:
            self.now, _, timer = heapq.heappop(self._timers)
            if timer.running:
                timer.running = timer.period is not None
                timer.callback(SimpleNamespace(current_real=self.time.of(self.now)))
                if timer.running:
                    heapq.heappush(self._timers, (self.now + timer.period, next(self._order), timer))

    @contextmanager
    def _modules(self):
        """Put the stand-ins where scripts import from, and what was there back again."""
        world = self

        class Clock(Time):
            @staticmethod
            def now():
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
        stand_ins = {"rospy": rospy}
        for package in PACKAGES:
            stand_ins[package] = ModuleType(package)
            stand_ins[f"{package}.msg"] = Messages(package, self._definitions)
        kept = {name: sys.modules.get(name) for name in stand_ins}
        sys.modules.update(stand_ins)
        try:
            yield
        finally:
            for name, module in kept.items():
                if module is None:
                    del sys.modules[name]
                else:
                    sys.modules[name] = module

    def _subscribe(self, topic, kind, callback, queue_size=None):
        self._callbacks.setdefault(topic, []).append(callback)

    def _publisher(self, topic, kind, queue_size=None, latch=False):
        def publish(*values, **named):
            message = values[0] if values and isinstance(values[0], kind) else kind(*values, **named)
            self.published.append((self.now, topic, message))

        return SimpleNamespace(publish=publish)

    def _timer(self, period, callback, oneshot=False):
        timer = SimpleNamespace(callback=callback, period=None if oneshot else period.ns, running=True)
        timer.shutdown = lambda: setattr(timer, "running", False)
        heapq.heappush(self._timers, (self.now + period.ns, next(self._order), timer))
        return timer


class Messages(ModuleType):
    """The module ``package.msg``: its classes are made from definitions when they are imported."""

    def __init__(self, package, definitions):
        super().__init__(f"{package}.msg")
        self._package, self._definitions = package, definitions

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        found = message_class(self._definitions.find(f"{self._package}/{name}"))
        setattr(self, name, found)
        return found


PACKAGES = ("std_msgs", "sensor_msgs", "geometry_msgs", "nav_msgs", "actionlib_msgs", "tf2_msgs")
