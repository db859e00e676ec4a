"""A base that beats twice a second, is silent for three seconds, comes back, and stops."""

TOPICS = {"/heartbeat": "std_msgs/Empty"}


def messages():
    """Yield time, topic and slots of each message."""
    for beat in range(8):
        yield 0.5 * beat, "/heartbeat", {}
    for beat in range(5):
        yield 6.5 + 0.5 * beat, "/heartbeat", {}
    yield 11.0, "/heartbeat", {}
