"""The page of node retalis: a dashboard of its engine, with what the nodes tell of their topics."""

from typing import Any, Callable, Dict, Iterable, List, Optional, Sequence

import rospy

from ..dashboard.page_server import Dashboard
from ..dashboard.view_model import DashboardSource, TopicLook
from ..engine.engine import Engine
from ..events.program.program_folder import TopicEvent, TopicType
from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import SECOND
from .diagnostics import TOPIC
from .internal_topics import INPUT, OUTPUT
from .topic_statistics import InputStatus

_MARK = ": input "
"""What stands between the names of node and topic in what a node tells of a topic on ``/diagnostics``."""

_TOLD = {"type", "publishers", "messages", "lag (s)"}
"""Values by which a status of a subscribed topic is known, whatever the hardware id of the node."""

PORTS = 100
"""Ports that are tried, from the one that is asked for on."""

MAX_REMOTE_TOPICS = 200
"""Topics of other nodes that are remembered."""


class NodeDashboard:
    """Serves the page as long as the node runs; where that cannot be, a warning says why, and the node goes on.

    If the port is taken, the page has the next one that is free, and the log names it.

    Args:
        port: where, on the loopback address; None for no page.
        queries: whether those who have the page may ask.
        engine: is shown.
        inputs: gives what has come on the topics that the node subscribes itself.
        named: the topics that the program names, whoever subscribes them.
        events: tells what the events of some of them are called.

    Attributes:
        url: the address of the page, "" if there is none.
    """

    def __init__(
        self,
        port: Optional[int],
        queries: bool,
        engine: Engine,
        inputs: Callable[[], Sequence[InputStatus]],
        named: Sequence[TopicType],
        events: Callable[[], Iterable[TopicEvent]] = tuple,
    ):
        self._inputs = inputs
        self._named = [TopicLook(rospy.resolve_name(one.topic), one.type) for one in named]
        self._events = events
        self._told: Dict[str, TopicLook] = {}
        self.url = ""
        if port is None:
            return
        source = DashboardSource(engine, rospy.get_name(), self.topics, queries)
        try:
            page = Dashboard(source, port, tries=PORTS)
        except UsageError as error:
            rospy.logwarn("%s; the node goes on without it", error)
            return
        self._listen()
        rospy.on_shutdown(page.close)
        self.url = page.url
        if page.port != port:
            rospy.logwarn("port %d is taken: the dashboard is at %s", port, page.url)
        else:
            rospy.loginfo("the dashboard is at %s", page.url)

    def topics(self) -> List[TopicLook]:
        """Return all topics that become events, with what is known of each."""
        found = {one.name: one for one in self._named}
        found.update(self._told)
        found.update({one.topic: _look(one) for one in self._inputs()})
        events = {rospy.resolve_name(topic): event for topic, event in self._events()}
        between = {rospy.resolve_name(name) for name in (INPUT, OUTPUT)}
        return [
            one._replace(event=events.get(name, "")) for name, one in found.items() if name not in between
        ]

    def _listen(self) -> None:
        """Take what the ROS interface tells of its topics, where it is another node."""
        try:
            from diagnostic_msgs import msg  # noqa: PLC0415 - a node runs without it
        except ImportError:
            return
        self._subscriber = rospy.Subscriber(TOPIC, msg.DiagnosticArray, self._take, queue_size=10)

    def _take(self, message: Any) -> None:
        """Note what is told of topics by nodes of this package in the same namespace."""
        own = rospy.get_name().strip("/")
        space = own.rpartition("/")[0]
        for status in message.status:
            node, mark, topic = status.name.partition(_MARK)
            values = {value.key: value.value for value in status.values}
            if not mark or not values.keys() >= _TOLD or node == own or node.rpartition("/")[0] != space:
                continue  # of another program, or no topic
            if topic in self._told or len(self._told) < MAX_REMOTE_TOPICS:
                self._told[topic] = _told_look(topic, values)


def _look(one: InputStatus) -> TopicLook:
    lag = None if one.lag is None else one.lag / SECOND
    lost = one.dropped + one.refused
    return TopicLook(one.topic, one.type, one.messages, one.publishers, lost, one.age, lag)


def _told_look(topic: str, values: Dict[str, str]) -> TopicLook:
    """Return what another node tells of a topic; see `InputHealth.of`."""
    messages, publishers = _number(values, "messages"), _number(values, "publishers")
    return TopicLook(
        topic,
        values.get("type", ""),
        None if messages is None else int(messages),
        None if publishers is None else int(publishers),
        int((_number(values, "dropped") or 0) + (_number(values, "refused") or 0)),
        _number(values, "last message (s ago)"),
        _number(values, "lag (s)"),
    )


def _number(values: Dict[str, str], key: str) -> Optional[float]:
    """Return a finite number that is told; None where there is none."""
    try:
        found = float(values.get(key, ""))
    except ValueError:
        return None
    return found if abs(found) < float("inf") else None
