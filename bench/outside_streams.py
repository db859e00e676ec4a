"""The streams of ``bench/outside.py``: lists of plain tuples, the same for all systems and in each run.

Times are integer nanoseconds. Each function takes the number of events, which resemble those of a robot's program:
orders that are fulfilled later, readings of many motors, two sensors at the same time.
"""

import random
from heapq import heappop, heappush
from typing import Any, Callable, Dict, List, Tuple

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
