#!/usr/bin/env python3
"""Status of a node: service ~list, and /diagnostics while simulated time stands still."""

import sys
import unittest
from pathlib import Path
from typing import Any, Dict, List

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64, String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import Collector, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402


class Status(unittest.TestCase):
    embedded: Any
    interface: Any
    list: Any
    list_interface: Any
    add_rule: Any
    add_memory: Any
    add_subscription: Any
    add_input: Any
    diagnostics: Collector
    events: rospy.Publisher

    @classmethod
    def setUpClass(cls) -> None:
        cls.embedded = rospy.get_param("retalis/embedded")
        cls.interface = "retalis" if cls.embedded else "retalis_ros_interface"
        cls.list = staticmethod(wait_for_service("retalis/list", srv.List))
        cls.list_interface = staticmethod(wait_for_service(f"{cls.interface}/list", srv.List))
        cls.add_rule = staticmethod(wait_for_service("retalis/add_rule", srv.AddRule))
        cls.add_memory = staticmethod(wait_for_service("add_memory", srv.AddMemory))
        cls.add_subscription = staticmethod(
            wait_for_service("add_output_subscription", srv.AddOutputSubscription)
        )
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        cls.diagnostics = Collector("/diagnostics", DiagnosticArray)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        wait_until(lambda: cls.events.get_num_connections() > 0, "node retalis")

    def wait_for_status(self, name: str, condition: Any = lambda status: True) -> Any:
        """Return the newest status with a name for which a condition holds."""
        statuses: List[Any] = []

        def is_received(messages: Any) -> bool:
            statuses[:] = [
                status
                for message in messages[-20:]
                for status in message.status
                if status.name == name and condition(status)
            ]
            return bool(statuses)

        self.diagnostics.wait_for(is_received, name)
        return statuses[-1]

    def values(self, status: Any) -> Dict[Any, Any]:
        return {pair.key: pair.value for pair in status.values}

    def test_list_has_entries_with_counters(self) -> None:
        self.assertEqual(self.add_rule(rule="counted: hot(X) <- heat(X) where X > 1").result, "ok")
        self.assertEqual(self.add_memory("hot(_)", "", "_", "hot_ones", "2").result, "ok")
        self.assertEqual(self.add_subscription("hot(X)", "", "_", "hot", "h").result, "ok")
        for number in range(5):
            self.events.publish(String(f"event(heat({number}), [10.0, 10.5])"))

        def memory() -> Any:
            return next(memory for memory in self.list(10).memories if memory.id == "hot_ones")

        wait_until(lambda: memory().added == 3, "the events")
        response = self.list(0)
        self.assertEqual(response.result, "ok")
        rule = next(rule for rule in response.rules if rule.label == "counted")
        self.assertEqual((rule.fired, rule.errors, rule.last_fired.to_sec()), (3, 0, 10.5))
        self.assertIn("hot(X)", rule.text)
        self.assertEqual((memory().size, memory().records, memory().oldest.to_sec()), (2, 2, 10.5))
        self.assertEqual([entry.sent for entry in response.subscriptions if entry.id == "h"], [3])
        self.assertGreaterEqual(response.taken, 5)
        self.assertIn("/retalisInputEvents", [entry.topic for entry in response.inputs])
        self.assertEqual(response.work, "")
        shortened = self.list(1)
        self.assertEqual((len(shortened.rules), shortened.more_rules), (1, len(response.rules) - 1))

    def test_list_and_diagnostics_have_input_topic(self) -> None:
        self.assertEqual(self.add_input("points", "geometry_msgs/PointStamped").result, "ok")
        publisher = rospy.Publisher("points", PointStamped, queue_size=100)
        wait_until(lambda: publisher.get_num_connections() > 0, "the subscription")
        for _ in range(20):
            publisher.publish(PointStamped())

        def topic() -> Any:
            return next(entry for entry in self.list_interface(0).inputs if entry.topic == "/points")

        wait_until(lambda: topic().messages == 20, "the messages")
        self.assertEqual(
            (topic().type, topic().publishers, topic().dropped), ("geometry_msgs/PointStamped", 1, 0)
        )
        self.assertGreaterEqual(topic().age.to_sec(), 0)
        name = f"{self.interface}: input /points"
        status = self.wait_for_status(name, lambda status: self.values(status)["messages"] == "20")
        self.assertEqual((status.level, status.hardware_id), (DiagnosticStatus.OK, "retalis"))
        publisher.unregister()
        self.wait_for_status(name, lambda status: status.level == DiagnosticStatus.WARN)

    def test_refused_publisher_is_a_diagnostic_error(self) -> None:
        self.assertEqual(self.add_input("wrong", "std_msgs/String").result, "ok")
        publisher = rospy.Publisher("wrong", Float64, queue_size=10)
        name = f"{self.interface}: input /wrong"
        try:
            wait_until(lambda: publisher.get_num_connections() > 0, "the subscription")
            publisher.publish(Float64(1.0))
            status = self.wait_for_status(name, lambda status: status.level == DiagnosticStatus.ERROR)
            self.assertEqual(self.values(status)["refused"], "1")
        finally:
            publisher.unregister()

    def test_both_nodes_have_diagnostics(self) -> None:
        for part in ("queue", "work", "rules", "waiting queries", "program", "process memory"):
            self.wait_for_status(f"retalis: {part}")
        self.wait_for_status("retalis: input /retalisInputEvents")
        self.wait_for_status(f"{self.interface}: process memory")


if __name__ == "__main__":
    rospy.init_node("status_test")
    rostest.rosrun("retalis", "status", Status)
