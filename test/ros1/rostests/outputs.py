#!/usr/bin/env python3
"""Output topics: types that publishers define, topics without a type, latched topics."""

import sys
import unittest
from pathlib import Path
from typing import Any

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import DEFINITIONS, Collector, RawPublisher, wait_until  # noqa: E402

from retalis import Operators  # noqa: E402
from retalis.prolog.syntax.term_reader import read_term  # noqa: E402

THING = DEFINITIONS.add(
    "nowhere_msgs/Thing", "float64 x\nPart part\n" + "=" * 80 + "\nMSG: nowhere_msgs/Part\nstring name"
)
PART = "nowhere_msgs__0__Part('\"arm\"')"


class Outputs(unittest.TestCase):
    log: Collector
    events: rospy.Publisher
    outputs: Collector

    @classmethod
    def setUpClass(cls) -> None:
        cls.log = Collector("/rosout", Log)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        cls.outputs = Collector("retalisOutputEvents", String)
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        wait_until(cls.log.is_connected, "the log")

    def event(self, text: str) -> None:
        """Publish an event and wait for its output as text."""
        self.events.publish(f"event({text})")
        output = f"event({text},nowhere,n)"
        self.outputs.wait_for(lambda messages: any(message.data == output for message in messages), output)

    def test_type_defined_by_publisher_is_published(self) -> None:
        thing = RawPublisher("things", THING)
        wait_until(thing.is_connected, "the subscriber of the things")
        term = read_term(f"nowhere_msgs__0__Thing(0.5,{PART})", Operators.prolog()).term
        data = DEFINITIONS.encoder(THING).encode(term, "things")
        thing.publish(data)  # its outputs may be lost: subscribers find the new topics afterwards
        copies, parts = (Collector(topic, rospy.AnyMsg) for topic in ("copies", "parts"))
        wait_until(copies.is_connected, "the publisher of the copies")
        wait_until(parts.is_connected, "the publisher of the parts")
        self.assertEqual([message._buff for message in parts.wait_for(bool)], [data[8:]])

        def is_copied() -> Any:
            thing.publish(data)
            return copies.messages

        wait_until(is_copied, "a copy")  # a subscriber has the connection a moment before the publisher
        self.assertEqual(copies.messages[-1]._buff, data)
        parts.wait_for(lambda messages: len(messages) > 1)
        header = copies.messages[0]._connection_header
        self.assertEqual(
            (header["type"], header["md5sum"], header["latching"]), (THING.name, THING.md5sum, "0")
        )
        self.assertEqual(parts.messages[0]._connection_header["latching"], "1")

    def test_output_on_unpublished_topic_is_no_error(self) -> None:
        for number in range(20):
            self.event(f"state('\"{number}\"')")
        records = [record for record in self.log.messages if "topic nowhere has no type" in record.msg]
        self.assertLessEqual(len([record for record in records if record.level >= Log.WARN]), 1)
        self.assertEqual([record.msg for record in self.log.messages if record.level >= Log.ERROR], [])

    def test_latched_topic_sends_last_message_once(self) -> None:
        state = Collector("state", String)
        wait_until(state.is_connected, "the publisher of the state")

        def is_received() -> Any:
            self.event("state('\"0\"')")
            return state.messages

        # Outputs before the connection are lost.
        wait_until(is_received, "the way from node retalis to the topic")
        for number in range(100, 110):
            self.event(f"state('\"{number}\"')")
        state.wait_for(lambda messages: messages and messages[-1].data == "109")
        state.close()
        late_joiner = Collector("state", String)
        late_joiner.wait_for(bool, "the latched message")
        self.event("state('\"110\"')")
        late_joiner.wait_for(lambda messages: messages and messages[-1].data == "110")
        self.assertEqual([message.data for message in late_joiner.messages], ["109", "110"])


if __name__ == "__main__":
    rospy.init_node("outputs")
    rostest.rosrun("retalis", "outputs", Outputs)
