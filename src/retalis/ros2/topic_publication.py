"""A published topic of rclpy, whose first messages wait for the subscribers that exist."""

import threading
import time
from collections import deque
from typing import Any, Callable, Deque, List, Optional, Tuple

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node

try:
    from rclpy.event_handler import PublisherEventCallbacks
except ImportError:  # Humble
    from rclpy.qos_event import PublisherEventCallbacks

from ..foundation.errors import RetalisError
from .quality_of_service import Quality

MAX_SUBSCRIBER_WAIT_SECONDS = 1.0
"""Seconds for which the first messages of a topic wait for subscribers; the middleware needs time to find them."""

_CHECK_SECONDS = 0.02

MAX_OWN_MESSAGES = 1000
"""Number of messages that are recognized as messages of this node."""

MAX_OWN_SECONDS = 10.0
"""Seconds after which a sent message is not expected any more."""


class OwnMessages:
    """Messages that this node has sent to a topic that it reads: rclpy does not say who has sent a message."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sent: Deque[Tuple[float, int]] = deque(maxlen=MAX_OWN_MESSAGES)

    def add(self, message: bytes) -> None:
        """Record a message that is about to be sent."""
        with self._lock:
            self._sent.append((time.monotonic(), hash(message)))

    def take(self, message: bytes) -> bool:
        """Return whether a message was sent by this node; each message is recognized once."""
        oldest = time.monotonic() - MAX_OWN_SECONDS
        with self._lock:
            # One that has not come back was sent before the subscription was connected.
            while self._sent and self._sent[0][0] < oldest:
                self._sent.popleft()
            for entry in self._sent:
                if entry[1] == hash(message):
                    self._sent.remove(entry)
                    return True
            return False


class RclpyPublication:
    """A publisher of rclpy; see `Transport.advertise`.

    Args:
        message_class: generated class of the messages.
        topic: full name of the topic.
        quality: quality of service.
        own_messages: records the sent messages.
        call_later: calls a function after some nanoseconds of wall time.
    """

    def __init__(
        self,
        node: Node,
        message_class: Any,
        topic: str,
        quality: Quality,
        own_messages: Callable[[], Optional[OwnMessages]],
        call_later: Callable[[int, Callable[[], object]], object],
    ):
        self.topic = topic
        self.sent = 0
        self.dropped = 0
        self._node = node
        self._own_messages = own_messages
        self._call_later = call_later
        # Without events, for which the executor would have to wait.
        events = PublisherEventCallbacks(use_default_callbacks=False)
        self._publisher = node.create_publisher(
            message_class, topic, quality.profile(), event_callbacks=events
        )
        self._lock = threading.Lock()
        self._waiting: Optional[Deque[bytes]] = deque()
        self._max_waiting = quality.depth
        self._is_ended = False
        self._checks = int(MAX_SUBSCRIBER_WAIT_SECONDS / _CHECK_SECONDS)
        self._check_subscribers()

    def subscriber_count(self) -> int:
        """See `TopicPublication`."""
        if self._is_ended:
            return 0
        count = int(self._publisher.get_subscription_count())
        return count if self._own_messages() is None else max(0, count - 1)

    def send(self, message: bytes) -> None:
        """See `TopicPublication`."""
        if self._waiting is not None:
            with self._lock:
                # Tested again: the waiting messages may have been sent meanwhile.
                if self._waiting is not None:
                    self._store(self._waiting, message)
                    return
        self._publish(message)

    def end(self) -> None:
        """Send what is waiting, and nothing later: the node ends."""
        try:
            self._send_waiting()
        finally:
            self._is_ended = True
            self._node.destroy_publisher(self._publisher)

    def _store(self, waiting: Deque[bytes], message: bytes) -> None:
        self.sent += 1
        if len(waiting) >= self._max_waiting:
            waiting.popleft()
            self.dropped += 1
        waiting.append(message)

    def _publish(self, message: bytes) -> None:
        if not self._is_ended:
            self.sent += 1
            self._write(message)

    def _write(self, message: bytes) -> None:
        own_messages = self._own_messages()
        if own_messages is not None:
            own_messages.add(message)
        try:
            self._publisher.publish(message)
        except (RuntimeError, InvalidHandle) as error:
            if not self._is_ended and self._node.context.ok():
                self.dropped += 1
                reason = str(error).partition(", at ")[0]
                raise RetalisError(f"topic {self.topic}: a message is not sent: {reason}") from error

    def _check_subscribers(self) -> None:
        """Send the waiting messages if the subscribers are connected, or the time is over; otherwise check later."""
        self._checks -= 1
        known = self._node.count_subscribers(self.topic)
        if self._is_ended or self._checks <= 0 or 0 < known <= self._publisher.get_subscription_count():
            self._send_waiting()
        else:
            self._call_later(int(_CHECK_SECONDS * 1e9), self._check_subscribers)

    def _send_waiting(self) -> None:
        with self._lock:
            waiting: List[bytes] = list(self._waiting or ())
            for message in waiting:
                self._write(message)
            # Assigned last: messages that are sent now wait for the lock.
            self._waiting = None
