"""Two thermometers: one is wrong for a single reading, later for many; in between the other one sends nothing."""

TOPICS = {"/temperature": "sensor_msgs/Temperature"}


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(24):
        off = 6.0 if step == 3 or step >= 14 else 0.5
        yield 1.0 * step, "/temperature", {"header": {"frame_id": "left"}, "temperature": 20.0}
        if not 8 <= step < 11:
            yield step + 0.1, "/temperature", {"header": {"frame_id": "right"}, "temperature": 20.0 + off}
