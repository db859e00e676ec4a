#!/usr/bin/env python3
"""The recipe as a rospy node: the number of consecutive good or bad readings."""

import rospy
from sensor_msgs.msg import Range
from std_msgs.msg import Bool


class DropOut:
    """Reports when three readings in a row are bad, and when three are good again."""

    def __init__(self):
        self._healthy = True
        self._against = 0
        self._valid = rospy.Publisher("distance_valid", Bool, queue_size=10, latch=True)
        rospy.Subscriber("distance", Range, self._on_range)

    def _on_range(self, message):
        good = message.min_range <= message.range <= message.max_range
        self._against = 0 if good == self._healthy else self._against + 1
        if self._against == 3:
            self._healthy, self._against = good, 0
            self._valid.publish(Bool(good))


if __name__ == "__main__":
    rospy.init_node("drop_out")
    DropOut()
    rospy.spin()
