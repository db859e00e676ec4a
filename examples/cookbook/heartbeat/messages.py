"""A base sends two heartbeats per second, none for three seconds, sends again, and stops."""

TOPICS = {"/heartbeat": "std_msgs/Empty"}


def messages():
    """Yield time, topic and slots of each message."""
    for beat in range(8):
        yield 0.5 * beat, "/heartbeat", {}
    for beat in range(5):
        yield 6.5 + 0.5 * beat, "/heartbeat", {}
    yield 11.0, "/heartbeat", {}
