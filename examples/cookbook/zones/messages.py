"""A robot drives from the hall into the kitchen, over the threshold and back, then out of all zones."""

TOPICS = {"/pose": "geometry_msgs/PoseStamped"}

PATH = [
    (0.0, 1.0),
    (2.0, 1.0),
    (3.9, 1.0),
    (4.1, 1.0),
    (5.0, 2.0),
    (4.2, 1.5),
    (3.8, 1.5),
    (2.0, 3.0),
    (2.0, 7.0),
]


def messages():
    """Yield time, topic and slots of each message."""
    for step, (x, y) in enumerate(PATH):
        yield 0.5 * step, "/pose", {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}}}
