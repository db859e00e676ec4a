#!/usr/bin/env python3
"""Starts of both nodes with latched inputs, and kills of the interface: no output is lost, no input is repeated.

rostest retalis start_orders.test starts:=50 kills:=50
"""

import signal
import sys
import unittest
from pathlib import Path
from typing import Any

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import ENGINE, INTERFACE, Collector, NodeProcesses, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "start_orders"
NODES = (ENGINE, INTERFACE)
LATCHED = {
    "map_name": String("hall"),
    "joints": JointState(),
    "health": DiagnosticArray(),
    "pose": PoseStamped(),
}


class StartOrders(unittest.TestCase):
    starts = kills = 0

    def setUp(self) -> None:
        self.nodes = NodeProcesses(PROGRAM, "_direct:=false")
        self.addCleanup(self.end_all)
        self.latched = []
        for topic, message in LATCHED.items():
            self.latched.append(rospy.Publisher(topic, message.__class__, queue_size=1, latch=True))
            self.latched[-1].publish(message)
        self.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        self.where = Collector("where", String)
        self.texts = Collector("retalisOutputEvents", String)

    def end_all(self) -> None:
        self.nodes.end_all()
        for publisher in (*self.latched, self.events):
            publisher.unregister()
        self.where.close()
        self.texts.close()

    def count_map_names(self, number: int) -> Any:
        """Let the engine publish a number; return the number of names of maps that it has received."""
        self.events.publish(f"event(say({number}))")
        begin = f"event(said({number},"
        messages = self.texts.wait_for(
            lambda messages: any(message.data.startswith(begin) for message in messages), f"{number}"
        )
        text = next(message.data for message in messages if message.data.startswith(begin))
        return text[len(begin) :].partition(")")[0]

    def received(self) -> Any:
        """Return the number of outputs that the interface has received."""
        inputs = wait_for_service(f"{INTERFACE}/list", srv.List)(0).inputs
        return next(topic.messages for topic in inputs if topic.topic == "/retalisOutputEvents")

    def expect_outputs(self, number: int) -> None:
        """Wait for outputs on the latched topic, and check that there are no others."""
        self.where.wait_for(lambda messages: len(messages) >= number, f"output {number}")
        self.assertEqual(len(self.where.messages), number)

    def test_outputs_of_each_start_are_published(self) -> None:
        for number in range(self.starts):
            with self.subTest(start=number):
                for name in NODES:
                    self.nodes.start(name)
                self.expect_outputs(number + 1)
                self.nodes.end(signal.SIGINT, *NODES)

    def test_outputs_wait_for_killed_interface(self) -> None:
        for name in NODES:
            self.nodes.start(name)
        self.expect_outputs(1)
        wait_until(lambda: self.events.get_num_connections() > 0, "node retalis")
        wait_until(lambda: ENGINE in "".join(self.texts.publishers()), "the outputs of node retalis")
        for number in range(1, self.kills + 1):
            with self.subTest(kill=number):
                self.nodes.end(signal.SIGKILL, INTERFACE)
                self.assertEqual(self.count_map_names(2 * number), "1")
                self.nodes.start(INTERFACE)
                self.assertEqual(self.count_map_names(2 * number + 1), "1")
                self.expect_outputs(number + 1)
                wait_until(lambda: self.received() >= 3, "both outputs, and the latched one", pause=0.1)
                self.assertEqual(self.received(), 3)
        self.assertEqual(self.count_map_names(1), "1")


if __name__ == "__main__":
    rospy.init_node("start_orders")
    StartOrders.starts, StartOrders.kills = map(int, sys.argv[1:3])
    rostest.rosrun("retalis", "start_orders", StartOrders)
