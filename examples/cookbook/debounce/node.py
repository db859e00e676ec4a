#!/usr/bin/env python3
"""The recipe as a rospy node: a timer that each change of the contact stops or restarts."""

import threading

import rospy
from std_msgs.msg import Bool, Empty


class Debounce:
    """Publishes a press when the contact has been closed for 50 ms."""

    def __init__(self):
        self._lock = threading.Lock()
        self._timer = None
        self._pressed = rospy.Publisher("pressed", Empty, queue_size=10)
        rospy.Subscriber("button", Bool, self._on_button)

    def _on_button(self, message):
        with self._lock:
            if self._timer is not None:
                self._timer.shutdown()
                self._timer = None
            if message.data:
                self._timer = rospy.Timer(rospy.Duration(0.05), self._on_time, oneshot=True)

    def _on_time(self, event):
        with self._lock:
            if self._timer is None:  # the contact opened while this call was on its way
                return
            self._timer = None
        self._pressed.publish(Empty())


if __name__ == "__main__":
    rospy.init_node("debounce")
    Debounce()
    rospy.spin()
