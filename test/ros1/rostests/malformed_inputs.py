#!/usr/bin/env python3
"""Malformed requests, texts, messages and headers: the node answers and continues."""

import sys
import unittest
from pathlib import Path
from typing import Any, List
from xmlrpc.client import ServerProxy

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

TEST = Path(__file__).resolve().parents[2]
sys.path += [str(TEST / "ros1"), str(TEST)]
from fuzz.live_node_inputs import FIELDS, Inputs  # noqa: E402
from harness import (  # noqa: E402
    TIMEOUT_SECONDS,
    Collector,
    RawPublisher,
    wait_for_message_path,
    wait_for_service,
    wait_until,
)

from retalis import srv  # noqa: E402

NODES = ("/retalis", "/retalis_ros_interface")
WARM_UP_REQUESTS, MAX_GROWTH_KILOBYTES = 300, 50 << 10
"""Requests after which the memory of a node should be constant, and kB by which it may still grow."""

INPUTS_PER_CHECK = 50
"""Number of inputs after which a check follows that the node still processes events."""

MAX_HEADERS = 40
"""Maximum number of publishers with different headers: each needs a connection."""


def read_arguments() -> Any:
    """Return the number of inputs and the seed from the command line."""
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    return (*numbers, 1)[:2] if numbers else (1500, 1)


class RawHeaderPublisher:
    """Publisher with an arbitrary type, definition and checksum in its connection header."""

    def __init__(self, topic: Any, message_type: Any, definition: Any, md5sum: Any) -> None:
        members = {"_type": message_type, "_full_text": definition, "_md5sum": md5sum, "_has_header": False}
        self.message_class = type(
            "Sent", (rospy.AnyMsg,), {**members, "__slots__": ["_buff"], "_slot_types": []}
        )
        self.publisher = rospy.Publisher(topic, self.message_class, queue_size=100)


class MalformedInputsTest(unittest.TestCase):
    seed: Any
    inputs: Any
    services: Any
    events: rospy.Publisher
    to_topics: rospy.Publisher
    outputs: Collector
    log: Collector
    processes: Any
    check_count: int
    count: Any

    @classmethod
    def setUpClass(cls) -> None:
        wait_for_message_path()
        cls.count, cls.seed = read_arguments()
        cls.inputs = Inputs(cls.seed)
        service_types = {
            name: getattr(srv, "".join(word.capitalize() for word in name.split("_"))) for name in FIELDS
        }
        cls.services = {
            name: wait_for_service(name, message_type) for name, message_type in service_types.items()
        }
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        cls.to_topics = rospy.Publisher("retalisOutputEvents", String, queue_size=5000)
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.log = Collector("/rosout_agg", Log)
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        wait_until(lambda: cls.to_topics.get_num_connections() > 1, "the interface")
        cls.processes = cls.pids()
        cls.check_count = 0
        added = cls.services["add_output_subscription"]("alive(X)", "", "_", "alive", "alive").result
        assert added == "ok", added

    @classmethod
    def pids(cls) -> List[Any]:
        """Return the processes of the nodes."""
        master = rospy.get_master()
        servers: List[Any] = [ServerProxy(master.lookupNode(node)[2]) for node in NODES]
        return [server.getPid("/malformed_inputs")[2] for server in servers]

    def resident(self) -> List[int]:
        """Return the memory of each node in kB."""
        return [
            int(Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0])
            for pid in self.processes
        ]

    def assert_alive(self) -> None:
        """Send an event to the engine and wait for its output."""
        type(self).check_count += 1
        text = f"event(alive({self.check_count}),alive,alive)"

        def is_received() -> bool:
            return any(message.data == text for message in self.outputs.messages)

        self.events.publish(f"event(alive({self.check_count}))")
        wait_until(is_received, f"a sign of life after input {self.check_count * INPUTS_PER_CHECK}")
        del self.outputs.messages[:]

    def test_malformed_requests_are_answered(self) -> None:
        before = None
        for number in range(self.count):
            name, fields = self.inputs.request(number)
            result = self.services[name](*fields).result
            self.assertTrue(result == "ok" or result.startswith("error: "), (number, name, fields, result))
            self.assertNotIn("\n", result, (number, name, fields))
            self.events.publish(f"event(a({number}))")
            if number % INPUTS_PER_CHECK == 0:
                self.assert_alive()
            if number == WARM_UP_REQUESTS:
                before = self.resident()
        self.assert_alive()
        if before is not None:
            for old_size, new_size in zip(before, self.resident()):
                self.assertLess(new_size - old_size, MAX_GROWTH_KILOBYTES)

    def test_malformed_texts_are_ignored(self) -> None:
        for number in range(self.count):
            text = self.inputs.text(number)
            self.events.publish(text)
            self.to_topics.publish(text)
            if number % INPUTS_PER_CHECK == 0:
                self.assert_alive()
        self.assert_alive()

    def test_malformed_messages_are_ignored(self) -> None:
        publisher = RawPublisher("fuzz_messages", self.inputs.definition)
        texts = RawPublisher("retalisInputEvents", self.inputs.known.find("std_msgs/String"))
        result = self.services["add_input_subscription"]("fuzz_messages", "fuzz/A").result
        self.assertEqual(result, "ok")
        # A connection of test_malformed_headers_are_ignored that sends nothing blocks the others for a minute.
        wait_until(
            lambda: publisher.is_connected() and texts.is_connected(), "the subscribers", 3 * TIMEOUT_SECONDS
        )
        for number in range(self.count):
            publisher.publish(self.inputs.message(number))
            texts.publish(self.inputs.message(number))
            if number % INPUTS_PER_CHECK == 0:
                self.assert_alive()
        self.assert_alive()

    def test_malformed_headers_are_ignored(self) -> None:
        for number in range(min(MAX_HEADERS, self.count)):
            message_type, definition, md5sum = self.inputs.header(number)
            topic = f"fuzz_header_{number}"
            try:
                header_publisher = RawHeaderPublisher(topic, message_type, definition, md5sum)
            except (ValueError, rospy.ROSException):  # rospy itself refuses to send it
                continue
            self.services["add_input_subscription"](topic, "fuzz/A")
            message = header_publisher.message_class()
            message._buff = bytes(8)
            header_publisher.publisher.publish(message)
            self.assert_alive()
            header_publisher.publisher.unregister()
            self.services["delete_input_subscription"](topic)

    def tearDown(self) -> None:
        self.assertEqual(self.pids(), self.processes)
        internal_errors = [
            record.msg
            for record in self.log.messages
            if "internal error" in record.msg or "Traceback" in record.msg
        ]
        self.assertEqual(internal_errors, [])


if __name__ == "__main__":
    rospy.init_node("malformed_inputs")
    rostest.rosrun("retalis", "malformed_inputs", MalformedInputsTest)
