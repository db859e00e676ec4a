#!/usr/bin/env python3
"""Write the events of robots in a warehouse, which carry parcels between shelves, sometimes with a bump."""

import argparse
import json
from random import Random

SHELVES = [(3.0 * column, 4.0 * row) for row in range(4) for column in range(6)]


class Carrier:
    """A robot that drives from one shelf to the next at 1 m/s."""

    def __init__(self, name, random):
        self._name = name
        self._random = random
        self._x, self._y = random.choice(SHELVES)
        self._to = random.randrange(len(SHELVES))
        self._parcels = 0
        self._carries = None

    def second(self, time):
        """Yield the time of receipt and the text of each event in a second."""
        yield time, f"at({self._x:.2f},{self._y:.2f})"
        if self._random.random() < 0.01:
            yield time + 0.5, "bump"
        x, y = SHELVES[self._to]
        away = abs(x - self._x) + abs(y - self._y)
        if away > 0:
            part = min(1.0, 1 / away)
            self._x += part * (x - self._x)
            self._y += part * (y - self._y)
        else:
            yield from self._at_shelf(time)

    def _at_shelf(self, time):
        """Yield the events at a shelf; the camera sees it later, and its event is received with a delay."""
        yield time + self._random.uniform(1.5, 3.5), f"shelf(s{self._to},{time + 1.4:.3f})"
        if self._carries is None:
            self._parcels += 1
            self._carries = f"{self._name}_{self._parcels}"
            yield time + 0.2, f"picked({self._carries})"
        else:
            yield time + 0.2, f"dropped({self._carries},s{self._to})"
            self._carries = None
        self._to = self._random.randrange(len(SHELVES))


def events(robots, seconds, seed=1):
    """Return all events in the order of their receipt."""
    made = []
    for number in range(robots):
        name = f"r{number:02}"
        carrier = Carrier(name, Random(f"{seed} {name}"))
        late = Random(f"late {seed} {name}").random()  # the robots send at different times
        for second in range(seconds):
            for time, event in carrier.second(second + late):
                made.append({"robot": name, "time": round(time, 3), "event": event})
    return sorted(made, key=lambda event: event["time"])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="output file, one JSON object per line")
    parser.add_argument("--robots", type=int, default=20, help="number of robots (default: 20)")
    parser.add_argument("--seconds", type=int, default=600, help="duration (default: 600)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random events (default: 1)")
    options = parser.parse_args(arguments)
    with open(options.file, "w", encoding="utf-8") as file:
        for event in events(options.robots, options.seconds, options.seed):
            file.write(json.dumps(event) + "\n")


if __name__ == "__main__":
    main()
