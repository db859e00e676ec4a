#!/usr/bin/env python3
"""Malformed requests, texts, messages and headers to a running node, which has to answer and continue."""

import sys
import unittest
from pathlib import Path
from xmlrpc.client import ServerProxy

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parent)]
from fuzz.services import FIELDS, Inputs  # noqa: E402
from harness import PATIENCE, Collector, RawPublisher, open_the_way, service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

NODES = ("/retalis", "/retalis_ros_interface")
WARM, GROWTH = 300, 50 << 10
"""Requests after which a node should have what it needs, and kB by which it may grow all the same."""

EACH = 50
"""Inputs from one sign of life to the next."""

CONNECTIONS = 40
"""Publishers with a header of their own: each is a connection that has to be made."""


def numbers():
    """Return how many inputs the command line asks for, and the seed."""
    given = [int(word) for word in sys.argv[1:] if word.isdigit()]
    return (*given, 1)[:2] if given else (1500, 1)


class RawString:
    """Bytes as they are, said to be of a type."""

    def __init__(self, topic, kind, definition, md5sum):
        members = {"_type": kind, "_full_text": definition, "_md5sum": md5sum, "_has_header": False}
        self.kind = type("Sent", (rospy.AnyMsg,), {**members, "__slots__": ["_buff"], "_slot_types": []})
        self.publisher = rospy.Publisher(topic, self.kind, queue_size=100)


class Hostile(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        open_the_way()
        cls.count, cls.seed = numbers()
        cls.inputs = Inputs(cls.seed)
        kinds = {
            name: getattr(srv, "".join(word.capitalize() for word in name.split("_"))) for name in FIELDS
        }
        cls.services = {name: service(name, kind) for name, kind in kinds.items()}
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        cls.to_topics = rospy.Publisher("retalisOutputEvents", String, queue_size=5000)
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.log = Collector("/rosout_agg", Log)
        wait_until(lambda: cls.events.get_num_connections() > 0 and cls.outputs.connected(), "node retalis")
        wait_until(lambda: cls.to_topics.get_num_connections() > 1, "the interface")
        cls.processes = cls.pids()
        cls.lives = 0
        added = cls.services["add_output_subscription"]("alive(X)", "", "_", "alive", "alive").result
        assert added == "ok", added

    @classmethod
    def pids(cls):
        """Return the processes of the nodes."""
        master = rospy.get_master()
        return [ServerProxy(master.lookupNode(node)[2]).getPid("/hostile")[2] for node in NODES]

    def resident(self):
        """Return the memory of each node in kB."""
        return [
            int(Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0])
            for pid in self.processes
        ]

    def assert_alive(self):
        """Send an event through the engine and wait until it comes out."""
        type(self).lives += 1
        text = f"event(alive({self.lives}),alive,alive)"

        def came():
            return any(message.data == text for message in self.outputs.messages)

        self.events.publish(f"event(alive({self.lives}))")
        wait_until(came, f"a sign of life after input {self.lives * EACH}")
        del self.outputs.messages[:]

    def test_requests_are_answered(self):
        before = None
        for number in range(self.count):
            name, fields = self.inputs.request(number)
            result = self.services[name](*fields).result
            self.assertTrue(result == "ok" or result.startswith("error: "), (number, name, fields, result))
            self.assertNotIn("\n", result, (number, name, fields))
            self.events.publish(f"event(a({number}))")
            if number % EACH == 0:
                self.assert_alive()
            if number == WARM:
                before = self.resident()
        self.assert_alive()
        if before is not None:
            for then, now in zip(before, self.resident()):
                self.assertLess(now - then, GROWTH)

    def test_texts(self):
        for number in range(self.count):
            text = self.inputs.text(number)
            self.events.publish(text)
            self.to_topics.publish(text)
            if number % EACH == 0:
                self.assert_alive()
        self.assert_alive()

    def test_messages(self):
        publisher = RawPublisher("fuzz_messages", self.inputs.definition)
        texts = RawPublisher("retalisInputEvents", self.inputs.known.find("std_msgs/String"))
        result = self.services["add_input_subscription"]("fuzz_messages", "fuzz/A").result
        self.assertEqual(result, "ok")
        # One that has connected for a topic of the headers and says nothing holds up the others for a minute.
        wait_until(lambda: publisher.connected() and texts.connected(), "the subscribers", 3 * PATIENCE)
        for number in range(self.count):
            publisher.publish(self.inputs.message(number))
            texts.publish(self.inputs.message(number))
            if number % EACH == 0:
                self.assert_alive()
        self.assert_alive()

    def test_headers(self):
        for number in range(min(CONNECTIONS, self.count)):
            kind, definition, md5sum = self.inputs.header(number)
            topic = f"fuzz_header_{number}"
            try:
                sent = RawString(topic, kind, definition, md5sum)
            except (ValueError, rospy.ROSException):  # rospy itself refuses to send it
                continue
            self.services["add_input_subscription"](topic, "fuzz/A")
            message = sent.kind()
            message._buff = bytes(8)
            sent.publisher.publish(message)
            self.assert_alive()
            sent.publisher.unregister()
            self.services["delete_input_subscription"](topic)

    def tearDown(self):
        self.assertEqual(self.pids(), self.processes)
        wrong = [
            one.msg for one in self.log.messages if "internal error" in one.msg or "Traceback" in one.msg
        ]
        self.assertEqual(wrong, [])


if __name__ == "__main__":
    rospy.init_node("hostile")
    rostest.rosrun("retalis", "hostile", Hostile)
