#!/usr/bin/env python3
"""Projection pushdown: the interface omits unread fields from event texts without visible effects."""

import sys
import unittest
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from std_msgs.msg import String, UInt8MultiArray

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

SIZE = 200_000
PATTERN = "std_msgs__0__UInt8MultiArray(Layout, {})"


class Projection(unittest.TestCase):
    outputs: Collector
    images: rospy.Publisher
    subscribe: Any
    interface: Any

    @classmethod
    def setUpClass(cls) -> None:
        wait_for_message_path()
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.images = rospy.Publisher("images", UInt8MultiArray, queue_size=100)
        add = wait_for_service("add_input_subscription", srv.AddInputSubscription)
        assert add("images", "std_msgs/UInt8MultiArray").result == "ok"
        cls.subscribe = staticmethod(wait_for_service("add_output_subscription", srv.AddOutputSubscription))
        wait_until(
            lambda: cls.images.get_num_connections() > 0 and cls.outputs.is_connected(), "the interface"
        )
        master = rosgraph.Master("/unread")
        cls.interface = ServerProxy(master.lookupNode("/retalis_ros_interface"))
        cls.subscribe(PATTERN.format("_"), "", "layout(Layout)", "t", "layouts")

    def sent_bytes(self) -> Any:
        """Return the number of bytes that the interface has sent as text."""
        topics = self.interface.getBusStats("/unread")[2][0]
        return sum(link[1] for topic in topics if topic[0] == "/retalisInputEvents" for link in topic[-1])

    def publish(self, letter: bytes) -> Any:
        """Publish an image and wait for its output; return the number of bytes of its text."""
        before, count = self.sent_bytes(), len(self.outputs.messages)
        self.images.publish(UInt8MultiArray(data=letter * SIZE))
        self.outputs.wait_for(
            lambda messages: any(message.data.startswith("event(layout(") for message in messages[count:]),
            "the layout",
        )
        return self.sent_bytes() - before

    def is_projected(self) -> bool:
        return self.publish(b"a") < 10_000

    def test_1_unread_fields_are_not_written(self) -> None:
        wait_until(self.is_projected, "the end of whole messages")
        self.assertLess(self.publish(b"a"), 10_000)

    def test_2_other_subscriber_receives_whole_messages(self) -> None:
        wait_until(self.is_projected, "the end of whole messages")
        texts = Collector("retalisInputEvents", String)
        wait_until(texts.is_connected, "the interface")
        # The interface sends to a new subscriber a moment after the connection.
        wait_until(lambda: self.publish(b"b") and texts.messages, "a whole message")
        self.assertIn("b" * SIZE, texts.messages[-1].data)
        texts.close()
        wait_until(self.is_projected, "the end of the other subscription")

    def test_3_added_subscription_has_whole_messages(self) -> None:
        wait_until(self.is_projected, "the end of whole messages")
        added = self.subscribe(PATTERN.format("Data"), "", "data(Data)", "t", "data").result
        self.assertEqual(added, "ok")
        wait_until(lambda: self.publish(b"c") > SIZE, "whole messages")
        prefix = "event(data("
        self.outputs.wait_for(
            lambda messages: any(message.data.startswith(prefix) for message in messages), "the data"
        )
        for message in self.outputs.messages:
            if message.data.startswith(prefix):
                self.assertIn("c" * SIZE, message.data)
        delete = wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)
        self.assertEqual(delete("t", "data").result, "ok")
        wait_until(self.is_projected, "the end of whole messages")


if __name__ == "__main__":
    rospy.init_node("projection")
    rostest.rosrun("retalis", "projection", Projection)
