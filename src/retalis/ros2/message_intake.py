"""Reading of the messages of all subscriptions in one thread.

The executors of rclpy take 190 to 250 µs for a message. This thread waits with a wait set of its own for all
subscriptions, takes all messages that have arrived, and passes them on in the order of their reception. It costs a
quarter of that. The wait set is not public: if it is missing, or different from what is expected here, the executor
of the node reads the messages.
"""

import logging
import threading
import time
from itertools import groupby
from operator import itemgetter
from typing import Any, Callable, Dict, List, NamedTuple, Tuple

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

log = logging.getLogger("retalis")

FAST_SECONDS = 0.002
"""Mean time between two messages below which they are read in batches."""

BATCH_SECONDS = 0.005
"""Seconds for which messages wait for the next ones if they are read in batches."""

MESSAGE_WEIGHT = 0.1
"""Weight of a message in the mean time: two messages that are published at once are no high rate."""

ERROR_SECONDS = 0.1
"""Seconds before messages are read again after an error."""

MAX_BATCH = 200
"""Maximum number of messages that are taken from a subscription at once."""


class ReceivedMessage(NamedTuple):
    """A serialized message.

    Attributes:
        received: instant of its reception in ns; 0 if unknown.
        sent: instant at which it was published in ns; 0 if unknown.
        number: its number among the messages of its publisher; 0 if unknown.
        data: its bytes.
    """

    received: int
    sent: int
    number: int
    data: bytes


Consume = Callable[[List[ReceivedMessage]], object]
"""Receives messages of one subscription that were read together. It raises no errors."""


class IntakeGroup(CallbackGroup):
    """A callback group that executors ignore.

    They must not wait for events of the subscriptions either: in Fast DDS each message wakes those who do.
    """

    def add_entity(self, entity: Any) -> None:
        """Store no references: the group of a subscription that has been closed would keep one."""

    def can_execute(self, entity: Any) -> bool:
        """See `CallbackGroup`."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """See `CallbackGroup`."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """See `CallbackGroup`."""


class MessageIntake:
    """The thread that reads the messages.

    Args:
        node: the node of the subscriptions.
        on_error: receives exceptions that show a bug.

    Attributes:
        group: callback group for the subscriptions that are read here; None if an executor has to read them.
        can_poll_events: whether `poll_event` works.
    """

    def __init__(self, node: Node, on_error: Callable[[Exception], object]):
        self._node = node
        self._on_error = on_error
        self._lock = threading.Lock()
        self._consumers: Dict[Subscription, Consume] = {}
        self._removed: List[Subscription] = []
        self._has_changed = False
        self._is_stopped = False
        self.group: Any = IntakeGroup()
        self._wake_up = node.create_guard_condition(lambda: None, callback_group=self.group)
        self._thread = threading.Thread(target=self._run, daemon=True, name="messages")
        reason = self._check_wait_set()
        if reason is None:
            self._thread.start()
        else:
            log.warning("messages are read by the executor of rclpy, which takes more time: %s", reason)
            self.group = None
        self.can_poll_events = reason is None

    def add(self, subscription: Subscription, consume: Consume) -> None:
        """Read the messages of a subscription that has been created with `group` and ``raw=True``."""
        with self._lock:
            self._consumers[subscription] = consume
            self._has_changed = True
        self._wake_up.trigger()

    def remove(self, subscription: Subscription) -> None:
        """Destroy a subscription. Messages that are being processed may still be passed on."""
        with self._lock:
            is_read_here = self._consumers.pop(subscription, None) is not None
            if is_read_here:
                # The thread may be waiting for it.
                self._removed.append(subscription)
                self._has_changed = True
        if is_read_here:
            self._wake_up.trigger()
        else:
            self._node.destroy_subscription(subscription)

    def poll_event(self, handler: Any) -> Any:
        """Return the event of a subscription's handler; None if there is none, or the subscription is closed."""
        context = self._node.context
        try:
            with context.handle, handler:
                wait_set = rclpy_implementation.WaitSet(0, 0, 0, 0, 0, 1, context.handle)
                wait_set.clear_entities()
                handler.add_to_wait_set(wait_set)
                wait_set.wait(0)
                return handler.take_data() if handler.is_ready(wait_set) else None
        except InvalidHandle:
            return None

    def stop(self) -> None:
        """Read no more messages, and destroy the subscriptions unless the thread waits for the engine for long."""
        self._is_stopped = True
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._wake_up.trigger()
            self._thread.join(timeout=1.0)
        if not self._thread.is_alive():
            self._destroy()

    def _destroy(self) -> None:
        """Destroy the subscriptions, for which nobody waits any more."""
        with self._lock:
            subscriptions = [*self._consumers, *self._removed]
            self._consumers, self._removed = {}, []
        for subscription in subscriptions:
            self._node.destroy_subscription(subscription)
        self._node.destroy_guard_condition(self._wake_up)

    def _check_wait_set(self) -> Any:
        """Return the reason why the wait set cannot be used; None if it can."""
        try:
            wait_set = self._make_wait_set([])
            self._wake_up.trigger()
            wait_set.wait(0)
            if not wait_set.is_ready("guard_condition", 0):
                return "its wait set does not report what is ready"
        except (AttributeError, TypeError, RuntimeError) as error:
            return str(error).partition("\n")[0]
        return None

    def _make_wait_set(self, subscriptions: List[Subscription]) -> Any:
        context = self._node.context
        with context.handle:
            wait_set = rclpy_implementation.WaitSet(len(subscriptions), 1, 0, 0, 0, 0, context.handle)
        self._fill_wait_set(wait_set, subscriptions)
        return wait_set

    def _fill_wait_set(self, wait_set: Any, subscriptions: List[Subscription]) -> None:
        # Waiting empties the wait set.
        wait_set.clear_entities()
        for subscription in subscriptions:
            wait_set.add_subscription(subscription.handle)
        wait_set.add_guard_condition(self._wake_up.handle)

    def _run(self) -> None:
        consumers: Dict[Subscription, Consume] = {}
        subscriptions: List[Subscription] = []
        wait_set: Any = None
        last, mean_seconds = time.monotonic(), FAST_SECONDS
        while not self._is_stopped:
            try:
                if self._has_changed or wait_set is None:
                    wait_set = None
                    consumers = self._take_changes()
                    subscriptions = list(consumers)
                    wait_set = self._make_wait_set(subscriptions)
                else:
                    self._fill_wait_set(wait_set, subscriptions)
                wait_set.wait(-1)
                if self._is_stopped:
                    return
                if mean_seconds < FAST_SECONDS:
                    time.sleep(BATCH_SECONDS)
                    ready = subscriptions
                else:
                    ready = [
                        subscription
                        for position, subscription in enumerate(subscriptions)
                        if wait_set.is_ready("subscription", position)
                    ]
                now = time.monotonic()
                count = self._pass_on(consumers, ready)
                if count:
                    weight = 1 - (1 - MESSAGE_WEIGHT) ** count
                    mean_seconds += weight * ((now - last) / count - mean_seconds)
                    last = now
            except Exception as error:
                if self._is_stopped:
                    return
                self._on_error(error)
                # Everything is set up again. The error may recur.
                wait_set = None
                time.sleep(ERROR_SECONDS)

    def _take_changes(self) -> Dict[Subscription, Consume]:
        """Destroy the removed subscriptions, for which nobody waits now; return the others with their consumers."""
        with self._lock:
            self._has_changed = False
            removed, self._removed = self._removed, []
            consumers = dict(self._consumers)
        for subscription in removed:
            self._node.destroy_subscription(subscription)
        return consumers

    def _pass_on(self, consumers: Dict[Subscription, Consume], ready: List[Subscription]) -> int:
        """Take the messages of subscriptions, pass them on in the order of their reception; return their number."""
        if len(ready) == 1:
            messages = take_messages(ready[0])
            if messages:
                consumers[ready[0]](messages)
            return len(messages)
        received: List[Tuple[int, int, ReceivedMessage]] = []
        for position, subscription in enumerate(ready):
            received += [(message.received, position, message) for message in take_messages(subscription)]
        received.sort(key=itemgetter(0))
        for position, entries in groupby(received, itemgetter(1)):
            consumers[ready[position]]([entry[2] for entry in entries])
        return len(received)


def take_messages(subscription: Subscription) -> List[ReceivedMessage]:
    """Return the messages of a subscription that have arrived, at most `MAX_BATCH`."""
    messages: List[ReceivedMessage] = []
    handle, message_type = subscription.handle, subscription.msg_type
    with handle:
        while len(messages) < MAX_BATCH:
            taken = handle.take_message(message_type, True)
            if taken is None:
                break
            messages.append(make_message(*taken))
    return messages


def make_message(data: bytes, info: Dict[str, Any]) -> ReceivedMessage:
    """Return a message with what rclpy tells about it."""
    return ReceivedMessage(
        info.get("received_timestamp", 0),
        info.get("source_timestamp", 0),
        info.get("publication_sequence_number") or 0,
        data,
    )
