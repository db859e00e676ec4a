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

import rosgraph
import roslib.packages
import rospy
import rostest
from std_msgs.msg import Int32, String

sys.path.append(str(Path(__file__).resolve().parent))
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


def encoded(topic):
    kind, text = LATCHED[topic]
    term = read_term(text, Operators.prolog()).term
    return DEFINITIONS.encoder(kind).encode(term, topic)


def executable(name):
    """Return the path of a node: rosrun starts several processes each time to find it."""
    return roslib.packages.find_node("retalis", name)[0]


def publish():
    """Be the publisher of the latched messages: rospy is slow to come back to one in the same process."""
    rospy.init_node("publisher")
    for topic, (kind, _) in LATCHED.items():
        RawPublisher(topic, DEFINITIONS.find(kind), latch=True).publish(encoded(topic))
    rospy.spin()


class Nodes(unittest.TestCase):
    """Starts nodes and ends them."""

    def setUp(self):
        self.running = {}
        self.options = ["_direct:=false"]
        self.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        self.news = rospy.Publisher("news", Int32, queue_size=100)
        self.outputs = Collector("retalisOutputEvents", String)
        self.asked = 0
        self.addCleanup(self.outputs.close)
        self.addCleanup(self.end_all)

    def start(self, name):
        """Start a node, or the publisher, and wait until it is there."""
        command = [sys.executable, __file__, "publisher"]
        if name in NODES:
            command = [
                executable(NODES[name]),
                f"__name:={name}",
                f"_program:={PROGRAM}",
                *self.options,
            ]
        self.running[name] = subprocess.Popen(command, start_new_session=True)
        wait_until(lambda: self.is_there(name), f"node {name}", pause=0.05)

    def is_there(self, name):
        """Tell whether a node has taken up its work: it offers its last service, and listens."""
        published, subscribed, offered = rosgraph.Master("/latched").getSystemState()
        if name == "publisher":
            return all("/publisher" in dict(published).get(f"/{topic}", ()) for topic in LATCHED)
        service = "/delete_memory" if name == "retalis" else "/delete_input_subscription"
        topic = "/retalisInputEvents" if name == "retalis" else "/retalisOutputEvents"
        return f"/{name}" in dict(offered).get(service, ()) and f"/{name}" in dict(subscribed).get(topic, ())

    def end(self, name, number=signal.SIGINT):
        process = self.running.pop(name)
        os.killpg(process.pid, number)
        process.wait(TIMEOUT_SECONDS)
        if number == signal.SIGKILL:
            subprocess.run(["rosnode", "cleanup"], input=b"y\n", stdout=subprocess.DEVNULL, check=True)

    def end_all(self):
        for name in list(self.running):
            self.end(name)
        self.events.unregister()
        self.news.unregister()

    def there(self):
        """Return what the engine has now: how often each latched message, and the others."""
        self.asked += 1
        begin = f"event(there({self.asked},"
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while True:
            self.events.publish(f"event(ask({self.asked}))")
            time.sleep(0.05)
            for one in self.outputs.messages:
                if one.data.startswith(begin):
                    return one.data[len(begin) :].partition("),there")[0]
            self.assertLess(time.monotonic(), deadline, "the engine does not answer")

    def expect(self, wanted):
        """Wait for an answer, and see that it stays so."""
        found = []

        def has_come():
            found.append(self.there())
            return found[-1] == wanted

        try:
            wait_until(has_come, wanted)
        except AssertionError as error:
            self.fail(f"{error}; found {found[-3:]}")
        for _ in range(5):
            self.assertEqual(self.there(), wanted)

    def orders(self, names, restarted=(), counts=()):
        """Start in each order; after the first and the last, start again what is to be started again.

        To start one again is to start it last, so the orders between would show nothing else.
        """
        every = list(permutations(names))
        for order in every:
            with self.subTest(order=order):
                for name in order:
                    self.start(name)
                self.expect("1,1,[]")
                again = zip(restarted, counts) if order in (every[0], every[-1]) else ()
                for name, count in again:
                    self.end(name, signal.SIGKILL if name == "retalis" and count == 1 else signal.SIGINT)
                    self.start(name)
                    self.expect(f"{count},{count},[]")
                for name in names:
                    self.end(name)

    def reconnects(self, *names):
        """Drop the connection of a publisher: what it sends again when it returns is no event, a new message is."""
        publisher = RawPublisher("map", DEFINITIONS.find("nav_msgs/OccupancyGrid"), latch=True)
        self.addCleanup(publisher.publisher.unregister)
        publisher.publish(encoded("map"))
        for name in names:
            self.start(name)
        self.expect("0,1,[]")
        for count in (2, 3):
            before = publisher.publisher.impl.connections
            for link in before:
                link.close()

            def is_back(before=before):
                return set(publisher.publisher.impl.connections).difference(before)

            # rospy connects again when the master tells of the publishers, as it does when there is another one.
            other = rosgraph.Master(f"/other{count}")
            other.registerPublisher("/map", "nav_msgs/OccupancyGrid", "http://localhost:1/")
            wait_until(is_back, "the connection")
            other.unregisterPublisher("/map", "http://localhost:1/")
            publisher.publish(encoded("map"))  # after what the connection has brought again
            self.expect(f"0,{count},[]")


class OverText(Nodes):
    def test_a_connection_that_returns(self):
        self.reconnects("retalis", "retalis_ros_interface")

    def test_all_orders(self):
        again = ("retalis_ros_interface", "publisher", "retalis", "retalis")
        self.orders(("retalis", "retalis_ros_interface", "publisher"), again, (1, 2, 1, 1))

    def test_what_comes_while_node_retalis_is_away_is_held(self):
        for name in ("retalis_ros_interface", "publisher"):
            self.start(name)
        listener = Collector("retalisInputEvents", String)
        self.addCleanup(listener.close)
        wait_until(lambda: self.news.get_num_connections() > 0, "the subscriber of the news")
        wait_until(lambda: "/retalis_ros_interface" in listener.publishers(), "the publisher of the events")
        for number in (1, 2, 3):
            self.news.publish(number)
        listener.wait_for(lambda all_: any("Int32(3)" in one.data for one in all_), "the news for others")
        self.start("retalis")
        self.expect("1,1,[1,2,3]")
        self.end("retalis")
        for number in (4, 5):
            self.news.publish(number)
        listener.wait_for(lambda all_: any("Int32(5)" in one.data for one in all_), "the news for others")
        self.start("retalis")
        self.news.publish(6)
        self.expect("1,1,[4,5,6]")
        numbers = [one.data for one in listener.messages if "Int32" in one.data]
        self.assertEqual(len(numbers), 6)


class WithoutText(Nodes):
    def test_direct(self):
        self.options = ["_direct:=[" + ", ".join(DIRECT) + "]"]
        self.orders(("retalis", "retalis_ros_interface", "publisher"))

    def test_a_connection_that_returns_direct(self):
        self.options = ["_direct:=[" + ", ".join(DIRECT) + "]"]
        self.reconnects("retalis", "retalis_ros_interface")

    def test_a_connection_that_returns_embedded(self):
        self.options = ["_direct:=false", "_embedded:=true"]
        self.reconnects("retalis")

    def test_embedded(self):
        self.options = ["_direct:=false", "_embedded:=true"]
        self.orders(("retalis", "publisher"), ("publisher", "retalis"), (2, 1))


if __name__ == "__main__":
    if "publisher" in sys.argv:
        sys.exit(publish())
    rospy.init_node("latched")
    rostest.rosrun("retalis", "latched", OverText if "text" in sys.argv else WithoutText)
