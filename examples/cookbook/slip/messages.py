"""A gripper puts a cup down, grasps it again, and loses it."""

TOPICS = {"/joint_states": "sensor_msgs/JointState", "/gripper_command": "std_msgs/Float32"}


def messages():
    """Yield time, topic and slots of each message."""
    for time, width in ((0.5, 0.0), (3.0, 0.0625), (5.0, 0.0)):
        yield time, "/gripper_command", {"data": width}
    for step in range(90):
        time = 0.1 * step + 0.02
        holds = 1.0 <= time < 3.1 or 5.5 <= time < 7.5
        effort = (8.0, 7.5, 8.5)[step % 3] if holds else 0.25
        names = ["gripper", "elbow"]
        yield time, "/joint_states", {"name": names, "position": [0.03125, 1.5], "effort": [effort, 2.0]}
