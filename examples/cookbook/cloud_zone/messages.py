"""A person walks through the door and stops at the shelf. Some points are nan: the sensor measured nothing."""

import math
import random
import struct

TOPICS = {"/points": "sensor_msgs/PointCloud2"}

FLOAT32 = 7
POINTS = 40
NAMES = ("x", "y", "z", "intensity")


def messages():
    """Yield time, topic and slots of each message."""
    rnd = random.Random(1)
    for step in range(24):
        x, y = (3.5 - 0.25 * step, 0.0) if step < 10 else (1.25 - 0.0625 * (step - 10), 0.125 * (step - 10))
        data = b"".join(struct.pack("<4f", *point(rnd, number, x, y)) for number in range(POINTS))
        yield (
            0.25 * step,
            "/points",
            {
                "height": 1,
                "width": POINTS,
                "fields": [
                    {"name": name, "offset": 4 * place, "datatype": FLOAT32, "count": 1}
                    for place, name in enumerate(NAMES)
                ],
                "point_step": 16,
                "row_step": 16 * POINTS,
                "data": data,
            },
        )


def point(rnd, number, x, y):
    """Return coordinates and intensity of a point: of the floor, of somebody at a place, or of nothing."""
    if number % 10 == 0:
        return [math.nan] * 4
    if number % 2:
        return rnd.uniform(0, 4), rnd.uniform(-2, 2), rnd.uniform(-0.02, 0.02), 1.0
    return x + rnd.uniform(-0.2, 0.2), y + rnd.uniform(-0.2, 0.2), rnd.uniform(0.3, 1.8), 9.0
