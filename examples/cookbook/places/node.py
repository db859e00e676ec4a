#!/usr/bin/env python3
"""The recipe as a rospy node: the buffer of tf2, which is polled for each pending sighting."""

import threading
from collections import deque
from math import hypot

import rospy
import tf2_geometry_msgs
import tf2_ros
from geometry_msgs.msg import PoseStamped, TransformStamped
from std_msgs.msg import String

PLACES = {"table": (2, 1), "shelf": (-1, 3)}


class Places:
    """Reports the place of each sighting."""

    def __init__(self):
        self._lock = threading.Lock()
        self._waiting = deque(maxlen=1000)
        self._buffer = tf2_ros.Buffer(rospy.Duration(60))
        self._listener = tf2_ros.TransformListener(self._buffer)
        self._placed = rospy.Publisher("placed", String, queue_size=10)
        rospy.Subscriber("objects", TransformStamped, self._on_object)
        rospy.Timer(rospy.Duration(0.05), self._on_time)

    def _on_object(self, message):
        with self._lock:
            self._waiting.append(message)

    def _on_time(self, event):
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        for message in waiting:
            try:
                found = self._buffer.lookup_transform("map", message.header.frame_id, message.header.stamp)
            except tf2_ros.ExtrapolationException:  # too early; or too late, and then it waits for ever
                with self._lock:
                    self._waiting.append(message)
            except tf2_ros.TransformException as error:
                rospy.logwarn_throttle(5, str(error))
            else:
                self._say(message, found)

    def _say(self, message, camera):
        seen = PoseStamped(header=message.header)
        seen.pose.position = message.transform.translation
        seen.pose.orientation = message.transform.rotation
        place = tf2_geometry_msgs.do_transform_pose(seen, camera).pose.position
        distance, name = min((hypot(place.x - x, place.y - y), name) for name, (x, y) in PLACES.items())
        self._placed.publish(String(f"{message.child_frame_id} at {name if distance < 1 else 'no place'}"))


if __name__ == "__main__":
    rospy.init_node("places")
    Places()
    rospy.spin()
