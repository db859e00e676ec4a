"""What is said once, some seconds after the start: topics that nobody publishes, and a clock that does not come."""

import threading
from difflib import get_close_matches
from http.client import HTTPException
from typing import Callable, Collection, Dict, Iterable, Iterator, List, Mapping
from xmlrpc.client import Error

import rosgraph
import rospy

from ..foundation import printable
from .counting import InputStatus
from .rostime import ros_now

PATIENCE = 10.0
"""Seconds that publishers have to come."""

_ALIKE = 0.7

_SERVICES = ("add_memory", "add_input_subscription")
"""Services by which the two nodes of a program are found; they have one each."""

_NO_MASTER = (OSError, Error, HTTPException, rosgraph.MasterException)


def unpublished(
    inputs: Iterable[InputStatus], publishers: Mapping[str, Collection[str]], own: Collection[str]
) -> Iterator[str]:
    """Yield a warning for each subscribed topic that nobody publishes.

    Args:
        inputs: what has come on each topic.
        publishers: the nodes that publish each topic.
        own: the nodes that run this program: a topic that nobody else publishes is no input that was meant.
    """
    foreign = [topic for topic, nodes in publishers.items() if any(node not in own for node in nodes)]
    for one in inputs:
        if one.publishers or one.messages or publishers.get(one.topic):
            continue
        near = get_close_matches(one.topic, foreign, 1, _ALIKE)
        hint = f"; did you mean {near[0]}?" if near else ""
        yield f"nobody publishes topic {one.topic} ({one.type}) {PATIENCE:g} s after the start{hint}"


def published_types() -> Dict[str, str]:
    """Return the types of all topics that somebody publishes; none if the master does not answer."""
    try:
        return dict(rosgraph.Master(rospy.get_name()).getPublishedTopics(""))
    except _NO_MASTER:  # which is said elsewhere
        return {}


class StartHints:
    """Looks once, by the clock on the wall: that of ROS may stand still.

    Args:
        inputs: tells what has come on each topic.
        named: the topics that somebody has named, which are looked at.
        clock: whether to say, too, that ``/clock`` is expected and does not come.
    """

    def __init__(self, inputs: Callable[[], List[InputStatus]], named: Iterable[str], clock: bool = False):
        self._inputs = inputs
        self._named = {rospy.resolve_name(topic) for topic in named}
        self._clock = clock
        timer = threading.Timer(PATIENCE, self.look)
        timer.daemon = True
        timer.start()
        rospy.on_shutdown(timer.cancel)

    def look(self) -> None:
        """Say what is missing."""
        if rospy.is_shutdown():
            return
        if self._clock:
            ros_now()  # which says it, once
        waiting = [one for one in self._inputs() if not one.publishers and one.topic in self._named]
        if not waiting:
            return
        try:
            published, _, services = rosgraph.Master(rospy.get_name()).getSystemState()
        except _NO_MASTER:  # which is said elsewhere
            return
        servers = {rospy.resolve_name(name) for name in _SERVICES}
        own = {rospy.get_name(), *(node for name, nodes in services if name in servers for node in nodes)}
        for text in unpublished(waiting, dict(published), own):
            rospy.logwarn("%s", printable(text))
