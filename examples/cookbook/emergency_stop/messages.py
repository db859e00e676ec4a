"""The button is pressed, and reset while it is still pressed; later a reset without an emergency stop."""

TOPICS = {"/emergency_stop": "std_msgs/Bool", "/reset": "std_msgs/Empty"}


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(40):
        time = 0.5 * step
        yield time, "/emergency_stop", {"data": 3.0 <= time < 7.0 or time == 15.0}
    for time in (1.25, 5.25, 8.25, 8.75, 17.25):
        yield time, "/reset", {}
