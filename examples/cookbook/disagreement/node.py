#!/usr/bin/env python3
"""The recipe as a rospy node: the newest reading of each side, and the times of differences."""

from collections import deque

import rospy
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float32


class Disagreement:
    """Reports when two thermometers have differed three times in five seconds."""

    def __init__(self):
        self._newest = {}
        self._differed = deque(maxlen=3)
        self._told = None
        self._disagreement = rospy.Publisher("disagreement", Float32, queue_size=10)
        rospy.Subscriber("temperature", Temperature, self._on_temperature)

    def _on_temperature(self, message):
        side, now = message.header.frame_id, message.header.stamp
        other = self._newest.pop("right" if side == "left" else "left", None)
        if other is None or abs(now - other[0]) >= rospy.Duration(0.5):
            self._newest[side] = (now, message.temperature)
            return
        difference = abs(message.temperature - other[1])
        if difference > 3:
            self._differed.append(other[0])
            if len(self._differed) == 3 and now - self._differed[0] < rospy.Duration(5):
                self._tell(now, difference)

    def _tell(self, now, difference):
        if self._told is None or now - self._told >= rospy.Duration(10):
            self._told = now
            self._disagreement.publish(Float32(difference))


if __name__ == "__main__":
    rospy.init_node("disagreement")
    Disagreement()
    rospy.spin()
