#!/usr/bin/env python3
"""Outputs of initial goals and of a latched input: each subscriber receives all outputs of each start.

rostest retalis first_outputs.test starts:=50
"""

import sys
import unittest
from pathlib import Path
from typing import Any, Dict, List

import rospy
import rostest
from std_msgs.msg import Int32, String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import ENGINE, INTERFACE, Collector, NodeProcesses  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "first_outputs"
# Each configuration sets both parameters, because the master keeps those of the previous one.
CONFIGURATIONS = {
    "direct": ((ENGINE,), ("_direct:=auto", "_embedded:=false")),  # without the interface node
    "text": ((ENGINE, INTERFACE), ("_direct:=false", "_embedded:=false")),
    "embedded": ((ENGINE,), ("_direct:=auto", "_embedded:=true")),
}


class FirstOutputs(unittest.TestCase):
    starts = 0

    def setUp(self) -> None:
        self.map_name = rospy.Publisher("map_name", String, queue_size=1, latch=True)
        self.map_name.publish("hall")
        self.outputs = {
            "ready": Collector("ready", Int32),
            "where": Collector("where", String),
            "greeting": Collector("greeting", String),
        }
        self.addCleanup(self.map_name.unregister)
        for collector in self.outputs.values():
            self.addCleanup(collector.close)

    def start_nodes(self, configuration: str) -> None:
        names, arguments = CONFIGURATIONS[configuration]
        nodes = NodeProcesses(PROGRAM, *arguments)
        self.addCleanup(nodes.end_all)
        for number in range(1, self.starts + 1):
            with self.subTest(start=number):
                for name in names:
                    nodes.start(name)
                for topic, count in (("ready", 2), ("where", 1), ("greeting", 2)):
                    self.outputs[topic].wait_for(
                        lambda messages, expected=count * number: len(messages) >= expected,
                        f"{topic} {number}",
                    )
                # The interface may still be starting, and then ends by the signal itself.
                nodes.end_all()
        received = {
            topic: [message.data for message in collector.messages]
            for topic, collector in self.outputs.items()
        }
        expected: Dict[str, List[Any]] = {"ready": [1, 2], "where": ["hall"], "greeting": ["hello"] * 2}
        self.assertEqual(received, {topic: values * self.starts for topic, values in expected.items()})

    def test_direct_topics_lose_no_output(self) -> None:
        self.start_nodes("direct")

    def test_text_topics_lose_no_output(self) -> None:
        self.start_nodes("text")

    def test_embedded_interface_loses_no_output(self) -> None:
        self.start_nodes("embedded")


if __name__ == "__main__":
    rospy.init_node("first_outputs")
    FirstOutputs.starts = int(sys.argv[1])
    rostest.rosrun("retalis", "first_outputs", FirstOutputs)
