#!/usr/bin/env python3
"""The recipe as a rospy node: the detections of each sensor without a counterpart of the other."""

import threading

import rospy
from sensor_msgs.msg import Range
from std_msgs.msg import Float32

WITHIN = rospy.Duration(2.0)


class TwoSensors:
    """Pairs a near echo and a loud noise that are less than two seconds apart."""

    def __init__(self):
        self._lock = threading.Lock()
        self._near = []
        self._loud = []
        self._visitor = rospy.Publisher("visitor", Float32, queue_size=10)
        rospy.Subscriber("sonar", Range, self._on_range)
        rospy.Subscriber("loudness", Float32, self._on_loudness)

    def _on_range(self, message):
        if message.range < 1.0:
            self._pair(self._near, self._loud, message.header.stamp, message.range)

    def _on_loudness(self, message):
        if message.data > 0.5:
            self._pair(self._loud, self._near, rospy.Time.now(), message.data)

    def _pair(self, own, others, time, value):
        with self._lock:
            others[:] = [other for other in others if abs(time - other[0]) < WITHIN]
            if not others:
                own.append((time, value))
                return
            _, other = others.pop()
        self._visitor.publish(Float32(value if own is self._near else other))


if __name__ == "__main__":
    rospy.init_node("two_sensors")
    TwoSensors()
    rospy.spin()
