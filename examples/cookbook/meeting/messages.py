"""Three robots: two pass each other in a corridor, the third one crosses behind them and stays near one."""

TOPICS = {"/odometry": "nav_msgs/Odometry"}


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(50):
        time = 0.2 * step
        places = (("ann", time - 4.0, 0.0), ("bob", 4.0 - time, 0.25), ("cleo", -3.5, max(1.0, 8.0 - time)))
        for number, (name, x, y) in enumerate(places):
            position = {"pose": {"position": {"x": x, "y": y}}}
            slots = {"header": {"frame_id": "map"}, "child_frame_id": name, "pose": position}
            yield time + 0.05 * number, "/odometry", slots
