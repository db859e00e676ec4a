#!/usr/bin/env python3
"""Projection pushdown: the interface omits unread fields from event texts without visible effects."""

import sys
import unittest
from pathlib import Path
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from std_msgs.msg import String, UInt8MultiArray

sys.path.append(str(Path(__file__).resolve().parent))
from harness import Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

SIZE = 200_000
PATTERN = "std_msgs__0__UInt8MultiArray(Layout, {})"


class Projection(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
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

    def sent(self):
        """Return how many bytes the interface has sent as text."""
        topics = self.interface.getBusStats("/unread")[2][0]
        return sum(link[1] for topic in topics if topic[0] == "/retalisInputEvents" for link in topic[-1])

    def publish(self, letter):
        """Publish an image and wait for what follows; return the bytes that it took as text."""
        before, known = self.sent(), len(self.outputs.messages)
        self.images.publish(UInt8MultiArray(data=letter * SIZE))
        self.outputs.wait_for(
            lambda found: any(m.data.startswith("event(layout(") for m in found[known:]), "the layout"
        )
        return self.sent() - before

    def saves(self):
        return self.publish(b"a") < 10_000

    def test_1_what_nobody_reads_is_not_written(self):
        wait_until(self.saves, "the end of whole messages")
        self.assertLess(self.publish(b"a"), 10_000)

    def test_2_somebody_else_who_listens_gets_whole_messages(self):
        wait_until(self.saves, "the end of whole messages")
        texts = Collector("retalisInputEvents", String)
        wait_until(texts.is_connected, "the interface")
        wait_until(
            lambda: self.publish(b"b") and texts.messages, "a whole message"
        )  # it is served a moment later
        found = texts.messages
        self.assertIn("b" * SIZE, found[-1].data)
        texts.close()
        wait_until(self.saves, "the end of the other one")

    def test_3_who_comes_later_gets_nothing_but_whole_messages(self):
        wait_until(self.saves, "the end of whole messages")
        added = self.subscribe(PATTERN.format("Data"), "", "data(Data)", "t", "data").result
        self.assertEqual(added, "ok")
        wait_until(lambda: self.publish(b"c") > SIZE, "whole messages")
        self.outputs.wait_for(
            lambda all_: any(one.data.startswith("event(data(") for one in all_), "the data"
        )
        found = [one.data for one in self.outputs.messages if one.data.startswith("event(data(")]
        for text in found:
            self.assertIn("c" * SIZE, text)
        delete = wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)
        self.assertEqual(delete("t", "data").result, "ok")
        wait_until(self.saves, "the end of whole messages")


if __name__ == "__main__":
    rospy.init_node("projection")
    rostest.rosrun("retalis", "projection", Projection)
