"""An operator confirms, answers late, declines, confirms without a question, and changes the answer."""

TOPICS = {"/operator": "std_msgs/String"}


def messages():
    """Yield time, topic and slots of each message."""
    said = "1 shut down|2 yes|10 open the gripper|18 yes|20 shut down|21 no|22 yes|30 shut down"
    said += "|32 open the gripper|33 yes|34 yes|40 hello|41 yes"
    for part in said.split("|"):
        second, _, text = part.partition(" ")
        yield float(second), "/operator", {"data": text}
