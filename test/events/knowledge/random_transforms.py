"""Random trees of coordinate frames: operations on a transform buffer, and lookups in it."""

import math
from random import Random
from typing import Any, Iterator, Tuple

SECOND = 1_000_000_000
EPOCHS = (0, 50)
"""Seconds at which scenarios begin: tf2's interface takes floats of seconds, which are coarse near the present."""


def scenario(seed: Any, epochs: Any = EPOCHS) -> Iterator[Any]:
    """Yield random operations, each a tuple of its name and its arguments.

    Stored transforms have gaps, repetitions, late and old timestamps, and change their parents; the clock jumps. The
    frames are few, so that most lookups are about connected ones.
    """
    generator = Random(seed)
    base = generator.choice(epochs) * SECOND + generator.randrange(SECOND)
    names = [f"f{number}" for number in range(generator.randint(2, 8))]
    parents = {name: generator.choice([*names[:position], "root"]) for position, name in enumerate(names)}
    static = {name for name in names if generator.random() < 0.25}
    step = generator.choice((1_000_000, 20_000_000, 500_000_000))
    now = base
    timestamps = [base]
    for _ in range(generator.randint(3, 40)):
        action = generator.random()
        name = generator.choice(names)
        if action < 0.02:
            yield ("clear",)
            now = base if generator.random() < 0.5 else now
        elif action < 0.7:
            now += generator.choice((0, 1, step, step, step, 3 * step, 40 * step))
            late = generator.choice((0, 0, 0, 0, step // 2, 2 * step, 11 * SECOND))
            if generator.random() < 0.05:
                parents[name] = generator.choice([*names, "root", "other"])
            timestamp = max(0, now - late)
            timestamps.append(timestamp)
            yield "store", parents[name], name, timestamp, numbers(generator), name in static
        else:
            yield "ask", *lookup_arguments(generator, names, timestamps, step)
    for _ in range(6):
        yield "ask", *lookup_arguments(generator, names, timestamps, step)


def lookup_arguments(generator: Any, names: Any, timestamps: Any, step: Any) -> Tuple[Any, ...]:
    """Return target, source and instant."""
    target, source = (
        generator.choice(
            [
                *names,
                *names,
                "root",
                "root",
                *(["other", "nobody", "", "/f0"] if generator.random() < 0.2 else []),
            ]
        )
        for _ in range(2)
    )
    timestamp = generator.choice(timestamps[-12:])
    offset = generator.choice((0, 0, 1, -1, step // 3, -step // 3, generator.randrange(-step, step)))
    return target, source, 0 if generator.random() < 0.1 else max(1, timestamp + offset)


def numbers(generator: Any) -> Any:
    """Return position and rotation; a few are invalid."""
    position = [generator.uniform(-3, 3) for _ in range(3)]
    rotation = [generator.gauss(0, 1) for _ in range(4)]
    chance = generator.random()
    if chance < 0.1:  # half a turn apart, equal, or nearly so
        rotation = generator.choice(
            ([0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 1, 0], [1e-9, 0, 0, 1], [1, 0, 0, 1e-12])
        )
    length = math.sqrt(sum(value * value for value in rotation))
    scale = 1.0 if chance < 0.95 else generator.choice((1.004, 0.996, 1.1, 0.0))
    values = (*position, *(scale * value / length for value in rotation))
    return (float("nan"), *values[1:]) if chance > 0.99 else values
