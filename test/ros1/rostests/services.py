#!/usr/bin/env python3
"""Each service on a live node, while events are processed: requests and responses have the types of the `.srv` files.

The answers in detail are tested in `test/node/test_service_answers.py`.
"""

import sys
import threading
import time
import unittest
from pathlib import Path
from typing import Any, List

import rospy
import rostest
from std_msgs.msg import Float64, String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

SERVICES = {
    "add_output_subscription": srv.AddOutputSubscription,
    "delete_output_subscription": srv.DeleteOutputSubscription,
    "add_memory": srv.AddMemory,
    "delete_memory": srv.DeleteMemory,
    "add_input_subscription": srv.AddInputSubscription,
    "delete_input_subscription": srv.DeleteInputSubscription,
    "retalis/query": srv.Query,
    "retalis/explain": srv.Explain,
    "retalis/add_rule": srv.AddRule,
    "retalis/delete_rule": srv.DeleteRule,
    "retalis/list": srv.List,
}


class Services(unittest.TestCase):
    proxies: Any
    outputs: Collector
    events: rospy.Publisher
    is_flowing: Any
    flow: Any

    @classmethod
    def setUpClass(cls) -> None:
        wait_for_message_path()
        cls.proxies = {name: wait_for_service(name, kind) for name, kind in SERVICES.items()}
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        cls.is_flowing = True
        cls.flow = threading.Thread(target=cls.publish_flow, daemon=True)
        cls.flow.start()

    @classmethod
    def tearDownClass(cls) -> None:
        cls.is_flowing = False
        cls.flow.join(10)

    @classmethod
    def publish_flow(cls) -> None:
        """Publish events all the time, so that services are not answered by an idle node only."""
        number = 0
        while cls.is_flowing and not rospy.is_shutdown():
            number += 1
            cls.events.publish(String(f"event(flow({number}))"))
            time.sleep(0.002)

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service that succeeds; return its response."""
        response = self.proxies[name](**fields)
        self.assertEqual(response.result, "ok", name)
        return response

    def send(self, *events: Any) -> None:
        for event in events:
            self.events.publish(String(f"event({event})"))

    def wait_for_output(self, text: str) -> None:
        self.outputs.wait_for(lambda messages: any(message.data == text for message in messages), text)

    def ask(self, goal: str, **fields: Any) -> Any:
        return self.proxies["retalis/query"](srv.QueryRequest(goal=goal, **fields))

    def test_subscriptions_and_memories(self) -> None:
        fields = {"event": "v(X)", "conditions": "X > 1", "format": "got(X)"}
        self.call("add_output_subscription", topic="somewhere", id="s", **fields)
        self.call("add_memory", id="m", size="2", **fields)
        self.send("v(1)", "v(2)", "v(3)")
        self.wait_for_output("event(got(3),somewhere,s)")
        self.assertIn("event(got(2),somewhere,s)", [message.data for message in self.outputs.messages])
        self.assertNotIn("event(got(1),somewhere,s)", [message.data for message in self.outputs.messages])
        # The output of an event may arrive before the memory has stored it. A query is answered between events.
        self.ask("true")
        (memory,) = [memory for memory in self.call("retalis/list", most=0).memories if memory.id == "m"]
        self.assertEqual((memory.added, memory.size), (2, 2))
        self.call("delete_output_subscription", topic="somewhere", id="s")
        self.call("delete_memory", id="m")
        result = self.proxies["delete_memory"](id="m").result
        self.assertEqual(result, "error: there is no memory m")

    def test_input_topics(self) -> None:
        number = rospy.Publisher("number", Float64, queue_size=10)
        self.call("add_input_subscription", topic="number", message_type="std_msgs/msg/Float64")
        fields = {"event": "std_msgs__0__Float64(X)", "conditions": "", "format": "number(X)"}
        self.call("add_output_subscription", topic="t", id="n", **fields)
        wait_until(lambda: number.get_num_connections() > 0, "the subscription")
        number.publish(2.5)
        self.wait_for_output("event(number(2.5),t,n)")
        self.call("delete_input_subscription", topic="number")
        wait_until(lambda: number.get_num_connections() == 0, "the end of the subscription")
        self.call("delete_output_subscription", topic="t", id="n")

    def test_query_waits_while_events_are_processed(self) -> None:
        self.call("add_memory", event="late(X)", conditions="", format="_", id="late", size="5")
        answers: List[Any] = []
        fields = {"wait_for": ["late"], "stamp": rospy.Time(10), "timeout": 60}
        thread = threading.Thread(
            target=lambda: answers.append(self.ask("access_mem(late, late(X), _)", **fields))
        )
        thread.start()
        self.send("late(1), [9,9]")
        wait_until(lambda: self.ask("access_mem(late, late(1), _)").solutions, "the first event")
        self.assertFalse(answers)
        self.send("late(2), [10,10]")
        thread.join(60)
        bindings = [binding for solution in answers[0].solutions for binding in solution.bindings]
        self.assertEqual(
            [(each.name, each.text, each.json) for each in bindings], [("X", "2", "2"), ("X", "1", "1")]
        )
        self.call("delete_memory", id="late")

    def test_rules_and_explanations(self) -> None:
        added = self.call("retalis/add_rule", rule="glow(X) <- warm(X) seq dark(X)", label="glow")
        self.assertEqual(added.label, "glow")
        self.send("warm(1)", "dark(1)")
        wait_until(lambda: self.proxies["retalis/explain"]("glow(1)").happened, "the explanation")
        lines = self.call("retalis/explain", event="glow(1)").lines
        self.assertIn("by rule glow: ", lines[0])
        (rule,) = [rule for rule in self.call("retalis/list", most=0).rules if rule.label == "glow"]
        self.assertEqual(rule.fired, 1)
        self.call("retalis/delete_rule", label="glow")


if __name__ == "__main__":
    rospy.init_node("services")
    rostest.rosrun("retalis", "services", Services)
