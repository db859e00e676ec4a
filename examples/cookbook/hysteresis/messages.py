"""A motor that becomes warm and cools down; its thermometer is noisy and sometimes far off."""

TOPICS = {"/temperature": "sensor_msgs/Temperature"}


def messages():
    """Yield time, topic and slots of each message."""
    for second in range(120):
        warm = 50.0 + (second if second < 60 else 120 - second) * 0.25
        noise = (3.0, -2.0, 1.0, -2.5, 0.5)[second % 5] + (20.0 if second == 10 else 0.0)
        yield 1.0 * second, "/temperature", {"temperature": warm + noise}
