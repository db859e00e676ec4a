#!/usr/bin/env python3
"""Status of a node: service ~list, and /diagnostics while simulated time stands still."""

import sys
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64, String

sys.path.append(str(Path(__file__).resolve().parent))
from harness import Collector, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402


class Status(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.embedded = rospy.get_param("retalis/embedded")
        cls.interface = "retalis" if cls.embedded else "retalis_ros_interface"
        cls.list = staticmethod(wait_for_service("retalis/list", srv.List))
        cls.list_interface = staticmethod(wait_for_service(f"{cls.interface}/list", srv.List))
        cls.query = staticmethod(wait_for_service("retalis/query", srv.Query))
        cls.add_rule = staticmethod(wait_for_service("retalis/add_rule", srv.AddRule))
        cls.add_memory = staticmethod(wait_for_service("add_memory", srv.AddMemory))
        cls.add_subscription = staticmethod(
            wait_for_service("add_output_subscription", srv.AddOutputSubscription)
        )
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        cls.told = Collector("/diagnostics", DiagnosticArray)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        wait_until(lambda: cls.events.get_num_connections() > 0, "node retalis")

    def wait_for_status(self, name, condition=lambda status: True):
        """Return the newest status of this name, once one fulfils a condition."""
        found = []

        def has_come(messages):
            found[:] = [
                one
                for message in messages[-20:]
                for one in message.status
                if one.name == name and condition(one)
            ]
            return bool(found)

        self.told.wait_for(has_come, name)
        return found[-1]

    def values(self, status):
        return {one.key: one.value for one in status.values}

    def test_lists_what_there_is_with_counters(self):
        self.assertEqual(self.add_rule(rule="counted: hot(X) <- heat(X) where X > 1").result, "ok")
        self.assertEqual(self.add_memory("hot(_)", "", "_", "hot_ones", "2").result, "ok")
        self.assertEqual(self.add_subscription("hot(X)", "", "_", "hot", "h").result, "ok")
        for number in range(5):
            self.events.publish(String(f"event(heat({number}), [10.0, 10.5])"))

        def memory():
            return [one for one in self.list(10).memories if one.id == "hot_ones"][0]

        wait_until(lambda: memory().added == 3, "the events")
        found = self.list(0)
        self.assertEqual(found.result, "ok")
        rule = [one for one in found.rules if one.label == "counted"][0]
        self.assertEqual((rule.fired, rule.errors, rule.last_fired.to_sec()), (3, 0, 10.5))
        self.assertIn("hot(X)", rule.text)
        self.assertEqual((memory().size, memory().records, memory().oldest.to_sec()), (2, 2, 10.5))
        self.assertEqual([one.sent for one in found.subscriptions if one.id == "h"], [3])
        self.assertGreaterEqual(found.taken, 5)
        self.assertIn("/retalisInputEvents", [one.topic for one in found.inputs])
        self.assertEqual(found.work, "")
        some = self.list(1)
        self.assertEqual((len(some.rules), some.more_rules), (1, len(found.rules) - 1))

    def test_lists_waiting_queries_with_what_they_wait_for(self):
        self.assertEqual(self.add_memory("pose", "", "_", "odom", "5").result, "ok")
        self.add_rule(rule="synchronized(late(X), true, [[odom, 30]]) <- late_marker(X)")
        self.events.publish(String("event(pose, [20.0, 20.0])"))
        self.events.publish(String("event(late_marker(1), [25.0, 25.0])"))
        wait_until(lambda: self.list(0).waiting, "the query")
        waiting = self.list(0).waiting[0]
        self.assertEqual((waiting.event, waiting.since.to_sec()), ("late(1)", 25.0))
        self.assertEqual(
            [(one.id, one.instant.to_sec(), one.behind.to_sec()) for one in waiting.memories],
            [("odom", 30.0, 10.0)],
        )
        status = self.wait_for_status("retalis: waiting queries", lambda one: one.values)
        self.assertIn("odom (10.000 s behind)", self.values(status)["late(1)"])

    def test_tells_of_a_topic(self):
        self.assertEqual(self.add_input("points", "geometry_msgs/PointStamped").result, "ok")
        publisher = rospy.Publisher("points", PointStamped, queue_size=100)
        wait_until(lambda: publisher.get_num_connections() > 0, "the subscription")
        for _ in range(20):
            publisher.publish(PointStamped())

        def topic():
            return [one for one in self.list_interface(0).inputs if one.topic == "/points"][0]

        wait_until(lambda: topic().messages == 20, "the messages")
        self.assertEqual(
            (topic().type, topic().publishers, topic().dropped), ("geometry_msgs/PointStamped", 1, 0)
        )
        self.assertGreaterEqual(topic().age.to_sec(), 0)
        name = f"{self.interface}: input /points"
        status = self.wait_for_status(name, lambda one: self.values(one)["messages"] == "20")
        self.assertEqual((status.level, status.hardware_id), (DiagnosticStatus.OK, "retalis"))
        publisher.unregister()
        self.wait_for_status(name, lambda one: one.level == DiagnosticStatus.WARN)

    def test_tells_of_a_publisher_that_is_refused(self):
        self.assertEqual(self.add_input("wrong", "std_msgs/String").result, "ok")
        publisher = rospy.Publisher("wrong", Float64, queue_size=10)
        name = f"{self.interface}: input /wrong"
        try:
            wait_until(lambda: publisher.get_num_connections() > 0, "the subscription")
            publisher.publish(Float64(1.0))
            status = self.wait_for_status(name, lambda one: one.level == DiagnosticStatus.ERROR)
            self.assertEqual(self.values(status)["refused"], "1")
        finally:
            publisher.unregister()

    def test_tells_of_errors_by_rule(self):
        self.add_rule(rule="wrong_one: never <- number(X) where X > 1")
        self.events.publish(String("event(number(many))"))
        status = self.wait_for_status("retalis: rules", lambda one: one.level == DiagnosticStatus.ERROR)
        self.assertIn("wrong_one", " ".join(self.values(status)))

    def test_both_nodes_tell_of_themselves(self):
        for part in ("queue", "work", "rules", "waiting queries", "program", "process memory"):
            self.wait_for_status(f"retalis: {part}")
        self.wait_for_status("retalis: input /retalisInputEvents")
        self.wait_for_status(f"{self.interface}: process memory")

    def test_a_busy_engine_is_told_of_at_once(self):
        request = srv.QueryRequest(goal="repeat, fail", seconds=4.0)
        asking = threading.Thread(target=lambda: self.query(request))
        asking.start()
        wait_until(lambda: self.list(0).work_goal, "the goal")
        found = self.list(0)
        self.assertTrue(asking.is_alive())
        self.assertEqual(found.work_goal, "goal repeat")
        self.wait_for_status("retalis: work", lambda one: one.level == DiagnosticStatus.WARN)
        asking.join()
        self.wait_for_status("retalis: work", lambda one: one.level == DiagnosticStatus.OK)


if __name__ == "__main__":
    rospy.init_node("status_test")
    rostest.rosrun("retalis", "status", Status)
