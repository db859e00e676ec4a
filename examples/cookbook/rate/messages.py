"""A camera with ten pictures per second that is slower for some time."""

TOPICS = {"/camera": "sensor_msgs/Image"}


def messages():
    """Yield time, topic and slots of each message."""
    time = 0.0
    for number in range(70):
        yield time, "/camera", {"header": {"seq": number, "frame_id": "camera"}}
        time += 0.1875 if 20 <= number < 35 else 0.09375
