"""An arm lifts a load that is too heavy for its elbow, then its wrist is blocked. Short peaks are normal."""

TOPICS = {"/joint_states": "sensor_msgs/JointState"}

JOINTS = ["shoulder", "elbow", "wrist"]


def messages():
    """Yield time, topic and slots of each message."""
    for step in range(120):
        time = 0.1 * step
        elbow = 9.0 if 3.0 <= time < 6.0 else 25.0 if step == 20 else 1.0
        wrist = 8.5 if time >= 9.0 else 0.5
        noise = (step % 3 - 1) / 4
        yield (
            time,
            "/joint_states",
            {
                "name": JOINTS,
                "position": [0.5, 1.0, 0.0],
                "velocity": [0.0] * 3,
                "effort": [2.0 + noise, elbow - noise, wrist + noise],
            },
        )
