"""A subscribed topic of rclpy, whose quality of service follows the publishers."""

import threading
from collections import deque
from typing import Any, Callable, Deque, List, NamedTuple, Optional, Set, Tuple

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.subscription import Subscription

try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ImportError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks

from ..events.program.topic_configuration import QualityOfService
from ..messages.type_definition import SerializationFormat
from ..node.transport import Connect, MessageReceiver, MessageSource
from .message_intake import MessageIntake, ReceivedMessage, make_message
from .quality_of_service import Offer, Quality, choose_quality, full_node_name, list_mismatches, read_offers

MAX_RECENT_MESSAGES = 1000
"""Number of messages that are recognized if another subscription to the same topic receives them again."""

MAX_REPORTED_MISMATCHES = 100
"""Number of publishers that are reported because they offer less than is demanded."""

CHECK_SECONDS = 0.2
"""Seconds between two checks whether there are other publishers."""

CHECKS_PER_CHOICE = 10
"""Number of checks after which the quality is chosen again even if the number of publishers is unchanged."""

CHECKS_OF_OVERLAP = 10
"""Number of checks for which the former subscription remains after a change, until publishers know the new one."""


class RecentMessages:
    """The last `MAX_RECENT_MESSAGES` messages of a topic, by when and where they were published."""

    def __init__(self) -> None:
        self._order: Deque[Tuple[int, int, int, bytes]] = deque()
        self._messages: Set[Tuple[int, int, int, bytes]] = set()

    def add(self, message: ReceivedMessage) -> bool:
        """Add a message; return whether it is new. Without the instant of its publication it counts as new."""
        # Two publishers may send at the same nanosecond.
        key = message.sent, message.number, len(message.data), message.data[:64]
        if not message.sent:
            return True
        if key in self._messages:
            return False
        self._messages.add(key)
        self._order.append(key)
        if len(self._order) > MAX_RECENT_MESSAGES:
            self._messages.discard(self._order.popleft())
        return True


class TopicOptions(NamedTuple):
    """A topic and the way in which it is read.

    Attributes:
        topic: full name of the topic.
        message_type: type of its messages, ``pkg/Type``.
        message_class: generated class of the type.
        requested: what the program demands of the quality of service, with the depth.
        is_own: returns whether a message was sent by this node, and has to be ignored; None if none are ignored.
    """

    topic: str
    message_type: str
    message_class: Any
    requested: QualityOfService
    is_own: Optional[Callable[[bytes], bool]] = None


class RclpySubscription:
    """Subscriptions of rclpy to one topic; see `Transport.subscribe`.

    There is one subscription, or for a moment two after the quality of service has changed. All publishers are one
    source, because rclpy does not tell from which of them a message comes. It has the name of the publisher if there
    is one, and is replaced when another one follows.

    Args:
        intake: reads the messages.
        options: how the topic is read.
        connect: returns the receiver of the messages.
        call_later: calls a function after some nanoseconds of real time.
        report: receives warnings.
    """

    def __init__(
        self,
        node: Node,
        intake: MessageIntake,
        options: TopicOptions,
        connect: Connect,
        call_later: Callable[[int, Callable[[], object]], object],
        report: Callable[[str], object],
    ):
        self._node = node
        self._intake = intake
        self._options = options
        self._connect = connect
        self._call_later = call_later
        self._report = report
        self._lock = threading.Lock()
        self._receiver: Optional[MessageReceiver] = None
        self._source_name = ""
        self._has_other_publishers = False
        self._recent = RecentMessages()
        self._last_number = 0
        self._is_closed = False
        self._reported_mismatches: Set[Offer] = set()
        self._former: Optional[Subscription] = None
        self._former_checks = 0
        self._check_count = 0
        offers = self._offers()
        self._quality = choose_quality(offers, options.requested)
        self._knows_publishers = bool(offers)
        self._subscription = self._open(self._quality)
        self._publisher_count = -1
        self._check_publishers()

    def publisher_count(self) -> int:
        """See `TopicSubscription`. In Humble, publishers that cannot connect are counted, too."""
        subscription = self._subscription
        if self._is_closed:
            return 0
        try:
            if hasattr(subscription, "get_publisher_count"):
                return int(subscription.get_publisher_count())
            return int(self._node.count_publishers(self._options.topic))
        except InvalidHandle:
            # Closed, or replaced, meanwhile.
            return 0

    def publishers(self) -> List[str]:
        """See `TopicSubscription`."""
        return sorted({full_node_name(endpoint) for endpoint in self._endpoints()})

    def close(self) -> None:
        """See `TopicSubscription`."""
        with self._lock:
            self._is_closed = True
            subscriptions = [self._subscription, self._former]
        for subscription in subscriptions:
            if subscription is not None:
                self._intake.remove(subscription)

    def _endpoints(self) -> List[Any]:
        return list(self._node.get_publishers_info_by_topic(self._options.topic))

    def _offers(self) -> List[Offer]:
        return read_offers(self._endpoints())

    def _open(self, quality: Quality) -> Subscription:
        options, intake = self._options, self._intake

        def receive(data: bytes, info: Any) -> None:
            self._receive([make_message(data, info)])

        subscription = self._node.create_subscription(
            options.message_class,
            options.topic,
            receive,
            quality.profile(),
            callback_group=intake.group,
            event_callbacks=self._make_event_callbacks(),
            raw=True,
        )
        if intake.group is not None:
            intake.add(subscription, self._receive)
        return subscription

    def _make_event_callbacks(self) -> SubscriptionEventCallbacks:
        if not self._intake.can_poll_events:
            # The executor would have to wait for them, see `IntakeGroup`.
            return SubscriptionEventCallbacks(use_default_callbacks=False)
        return SubscriptionEventCallbacks(message_lost=self._on_message_lost, use_default_callbacks=False)

    # ---- quality of service

    def _check_publishers(self) -> None:
        """Choose the quality again if there are other publishers, and poll for lost messages; repeat this later."""
        if self._is_closed:
            return
        try:
            self._end_overlap()
            publisher_count = self._node.count_publishers(self._options.topic)
            has_changed = publisher_count != self._publisher_count
            if has_changed:
                self._publisher_count = publisher_count
                # The numbers of other publishers say nothing about losses.
                self._last_number = 0
            if has_changed or self._check_count % CHECKS_PER_CHOICE == 0:
                # Also if their number is unchanged: one may have been replaced by another.
                self._has_other_publishers = True
                self._choose_again()
                self._poll_lost_messages()
            self._check_count += 1
        finally:
            self._call_later(int(CHECK_SECONDS * 1e9), self._check_publishers)

    def _choose_again(self) -> None:
        """Subscribe with another quality if that of the publishers has changed."""
        offers = self._offers()
        self._knows_publishers = self._knows_publishers or bool(offers)
        quality = choose_quality(offers, self._options.requested)
        self._report_mismatches(list_mismatches(offers, quality), quality)
        with self._lock:
            if self._is_closed or not offers or quality == self._quality or self._former is not None:
                return
            subscription = self._open(quality)
            self._former, self._former_checks = self._subscription, CHECKS_OF_OVERLAP
            change = self._describe_change(offers, quality)
            self._subscription, self._quality = subscription, quality
        self._report(change)

    def _end_overlap(self) -> None:
        """Close the former subscription some checks after a change."""
        with self._lock:
            former = self._former
            if former is None:
                return
            self._former_checks -= 1
            if self._former_checks > 0:
                return
            self._former = None
        self._intake.remove(former)

    def _report_mismatches(self, mismatches: List[Offer], quality: Quality) -> None:
        """Report each publisher that offers less than the program demands, once."""
        for offer in mismatches:
            if (
                offer not in self._reported_mismatches
                and len(self._reported_mismatches) < MAX_REPORTED_MISMATCHES
            ):
                self._reported_mismatches.add(offer)
                self._report(
                    f"topic {self._options.topic}: nothing is received from {offer}: pub_sub.xml demands {quality}; "
                    "leave out reliability and durability there, or have the node offer more"
                )

    def _describe_change(self, offers: List[Offer], quality: Quality) -> str:
        shown = ", ".join(map(str, offers[:3])) + (f" and {len(offers) - 3} more" if len(offers) > 3 else "")
        return (
            f"topic {self._options.topic}: read as {quality}, before as {self._quality}: published by {shown}"
        )

    # ---- messages

    def _receive(self, messages: List[ReceivedMessage]) -> None:
        """Pass messages on, without those that were received before or sent by this node."""
        if self._is_closed:
            return
        is_own = self._options.is_own
        # Until the former subscription has been closed, messages arrive twice, and old ones again.
        is_overlap = self._former is not None
        new = [
            message
            for message in messages
            if self._recent.add(message) and not (is_own is not None and is_own(message.data))
        ]
        if not new:
            return
        receiver = self._find_receiver()
        # The first messages of a publisher may be received before its quality is known.
        may_be_repeated = self._quality.is_transient_local or not self._knows_publishers
        is_identified = may_be_repeated and all(message.sent for message in new)
        receiver.receive(
            [message.data for message in new],
            [message.received for message in new],
            [(message.sent, message.number) for message in new] if is_identified else (),
        )
        # After `receive`: a message that is being processed may be lost, too.
        self._count_lost(messages, receiver, is_overlap)

    def _find_receiver(self) -> MessageReceiver:
        """Return the receiver for the present publishers."""
        receiver = self._receiver
        if receiver is not None and not self._has_other_publishers:
            return receiver
        self._has_other_publishers = False
        publishers = self.publishers()
        # Without publishers, their last messages are received.
        name = publishers[0] if len(publishers) == 1 else self._source_name if not publishers else ""
        if receiver is None or name != self._source_name:
            self._source_name = name
            source = MessageSource(name, self._options.message_type, format=SerializationFormat.CDR)
            receiver = self._receiver = self._connect(source)
        return receiver

    def _count_lost(
        self, messages: List[ReceivedMessage], receiver: MessageReceiver, is_overlap: bool
    ) -> None:
        """Record gaps in the numbers of a single publisher's messages."""
        last_number = self._last_number
        self._last_number = 0 if is_overlap else messages[-1].number
        lost = messages[-1].number - last_number - len(messages)
        # rclpy is asked only if there is a gap.
        if (
            last_number
            and not is_overlap
            and lost > 0
            and messages[0].number > last_number
            and self.publisher_count() == 1
        ):
            receiver.record_lost(lost)

    def _poll_lost_messages(self) -> None:
        if self._intake.can_poll_events:
            for handler in self._subscription.event_handlers:
                event = self._intake.poll_event(handler)
                if event is not None:
                    self._on_message_lost(event)

    def _on_message_lost(self, event: Any) -> None:
        """Record messages that the middleware knows to be lost, if their numbers do not tell."""
        receiver = self._receiver
        if receiver is not None and event.total_count_change > 0 and self.publisher_count() > 1:
            receiver.record_lost(event.total_count_change)
