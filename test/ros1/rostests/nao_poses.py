#!/usr/bin/env python3
"""Playback of the NAO bag to nodes: the poses are those of the engine without ROS."""

import sys
import tempfile
import time
import unittest
from pathlib import Path
from typing import Any, List

import rospy
import rostest
from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[3] / "examples" / "nao"))
from harness import DEFINITIONS, Collector, RawPublisher, wait_for_message_path, wait_until  # noqa: E402
from make_bag import make_bag  # noqa: E402

from retalis import BagReader  # noqa: E402

SPEED = 2.0
"""Speed of the playback, as a multiple of the recorded speed."""


class NaoPoses(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.bag = Path(folder.name) / "nao.bag"
        self.truth = make_bag(self.bag, seconds=5.0, seed=3)

    def test_poses_equal_those_of_truth(self) -> None:
        clock = rospy.Publisher("/clock", Clock, queue_size=10)
        markers = [Collector(f"marker{i}", PoseStamped) for i in range(1, 9)]
        with BagReader(self.bag) as bag:
            publishers = {
                topic.name: RawPublisher(topic.name, DEFINITIONS.add(topic.type, topic.definition))
                for topic in bag.topics
            }
            wait_until(
                lambda: all(publisher.is_connected() for publisher in publishers.values()),
                "subscribers of the bag's topics",
            )
            wait_until(
                lambda: all(collector.is_connected() for collector in markers), "publishers of the markers"
            )
            wait_for_message_path()
            self.play(bag, publishers, clock)
        expected = sorted((view.marker, view.stamp) for view in self.truth.complete)
        self.assertGreater(len(expected), 0)
        wait_until(
            lambda: sum(len(collector.messages) for collector in markers) >= len(expected),
            f"{len(expected)} poses",
        )
        poses: List[Any] = []
        for number, collector in enumerate(markers, 1):
            for pose in collector.messages:
                name = pose.header.frame_id
                self.assertEqual(name, f"4x4_{number}")
                poses.append((name, pose.header.stamp.to_nsec()))
                position = pose.pose.position
                true = self.truth.markers[name][0]
                error = sum((a - b) ** 2 for a, b in zip((position.x, position.y, position.z), true)) ** 0.5
                self.assertLess(error, 0.02)
        self.assertEqual(sorted(poses), expected)

    def play(self, bag: Any, publishers: Any, clock: Any) -> None:
        """Publish the bag's messages at their times, as ``rosbag play --clock`` does."""
        began, last = time.monotonic(), 0
        for record in bag.records():
            wait = (record.time - bag.start) / 1e9 / SPEED - (time.monotonic() - began)
            if wait > 0:
                time.sleep(wait)
            if record.time - last > 10_000_000:
                last = record.time
                clock.publish(Clock(rospy.Time(*divmod(record.time, 10**9))))
            publishers[record.topic.name].publish(record.data)


if __name__ == "__main__":
    rospy.init_node("nao_poses")
    rostest.rosrun("retalis", "nao_poses", NaoPoses)
