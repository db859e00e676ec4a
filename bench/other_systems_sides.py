"""Implementations of the workloads of ``bench/other_systems.py`` in each system.

An implementation prepares events and returns the function that processes them, which calls ``emit`` with the values
of each result. It imports its packages itself, because not all of them are installed.

The events of a workload are plain tuples, the same for all systems and in each run, with times in integer
nanoseconds. They resemble those of a robot's program: orders that are fulfilled later, readings of many motors, two
sensors at the same time.
"""

import random
from collections import OrderedDict, deque
from heapq import heappop, heappush
from math import fsum
from typing import Any, Callable, Deque, Dict, List, Tuple

SECOND = 10**9
BEGIN = 1_500_000_000 * SECOND
WAITING = 10_000
"""Number of sequences that are open at the same time."""

StreamEvent = Tuple[Any, ...]


def sequences(events: int, undone: bool = False) -> List[StreamEvent]:
    """Return ``a``, ``b`` and ``c`` with their keys: ("a", key, time).

    Most ``a`` have their ``b`` after half a minute, some too late after a minute and a half, and some have none.

    Args:
        events: number of events.
        undone: whether a quarter of the keys get a ``c`` after a quarter of a minute.
    """
    chance = random.Random(11)
    step = 35 * SECOND // WAITING
    found: List[StreamEvent] = []
    due: List[Tuple[int, str, int]] = []
    key = 0
    while len(found) < events:
        time = BEGIN + key * step
        while due and due[0][0] <= time:
            then, kind, whose = heappop(due)
            found.append((kind, whose, then))
        found.append(("a", key, time))
        fate = chance.random()
        if fate < 0.9:
            heappush(due, (time + (30 if fate < 0.85 else 90) * SECOND + chance.randrange(1, 1000), "b", key))
        if undone and chance.random() < 0.25:
            heappush(due, (time + 15 * SECOND + chance.randrange(1, 1000), "c", key))
        key += 1
    return found[:events]


def readings(events: int, rounded: bool = True) -> List[StreamEvent]:
    """Return readings of a hundred keys, a thousand a second: (key, value, time).

    Args:
        events: number of readings.
        rounded: whether sums of the values are exact in floats.
    """
    chance = random.Random(12)
    return [
        (
            chance.randrange(100),
            chance.randrange(1000) / 8 if rounded else chance.uniform(0, 125),
            BEGIN + at * SECOND // 1000,
        )
        for at in range(events)
    ]


def sides(events: int) -> List[StreamEvent]:
    """Return ``l`` and ``r``, each about 900 a second, of which a tenth is missing: ("l", number, time)."""
    chance = random.Random(13)
    found: List[StreamEvent] = []
    number = 0
    while len(found) < events:
        time = BEGIN + number * SECOND // 1000
        for kind, later in (("l", 0), ("r", 500_000)):
            if chance.random() < 0.9:
                found.append((kind, number, time + later + chance.randrange(300_000)))
        number += 1
    return found[:events]


STREAMS: Dict[str, Callable[[int], List[StreamEvent]]] = {
    "keyed": sequences,
    "absence": lambda events: sequences(events, undone=True),
    "sliding": readings,
    "exact": lambda events: readings(events, rounded=False),
    "pairs": sides,
}
"""Stream of each workload."""

Emit = Callable[..., None]
Run = Callable[[], None]
NAP, TEN, MINUTE = SECOND // 20, 10 * SECOND, 60 * SECOND

SLIDING = "out(K, N, A) <- aggregate([count, avg(X)], x(K, X), [N, A], last(10))."
RULES = {
    "keyed": "out(K) <- (a(K) seq b(K)) within 60.",
    "absence": "out(K) <- ((a(K) seq b(K)) cnot c(K)) within 60.",
    "sliding": SLIDING,
    "exact": SLIDING,
    "pairs": "out(I, J) <- (l(I) and r(J)) within 0.05.",
}


def rules(work: str, events: List[StreamEvent], emit: Emit) -> Run:
    """Return the engine's function, with one rule. Its clock stands at the last event: none is in the future."""
    from retalis import Engine, StreamClock, Var, functor
    from retalis.events.dispatch.listeners import ListenerPhase

    engine = Engine(StreamClock(events[-1][2]))
    engine.rules.network.limit_stored(10**8)
    engine.load(rules=RULES[work])

    def heard(term: Any, values: Any, start: int, end: int, after: Any) -> Any:
        emit(*term[1:])
        return after

    size = RULES[work].partition(")")[0].count(",") + 1
    result = functor("out", size)(*(Var() for _ in range(size)))
    engine.dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, result, heard)
    if work in ("sliding", "exact"):
        x = functor("x", 2)
        ready = [(x(key, value), time) for key, value, time in events]
    else:
        kinds = {kind: functor(kind, 1) for kind in "abclr"}
        ready = [(kinds[kind](key), time) for kind, key, time in events]
    dispatch = engine.event_input.dispatch_event

    def all_of_them() -> None:
        for term, time in ready:
            dispatch(term, time, time, True)

    return lambda: engine.do(all_of_them)


def loop(work: str, events: List[StreamEvent], emit: Emit) -> Run:
    """Return the function of a handwritten loop."""
    take = {
        "keyed": _sequence,
        "absence": _sequence,
        "sliding": _window,
        "exact": _exact_window,
        "pairs": _pairs,
    }[work](emit)

    def all_of_them() -> None:
        for event in events:
            take(event)

    return all_of_them


def _sequence(emit: Emit) -> Callable[[StreamEvent], None]:
    """Return a handler of a, b and c: a key's b less than a minute after its a, without c in between."""
    begun: OrderedDict[int, int] = OrderedDict()  # by time, as each key has one a

    def take(event: StreamEvent) -> None:
        kind, key, time = event
        while begun and time - begun[next(iter(begun))] >= MINUTE:
            begun.popitem(last=False)
        if kind == "a":
            begun[key] = time
        elif begun.pop(key, None) is not None and kind == "b":
            emit(key)

    return take


def _window(emit: Emit) -> Callable[[StreamEvent], None]:
    """Return a handler of readings: count and mean of a key in the last ten seconds.

    The total is a float, so its rounding errors add up.
    """
    windows: Dict[int, Tuple[Deque[Tuple[int, float]], List[float]]] = {}

    def take(event: StreamEvent) -> None:
        key, value, time = event
        if key not in windows:
            windows[key] = (deque(), [0.0])
        window, total = windows[key]
        window.append((time, value))
        total[0] += value
        while time - window[0][0] >= TEN:
            total[0] -= window.popleft()[1]
        emit(key, len(window), total[0] / len(window))

    return take


def _exact_window(emit: Emit) -> Callable[[StreamEvent], None]:
    """Return a handler like `_window` that sums all readings each time, so that no rounding errors add up."""
    windows: Dict[int, Tuple[Deque[int], Deque[float]]] = {}

    def take(event: StreamEvent) -> None:
        key, value, time = event
        if key not in windows:
            windows[key] = (deque(), deque())
        times, values = windows[key]
        times.append(time)
        values.append(value)
        while time - times[0] >= TEN:
            times.popleft()
            values.popleft()
        emit(key, len(values), fsum(values) / len(values))

    return take


def _pairs(emit: Emit) -> Callable[[StreamEvent], None]:
    """Return a handler of l and r: pairs with the newest other one that is less than 50 ms old, each used once."""
    waiting: Dict[str, Deque[Tuple[int, int]]] = {"l": deque(), "r": deque()}

    def take(event: StreamEvent) -> None:
        kind, number, time = event
        others = waiting["r" if kind == "l" else "l"]
        while others and time - others[0][1] >= NAP:
            others.popleft()
        if not others:
            waiting[kind].append((number, time))
        elif kind == "l":
            emit(number, others.pop()[0])
        else:
            emit(others.pop()[0], number)

    return take


def filters(work: str, events: List[StreamEvent], emit: Emit) -> Run:
    """Return the function of ROS's approximate time synchronizer, for pairs."""
    if work != "pairs":
        raise ImportError(f"message_filters has nothing for {work}")
    import rospy
    from message_filters import ApproximateTimeSynchronizer, SimpleFilter
    from std_msgs.msg import Header

    class Stamped:
        def __init__(self, number: int, time: int):
            self.header = Header(seq=number, stamp=rospy.Time(*divmod(time, SECOND)))

    rospy.rostime.set_rostime_initialized(True)
    inputs = {"l": SimpleFilter(), "r": SimpleFilter()}
    both = ApproximateTimeSynchronizer([inputs["l"], inputs["r"]], 50, 0.05)
    both.registerCallback(lambda left, right: emit(left.header.seq, right.header.seq))
    ready = [(inputs[kind].signalMessage, Stamped(number, time)) for kind, number, time in events]

    def all_of_them() -> None:
        for signal, message in ready:
            signal(message)

    return all_of_them


SIDES: Dict[str, Callable[[str, List[StreamEvent], Emit], Run]] = {
    "retalis": rules,
    "loop": loop,
    "message_filters": filters,
}
