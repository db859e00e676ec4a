#!/usr/bin/env python3
"""The recipe as a rospy node: a count of misses, and a timer for the next try."""

import threading

import rospy
from std_msgs.msg import String


class Docking:
    """Retries a failed docking twice, and then reports the failure."""

    def __init__(self):
        self._lock = threading.Lock()
        self._misses = 0
        self._command = rospy.Publisher("dock_command", String, queue_size=10)
        rospy.Subscriber("dock_result", String, self._on_result)

    def _on_result(self, message):
        with self._lock:
            misses = self._misses + 1 if message.data == "missed" else 0
            self._misses = misses % 3
        if misses == 3:
            self._command.publish(String("call somebody"))
        elif misses:
            wait = rospy.Duration(2 * misses)
            rospy.Timer(wait, lambda event: self._on_time(misses), oneshot=True)

    def _on_time(self, misses):
        with self._lock:
            if misses != self._misses:
                return
        self._command.publish(String("again"))


if __name__ == "__main__":
    rospy.init_node("docking")
    Docking()
    rospy.spin()
