"""A node with simulated time, as a test sees it: its clock, its topics and two of its services."""

import threading
from importlib import import_module
from typing import Any, Dict, Iterable, List, Tuple

from rclpy.qos import DurabilityPolicy, QoSProfile
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from rosgraph_msgs.msg import Clock

from retalis.srv import List as ListService
from retalis.srv import Query

DEPTH = 1000
STATIC_TRANSFORMS = "/tf_static"
SECOND = 10**9


def message_class(message_type: str) -> Any:
    """Return the class of a type, such as ``std_msgs/msg/String``."""
    package, _, name = message_type.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


class SimulatedTimeNode:
    """A running node with simulated time; see `LiveNode`.

    Args:
        network: the nodes of the test.
        inputs: types by topic, of the messages that the test publishes.
        outputs: types by topic, of the messages that it receives.
        name: full name of the node.
    """

    def __init__(
        self, network: Network, inputs: Dict[str, str], outputs: Dict[str, str], name: str = "/retalis"
    ) -> None:
        self._peer = network.add_node()
        self._outputs: List[Tuple[str, bytes]] = []
        self._clock = self._peer.create_publisher(Clock, "/clock", 10)
        self._publishers = {topic: self._create_publisher(topic, name) for topic, name in inputs.items()}
        self._sent = dict.fromkeys(inputs, 0)
        for topic, message_type in outputs.items():
            self._subscribe(topic, message_class(message_type))
        self._clients = {
            service_class: self._peer.create_client(service_class, f"{name}/{service}")
            for service_class, service in ((ListService, "list"), (Query, "query"))
        }
        for client in self._clients.values():
            assert client.wait_for_service(TIMEOUT_SECONDS)
        # A node that continues from a checkpoint has sent some before.
        self._taken_count = self._count_sent()
        for publisher in (self._clock, *self._publishers.values()):
            wait_until(publisher.get_subscription_count)
        for topic in outputs:
            wait_until(lambda: self._peer.count_publishers(topic))  # noqa: B023 - called at once

    def _create_publisher(self, topic: str, message_type: str) -> Any:
        durability = (
            DurabilityPolicy.TRANSIENT_LOCAL if topic == STATIC_TRANSFORMS else DurabilityPolicy.VOLATILE
        )
        return self._peer.create_publisher(
            message_class(message_type), topic, QoSProfile(depth=DEPTH, durability=durability)
        )

    def _subscribe(self, topic: str, message_class: Any) -> None:
        self._peer.create_subscription(
            message_class, topic, lambda data: self._outputs.append((topic, data)), DEPTH, raw=True
        )

    def _call(self, service_class: Any, **fields: Any) -> Any:
        """Return the response of a service, without the pauses of `wait_until`."""
        is_done = threading.Event()
        future = self._clients[service_class].call_async(service_class.Request(**fields))
        future.add_done_callback(lambda future: is_done.set())
        assert is_done.wait(TIMEOUT_SECONDS)
        response = future.result()
        assert response.result == "ok", response.result
        return response

    def list(self) -> Any:
        """Return the response of the service ``~list``."""
        return self._call(ListService)

    def query(self, goal: str) -> List[str]:
        """Return the values of the variables of a goal, in all solutions."""
        solutions = self._call(Query, goal=goal).solutions
        return [binding.text for solution in solutions for binding in solution.bindings]

    def publish_clock(self, instant: int) -> None:
        """Publish an instant in ns on ``/clock``."""
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(instant, SECOND)
        self._clock.publish(clock)

    def set_time(self, instant: int) -> None:
        """See `LiveNode`."""
        self.publish_clock(instant)

        def is_received() -> bool:
            now = self.list().now
            return now.sec * SECOND + now.nanosec == instant

        wait_until(is_received)

    def publish(self, topic: str, data: bytes) -> None:
        """See `LiveNode`."""
        self._sent[topic] += 1
        self._publishers[topic].publish(data)
        self._wait_for_messages()
        # A goal runs after the messages that were received before it.
        self.query("true")

    def play(self, messages: Iterable[Tuple[int, str, bytes]]) -> None:
        """Publish messages and their instants in ns at once, and wait until the node has received them."""
        for instant, topic, data in messages:
            self.publish_clock(instant)
            self._sent[topic] += 1
            self._publishers[topic].publish(data)
        self._wait_for_messages()

    def _wait_for_messages(self) -> None:
        expected = {topic.strip("/"): count for topic, count in self._sent.items()}

        def are_received() -> bool:
            received = {entry.topic.strip("/"): int(entry.messages) for entry in self.list().inputs}
            return expected.items() <= received.items()

        wait_until(are_received)

    def receive_outputs(self) -> List[Tuple[str, bytes]]:
        """See `LiveNode`."""
        self.query("true")
        expected = self._count_sent() - self._taken_count
        wait_until(lambda: len(self._outputs) >= expected)
        outputs = self._outputs[:]
        self._taken_count += len(outputs)
        del self._outputs[: len(outputs)]
        return outputs

    def _count_sent(self) -> int:
        return sum(int(subscription.sent) for subscription in self.list().subscriptions)
