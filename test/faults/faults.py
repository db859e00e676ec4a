#!/usr/bin/env python3
"""What goes wrong on a robot, to live nodes: receivers that stop, bursts, publishers that change their type."""

import signal
import subprocess
import sys
import unittest
from pathlib import Path
from struct import pack
from xmlrpc.client import ServerProxy

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent / "ros1"))
from harness import DEFINITIONS, Collector, RawPublisher, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

BURST = 50_000
LONG = 2000
"""Characters of a text of which few fit into a connection."""

TEXTS = 8000
"""More of them than the connection and the queue (5,000) for a receiver hold."""

GROWTH = 60 << 10
"""kB by which a node may grow for what it keeps for a receiver that has stopped."""

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


def node(name):
    return ServerProxy(rospy.get_master().lookupNode(name)[2])


def resident(name):
    """Return the memory of a node in kB."""
    pid = node(name).getPid("/faults")[2]
    return int(Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0])


def received(topic):
    """Return how many messages of a topic node retalis has received."""
    links = dict(node("/retalis").getBusStats("/faults")[2][1])[topic]
    return sum(link[2] for link in links)


class Faults(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        wait_for_message_path()
        cls.log = Collector("/rosout", Log)
        wait_until(cls.log.is_connected, "the nodes' log")
        cls.subscribe = staticmethod(wait_for_service("add_output_subscription", srv.AddOutputSubscription))
        cls.unsubscribe = staticmethod(
            wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)
        )
        cls.add_input = staticmethod(wait_for_service("add_input_subscription", srv.AddInputSubscription))
        cls.strings = DEFINITIONS.find("std_msgs/String")

    def input(self, topic):
        """Return a publisher whose texts become events."""
        self.assertEqual(self.add_input(topic, "std_msgs/String").result, "ok")
        publisher = RawPublisher(topic, self.strings)
        wait_until(publisher.is_connected, f"a subscriber of {topic}")
        return publisher

    def output(self, pattern, key):
        added = self.subscribe(f"std_msgs__0__String({pattern})", "", "_", "face_by_marker", key)
        self.assertEqual(added.result, "ok")
        self.addCleanup(self.unsubscribe, "face_by_marker", key)

    def test_a_receiver_that_stops_holds_up_nobody(self):
        texts = self.input("before_stop")
        self.output("X", "all")
        other = Collector("face_by_marker", String)
        wait_until(other.is_connected, "the other receiver")
        command = [sys.executable, "-c", LISTENER]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
            try:
                self.assertEqual(listener.stdout.readline(), "ready\n")
                wait_until(lambda: self.listeners() == 2, "the one that will stop")
                listener.send_signal(signal.SIGSTOP)
                before = resident("/retalis_ros_interface")
                sent = [f"{number} ".ljust(LONG, "x") for number in range(TEXTS)]
                for text in sent:
                    texts.publish(encoded(text))
                other.wait_for(lambda found: len(found) >= TEXTS, "all texts")
                self.assertEqual([message.data for message in other.messages], sent)
                self.assertLess(resident("/retalis_ros_interface") - before, GROWTH)
                self.reported("does not keep up with topic /face_by_marker")
                listener.send_signal(signal.SIGCONT)
                texts.publish(encoded("the last"))
                self.assertEqual(listener.stdout.readline(), "the last\n")
            finally:
                listener.kill()
        other.close()

    def test_a_burst_arrives_whole_and_in_order(self):
        texts = self.input("burst")
        self.output("'\"last\"'", "last")
        last = Collector("face_by_marker", String)
        wait_until(last.is_connected, "the receiver")
        wait_until(
            lambda: "/retalisInputEvents" in dict(node("/retalis").getBusStats("/faults")[2][1]), "texts"
        )
        before = received("/retalisInputEvents")
        frame = framed("burst")
        (link,) = texts.publisher.impl.connections
        for _ in range(BURST // 1000):
            getattr(link, "_connection", link).socket.sendall(frame * 1000)
        texts.publish(encoded("last"))
        last.wait_for(lambda found: found, "the end of the burst")
        wait_until(lambda: received("/retalisInputEvents") - before > BURST, "all that was counted")
        last.close()

    def test_publishers_that_change_the_type_of_a_topic(self):
        self.assertEqual(self.add_input("changing", "std_msgs/String").result, "ok")
        self.output("X", "changing")
        back = Collector("face_by_marker", String)
        wait_until(back.is_connected, "the receiver")
        numbers = DEFINITIONS.find("std_msgs/Int32")
        for turn in range(3):
            wrong = self.published("changing", numbers)
            for _ in range(2**turn // 2 or 1):  # reports come the 1st, 2nd and 4th time
                wrong.publish(pack("<i", turn))
            self.reported("topic /changing: ", "a message of /faults is dropped")
            wrong.publisher.unregister()
            right = self.published("changing", self.strings)
            right.publish(encoded(f"turn {turn}"))
            back.wait_for(lambda found: found[-1:] and found[-1].data == f"turn {turn}", "the text")  # noqa: B023
            right.publisher.unregister()
        back.close()

    def published(self, topic, definition):
        publisher = RawPublisher(topic, definition)
        wait_until(publisher.is_connected, f"a subscriber of {topic}")
        return publisher

    def listeners(self):
        found = node("/retalis_ros_interface").getBusStats("/faults")[2][0]
        return sum(len(links) for topic, _, links in found if topic == "/face_by_marker")

    def reported(self, *parts):
        """Wait until a report has all these parts, and forget it."""
        self.log.wait_for(
            lambda found: any(all(part in one.msg for part in parts) for one in found), f"a report: {parts}"
        )
        del self.log.messages[:]


def encoded(text):
    return pack("<I", len(text)) + text.encode()


def framed(text):
    data = encoded(text)
    return pack("<I", len(data)) + data


if __name__ == "__main__":
    rospy.init_node("faults")
    rostest.rosrun("retalis", "faults", Faults)
