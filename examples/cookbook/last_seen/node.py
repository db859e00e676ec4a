#!/usr/bin/env python3
"""The recipe as a rospy node: a table of the last sightings."""

import threading

import rospy
from geometry_msgs.msg import Point, PointStamped, TransformStamped
from std_msgs.msg import String


class LastSeen:
    """Answers with the place where a thing was last seen."""

    def __init__(self):
        self._lock = threading.Lock()
        self._sightings = {}
        self._last_seen = rospy.Publisher("last_seen", PointStamped, queue_size=10)
        self._never_seen = rospy.Publisher("never_seen", String, queue_size=10)
        rospy.Subscriber("objects", TransformStamped, self._on_object)
        rospy.Subscriber("where_is", String, self._on_question)

    def _on_object(self, message):
        if message.header.frame_id == "map":
            with self._lock:
                self._sightings[message.child_frame_id] = message

    def _on_question(self, message):
        with self._lock:
            found = self._sightings.get(message.data)
        if found is None:
            self._never_seen.publish(String(message.data))
            return
        place = found.transform.translation
        answer = PointStamped(point=Point(place.x, place.y, place.z))
        answer.header.stamp, answer.header.frame_id = found.header.stamp, "map"
        self._last_seen.publish(answer)


if __name__ == "__main__":
    rospy.init_node("last_seen")
    LastSeen()
    rospy.spin()
