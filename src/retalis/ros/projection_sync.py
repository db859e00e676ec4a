"""Projection pushdown between the nodes: the interface omits fields of messages that node ``retalis`` does not read.

Node ``retalis`` publishes the argument positions that no rule, memory or goal reads, after each change. The interface
writes a message completely unless it is certain that the omission is invisible: node ``retalis`` is the only
subscriber of the texts, and the connection on which it has published the positions still exists. A restarted node
publishes them again.
"""

import json
import threading
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional

import rospy
from std_msgs.msg import String

from ..engine.engine import Engine
from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import MessageError, beginning
from ..prolog.terms.types import Functor
from .internal_topics import MAX_CONTROL_CHARACTERS, read_control_json

UNREAD_ARGUMENTS_TOPIC = "retalisUnread"
"""Topic of the unread arguments: JSON, lists of argument positions by functor (name and arity)."""

NO_POSITIONS: FrozenSet[int] = frozenset()


class ProjectionPublisher:
    """Publishes the unread arguments of an engine after each change, in a thread."""

    def __init__(self, engine: Engine):
        self._dispatcher = engine.dispatcher
        self._publisher = rospy.Publisher(UNREAD_ARGUMENTS_TOPIC, String, queue_size=10, latch=True)
        self._last_published: Optional[str] = None
        self._changed = threading.Event()
        self._changed.set()
        self._dispatcher.on_change = self._changed.set
        threading.Thread(target=self._run, name=UNREAD_ARGUMENTS_TOPIC, daemon=True).start()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            # Several changes during the loading of a program are combined into one message.
            self._changed.wait()
            self._changed.clear()
            try:
                self._publish_changes()
            except rospy.ROSException as error:
                # The node is being shut down.
                rospy.logdebug("%s: %s", UNREAD_ARGUMENTS_TOPIC, error)

    def _publish_changes(self) -> None:
        unread_positions = self._dispatcher.projection.announce()
        text = json.dumps(
            {str(functor): sorted(positions) for functor, positions in unread_positions.items()}
        )
        if (
            len(text) > MAX_CONTROL_CHARACTERS
        ):  # the receiver would reject it; "{}" means that everything is read
            text = "{}"
        if text != self._last_published:
            self._publisher.publish(String(text))
            self._last_published = text


class _ReceivedPositions(NamedTuple):
    """The last received positions, and the header of the connection on which they were received."""

    header: Dict[str, str]
    positions: Dict[str, FrozenSet[int]]


class ProjectionReceiver:
    """Receiver of the unread arguments in the interface node.

    Args:
        connections: returns the connections of the subscribers of the texts.
        reports: receives a warning for each malformed message.
    """

    def __init__(self, connections: Callable[[], List[Any]], reports: Reports):
        self._connections = connections
        self._reports = reports
        self._received: Optional[_ReceivedPositions] = None
        self._subscriber = rospy.Subscriber(UNREAD_ARGUMENTS_TOPIC, String, self._receive, queue_size=10)

    def of(self, functor: Functor) -> FrozenSet[int]:
        """Return the argument positions of events that may be omitted now.

        This is valid only for a text that is sent at once. A text that is stored for later subscribers has to be
        complete.
        """
        received = self._received
        positions = NO_POSITIONS if received is None else received.positions.get(str(functor), NO_POSITIONS)
        return positions if positions and received is not None and self._is_valid(received) else NO_POSITIONS

    def _is_valid(self, received: _ReceivedPositions) -> bool:
        """Return whether the positions' publisher is still connected, and the only subscriber of the texts."""
        subscribers = self._connections()
        if len(subscribers) != 1 or getattr(subscribers[0], "endpoint_id", None) != received.header.get(
            "callerid"
        ):
            return False
        publisher_connections = getattr(self._subscriber.impl, "connections", ())
        # A restarted node has the same name, but another connection, and its rules may read other arguments.
        return any(
            connection.header is received.header and not connection.done
            for connection in publisher_connections
        )

    def _receive(self, message: Any) -> None:
        header = message._connection_header  # noqa: SLF001 - rospy has no other name for it
        try:
            self._received = _ReceivedPositions(header, _parse_positions(message.data))
        except MessageError as error:
            self._received = None
            self._reports.warning(
                f"{UNREAD_ARGUMENTS_TOPIC} from {header.get('callerid', 'somebody')}: {error}",
                UNREAD_ARGUMENTS_TOPIC,
            )


def _parse_positions(text: str) -> Dict[str, FrozenSet[int]]:
    """Return the argument positions by functor in a text.

    Raises:
        MessageError: if the text does not have the expected form.
    """
    malformed = MessageError(f"expected numbers of arguments by name, found {beginning(text)}")
    data = read_control_json(text, malformed)
    if not isinstance(data, dict):
        raise malformed
    for positions in data.values():
        if not isinstance(positions, list) or not all(position.__class__ is int for position in positions):
            raise malformed
    return {name: frozenset(positions) for name, positions in data.items()}
