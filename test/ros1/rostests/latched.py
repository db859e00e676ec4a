#!/usr/bin/env python3
"""Delivery of latched messages for all orders in which nodes and publisher are started and restarted."""

import os
import signal
import subprocess
import sys
import time
import unittest
from itertools import permutations
from pathlib import Path
from typing import Any, Dict, List, Tuple

import rosgraph
import roslib.packages
import rospy
import rostest
from std_msgs.msg import Int32, String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import DEFINITIONS, TIMEOUT_SECONDS, Collector, RawPublisher, wait_until  # noqa: E402

from retalis import Operators  # noqa: E402
from retalis.prolog.syntax.term_reader import read_term  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "latched"
NODES = {"retalis": "retalis_node", "retalis_ros_interface": "retalis_ros_converter.py"}
DIRECT = ["tf_static", "tf2_msgs/TFMessage", "map", "nav_msgs/OccupancyGrid", "news", "std_msgs/Int32"]
HEADER = "std_msgs__0__Header(1,[0,0],'\"odom\"')"
POSE = "geometry_msgs__0__Pose(geometry_msgs__0__Point(0.0,0.0,0.0),geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0))"
LATCHED = {
    "tf_static": (
        "tf2_msgs/TFMessage",
        f"tf2_msgs__0__TFMessage([geometry_msgs__0__TransformStamped({HEADER},'\"base\"',"
        "geometry_msgs__0__Transform(geometry_msgs__0__Vector3(1.0,2.0,3.0),"
        "geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0)))])",
    ),
    "map": (
        "nav_msgs/OccupancyGrid",
        f"nav_msgs__0__OccupancyGrid({HEADER},nav_msgs__0__MapMetaData([0,0],0.05,100,100,{POSE}),"
        f"[{','.join(['-1', '0', '100', '50'] * 2500)}])",
    ),
}


def encoded_message(topic: str) -> bytes:
    type_name, text = LATCHED[topic]
    term = read_term(text, Operators.prolog()).term
    return DEFINITIONS.encoder(type_name).encode(term, topic)


def executable(name: Any) -> Any:
    """Return the path of a node; rosrun would start several processes to find it."""
    return roslib.packages.find_node("retalis", name)[0]


def publish() -> None:
    """Publish the latched messages in a separate process: rospy is slow to reconnect within a process."""
    rospy.init_node("publisher")
    for topic, (type_name, _) in LATCHED.items():
        RawPublisher(topic, DEFINITIONS.find(type_name), latch=True).publish(encoded_message(topic))
    rospy.spin()


class Nodes(unittest.TestCase):
    """Base of tests that start and end nodes."""

    all_orders = False

    def setUp(self) -> None:
        self.running: Dict[Any, Any] = {}
        self.options = ["_direct:=false"]
        self.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        self.news = rospy.Publisher("news", Int32, queue_size=100)
        self.outputs = Collector("retalisOutputEvents", String)
        self.request_count = 0
        self.addCleanup(self.outputs.close)
        self.addCleanup(self.end_all)

    def start(self, name: str) -> None:
        """Start a node or the publisher and wait until it is ready."""
        command = [sys.executable, __file__, "publisher"]
        if name in NODES:
            command = [
                executable(NODES[name]),
                f"__name:={name}",
                f"_program:={PROGRAM}",
                *self.options,
            ]
        self.running[name] = subprocess.Popen(command, start_new_session=True)
        wait_until(lambda: self.is_ready(name), f"node {name}", pause=0.05)

    def is_ready(self, name: Any) -> bool:
        """Return whether a node is ready: it offers its last service and subscribes to its topics."""
        published, subscribed, offered = rosgraph.Master("/latched").getSystemState()
        if name == "publisher":
            return all("/publisher" in dict(published).get(f"/{topic}", ()) for topic in LATCHED)
        service = "/delete_memory" if name == "retalis" else "/delete_input_subscription"
        topic = "/retalisInputEvents" if name == "retalis" else "/retalisOutputEvents"
        return f"/{name}" in dict(offered).get(service, ()) and f"/{name}" in dict(subscribed).get(topic, ())

    def end(self, name: str, number: Any = signal.SIGINT) -> None:
        process = self.running.pop(name)
        os.killpg(process.pid, number)
        process.wait(TIMEOUT_SECONDS)
        if number == signal.SIGKILL:
            subprocess.run(["rosnode", "cleanup"], input=b"y\n", stdout=subprocess.DEVNULL, check=True)

    def end_all(self) -> None:
        for name in list(self.running):
            self.end(name)
        self.events.unregister()
        self.news.unregister()

    def received_messages(self) -> Any:
        """Return the counts of latched messages that the engine has received, and the other messages."""
        self.request_count += 1
        begin = f"event(there({self.request_count},"
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while True:
            self.events.publish(f"event(ask({self.request_count}))")
            time.sleep(0.05)
            for message in self.outputs.messages:
                if message.data.startswith(begin):
                    return message.data[len(begin) :].partition("),there")[0]
            self.assertLess(time.monotonic(), deadline, "the engine does not answer")

    def expect(self, expected: str) -> None:
        """Wait until the engine has received the expected messages, and check that it receives no others."""
        answers: List[Any] = []

        def is_expected() -> bool:
            answers.append(self.received_messages())
            return answers[-1] == expected

        try:
            wait_until(is_expected, expected)
        except AssertionError as error:
            self.fail(f"{error}; found {answers[-3:]}")
        for _ in range(5):
            self.assertEqual(self.received_messages(), expected)

    def check_orders(self, names: Tuple[Any, ...], restarted: Any = (), counts: Any = ()) -> None:
        """Start nodes in some order and in its reverse, or in each order; after the last, restart some.

        With all orders, some are restarted after the first as well. A restart is a start as the last node, so
        restarts in the other orders add no case.
        """
        orders = list(permutations(names))
        orders_with_restarts = [orders[0], orders[-1]]
        if not self.all_orders:
            orders, orders_with_restarts = orders_with_restarts, orders[-1:]
        for order in orders:
            with self.subTest(order=order):
                for name in order:
                    self.start(name)
                self.expect("1,1,[]")
                restarts = zip(restarted, counts) if order in orders_with_restarts else ()
                for name, count in restarts:
                    self.end(name, signal.SIGKILL if name == "retalis" and count == 1 else signal.SIGINT)
                    self.start(name)
                    self.expect(f"{count},{count},[]")
                for name in names:
                    self.end(name)

    def check_reconnection(self, *names: Any) -> None:
        """Close the connection of a publisher: its repeated latched message is no event, a new message is one."""
        publisher = RawPublisher("map", DEFINITIONS.find("nav_msgs/OccupancyGrid"), latch=True)
        self.addCleanup(publisher.publisher.unregister)
        publisher.publish(encoded_message("map"))
        for name in names:
            self.start(name)
        self.expect("0,1,[]")
        for count in (2, 3):
            before = publisher.publisher.impl.connections
            for link in before:
                link.close()

            def is_reconnected(before: Any = before) -> Any:
                return set(publisher.publisher.impl.connections).difference(before)

            # rospy reconnects when the master sends the list of publishers, as it does for an additional publisher.
            other = rosgraph.Master(f"/other{count}")
            other.registerPublisher("/map", "nav_msgs/OccupancyGrid", "http://localhost:1/")
            wait_until(is_reconnected, "the connection")
            other.unregisterPublisher("/map", "http://localhost:1/")
            publisher.publish(encoded_message("map"))  # follows the repeated message
            self.expect(f"0,{count},[]")


class OverText(Nodes):
    def test_repeated_message_of_connection_is_no_event(self) -> None:
        self.check_reconnection("retalis", "retalis_ros_interface")

    def test_latched_messages_are_received_in_all_orders(self) -> None:
        again = ("retalis_ros_interface", "publisher", "retalis", "retalis")
        self.check_orders(("retalis", "retalis_ros_interface", "publisher"), again, (1, 2, 1, 1))

    def test_messages_without_engine_are_buffered(self) -> None:
        for name in ("retalis_ros_interface", "publisher"):
            self.start(name)
        listener = Collector("retalisInputEvents", String)
        self.addCleanup(listener.close)
        wait_until(lambda: self.news.get_num_connections() > 0, "the subscriber of the news")
        wait_until(lambda: "/retalis_ros_interface" in listener.publishers(), "the publisher of the events")
        for number in (1, 2, 3):
            self.news.publish(number)
        listener.wait_for(
            lambda messages: any("Int32(3)" in message.data for message in messages), "the news for others"
        )
        self.start("retalis")
        self.expect("1,1,[1,2,3]")
        self.end("retalis")
        for number in (4, 5):
            self.news.publish(number)
        listener.wait_for(
            lambda messages: any("Int32(5)" in message.data for message in messages), "the news for others"
        )
        self.start("retalis")
        self.news.publish(6)
        self.expect("1,1,[4,5,6]")
        texts = [message.data for message in listener.messages if "Int32" in message.data]
        self.assertEqual(len(texts), 6)


class WithoutText(Nodes):
    def test_direct_topics_are_received_in_all_orders(self) -> None:
        self.options = ["_direct:=[" + ", ".join(DIRECT) + "]"]
        self.check_orders(("retalis", "retalis_ros_interface", "publisher"))

    def test_direct_repeated_message_is_no_event(self) -> None:
        self.options = ["_direct:=[" + ", ".join(DIRECT) + "]"]
        self.check_reconnection("retalis", "retalis_ros_interface")

    def test_embedded_repeated_message_is_no_event(self) -> None:
        self.options = ["_direct:=false", "_embedded:=true"]
        self.check_reconnection("retalis")

    def test_embedded_interface_receives_in_all_orders(self) -> None:
        self.options = ["_direct:=false", "_embedded:=true"]
        self.check_orders(("retalis", "publisher"), ("publisher", "retalis"), (2, 1))


if __name__ == "__main__":
    if "publisher" in sys.argv:
        publish()
        sys.exit()
    rospy.init_node("latched")
    Nodes.all_orders = "all" in sys.argv
    rostest.rosrun("retalis", "latched", OverText if "text" in sys.argv else WithoutText)
