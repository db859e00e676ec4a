#!/usr/bin/env python3
"""Faults of other nodes: receivers that stop, bursts, and publishers that change the type of a topic."""

import signal
import subprocess
import sys
import unittest
from pathlib import Path
from struct import pack
from typing import Any
from xmlrpc.client import ServerProxy

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent / "ros1"))
from harness import DEFINITIONS, Collector, RawPublisher, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

BURST_MESSAGES = 50_000
TEXT_CHARACTERS = 2000
"""Length of a text: the buffers of a connection hold few of them."""

TEXT_COUNT = 8000
"""Number of texts: more than the connection and the queue (5,000) of a receiver hold."""

MAX_GROWTH_KILOBYTES = 60 << 10
"""kB by which a node may grow for the queue of a stopped receiver."""

LISTENER = """
import rospy
from std_msgs.msg import String
rospy.init_node("stopped", disable_signals=True)
def take(message):
    if message.data == "the last":
        print(message.data, flush=True)
rospy.Subscriber("face_by_marker", String, take, queue_size=10000)
print("ready", flush=True)
rospy.spin()
"""


def node(name: str) -> Any:
    return ServerProxy(rospy.get_master().lookupNode(name)[2])


def resident(name: str) -> int:
    """Return the memory of a node in kB."""
    pid = node(name).getPid("/faults")[2]
    return int(Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0])


def received_count(topic: str) -> Any:
    """Return the number of messages of a topic that node retalis has received."""
    links = dict(node("/retalis").getBusStats("/faults")[2][1])[topic]
    return sum(link[2] for link in links)


class Faults(unittest.TestCase):
    log: Collector
    subscribe: Any
    unsubscribe: Any
    add_input: Any
    strings: Any

    @classmethod
    def setUpClass(cls) -> None:
        wait_for_message_path()
        cls.log = Collector("/rosout", Log)
        wait_until(cls.log.is_connected, "the nodes' log")
        cls.subscribe = staticmethod(wait_for_service("add_output_subscription", srv.AddOutputSubscription))
        cls.unsubscribe = staticmethod(
            wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)
        )
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        cls.strings = DEFINITIONS.find("std_msgs/String")

    def input(self, topic: str) -> Any:
        """Return a publisher whose texts become events."""
        self.assertEqual(self.add_input(topic, "std_msgs/String").result, "ok")
        publisher = RawPublisher(topic, self.strings)
        wait_until(publisher.is_connected, f"a subscriber of {topic}")
        return publisher

    def output(self, pattern: str, key: str) -> None:
        added = self.subscribe(f"std_msgs__0__String({pattern})", "", "_", "face_by_marker", key)
        self.assertEqual(added.result, "ok")
        self.addCleanup(self.unsubscribe, "face_by_marker", key)

    def test_stopped_receiver_does_not_block_others(self) -> None:
        texts = self.input("before_stop")
        self.output("X", "all")
        other = Collector("face_by_marker", String)
        wait_until(other.is_connected, "the other receiver")
        command = [sys.executable, "-c", LISTENER]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
            output: Any = listener.stdout
            try:
                self.assertEqual(output.readline(), "ready\n")
                wait_until(lambda: self.listeners() == 2, "the one that will stop")
                listener.send_signal(signal.SIGSTOP)
                before = resident("/retalis_ros_interface")
                expected = [f"{number} ".ljust(TEXT_CHARACTERS, "x") for number in range(TEXT_COUNT)]
                for text in expected:
                    texts.publish(encode(text))
                other.wait_for(lambda messages: len(messages) >= TEXT_COUNT, "all texts")
                self.assertEqual([message.data for message in other.messages], expected)
                self.assertLess(resident("/retalis_ros_interface") - before, MAX_GROWTH_KILOBYTES)
                self.wait_for_report("does not keep up with topic /face_by_marker")
                listener.send_signal(signal.SIGCONT)
                texts.publish(encode("the last"))
                self.assertEqual(output.readline(), "the last\n")
            finally:
                listener.kill()
        other.close()

    def test_burst_is_complete(self) -> None:
        texts = self.input("burst")
        self.output("'\"last\"'", "last")
        last = Collector("face_by_marker", String)
        wait_until(last.is_connected, "the receiver")
        wait_until(
            lambda: "/retalisInputEvents" in dict(node("/retalis").getBusStats("/faults")[2][1]), "texts"
        )
        before = received_count("/retalisInputEvents")
        frame = frame_of("burst")
        (link,) = texts.publisher.impl.connections
        for _ in range(BURST_MESSAGES // 1000):
            getattr(link, "_connection", link).socket.sendall(frame * 1000)
        texts.publish(encode("last"))
        last.wait_for(lambda messages: messages, "the end of the burst")
        wait_until(
            lambda: received_count("/retalisInputEvents") - before > BURST_MESSAGES, "all that was counted"
        )
        last.close()

    def test_changed_type_of_topic_is_refused(self) -> None:
        self.assertEqual(self.add_input("changing", "std_msgs/String").result, "ok")
        self.output("X", "changing")
        outputs = Collector("face_by_marker", String)
        wait_until(outputs.is_connected, "the receiver")
        numbers = DEFINITIONS.find("std_msgs/Int32")
        for turn in range(3):
            number_publisher = self.make_publisher("changing", numbers)
            for _ in range(2**turn // 2 or 1):  # the 1st, 2nd and 4th occurrence are reported
                number_publisher.publish(pack("<i", turn))
            self.wait_for_report("topic /changing: ", "a message of /faults is dropped")
            number_publisher.publisher.unregister()
            text_publisher = self.make_publisher("changing", self.strings)
            text = f"turn {turn}"
            text_publisher.publish(encode(text))
            outputs.wait_for(
                lambda messages, text=text: messages[-1:] and messages[-1].data == text, "the text"
            )
            text_publisher.publisher.unregister()
        outputs.close()

    def make_publisher(self, topic: str, definition: Any) -> Any:
        publisher = RawPublisher(topic, definition)
        wait_until(publisher.is_connected, f"a subscriber of {topic}")
        return publisher

    def listeners(self) -> int:
        statistics = node("/retalis_ros_interface").getBusStats("/faults")[2][0]
        return sum(len(links) for topic, _, links in statistics if topic == "/face_by_marker")

    def wait_for_report(self, *parts: Any) -> None:
        """Wait for a report with all parts, and delete it."""
        self.log.wait_for(
            lambda records: any(all(part in record.msg for part in parts) for record in records),
            f"a report: {parts}",
        )
        del self.log.messages[:]


def encode(text: str) -> bytes:
    return pack("<I", len(text)) + text.encode()


def frame_of(text: str) -> Any:
    data = encode(text)
    return pack("<I", len(data)) + data


if __name__ == "__main__":
    rospy.init_node("faults")
    rostest.rosrun("retalis", "faults", Faults)
