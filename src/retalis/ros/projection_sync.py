"""What node retalis reads of messages, told to the ROS interface, which writes as text only that.

Nothing is left out where that could be seen. The interface writes all of a message unless node retalis, and nobody
else, is connected to the texts, and the connection over which it has told what it reads is still there: one that was
started anew tells anew.
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
from .internal_topics import MAX_CONTROL_CHARACTERS, read_told_json

UNREAD = "retalisUnread"
"""The topic on which node retalis says what it reads not: JSON, the numbers of arguments by name and arity."""

NONE: FrozenSet[int] = frozenset()


class ProjectionPublisher:
    """Tells what an engine does not read, again whenever that has changed, by a thread of its own."""

    def __init__(self, engine: Engine):
        self._dispatcher = engine.dispatcher
        self._publisher = rospy.Publisher(UNREAD, String, queue_size=10, latch=True)
        self._last: Optional[str] = None
        self._changed = threading.Event()
        self._changed.set()
        self._dispatcher.on_change = self._changed.set
        threading.Thread(target=self._run, name=UNREAD, daemon=True).start()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            self._changed.wait()
            self._changed.clear()
            try:
                self._tell()
            except rospy.ROSException as error:  # the node is being shut down
                rospy.logdebug("%s: %s", UNREAD, error)

    def _tell(self) -> None:
        found = self._dispatcher.unread.tell()
        text = json.dumps({str(functor): sorted(positions) for functor, positions in found.items()})
        if len(text) > MAX_CONTROL_CHARACTERS:  # beyond, nothing is told, and everything is written
            text = "{}"
        if text != self._last:
            self._publisher.publish(String(text))
            self._last = text


class _Notice(NamedTuple):
    """What was told last, and the header of the connection over which it came."""

    header: Dict[str, str]
    unread: Dict[str, FrozenSet[int]]


class ProjectionReceiver:
    """What the reader of the texts does not read of events, as far as that is sure.

    Args:
        links: gives the connections of those who get the texts.
        reports: takes what is told and cannot be understood.
    """

    def __init__(self, links: Callable[[], List[Any]], reports: Reports):
        self._links = links
        self._reports = reports
        self._told: Optional[_Notice] = None
        self._subscriber = rospy.Subscriber(UNREAD, String, self._take, queue_size=10)

    def of(self, functor: Functor) -> FrozenSet[int]:
        """Return the arguments of events, by number, that may be left out now.

        That is for what is sent at once: a text that is kept, to be sent to who comes later, has to be whole.
        """
        told = self._told
        positions = NONE if told is None else told.unread.get(str(functor), NONE)
        return positions if positions and told is not None and self._holds(told) else NONE

    def _holds(self, told: _Notice) -> bool:
        """Tell whether the one who has told it is there, and the only one who gets texts."""
        links = self._links()
        if len(links) != 1 or getattr(links[0], "endpoint_id", None) != told.header.get("callerid"):
            return False
        sources = getattr(self._subscriber.impl, "connections", ())
        return any(link.header is told.header and not link.done for link in sources)

    def _take(self, message: Any) -> None:
        header = message._connection_header  # noqa: SLF001 - rospy has no other name for it
        try:
            self._told = _Notice(header, _read(message.data))
        except MessageError as error:
            self._told = None
            self._reports.warning(f"{UNREAD} from {header.get('callerid', 'somebody')}: {error}", UNREAD)


def _read(text: str) -> Dict[str, FrozenSet[int]]:
    """Return what a text tells.

    Raises:
        MessageError: where it is not as it has to be.
    """
    wrong = MessageError(f"expected numbers of arguments by name, found {beginning(text)}")
    found = read_told_json(text, wrong)
    if not isinstance(found, dict):
        raise wrong
    for positions in found.values():
        if not isinstance(positions, list) or not all(one.__class__ is int for one in positions):
            raise wrong
    return {name: frozenset(positions) for name, positions in found.items()}
