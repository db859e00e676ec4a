"""Docking works at the third try, later not at all, and then at once."""

TOPICS = {"/dock_result": "std_msgs/String"}


def messages():
    """Yield time, topic and slots of each message."""
    results = "missed missed docked missed missed missed docked missed docked"
    for number, result in enumerate(results.split()):
        yield 10.0 * number, "/dock_result", {"data": result}
