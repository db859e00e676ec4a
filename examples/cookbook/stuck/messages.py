"""A robot drives, is blocked by a step for seven seconds while it is commanded to drive, and is stopped."""

TOPICS = {"/cmd_vel": "geometry_msgs/Twist", "/odom": "nav_msgs/Odometry"}


def messages():
    """Yield time, topic and slots of each message."""
    x = 0.0
    for step in range(170):
        time = 0.1 * step
        commanded = 0.25 if 1.0 <= time < 12.0 else 0.0
        yield time, "/cmd_vel", {"linear": {"x": commanded}}
        if time < 5.0:
            x += 0.1 * commanded
        position = {"pose": {"position": {"x": x}}}
        yield time + 0.05, "/odom", {"header": {"frame_id": "odom"}, "pose": position}
