"""Program that sends texts on topic ``in`` until one returns on topic ``out``, then calls a service of each node."""

import sys

import rospy
from harness import Collector, service, wait_until
from std_msgs.msg import String

from retalis import srv

rospy.init_node("probe", anonymous=True, disable_signals=True)
text = sys.argv[1]
sent = rospy.Publisher("in", String, queue_size=10)
back = Collector("out", String)


def answered():
    sent.publish(text)
    return any(message.data == text for message in back.messages)


wait_until(answered, "the way through the nodes")
add = service("add_memory", srv.AddMemory)
assert add("x(Y)", "", "_", f"memory_{text}", "1").result == "ok"
subscribe = service("add_input_subscription", srv.AddInputSubscription)
assert subscribe(f"topic_{text}", "std_msgs/String").result == "ok"
