"""Random trees of coordinate frames: operations on a transform buffer, and questions about it."""

import math
from random import Random

SECOND = 1_000_000_000
EPOCHS = (0, 50)
"""Seconds at which scenarios begin: tf2's interface takes floats of seconds, which are coarse near the present."""


def scenario(seed, epochs=EPOCHS):
    """Yield random operations, each a tuple of its name and its arguments.

    Stored transforms have gaps, repetitions, late and old stamps, and change their parents; the clock jumps. The
    frames are few, so that most questions are about connected ones.
    """
    rnd = Random(seed)
    base = rnd.choice(epochs) * SECOND + rnd.randrange(SECOND)
    names = [f"f{number}" for number in range(rnd.randint(2, 8))]
    parents = {name: rnd.choice([*names[:position], "root"]) for position, name in enumerate(names)}
    static = {name for name in names if rnd.random() < 0.25}
    step = rnd.choice((1_000_000, 20_000_000, 500_000_000))
    now = base
    stamps = [base]
    for _ in range(rnd.randint(3, 40)):
        action = rnd.random()
        name = rnd.choice(names)
        if action < 0.02:
            yield ("clear",)
            now = base if rnd.random() < 0.5 else now
        elif action < 0.7:
            now += rnd.choice((0, 1, step, step, step, 3 * step, 40 * step))
            late = rnd.choice((0, 0, 0, 0, step // 2, 2 * step, 11 * SECOND))
            if rnd.random() < 0.05:
                parents[name] = rnd.choice([*names, "root", "other"])
            stamp = max(0, now - late)
            stamps.append(stamp)
            yield "store", parents[name], name, stamp, numbers(rnd), name in static
        else:
            yield "ask", *question(rnd, names, stamps, step)
    for _ in range(6):
        yield "ask", *question(rnd, names, stamps, step)


def question(rnd, names, stamps, step):
    """Return target, source and instant."""
    target, source = (
        rnd.choice(
            [*names, *names, "root", "root", *(["other", "nobody", "", "/f0"] if rnd.random() < 0.2 else [])]
        )
        for _ in range(2)
    )
    stamp = rnd.choice(stamps[-12:])
    offset = rnd.choice((0, 0, 1, -1, step // 3, -step // 3, rnd.randrange(-step, step)))
    return target, source, 0 if rnd.random() < 0.1 else max(1, stamp + offset)


def numbers(rnd):
    """Return position and rotation; a few are invalid."""
    position = [rnd.uniform(-3, 3) for _ in range(3)]
    rotation = [rnd.gauss(0, 1) for _ in range(4)]
    chance = rnd.random()
    if chance < 0.1:  # half a turn apart, equal, or nearly so
        rotation = rnd.choice(([0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 1, 0], [1e-9, 0, 0, 1], [1, 0, 0, 1e-12]))
    length = math.sqrt(sum(value * value for value in rotation))
    scale = 1.0 if chance < 0.95 else rnd.choice((1.004, 0.996, 1.1, 0.0))
    values = (*position, *(scale * value / length for value in rotation))
    return (float("nan"), *values[1:]) if chance > 0.99 else values
