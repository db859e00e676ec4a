#!/usr/bin/env python3
"""The recipe as a rospy node: a structured array of the points, and the state of each zone."""

import numpy
import rospy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

ZONES = {"door": ((1.5, -0.5, 0.25), (2.5, 0.5, 2.0)), "shelf": ((-0.5, 1.0, 0.25), (1.0, 2.0, 2.0))}


class CloudZone:
    """Reports when a zone is occupied, and free again. It reads clouds of little-endian float32 in one row."""

    def __init__(self):
        self._states = {}
        self._zone = rospy.Publisher("zone", String, queue_size=10, latch=True)
        rospy.Subscriber("points", PointCloud2, self._on_cloud)

    def _on_cloud(self, message):
        offsets = {field.name: field.offset for field in message.fields}
        layout = numpy.dtype(
            {
                "names": list("xyz"),
                "formats": ["<f4"] * 3,
                "offsets": [offsets[name] for name in "xyz"],
                "itemsize": message.point_step,
            }
        )
        points = numpy.frombuffer(bytes(message.data), layout)
        points = numpy.stack([points[name].astype(float) for name in "xyz"], axis=1)
        for zone, (low, high) in ZONES.items():
            count = ((points >= low) & (points <= high)).all(axis=1).sum()
            if 2 < count < 10:
                continue
            state = "taken" if count >= 10 else "free"
            if self._states.get(zone) != state:
                self._states[zone] = state
                self._zone.publish(String(f"{zone} {state}"))


if __name__ == "__main__":
    rospy.init_node("cloud_zone")
    CloudZone()
    rospy.spin()
