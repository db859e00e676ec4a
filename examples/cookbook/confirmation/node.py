#!/usr/bin/env python3
"""The recipe as a rospy node: the command that waits for a confirmation, and its time."""

import rospy
from std_msgs.msg import String

RISKY = {"shut down", "open the gripper"}


class Confirmation:
    """Executes a risky command when the operator says yes within five seconds."""

    def __init__(self):
        self._asked = None
        self._execute = rospy.Publisher("execute", String, queue_size=10)
        rospy.Subscriber("operator", String, self._on_words)

    def _on_words(self, message):
        now = rospy.Time.now()
        if message.data in RISKY:
            self._asked = (now, message.data)
        elif message.data == "no":
            self._asked = None
        elif message.data == "yes" and self._asked is not None:
            time, command = self._asked
            self._asked = None
            if now - time < rospy.Duration(5):
                self._execute.publish(String(command))


if __name__ == "__main__":
    rospy.init_node("confirmation")
    Confirmation()
    rospy.spin()
