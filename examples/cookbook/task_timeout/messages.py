"""Four tasks: one ends in time, one hangs, one is aborted, and one ends just in time."""

TOPICS = {"/task": "actionlib_msgs/GoalStatus"}

ACTIVE, SUCCEEDED, ABORTED = 1, 3, 4


def messages():
    """Yield time, topic and slots of each message."""
    for name, begin, seconds, end in (
        ("fetch", 0, 8, SUCCEEDED),
        ("sweep", 10, 30, SUCCEEDED),
        ("open", 45, 3, ABORTED),
        ("dock", 50, 19, SUCCEEDED),
    ):
        goal = {"id": name, "stamp": begin}
        for second in range(seconds):
            yield 1.0 * begin + second, "/task", {"goal_id": goal, "status": ACTIVE}
        yield 1.0 * begin + seconds, "/task", {"goal_id": goal, "status": end}
