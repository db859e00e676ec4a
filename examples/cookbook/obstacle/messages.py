"""A robot drives towards a box, waits before it, and turns away."""

import math

TOPICS = {"/scan": "sensor_msgs/LaserScan"}

FIRST, STEP, BEAMS = -1.5, 0.03125, 97


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(60):
        box = max(0.375, 2.0 - 0.0625 * step) if step < 45 else math.inf
        ranges = [reading(FIRST + STEP * beam, box, beam + step) for beam in range(BEAMS)]
        yield (
            0.1 * step,
            "/scan",
            {
                "angle_min": FIRST,
                "angle_max": FIRST + STEP * (BEAMS - 1),
                "angle_increment": STEP,
                "range_min": 0.125,
                "range_max": 8.0,
                "ranges": ranges,
            },
        )


def reading(angle, box, number):
    """Return the distance that a beam measures: a box ahead, a wall on the left, nothing on the right."""
    if number % 13 == 0:
        return math.nan
    if abs(angle) <= 0.2:
        return box + (number % 4) / 64
    return 0.25 + (number % 8) / 64 if angle > 0.5 else math.inf
