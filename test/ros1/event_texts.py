#!/usr/bin/env python3
"""Event texts of other nodes, simulated time, and a type that is not installed."""

import sys
import time
import unittest
from pathlib import Path

import rospy
import rostest
from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parent))
from harness import (  # noqa: E402
    DEFINITIONS,
    TIMEOUT_SECONDS,
    Collector,
    RawPublisher,
    wait_for_message_path,
    wait_for_service,
    wait_until,
)

from retalis import Operators, srv  # noqa: E402
from retalis.prolog.syntax.term_reader import read_term  # noqa: E402

POSE = (
    "geometry_msgs__0__PoseStamped(std_msgs__0__Header(0,[5,7],{name}),"
    "geometry_msgs__0__Pose(geometry_msgs__0__Point(1.5,-2,3e0),geometry_msgs__0__Quaternion(0,0,0.0,1)))"
)


class EventTexts(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        wait_for_message_path()
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.inputs = Collector("retalisInputEvents", String)
        cls.to_engine = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        cls.to_topics = rospy.Publisher("retalisOutputEvents", String, queue_size=5000)
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=10)
        cls.marker = Collector("marker1", PoseStamped)
        cls.subscribe = staticmethod(wait_for_service("add_output_subscription", srv.AddOutputSubscription))
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        wait_until(lambda: cls.to_engine.get_num_connections() > 0, "node retalis")
        wait_until(lambda: cls.to_topics.get_num_connections() > 0, "the interface")
        wait_until(lambda: cls.outputs.is_connected() and cls.marker.is_connected(), "publishers")

    def wait_for_output(self, text):
        self.outputs.wait_for(lambda messages: any(message.data == text for message in messages), text)

    def test_each_form_of_event_is_processed(self):
        self.subscribe("form(X)", "", "_", "t", "forms")
        for text in (
            "event(form(1),[datime(2014,10,19,19,50,5,1),datime(2014,10,19,19,50,6,1)])",
            "event(form(2))",
            "new_event(form(3),1413748205,981209993)",
            "new_event(form(4), [datime(2014,10,19,19,50,5,1), datime(2014,10,19,19,50,5,1)])",
            "new_event(form('\"a, [b\"'),1,0,2,0).",
        ):
            self.to_engine.publish(text)
        self.wait_for_output("event(form('\"a, [b\"'),t,forms)")
        for number in range(1, 5):
            self.wait_for_output(f"event(form({number}),t,forms)")

    def test_invalid_text_is_ignored(self):
        self.subscribe("after(X)", "", "_", "t", "refused")
        for text in (
            "shell('true')",
            "event(",
            "halt",
            "assertz(x)",
            "event(3)",
            "",
            "event(a,[2,1])",
            "event(X)",
        ):
            self.to_engine.publish(text)
        self.to_engine.publish("event(after(1))")
        self.wait_for_output("event(after(1),t,refused)")

    def test_outputs_of_other_nodes_are_published(self):
        for name in ("'\"4x4_1\"'", '"4x4_1"'):
            count = len(self.marker.messages)
            self.to_topics.publish(f"event({POSE.format(name=name)}, marker1, m1)")
            pose = self.marker.wait_for(lambda messages, count=count: len(messages) > count)[-1]
            self.assertEqual(pose.header.frame_id, "4x4_1")
            self.assertEqual((pose.header.stamp.secs, pose.header.stamp.nsecs), (5, 7))
            self.assertEqual(
                (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z), (1.5, -2.0, 3.0)
            )

    def test_invalid_outputs_are_not_published(self):
        count = len(self.marker.messages)
        for text in (
            "event(std_msgs__0__String('\"x\"'),marker1,m1)",
            "event(" + POSE.format(name="7") + ",marker1,m1)",
            "event(" + POSE.format(name='"n"') + ",no_such_topic,m1)",
            "nonsense",
            "event(",
        ):
            self.to_topics.publish(text)
        good = POSE.format(name='"last"')
        self.to_topics.publish(f"event({good},marker1,m1)")
        messages = self.marker.wait_for(lambda messages: any(m.header.frame_id == "last" for m in messages))
        self.assertEqual(len(messages), count + 1)

    def test_type_without_installation_is_subscribed(self):
        definition = DEFINITIONS.add(
            "nowhere_msgs/Thing",
            "float64 x\nPart[] parts\n" + "=" * 80 + "\nMSG: nowhere_msgs/Part\nstring name\nbool ok",
        )
        publisher = RawPublisher("thing", definition)
        self.assertEqual(self.add_input("thing", "nowhere_msgs/Thing").result, "ok")
        self.subscribe("nowhere_msgs__0__Thing(_,_)", "", "_", "t", "thing")
        wait_until(publisher.is_connected, "the subscriber of the thing")
        term = read_term(
            "nowhere_msgs__0__Thing(0.5,[nowhere_msgs__0__Part('\"arm\"',true)])", Operators.prolog()
        ).term
        publisher.publish(DEFINITIONS.encoder(definition).encode(term, "thing"))
        self.wait_for_output(
            "event(nowhere_msgs__0__Thing(0.5,[nowhere_msgs__0__Part('\"arm\"',true)]),t,thing)"
        )

    def test_burst_is_complete_and_in_order(self):
        burst = rospy.Publisher("burst", String, queue_size=5000)
        self.assertEqual(self.add_input("burst", "std_msgs/String").result, "ok")
        self.subscribe("std_msgs__0__String(_)", "", "_", "t", "burst")
        wait_until(lambda: burst.get_num_connections() > 0, "the subscriber of the burst")
        for number in range(3000):
            burst.publish(f"burst {number}")

        def numbers(messages):
            return [int(m.data.split()[1].split('"')[0]) for m in messages if m.data.endswith(",t,burst)")]

        messages = self.outputs.wait_for(lambda messages: "burst 2999" in messages[-1].data, "the burst")
        self.assertEqual(numbers(messages), list(range(3000)))

    def test_message_without_header_has_simulated_time(self):
        publisher = rospy.Publisher("plain", String, queue_size=10)
        self.assertEqual(self.add_input("plain", "std_msgs/String").result, "ok")
        wait_until(lambda: publisher.get_num_connections() > 0, "the subscriber")
        stamp = "datime(2001,9,9,1,46,40,5)"
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while not any(stamp in message.data for message in self.inputs.messages):
            self.assertLess(time.monotonic(), deadline, "simulated time was not used")
            self.clock.publish(Clock(rospy.Time(1_000_000_000, 5)))
            publisher.publish("x")
            time.sleep(0.01)


if __name__ == "__main__":
    rospy.init_node("event_texts")
    rostest.rosrun("retalis", "event_texts", EventTexts)
