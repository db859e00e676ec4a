"""Subscription to topics by goals of the program (``subscribe_to``), during loading or at run time.

If node ``retalis`` contains the ROS interface, it subscribes to the topics itself. Otherwise it publishes the
complete list of topics on a latched topic after each change, so that an interface node that is restarted receives it.
"""

import json
import threading
from queue import Empty, SimpleQueue
from typing import Any, Callable, List, Optional, Set

import rospy
from std_msgs.msg import String

from ..engine.event_input import MAX_INPUT_TOPICS, TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..events.language.event_declarations import event_name_error
from ..foundation.errors import MessageError, RetalisError, UsageError, beginning
from .internal_topics import INPUT, OUTPUT, read_control_json, resolve
from .ros_interface import RosInterface

SUBSCRIPTIONS_TOPIC = "retalisSubscribe"
"""Topic with the list of subscriptions: JSON, a list of [topic, type, event name]."""


class DynamicSubscriptions:
    """Queue of subscriptions that goals request, executed by a thread as soon as there is an interface.

    A thread is necessary because subscribing calls the master, which would block the engine. The length of the queue
    is bounded by `MAX_INPUT_TOPICS`.
    """

    def __init__(self) -> None:
        self._requests: SimpleQueue[TopicRequest] = SimpleQueue()
        self.request: Callable[[TopicRequest], None] = self._requests.put

    def start(self, interface: Optional[RosInterface]) -> None:
        """Execute the queued requests, and start the thread for later ones.

        Args:
            interface: the ROS interface of this node; None if the interface runs in another node.
        """
        execute = (
            _SubscriptionPublisher().publish_added
            if interface is None
            else lambda request: _subscribe(interface, request)
        )

        def run() -> None:
            while not rospy.is_shutdown():
                execute(self._requests.get())

        # Requests of the program's loading are executed before this returns, as for the topics of `pub_sub.xml`.
        try:
            while True:
                execute(self._requests.get_nowait())
        except Empty:
            pass
        threading.Thread(target=run, daemon=True, name="topics of goals").start()


class _SubscriptionPublisher:
    """Publisher of the list of subscriptions, for the interface node."""

    def __init__(self) -> None:
        self._subscriptions: List[TopicRequest] = []
        self._publisher = rospy.Publisher(SUBSCRIPTIONS_TOPIC, String, queue_size=10, latch=True)

    def publish_added(self, request: TopicRequest) -> None:
        """Add a topic to the list, and publish it."""
        self._subscriptions.append(request)
        try:
            self._publisher.publish(String(json.dumps(self._subscriptions)))
        except rospy.ROSException as error:
            # The node is being shut down.
            rospy.logdebug("%s: %s", SUBSCRIPTIONS_TOPIC, error)


class SubscriptionReceiver:
    """Receiver of the list of subscriptions in the interface node; it subscribes to each topic once.

    Args:
        interface: the ROS interface.
        reports: receives a warning for each malformed list.
    """

    def __init__(self, interface: RosInterface, reports: Reports):
        self._interface = interface
        self._reports = reports
        self._subscribed: Set[TopicRequest] = set()
        self._subscriber = rospy.Subscriber(SUBSCRIPTIONS_TOPIC, String, self._receive, queue_size=10)

    def _receive(self, message: Any) -> None:
        try:
            topics = read_subscriptions(message.data)
        except MessageError as error:
            self._reports.warning(f"{SUBSCRIPTIONS_TOPIC}: {error}", SUBSCRIPTIONS_TOPIC)
            return
        for request in topics:
            if request not in self._subscribed and len(self._subscribed) < MAX_INPUT_TOPICS:
                self._subscribed.add(request)
                _subscribe(self._interface, request)


def read_subscriptions(text: str) -> List[TopicRequest]:
    """Return the subscriptions of a list.

    Raises:
        MessageError: if the text does not have the expected form.
    """
    malformed = MessageError(f"expected topics, types and names of events, found {beginning(text)}")
    items = read_control_json(text, malformed)
    if not isinstance(items, list):
        raise malformed
    for item in items:
        if not isinstance(item, list) or len(item) != 3 or not all(part.__class__ is str for part in item):
            raise malformed
        if item[2] and event_name_error(item[2]):
            raise malformed
    return [TopicRequest(*item) for item in items]


def _subscribe(interface: RosInterface, request: TopicRequest) -> None:
    try:
        interface.subscribe(*request)
    except RetalisError as error:
        rospy.logerr("subscribe_to: %s", error)
    except rospy.ROSException as error:
        # The node is being shut down.
        rospy.logdebug("subscribe_to: topic %s: %s", beginning(request.topic), error)


def resolve_subscribable_topic(topic: str) -> str:
    """Return the full name of a topic that a goal may subscribe to.

    Raises:
        UsageError: if the name is invalid, or the topic belongs to the protocol between the nodes.
    """
    name = resolve(topic)
    if name in map(rospy.resolve_name, (INPUT, OUTPUT)):
        raise UsageError(f"topic {topic} is for events as text, between the nodes")
    return name
