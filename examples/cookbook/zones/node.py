#!/usr/bin/env python3
"""The recipe as a rospy node: the zone of the last pose, and a message at each change."""

import rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

ZONES = {"hall": (-1, 4, 0, 5), "kitchen": (4, 8, 0, 5)}


class Zones:
    """Reports when the robot has moved from one zone into another."""

    def __init__(self):
        self._inside = "nowhere"
        self._zone = rospy.Publisher("zone", String, queue_size=10, latch=True)
        rospy.Subscriber("pose", PoseStamped, self._on_pose)

    def _on_pose(self, message):
        place = message.pose.position
        found = next((name for name, box in ZONES.items() if contains(box, place)), "nowhere")
        if found != self._inside:
            self._zone.publish(String(f"{self._inside} -> {found}"))
            self._inside = found


def contains(box, place):
    x1, x2, y1, y2 = box
    return x1 <= place.x < x2 and y1 <= place.y < y2


if __name__ == "__main__":
    rospy.init_node("zones")
    Zones()
    rospy.spin()
