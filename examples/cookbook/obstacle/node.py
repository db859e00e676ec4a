#!/usr/bin/env python3
"""The recipe as a rospy node: the nearest reading ahead, and two limits."""

import numpy
import rospy
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool


class Obstacle:
    """Reports when an obstacle is near ahead, and when it is far again."""

    def __init__(self):
        self._near = None
        self._obstacle = rospy.Publisher("obstacle", Bool, queue_size=10, latch=True)
        rospy.Subscriber("scan", LaserScan, self._on_scan)

    def _on_scan(self, message):
        angles = message.angle_min + message.angle_increment * numpy.arange(len(message.ranges))
        ahead = numpy.asarray(message.ranges)[numpy.abs(angles) <= 0.25]
        valid = ahead[(ahead >= message.range_min) & (ahead <= message.range_max)]
        distance = min(valid, default=message.range_max)
        if 0.5 <= distance <= 0.75:
            return
        near = bool(distance < 0.5)
        if near != self._near:
            self._near = near
            self._obstacle.publish(Bool(near))


if __name__ == "__main__":
    rospy.init_node("obstacle")
    Obstacle()
    rospy.spin()
