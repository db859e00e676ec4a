#!/usr/bin/env python3
"""Node retalis reads and publishes all topics itself: each message once, in any order of starts and restarts."""

import signal
import sys
import unittest
from pathlib import Path
from typing import Any

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import Int32, String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import ENGINE, INTERFACE, Collector, NodeProcesses, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402
from retalis.ros1.internode_delivery import has_ended  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "direct"


class Direct(unittest.TestCase):
    namespace = ""

    def setUp(self) -> None:
        self.nodes = NodeProcesses(PROGRAM)
        self.addCleanup(self.nodes.end_all)
        self.sent = 0

    def connect(self, numbers: str = "numbers") -> None:
        """Create the publishers of inputs and the subscriber of outputs."""
        self.numbers = rospy.Publisher(f"{self.namespace}/{numbers}", Int32, queue_size=100)
        self.additional = rospy.Publisher(f"{self.namespace}/more", Int32, queue_size=100)
        self.received = Collector(f"{self.namespace}/received", Int32)
        for publisher in (self.numbers, self.additional):
            self.addCleanup(publisher.unregister)
        self.addCleanup(self.received.close)

    def call(self, service: str, **fields: Any) -> Any:
        return wait_for_service(f"{self.namespace}/{service}", getattr(srv, _service_class(service)))(
            **fields
        )

    def add_additional(self) -> None:
        response = self.call("add_input_subscription", topic="more", message_type="std_msgs/Int32")
        self.assertEqual(response.result, "ok")

    def send(self, *publishers: Any) -> None:
        """Publish the next number on each topic, and wait until the outputs are exactly one for each."""
        wait_until(
            lambda: all(count_subscribers(publisher) == 1 for publisher in publishers), "the subscriptions"
        )
        wait_until(self.received.is_connected, "the publisher of the outputs")
        for publisher in publishers:
            self.sent += 1
            publisher.publish(self.sent)
            expected = list(range(1, self.sent + 1))
            self.received.wait_for(
                lambda messages: any(message.data == self.sent for message in messages), expected
            )
            self.assertEqual([message.data for message in self.received.messages], expected)

    def test_first_engine_receives_messages_once(self) -> None:
        self.connect()
        self.nodes.start(ENGINE)
        self.nodes.start(INTERFACE)
        self.add_additional()
        self.send(self.numbers, self.additional)
        self.check_restarts()

    def test_first_interface_receives_messages_once(self) -> None:
        self.connect()
        self.nodes.start(INTERFACE)
        self.add_additional()
        self.nodes.start(ENGINE)
        self.send(self.numbers, self.additional)
        self.check_restarts()

    def check_restarts(self) -> None:
        self.nodes.end(signal.SIGKILL, ENGINE)
        self.nodes.start(ENGINE)
        self.send(self.additional, self.numbers)
        self.nodes.end(signal.SIGKILL, INTERFACE)
        self.send(self.additional, self.numbers)
        self.nodes.start(INTERFACE)
        # The services of the new interface node have added no topic.
        wait_until(lambda: count_subscribers(self.additional) == 0, "the end of the subscription")
        self.send(self.numbers)
        self.add_additional()
        self.send(self.additional, self.numbers)

    def test_topic_is_deleted_until_restart(self) -> None:
        self.connect()
        self.nodes.start(ENGINE)
        self.nodes.start(INTERFACE)
        self.send(self.numbers)
        self.assertEqual(self.call("delete_input_subscription", topic="numbers").result, "ok")
        self.assertIn("not subscribed", self.call("delete_input_subscription", topic="numbers").result)
        wait_until(lambda: count_subscribers(self.numbers) == 0, "the end of the subscription")
        self.nodes.end(signal.SIGINT, ENGINE)
        self.add_additional()
        self.nodes.start(ENGINE)
        self.send(self.additional)
        wait_until(lambda: count_subscribers(self.numbers) == 0, "the end of the subscription")
        self.nodes.shut_down(INTERFACE)
        self.nodes.start(INTERFACE)
        self.send(self.numbers)

    def test_namespace_and_remapping_apply_to_both_nodes(self) -> None:
        self.namespace = "/robot"
        self.nodes = NodeProcesses(PROGRAM, "__ns:=/robot", "numbers:=counts")
        self.addCleanup(self.nodes.end_all)
        self.connect("counts")
        self.nodes.start(INTERFACE)
        self.add_additional()
        result = self.call("add_input_subscription", topic="counts", message_type="std_msgs/Int32").result
        self.assertIn("already subscribed", result)
        self.nodes.start(ENGINE)
        self.send(self.numbers, self.additional)

    def test_texts_are_for_other_nodes(self) -> None:
        self.connect()
        self.nodes.start(ENGINE)
        self.nodes.start(INTERFACE)
        self.send(self.numbers)
        inputs, outputs = Collector("retalisInputEvents", String), Collector("retalisOutputEvents", String)
        to_engine = rospy.Publisher("retalisInputEvents", String, queue_size=10)
        to_topics = rospy.Publisher("retalisOutputEvents", String, queue_size=10)
        wait_until(lambda: inputs.is_connected() and outputs.is_connected(), "the texts")
        wait_until(
            lambda: count_subscribers(to_engine) == 2 and count_subscribers(to_topics) == 2,
            "node retalis, beside the subscriber of this test",
        )
        self.send(self.numbers)
        inputs.wait_for(
            lambda texts: any("event(std_msgs__0__Int32(2),[" in message.data for message in texts), "2"
        )
        outputs.wait_for(
            lambda texts: any(message.data == "event(std_msgs__0__Int32(2),received,r)" for message in texts)
        )
        to_engine.publish("event(std_msgs__0__Int32(3))")
        self.received.wait_for(lambda messages: len(messages) == 3)
        to_topics.publish("event(std_msgs__0__Int32(4),received,other)")
        self.received.wait_for(lambda messages: len(messages) == 4)
        self.sent = 4
        self.send(self.numbers)
        for publisher in (to_engine, to_topics):
            publisher.unregister()
        inputs.close()
        outputs.close()

    def test_different_values_of_direct_are_an_error(self) -> None:
        log = Collector("/rosout", Log)
        self.nodes.start(ENGINE)
        wait_until(lambda: f"/{ENGINE}" in log.publishers(), "the log")
        self.nodes.start(INTERFACE, "_direct:=false")
        self.addCleanup(rospy.delete_param, f"{INTERFACE}/direct")
        log.wait_for(
            lambda records: any(
                'parameter ~direct: it is "auto" here and false in node /retalis_ros_interface' in record.msg
                for record in records
            ),
            "the error",
        )
        log.close()


def count_subscribers(publisher: Any) -> int:
    """Return the number of connected subscribers; rospy also counts those that have been killed."""
    return sum(not has_ended(connection) for connection in publisher.impl.connections)


def _service_class(service: Any) -> str:
    return "".join(part.capitalize() for part in service.split("_"))


if __name__ == "__main__":
    rospy.init_node("direct")
    rostest.rosrun("retalis", "direct", Direct)
