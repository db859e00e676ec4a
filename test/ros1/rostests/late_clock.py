#!/usr/bin/env python3
"""Bags with the same stamps, with ``/clock`` later or earlier than messages: their poses are not mixed."""

import sys
import tempfile
import time
import unittest
from pathlib import Path
from typing import Any, List

import rospy
import rostest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[3] / "examples" / "nao"))
from harness import DEFINITIONS, Collector, RawPublisher, wait_for_message_path, wait_for_service, wait_until  # noqa: E402
from make_bag import make_bag  # noqa: E402

from retalis import (  # noqa: E402
    BagReader,
    Playback,
    srv,  # noqa: E402
)

PROGRAM = Path(__file__).resolve().parents[3] / "application_source"
MARKERS = [f"marker{number}" for number in range(1, 9)]
BAG_SECONDS = 4.0
SPEED = 2.0
LATE_SECONDS = 0.4
"""Seconds of a bag that are sent before the clock goes back to its start."""

LATE_MESSAGES = 40
"""Number of messages of the previous epoch that are received after its end."""


class LateClock(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.bags = []
        for seed in (3, 4):
            path = Path(folder.name) / f"{seed}.bag"
            make_bag(path, seconds=BAG_SECONDS, seed=seed)
            with BagReader(path) as bag:
                types = {topic.name: (topic.type, topic.definition) for topic in bag.topics}
                records = [(record.time, record.topic.name, record.data) for record in bag.records()]
                outputs = [
                    (output.topic, output.data) for output in Playback(PROGRAM, report=self.fail).run(bag)
                ]
                self.bags.append((records, sorted(output for output in outputs if output[0] in MARKERS)))
        self.clock = rospy.Publisher("/clock", Clock, queue_size=10)
        self.markers = {name: Collector(name, rospy.AnyMsg) for name in MARKERS}
        self.publishers = {
            name: RawPublisher(name, DEFINITIONS.add(*message_type)) for name, message_type in types.items()
        }
        wait_until(
            lambda: all(publisher.is_connected() for publisher in self.publishers.values()), "the subscribers"
        )
        wait_until(
            lambda: all(collector.is_connected() for collector in self.markers.values()),
            "the publishers of the markers",
        )
        wait_for_message_path()
        added = wait_for_service("add_memory", srv.AddMemory)(
            "std_msgs__0__String('\"probe\"')", "", "_", "probes", "1"
        )
        self.assertEqual(added.result, "ok")
        self.query = wait_for_service("retalis/query", srv.Query)
        self.probe = rospy.Publisher("probe", String, queue_size=10)

    def test_poses_are_those_of_each_run(self) -> None:
        (first, first_poses), (second, second_poses) = self.bags
        self.assertNotEqual(first_poses, second_poses)
        self.tick(first[0][0])
        self.play(first)
        self.expect(first_poses)
        early = self.count_until(second, LATE_SECONDS)  # the clock is late
        self.send(second[:early])
        self.play(second[early:])
        self.expect(second_poses)
        self.tick(first[0][0])  # the messages are late
        wait_until(self.is_clock_received, "time to go back")
        self.send(second[-LATE_MESSAGES:])
        self.play(first)
        self.expect(first_poses)

    def tick(self, instant: Any) -> None:
        self.now = instant
        self.clock.publish(Clock(rospy.Time(*divmod(instant, 10**9))))

    def is_clock_received(self) -> bool:
        """Return whether all nodes that process messages have the time, which stamps messages without header."""
        self.probe.publish("probe")
        response = self.query(
            srv.QueryRequest(goal=f"access_mem(probes, _, [_, T]), T < {self.now / 1e9 + 1}")
        )
        self.assertEqual(response.result, "ok")
        return bool(response.solutions)

    @staticmethod
    def count_until(records: Any, seconds: Any) -> Any:
        """Return the number of messages in the first seconds of a bag."""
        return sum(record[0] < records[0][0] + seconds * 1e9 for record in records)

    def play(self, records: Any) -> None:
        """Publish messages at their times, as ``rosbag play --clock`` does."""
        began = time.monotonic()
        for instant, topic, data in records:
            wait = (instant - records[0][0]) / 1e9 / SPEED - (time.monotonic() - began)
            if wait > 0:
                time.sleep(wait)
            if abs(instant - self.now) > 10_000_000:
                self.tick(instant)
            self.publishers[topic].publish(data)

    def send(self, records: Any) -> None:
        """Publish messages at once, because the clock must follow the first one within a second."""
        for _, topic, data in records:
            self.publishers[topic].publish(data)

    def expect(self, poses: Any) -> None:
        """Wait for poses, and check that there are no others."""

        def received_poses() -> List[Any]:
            return sorted(
                (name, message._buff)
                for name, collector in self.markers.items()
                for message in collector.messages
            )

        self.assertGreater(len(poses), 0)
        wait_until(lambda: len(received_poses()) >= len(poses), f"{len(poses)} poses")
        self.assertEqual(received_poses(), poses)
        for collector in self.markers.values():
            collector.messages.clear()


if __name__ == "__main__":
    rospy.init_node("late_clock", disable_rostime=True)
    rostest.rosrun("retalis", "late_clock", LateClock)
