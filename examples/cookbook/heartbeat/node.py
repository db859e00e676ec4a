#!/usr/bin/env python3
"""The recipe as a rospy node: a timer that each heartbeat restarts, and whether the base is alive."""

import threading

import rospy
from std_msgs.msg import Bool, Empty


class Heartbeat:
    """Reports when the base has been silent for a second, and when it is back."""

    def __init__(self):
        self._lock = threading.Lock()
        self._timer = None
        self._beats = 0
        self._lost = False
        self._alive = rospy.Publisher("base_alive", Bool, queue_size=10, latch=True)
        rospy.Subscriber("heartbeat", Empty, self._on_beat)

    def _on_beat(self, message):
        with self._lock:
            if self._timer is not None:
                self._timer.shutdown()
            self._beats += 1
            beats = self._beats
            self._timer = rospy.Timer(
                rospy.Duration(1.0), lambda event: self._on_silence(beats), oneshot=True
            )
            was_lost, self._lost = self._lost, False
        if was_lost:
            self._alive.publish(Bool(True))

    def _on_silence(self, beats):
        with self._lock:
            if beats != self._beats:
                return
            self._lost = True
        self._alive.publish(Bool(False))


if __name__ == "__main__":
    rospy.init_node("heartbeat")
    Heartbeat()
    rospy.spin()
