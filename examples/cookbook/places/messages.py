"""A robot turns and drives while it sees a cup and a book; transforms are received after the pictures."""

from math import cos, sin

TOPICS = {"/tf": "tf2_msgs/TFMessage", "/objects": "geometry_msgs/TransformStamped"}

THINGS = {"cup": (2.25, 1.0), "book": (-1.0, 3.0), "ball": (5.0, 5.0)}


def camera(time):
    """Return where the camera is and where it looks: x, y and angle."""
    return 0.25 * time, 0.125 * time, 0.2 * time


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(21):
        stamp = 0.5 * step
        x, y, angle = camera(stamp)
        rotation = {"z": sin(angle / 2), "w": cos(angle / 2)}
        moved = transform("map", "camera", x, y, stamp, rotation)
        yield stamp + 0.1, "/tf", {"transforms": [moved]}
    for stamp, name in ((1.25, "cup"), (4.75, "book"), (6.9, "ball"), (8.2, "cup")):
        x, y, angle = camera(stamp)
        dx, dy = THINGS[name][0] - x, THINGS[name][1] - y
        ahead, left = cos(angle) * dx + sin(angle) * dy, cos(angle) * dy - sin(angle) * dx
        yield stamp + 0.05, "/objects", transform("camera", name, ahead, left, stamp, {"w": 1.0})


def transform(parent, child, x, y, stamp, rotation):
    """Return the slots of a transform."""
    return {
        "header": {"frame_id": parent, "stamp": stamp},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": y}, "rotation": rotation},
    }
