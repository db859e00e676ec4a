"""Publish events for node retalis, as another node does: ``event_publisher.py EVENT...``.

`rostopic pub -1` stays for three seconds after each message; this program ends when the messages have been sent.
"""

import sys
import time
from typing import Any

import rospy
from std_msgs.msg import String

TOPIC = "/retalisInputEvents"
CONNECTION_TIMEOUT_SECONDS = 60.0


def main(events: Any) -> None:
    rospy.init_node("event_publisher", anonymous=True)
    # Without a queue, `publish` returns after the message has been sent.
    publisher = rospy.Publisher(TOPIC, String, queue_size=None)
    end = time.monotonic() + CONNECTION_TIMEOUT_SECONDS
    while not publisher.get_num_connections():
        if time.monotonic() > end:
            sys.exit(f"event_publisher.py: nobody subscribes to {TOPIC}")
        time.sleep(0.01)
    for event in events:
        publisher.publish(f"event({event})")


main(rospy.myargv()[1:])
