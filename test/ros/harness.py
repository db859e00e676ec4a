"""Helpers of the tests on a real master: publishers of raw bytes, and waiting for messages."""

import threading
import time
from http.client import HTTPException
from xmlrpc.client import Error, ServerProxy

import rospy
from std_msgs.msg import String

from retalis import Definitions
from retalis.ros.connection_writer import serialized_class
from retalis.srv import AddInputSubscription, AddOutputSubscription

PATIENCE = 60.0
"""Seconds after which a test gives up waiting."""


def wait_until(condition, what, patience=PATIENCE, pause=0.01):
    """Wait for a condition in real time (simulated time stands still in most tests); look again after each pause."""
    deadline = time.monotonic() + patience
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {patience:.0f} s in vain for {what}")
        if rospy.is_shutdown():
            raise AssertionError(f"shut down while waiting for {what}")
        time.sleep(pause)


class Collector:
    """Collects the messages of a topic."""

    def __init__(self, topic, kind):
        self.topic = topic
        self.messages = []
        self._changed = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, kind, self._take, queue_size=10_000)

    def _take(self, message):
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def wait_for(self, condition, what="messages"):
        """Wait until ``condition`` holds for the list of messages; return the list."""
        with self._changed:
            if not self._changed.wait_for(lambda: condition(self.messages), PATIENCE):
                got = [str(message)[:200] for message in self.messages[-5:]]
                raise AssertionError(f"waited in vain for {what} on {self.topic}; the last ones: {got}")
            return list(self.messages)

    def connected(self):
        """Tell whether a publisher is there, and what it sends from now on comes.

        rospy counts a connection that it is only trying to make. Of many that are made at once some have to be tried
        again, a second later.
        """
        return any(map(sends_to, self._answered()))

    def publishers(self):
        """Return the nodes of which what they send from now on comes."""
        return [link.header["callerid"] for link in self._answered() if sends_to(link)]

    def _answered(self):
        return [link for link in self._subscriber.impl.connections if link.header]

    def close(self):
        self._subscriber.unregister()


def sends_to(link):
    """Tell whether the publisher at the other end of a connection has it among those that it sends to.

    It writes its header first: what it publishes between the two goes to the others only, and never comes here.
    """
    try:
        with ServerProxy(link.endpoint_id) as publisher:
            known = publisher.getBusInfo(rospy.get_name())[2]
    except (OSError, Error, HTTPException):  # it is just ending
        return False
    here = f":{link.local_endpoint[1]} on socket "
    return any(here in described for *_, described in known)


class RawPublisher:
    """Publishes bytes as messages of a type, whether the type is installed or not."""

    def __init__(self, topic, definition, latch=False):
        self.kind = serialized_class(definition)
        self.publisher = rospy.Publisher(topic, self.kind, queue_size=10_000, latch=latch)

    def publish(self, data):
        message = self.kind()
        message._buff = data
        self.publisher.publish(message)

    def connected(self):
        return self.publisher.get_num_connections() > 0


def service(name, kind):
    """Return a service's proxy once it is there."""
    rospy.wait_for_service(name, PATIENCE)
    return rospy.ServiceProxy(name, kind)


def open_the_way():
    """Return when messages get from a topic through the engine to a topic, whichever nodes are in between."""
    added = service("add_input_subscription", AddInputSubscription)("probe", "std_msgs/String").result
    assert added == "ok", added
    subscribe = service("add_output_subscription", AddOutputSubscription)
    added = subscribe("std_msgs__0__String('\"probe\"')", "", "_", "face_by_marker", "probe").result
    assert added == "ok", added
    probe = rospy.Publisher("probe", String, queue_size=10)
    back = Collector("face_by_marker", String)

    def answered():
        probe.publish("probe")
        return any(message.data == "probe" for message in back.messages)

    wait_until(answered, "the way through the nodes")


DEFINITIONS = Definitions()
