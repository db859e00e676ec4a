#!/usr/bin/env python3
"""The recipe as a rospy node: the last place of each robot, and the pairs that are together."""

from math import hypot

import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import String

SAME_TIME = rospy.Duration(0.19)


class Meeting:
    """Reports when two robots meet, and when they leave each other."""

    def __init__(self):
        self._places = {}
        self._together = set()
        self._meeting = rospy.Publisher("meeting", String, queue_size=10)
        rospy.Subscriber("odometry", Odometry, self._on_odometry)

    def _on_odometry(self, message):
        if message.header.frame_id != "map":
            return
        name, now, place = message.child_frame_id, message.header.stamp, message.pose.pose.position
        self._places[name] = (now, place)
        for other, (time, there) in self._places.items():
            if other != name and abs(now - time) < SAME_TIME:
                self._look(*sorted((name, other)), hypot(place.x - there.x, place.y - there.y))

    def _look(self, first, second, distance):
        pair = (first, second)
        if distance < 1 and pair not in self._together:
            self._together.add(pair)
            self._meeting.publish(String(f"{first} meets {second}"))
        elif distance > 1.5 and pair in self._together:
            self._together.remove(pair)
            self._meeting.publish(String(f"{first} leaves {second}"))


if __name__ == "__main__":
    rospy.init_node("meeting")
    Meeting()
    rospy.spin()
