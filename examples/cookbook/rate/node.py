#!/usr/bin/env python3
"""The recipe as a rospy node: the stamps of the last eleven frames, and whether they were slow."""

from collections import deque

import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import String


class Rate:
    """Reports when the camera has become slower than 8 Hz, and when it is above 9 Hz again."""

    def __init__(self):
        self._stamps = deque(maxlen=11)
        self._slow = False
        self._rate = rospy.Publisher("camera_rate", String, queue_size=10)
        rospy.Subscriber("camera", Image, self._on_frame)

    def _on_frame(self, message):
        self._stamps.append(message.header.stamp.to_sec())
        if len(self._stamps) < 11:
            return
        rate = 10 / (self._stamps[-1] - self._stamps[0])
        if rate > 9 if self._slow else rate < 8:
            self._slow = not self._slow
            self._rate.publish(String(f"{rate:.1f} Hz"))


if __name__ == "__main__":
    rospy.init_node("rate")
    Rate()
    rospy.spin()
