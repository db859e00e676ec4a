"""A contact sends once per second whether the door is open: for 3 s, then for 14 s."""

TOPICS = {"/door_open": "std_msgs/Bool"}


def messages():
    """Yield time, topic and slots of each message."""
    for second in range(30):
        yield 1.0 * second, "/door_open", {"data": 2 <= second < 5 or 8 <= second < 22}
