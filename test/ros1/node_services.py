#!/usr/bin/env python3
"""Services that inspect and change a running node."""

import json
import sys
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parent))
from harness import Collector, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402


class NodeServices(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.query = staticmethod(wait_for_service("retalis/query", srv.Query))
        cls.explain = staticmethod(wait_for_service("retalis/explain", srv.Explain))
        cls.add_rule = staticmethod(wait_for_service("retalis/add_rule", srv.AddRule))
        cls.delete_rule = staticmethod(wait_for_service("retalis/delete_rule", srv.DeleteRule))
        cls.add_memory = staticmethod(wait_for_service("add_memory", srv.AddMemory))
        cls.delete_memory = staticmethod(wait_for_service("delete_memory", srv.DeleteMemory))
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )

    def send(self, text):
        self.events.publish(String(text))

    def ask(self, goal, **fields):
        return self.query(srv.QueryRequest(goal=goal, **fields))

    def wait_until_true(self, goal):
        wait_until(lambda: self.ask(goal).solutions, goal)

    def test_query_has_typed_solutions(self):
        response = self.ask("member(X-Y, [1-a, f(Z)-[b, 2.5]])")
        self.assertEqual((response.result, response.complete), ("ok", True))
        values = [
            {binding.name: binding.text for binding in solution.bindings} for solution in response.solutions
        ]
        self.assertEqual(values, [{"X": "1", "Y": "a", "Z": "_1"}, {"X": "f(_1)", "Y": "[b,2.5]", "Z": "_1"}])
        self.assertEqual(json.loads(response.solutions[1].bindings[1].json), ["b", 2.5])

    def test_query_has_limits(self):
        response = self.ask("repeat", max_solutions=3)
        self.assertEqual((response.result, response.complete, len(response.solutions)), ("ok", False, 3))
        self.assertIn("inferences", self.ask("repeat, fail", inferences=1000).result)
        self.assertIn("seconds", self.ask("repeat, fail", seconds=0.1).result)
        self.assertIn("more than", self.ask("numlist(1, 1000000, L)").result)
        self.assertLess(len(self.ask("numlist(1, 20, X), repeat", max_solutions=100_000).solutions), 100_000)
        self.assertIn("seconds: expected", self.ask("true", seconds=-1).result)

    def test_invalid_query_is_an_error(self):
        for goal, part in (
            ("f(X", "column 4"),
            ("", "goal: expected a term"),
            ("no_such(1)", "no_such/1"),
            ("X", "instantiat"),
        ):
            response = self.ask(goal)
            self.assertTrue(response.result.startswith("error: "), response.result)
            self.assertIn(part, response.result)
            self.assertNotIn("\n", response.result)

    def test_query_reads_no_files(self):
        self.assertIn("ermission", self.ask("compile_event_file('/etc/passwd')").result)

    def test_query_waits_for_memories(self):
        self.assertEqual(self.add_memory("late(X)", "", "_", "late", "5").result, "ok")
        responses = []
        stamp = rospy.Time(10)
        thread = threading.Thread(
            target=lambda: responses.append(
                self.ask("access_mem(late, late(X), _)", wait_for=["late"], stamp=stamp, timeout=60)
            )
        )
        thread.start()
        self.send("event(late(1), [9,9])")
        self.wait_until_true("access_mem(late, late(1), _)")
        self.assertFalse(responses)
        self.send("event(late(2), [10,10])")
        thread.join(60)
        values = [binding.text for solution in responses[0].solutions for binding in solution.bindings]
        self.assertEqual(values, ["2", "1"])
        response = self.ask("true", wait_for=["late"], stamp=rospy.Time(12), timeout=0.01)
        self.assertIn("in memory late (2 s too early) after 0.01 s", response.result)
        self.assertIn("there is no memory x", self.ask("true", wait_for=["x"]).result)
        self.assertEqual(self.delete_memory("late").result, "ok")

    def test_rules_are_added_and_deleted(self):
        added = self.add_rule("fire_(X) <- smoke_(X) seq heat_(X) where X > 1.", "hot")
        self.assertEqual((added.result, added.label), ("ok", "hot"))
        self.assertEqual(self.add_memory("fire_(X)", "", "_", "fires", "5").result, "ok")
        for event in ("smoke_(1)", "smoke_(2)", "heat_(1)", "heat_(2)"):
            self.send(f"event({event})")
        self.wait_until_true("access_mem(fires, fire_(2), _)")
        self.assertFalse(self.ask("access_mem(fires, fire_(1), _)").solutions)
        self.assertIn("already exists", self.add_rule("a <- b", "hot").result)
        self.assertEqual(self.delete_rule("hot").result, "ok")
        self.assertIn("there is no rule hot", self.delete_rule("hot").result)
        self.assertEqual(self.delete_memory("fires").result, "ok")

    def test_invalid_rule_is_an_error_with_caret(self):
        error = self.add_rule("a <- b seq\n  (c where X > )", "").result
        self.assertTrue(error.startswith("error: rule:2:16: "), error)
        self.assertEqual(error.splitlines()[1:], ["  (c where X > )", " " * 15 + "^"])

    def test_events_are_explained(self):
        self.assertEqual(self.add_rule("glow_(X) <- warm_(X) seq dark_(X)", "glow").result, "ok")
        self.assertEqual(self.add_memory("glow_(X)", "", "_", "glows", "5").result, "ok")
        self.send("event(warm_(1))")
        self.send("event(warm_(2))")
        self.send("event(dark_(1))")
        self.wait_until_true("access_mem(glows, glow_(1), _)")
        response = self.explain("glow_(1)")
        self.assertEqual((response.result, response.happened), ("ok", True))
        self.assertIn("by rule glow: ", response.lines[0])
        self.assertEqual([line[:9] for line in response.lines[1:]], ["  warm_(1", "  dark_(1"])
        response = self.explain("glow_(2)")
        self.assertEqual((response.result, response.happened), ("ok", False))
        self.assertIn("    - dark_(2): did not happen", response.lines)
        self.assertIn("error: ", self.explain("f(").result)
        self.assertEqual(self.delete_rule("glow").result, "ok")
        self.assertEqual(self.delete_memory("glows").result, "ok")


if __name__ == "__main__":
    rospy.init_node("node_services")
    rostest.rosrun("retalis", "node_services", NodeServices)
