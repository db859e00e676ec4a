"""Helpers of the tests with a master: publishers of raw bytes, and waits for messages."""

import signal
import subprocess
import threading
import time
from http.client import HTTPException
from typing import Any, Dict, List, Optional
from xmlrpc.client import Error, ServerProxy

import roslib.packages
import rosnode
import rospy
from std_msgs.msg import String

from retalis import Definitions
from retalis.ros1.connection_writer import serialized_class
from retalis.srv import AddInputSubscription, AddOutputSubscription

TIMEOUT_SECONDS = 60.0
"""Seconds after which a test that waits fails."""


def wait_until(condition: Any, description: str, timeout: Any = TIMEOUT_SECONDS, pause: float = 0.01) -> None:
    """Wait until a condition holds, in real time: simulated time stands still in most tests.

    Args:
        condition: returns whether the condition holds.
        description: the condition, for the error.
        timeout: seconds after which the test fails.
        pause: seconds between two calls of ``condition``.
    """
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {timeout:.0f} s in vain for {description}")
        if rospy.is_shutdown():
            raise AssertionError(f"shut down while waiting for {description}")
        time.sleep(pause)


class Collector:
    """Subscriber that stores the messages of a topic."""

    def __init__(self, topic: Any, message_class: Any) -> None:
        self.topic = topic
        self.messages: List[Any] = []
        self._changed = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, message_class, self._store, queue_size=10_000)

    def _store(self, message: Any) -> None:
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def wait_for(self, condition: Any, description: str = "messages") -> List[Any]:
        """Wait until ``condition`` holds for the list of messages; return the list."""
        with self._changed:
            if not self._changed.wait_for(lambda: condition(self.messages), TIMEOUT_SECONDS):
                last_messages = [str(message)[:200] for message in self.messages[-5:]]
                raise AssertionError(
                    f"waited in vain for {description} on {self.topic}; the last messages: {last_messages}"
                )
            return list(self.messages)

    def is_connected(self) -> bool:
        """Return whether a publisher is connected, so that all messages that it sends from now on are received.

        rospy also counts connections that are not established yet. If many are opened at once, it retries some after
        a second.
        """
        return any(map(is_served_by_publisher, self._established_connections()))

    def publishers(self) -> List[Any]:
        """Return the names of the connected publishers; see `is_connected`."""
        return [
            link.header["callerid"]
            for link in self._established_connections()
            if is_served_by_publisher(link)
        ]

    def _established_connections(self) -> List[Any]:
        return [link for link in self._subscriber.impl.connections if link.header]

    def close(self) -> None:
        self._subscriber.unregister()


def is_served_by_publisher(link: Any) -> bool:
    """Return whether the publisher sends messages to a connection.

    It writes its header earlier. A message that it publishes in between is not sent to this subscriber.
    """
    try:
        publisher: Any
        with ServerProxy(link.endpoint_id) as publisher:
            bus_info = publisher.getBusInfo(rospy.get_name())[2]
    except (OSError, Error, HTTPException):  # the publisher is ending
        return False
    own_endpoint = f":{link.local_endpoint[1]} on socket "
    return any(own_endpoint in description for *_, description in bus_info)


class RawPublisher:
    """Publisher of bytes as messages of a type that need not be installed."""

    def __init__(self, topic: Any, definition: Any, latch: bool = False) -> None:
        self.message_class = serialized_class(definition)
        self.publisher = rospy.Publisher(topic, self.message_class, queue_size=10_000, latch=latch)

    def publish(self, data: bytes) -> None:
        message = self.message_class()
        message._buff = data
        self.publisher.publish(message)

    def is_connected(self) -> bool:
        return self.publisher.get_num_connections() > 0

    def close(self) -> None:
        self.publisher.unregister()


ENGINE, INTERFACE = "retalis", "retalis_ros_interface"
"""Names of the two nodes in the launch file."""

_NODE_TYPES = {ENGINE: "retalis_node", INTERFACE: "retalis_ros_converter.py"}


class NodeProcesses:
    """The two nodes, started and ended one by one.

    Args:
        program: folder of the program.
        arguments: remappings and parameters of both nodes.
    """

    def __init__(self, program: Any, *arguments: Any) -> None:
        self._arguments = [f"_program:={program}", *arguments]
        self._running: Dict[Any, Any] = {}

    def start(self, name: Any, *arguments: Any) -> None:
        """Start a node, with further arguments of its own."""
        program = roslib.packages.find_node("retalis", _NODE_TYPES[name])[0]
        command = [program, f"__name:={name}", *self._arguments, *arguments]
        self._running[name] = subprocess.Popen(command, start_new_session=True)

    def end(self, number: Any, *names: Any) -> None:
        """End nodes together by a signal, and check their exit status."""
        for name in names:
            process = self._running[name]
            assert process.poll() is None, f"node {name} has ended"
            process.send_signal(number)
        for name in names:
            status = self._wait_for_end(name)
            expected = 0 if number == signal.SIGINT else -number
            assert status == expected, f"exit status of node {name}: {status}"

    def shut_down(self, name: Any) -> None:
        """End a node by a request of another node, as `rosnode kill` does, and check its exit status."""
        assert rosnode.kill_nodes([f"/{name}"]) == ([f"/{name}"], [])
        status = self._wait_for_end(name)
        assert status == 0, f"exit status of node {name}: {status}"

    def end_all(self) -> None:
        """Interrupt the nodes that still run; kill those that do not end, which is an error."""
        for process in self._running.values():
            process.send_signal(signal.SIGINT)
        hanging_nodes = [name for name in list(self._running) if self._wait_for_end(name) is None]
        assert not hanging_nodes, f"nodes that did not end: {hanging_nodes}"

    def _wait_for_end(self, name: Any) -> Optional[int]:
        """Return the exit status of a node; None if it has to be killed."""
        process = self._running.pop(name)
        try:
            return int(process.wait(TIMEOUT_SECONDS))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return None


def wait_for_service(name: str, service_class: Any) -> Any:
    """Wait until a service is offered; return its proxy."""
    rospy.wait_for_service(name, TIMEOUT_SECONDS)
    return rospy.ServiceProxy(name, service_class)


def wait_for_message_path() -> None:
    """Wait until a message on an input topic passes through the engine to an output topic, in any configuration."""
    result = wait_for_service("add_input_subscription", AddInputSubscription)(
        "probe", "std_msgs/String"
    ).result
    assert result == "ok", result
    subscribe = wait_for_service("add_output_subscription", AddOutputSubscription)
    result = subscribe("std_msgs__0__String('\"probe\"')", "", "_", "face_by_marker", "probe").result
    assert result == "ok", result
    probe = rospy.Publisher("probe", String, queue_size=10)
    outputs = Collector("face_by_marker", String)

    def is_returned() -> bool:
        probe.publish("probe")
        return any(message.data == "probe" for message in outputs.messages)

    try:
        wait_until(is_returned, "the path through the nodes")
    finally:
        probe.unregister()
        outputs.close()


DEFINITIONS = Definitions()
