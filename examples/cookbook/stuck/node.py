#!/usr/bin/env python3
"""The recipe as a rospy node: the begin of the drive, and the last position."""

import threading
from collections import deque
from math import hypot

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32

WAIT = rospy.Duration(3.0)


class Stuck:
    """Says that the robot is told to drive and does not move."""

    def __init__(self):
        self._lock = threading.Lock()
        self._since = None
        self._places = deque(maxlen=200)
        self._stuck = rospy.Publisher("stuck", Float32, queue_size=10)
        rospy.Subscriber("cmd_vel", Twist, self._on_command)
        rospy.Subscriber("odom", Odometry, self._on_odometry)

    def _on_command(self, message):
        with self._lock:
            if abs(message.linear.x) <= 0.05:
                self._since = None
            elif self._since is None:
                self._since = rospy.Time.now()

    def _on_odometry(self, message):
        now, place = message.header.stamp, message.pose.pose.position
        with self._lock:
            self._places.append((now, place))
            if self._since is None or now - self._since < WAIT:
                return
            before = [old for stamp, old in self._places if stamp <= now - WAIT]
            moved = hypot(place.x - before[-1].x, place.y - before[-1].y) if before else 1.0
            if moved >= 0.04:
                return
            self._since = now
        self._stuck.publish(Float32(moved))


if __name__ == "__main__":
    rospy.init_node("stuck")
    Stuck()
    rospy.spin()
