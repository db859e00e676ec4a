"""Docking succeeds at the third attempt, later fails, and then succeeds at the first."""

TOPICS = {"/dock_result": "std_msgs/String"}


def messages():
    """Yield time, topic and slots of each message."""
    results = "missed missed docked missed missed missed docked missed docked"
    for number, result in enumerate(results.split()):
        yield 10.0 * number, "/dock_result", {"data": result}
