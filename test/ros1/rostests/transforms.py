#!/usr/bin/env python3
"""Transforms of tf2 broadcasters, static and late, and pending queries."""

import sys
import unittest
from pathlib import Path
from typing import Any, List

import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import Collector, wait_until  # noqa: E402

START = 1_700_000_000
"""Seconds; floats of seconds are 2.4e-7 s apart there."""


def stamped(parent: str, child: str, seconds: int, x: float) -> Any:
    message = TransformStamped()
    message.header.stamp = rospy.Time(int(seconds), int(seconds % 1 * 10**9))
    message.header.frame_id, message.child_frame_id = parent, child
    message.transform.translation.x = x
    message.transform.rotation.w = 1.0
    return message


class Transforms(unittest.TestCase):
    events: rospy.Publisher
    outputs: Collector
    static: Any
    moving: Any
    request_count: int

    @classmethod
    def setUpClass(cls) -> None:
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        cls.outputs = Collector("retalisOutputEvents", String)
        # One static broadcaster for all tests: it is latched and stores one message.
        cls.static = tf2_ros.StaticTransformBroadcaster()
        cls.static.sendTransform([stamped("base", "camera", 0, 100.0)])
        cls.moving = tf2_ros.TransformBroadcaster()
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        wait_until(lambda: cls.moving.pub_tf.get_num_connections() > 0, "the subscriber of /tf")
        cls.request_count = 0
        cls.moving.sendTransform([stamped("map", "odom", START, 0.0)])

    def send(self, *transforms: Any) -> None:
        self.moving.sendTransform([stamped(*transform) for transform in transforms])

    def ask(self, frame: str, seconds: Any) -> str:
        """Query the position of a frame; return the name of the answer."""
        type(self).request_count += 1
        name = f"q{self.request_count}"
        parts = int(seconds), int(seconds % 1 * 10**9)
        self.events.publish(f"event(ask({name},{frame},{parts[0]},{parts[1]}))")
        return name

    def missing(self, frame: str) -> Any:
        """Return the reason why a frame has no newest transform; transforms may not be received yet."""
        type(self).request_count += 1
        name = f"q{self.request_count}"
        self.events.publish(f"event(check_now({name},{frame}))")
        prefix = f"event(now({name},"
        (text,) = self.wait_for(prefix)
        return text[len(prefix) : text.index("),now,")]

    def wait_for(self, prefix: str) -> List[Any]:
        self.outputs.wait_for(
            lambda messages: any(message.data.startswith(prefix) for message in messages), prefix
        )
        return [message.data for message in self.outputs.messages if message.data.startswith(prefix)]

    def answer(self, name: Any) -> float:
        (text,) = self.wait_for(f"event(found({name},")
        return float(text.split(",")[1].rstrip(")"))

    def has_answer(self, name: Any) -> bool:
        return any(f"found({name}," in message.data for message in self.outputs.messages)

    def test_query_waits_for_transforms_of_all_frames(self) -> None:
        base = START + 1000
        self.send(("map", "odom", base, 1.0), ("odom", "base", base, 10.0))
        name = self.ask("camera", base + 0.5)
        self.send(("map", "odom", base + 1, 2.0))
        wait_until(lambda: self.missing("camera") == "none", "the first transforms", pause=0.1)
        self.assertFalse(self.has_answer(name))
        self.send(("odom", "base", base + 1, 20.0))
        self.assertAlmostEqual(self.answer(name), 116.5, 9)

    def test_query_waits_for_static_transform(self) -> None:
        base = START + 4000
        name = self.ask("lens", base)
        self.send(("map", "stand", base, 7.0))
        self.static.sendTransform([stamped("stand", "lens", 0, 0.5)])
        self.assertAlmostEqual(self.answer(name), 7.5, 9)


if __name__ == "__main__":
    rospy.init_node("transforms")
    rostest.rosrun("retalis", "transforms", Transforms)
