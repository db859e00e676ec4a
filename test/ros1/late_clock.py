#!/usr/bin/env python3
"""Bags with the same stamps, while ``/clock`` and messages overtake each other: their poses are not mixed."""

import sys
import tempfile
import time
import unittest
from pathlib import Path

import rospy
import rostest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / "nao"))
from harness import DEFINITIONS, Collector, RawPublisher, wait_for_message_path, wait_for_service, wait_until  # noqa: E402
from make_bag import make_bag  # noqa: E402

from retalis import (  # noqa: E402
    BagReader,
    Playback,
    srv,  # noqa: E402
)

PROGRAM = Path(__file__).resolve().parents[2] / "application_source"
MARKERS = [f"marker{number}" for number in range(1, 9)]
SECONDS = 4.0
SPEED = 2.0
LATE = 0.4
"""Seconds of a bag that are sent before the clock goes back to its start."""

LEFT_OVER = 40
"""Messages of the run before that come after it."""


class LateClock(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.bags = []
        for seed in (3, 4):
            path = Path(folder.name) / f"{seed}.bag"
            make_bag(path, seconds=SECONDS, seed=seed)
            with BagReader(path) as bag:
                kinds = {topic.name: (topic.type, topic.definition) for topic in bag.topics}
                records = [(one.time, one.topic.name, one.data) for one in bag.records()]
                wanted = [(one.topic, one.data) for one in Playback(PROGRAM, report=self.fail).run(bag)]
                self.bags.append((records, sorted(one for one in wanted if one[0] in MARKERS)))
        self.clock = rospy.Publisher("/clock", Clock, queue_size=10)
        self.markers = {name: Collector(name, rospy.AnyMsg) for name in MARKERS}
        self.publishers = {name: RawPublisher(name, DEFINITIONS.add(*kind)) for name, kind in kinds.items()}
        wait_until(lambda: all(one.is_connected() for one in self.publishers.values()), "the subscribers")
        wait_until(
            lambda: all(one.is_connected() for one in self.markers.values()), "the publishers of the markers"
        )
        wait_for_message_path()
        added = wait_for_service("add_memory", srv.AddMemory)(
            "std_msgs__0__String('\"probe\"')", "", "_", "probes", "1"
        )
        self.assertEqual(added.result, "ok")
        self.query = wait_for_service("retalis/query", srv.Query)
        self.probe = rospy.Publisher("probe", String, queue_size=10)

    def test_poses_are_those_of_each_run(self):
        (first, first_poses), (second, second_poses) = self.bags
        self.assertNotEqual(first_poses, second_poses)
        self.tick(first[0][0])
        self.play(first)
        self.expect(first_poses)
        early = self.until(second, LATE)  # the clock comes late
        self.send(second[:early])
        self.play(second[early:])
        self.expect(second_poses)
        self.tick(first[0][0])  # the messages come late
        wait_until(self.clock_is_heard, "time to go back")
        self.send(second[-LEFT_OVER:])
        self.play(first)
        self.expect(first_poses)

    def tick(self, instant):
        self.now = instant
        self.clock.publish(Clock(rospy.Time(*divmod(instant, 10**9))))

    def clock_is_heard(self):
        """Tell whether all nodes on the way of messages have the time: what has no stamp is stamped by it."""
        self.probe.publish("probe")
        found = self.query(srv.QueryRequest(goal=f"access_mem(probes, _, [_, T]), T < {self.now / 1e9 + 1}"))
        self.assertEqual(found.result, "ok")
        return bool(found.solutions)

    @staticmethod
    def until(records, seconds):
        """Return how many messages a bag has up to a time."""
        return sum(one[0] < records[0][0] + seconds * 1e9 for one in records)

    def play(self, records):
        """Publish messages at their times, as ``rosbag play --clock`` does."""
        began = time.monotonic()
        for instant, topic, data in records:
            wait = (instant - records[0][0]) / 1e9 / SPEED - (time.monotonic() - began)
            if wait > 0:
                time.sleep(wait)
            if abs(instant - self.now) > 10_000_000:
                self.tick(instant)
            self.publishers[topic].publish(data)

    def send(self, records):
        """Publish messages at once: the clock must not come more than a second later than the first of them."""
        for _, topic, data in records:
            self.publishers[topic].publish(data)

    def expect(self, poses):
        """Wait for poses, and see that these are all."""

        def found():
            return sorted((name, one._buff) for name, all_ in self.markers.items() for one in all_.messages)

        wait_until(lambda: len(found()) >= len(poses), f"{len(poses)} poses")
        self.assertEqual(found(), poses)
        for one in self.markers.values():
            one.messages.clear()


if __name__ == "__main__":
    rospy.init_node("late_clock", disable_rostime=True)
    rostest.rosrun("retalis", "late_clock", LateClock)
