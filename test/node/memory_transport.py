"""Transport in memory: a middleware without processes, whose time the test advances.

Publishers and subscribers of one `MemoryNetwork` exchange messages at once, in the thread of the publisher.
"""

from types import SimpleNamespace
from typing import Any, Callable, Dict, List, Tuple

from retalis import UsageError
from retalis.events.knowledge.transform_buffer import TransformBuffer
from retalis.events.program.topic_configuration import ANY_QUALITY, QualityOfService
from retalis.foundation.ros_name_checks import topic_fault
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import InstalledTypes
from retalis.node.transport import MessageSource, NodeGraph


class MemoryNetwork:
    """Topics, services and time that several `MemoryTransport` share.

    Attributes:
        now: the time in ns.
        subscriptions: subscriptions by topic.
        publications: publications by topic.
        watches: functions that receive changes within nodes.
        qualities: demands on the quality of service, by the topic that was subscribed or published last.
        services: node and handler by the full name of a service.
        ros_parameters: parameters of the middleware by full name; a transport reads them on request.
        calls: the last call of each service of another node; the test ends it.
    """

    def __init__(self, now: int = 1_000 * 10**9) -> None:
        self.now = now
        self.subscriptions: Dict[Any, Any] = {}
        self.publications: Dict[Any, Any] = {}
        self.qualities: Dict[str, QualityOfService] = {}
        self.watches: List[Any] = []
        self.services: Dict[Any, Any] = {}
        self.calls: Dict[str, Any] = {}
        self.ros_parameters: Dict[str, Any] = {}
        self.timers: List[Any] = []

    def move_time(self, seconds: Any) -> None:
        """Advance the time and call each due timer at its time."""
        end = self.now + int(seconds * 10**9)
        while True:
            due = min(
                (timer for timer in self.timers if timer.instant <= end),
                key=lambda t: t.instant,
                default=None,
            )
            if due is None:
                break
            self.timers.remove(due)
            self.now = max(self.now, due.instant)
            due.callback()
        self.now = end

    def connect(self, publication: Any, subscription: Any) -> None:
        """Connect a publisher and a subscriber of a topic, unless the subscriber ignores its own node."""
        if subscription.ignores_own and publication.source.node == subscription.node:
            return
        subscription.receivers[publication] = subscription.connect(publication.source)
        if publication.source.is_latched and publication.last is not None:
            subscription.receivers[publication].receive([publication.last])

    def call(self, service: Any, **fields: Any) -> Any:
        """Call a service and return the fields of its response."""
        return self.services[service][1](SimpleNamespace(**fields))


class MemorySubscription:
    """A subscription; see `retalis.node.transport.TopicSubscription`."""

    def __init__(self, network: Any, node: Any, topic: Any, connect: Any, ignores_own: Any) -> None:
        self.network, self.node, self.topic, self.connect = network, node, topic, connect
        self.ignores_own = ignores_own
        self.receivers: Dict[Any, Any] = {}

    def publisher_count(self) -> int:
        return len(self.receivers)

    def publishers(self) -> List[Any]:
        return [publication.source.node for publication in self.receivers]

    def close(self) -> None:
        self.network.subscriptions[self.topic].remove(self)


class MemoryPublication:
    """A publication; see `retalis.node.transport.TopicPublication`.

    Attributes:
        messages: the published messages.
    """

    def __init__(self, network: Any, topic: Any, source: Any) -> None:
        self.network, self.topic, self.source = network, topic, source
        self.messages: List[Any] = []
        self.dropped = 0

    @property
    def sent(self) -> int:
        return len(self.messages)

    @property
    def last(self) -> Any:
        return self.messages[-1] if self.messages else None

    def subscriber_count(self) -> int:
        return sum(self in subscription.receivers for subscription in self._subscriptions())

    def send(self, *messages: Any) -> None:
        """Publish messages together."""
        self.messages += messages
        for subscription in self._subscriptions():
            if self in subscription.receivers:
                subscription.receivers[self].receive(list(messages))

    def close(self, is_incomplete: bool = False) -> None:
        """End the connections."""
        self.network.publications[self.topic].remove(self)
        for subscription in self._subscriptions():
            receiver = subscription.receivers.pop(self, None)
            if receiver is not None:
                receiver.close(is_incomplete)

    def _subscriptions(self) -> List[Any]:
        return list(self.network.subscriptions.get(self.topic, ()))


class MemoryTimer:
    """A call that `MemoryTransport.call_later` has scheduled."""

    def __init__(self, network: Any, instant: Any, callback: Any) -> None:
        self.network, self.instant, self.callback = network, instant, callback
        network.timers.append(self)

    def cancel(self) -> None:
        if self in self.network.timers:
            self.network.timers.remove(self)


class MemoryTransport:
    """A node of a network; see `retalis.node.transport.Transport`."""

    def __init__(
        self,
        network: Any,
        node_name: str = "/retalis",
        parameters: Any = None,
        is_time_simulated: bool = False,
        message_format: SerializationFormat = SerializationFormat.ROS1,
        remappings: Any = None,
    ) -> None:
        self.network = network
        self._remappings: Dict[str, str] = remappings or {}
        self.format = message_format
        self.received_formats: Tuple[SerializationFormat, ...] = (self.format,)
        self.node_name = node_name
        self.is_time_simulated = is_time_simulated
        self.create_transform_buffer: Callable[[float], TransformBuffer] = TransformBuffer
        self.clock_callbacks: List[Any] = []
        self.shutdown_callbacks: List[Any] = []
        self.is_ended = False
        self._parameters = parameters or {}
        self._ros_parameters: Dict[str, Any] = {}

    def now(self) -> Any:
        return self.network.now

    def on_clock(self, callback: Any) -> None:
        self.clock_callbacks.append(callback)

    def call_later(self, delay: Any, callback: Any) -> Any:
        return MemoryTimer(self.network, self.network.now + delay, callback).cancel

    def parameters(self) -> Any:
        return dict(self._parameters)

    def refresh_ros_parameters(self) -> None:
        self._ros_parameters = dict(self.network.ros_parameters)

    def ros_parameter(self, name: Any) -> Any:
        return self._ros_parameters[name]

    def resolve_topic(self, topic: Any) -> Any:
        fault = topic_fault(topic)
        if fault is not None:
            raise UsageError(fault)
        name = topic if topic.startswith("/") else f"/{topic}"
        return self._remappings.get(name, name)

    def installed_types(self, include_rosbags: bool = True) -> InstalledTypes:
        return InstalledTypes(include_rosbags=include_rosbags)

    def subscribe(
        self,
        topic: Any,
        message_type: Any,
        connect: Any,
        queue_size: Any,
        max_delay: float = 0.0,
        ignores_own: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> MemorySubscription:
        self.network.qualities[topic] = quality
        subscription = MemorySubscription(self.network, self.node_name, topic, connect, ignores_own)
        self.network.subscriptions.setdefault(topic, []).append(subscription)
        for publication in self.network.publications.get(topic, ()):
            self.network.connect(publication, subscription)
        return subscription

    def advertise(
        self,
        topic: Any,
        definition: Any,
        queue_size: Any,
        is_latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> MemoryPublication:
        self.network.qualities[topic] = quality
        source = MessageSource(
            self.node_name,
            definition.name,
            definition.full_text,
            definition.md5sum,
            is_latched,
            f"memory:{self.node_name}",
            self.format,
        )
        publication = MemoryPublication(self.network, topic, source)
        self.network.publications.setdefault(topic, []).append(publication)
        for subscription in self.network.subscriptions.get(topic, ()):
            self.network.connect(publication, subscription)
        return publication

    def offer_service(self, name: Any, service_type: Any, handler: Any) -> None:
        name = f"{self.node_name}/{name[1:]}" if name.startswith("~") else self.resolve_topic(name)
        self.network.services[name] = (self.node_name, handler)

    def resolve_service(self, name: Any) -> Any:
        return self.resolve_topic(name)

    def call_service(self, name: Any, call: Any) -> None:
        self.network.calls[name] = call

    def graph(self) -> Any:
        publications = self.network.publications
        return NodeGraph(
            {topic: entries[0].source.message_type for topic, entries in publications.items() if entries},
            {
                topic: {publication.source.node for publication in entries}
                for topic, entries in publications.items()
                if entries
            },
            {name: {node} for name, (node, _) in self.network.services.items()},
            {
                topic: {subscription.node for subscription in entries}
                for topic, entries in self.network.subscriptions.items()
                if entries
            },
        )

    def watch_nodes(self, report: Any) -> None:
        self.network.watches.append(report)

    def on_shutdown(self, callback: Any) -> None:
        self.shutdown_callbacks.append(callback)

    def is_shut_down(self) -> bool:
        return self.is_ended

    def shut_down(self) -> None:
        """End the node."""
        self.is_ended = True
        for callback in self.shutdown_callbacks:
            callback()
