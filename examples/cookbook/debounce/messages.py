"""A button whose contacts bounce, a spike on its wire, and a press that is held."""

TOPICS = {"/button": "std_msgs/Bool"}


def messages():
    """Yield time, topic and slots of each message."""
    bouncing = [(1.000, True), (1.004, False), (1.009, True), (1.013, False), (1.021, True)]
    let_go = [(1.600, False), (1.606, True), (1.611, False)]
    spike = [(2.500, True), (2.502, False)]
    held = [(3.200, True), (3.205, False), (3.211, True), (4.900, False)]
    for time, down in bouncing + let_go + spike + held:
        yield time, "/button", {"data": down}
