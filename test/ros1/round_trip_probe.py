"""Program that sends texts on topic ``in`` until one returns on topic ``out``, then calls a service of each node."""

import sys

import rospy
from harness import Collector, wait_for_service, wait_until
from std_msgs.msg import String

from retalis import srv

rospy.init_node("probe", anonymous=True, disable_signals=True)
text = sys.argv[1]
publisher = rospy.Publisher("in", String, queue_size=10)
outputs = Collector("out", String)


def is_returned() -> bool:
    publisher.publish(text)
    return any(message.data == text for message in outputs.messages)


wait_until(is_returned, "the path through the nodes")
add = wait_for_service("add_memory", srv.AddMemory)
assert add("x(Y)", "", "_", f"memory_{text}", "1").result == "ok"
subscribe = wait_for_service("add_input_subscription", srv.AddInputSubscription)
assert subscribe(f"topic_{text}", "std_msgs/String").result == "ok"
