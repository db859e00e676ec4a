"""What is said once, some seconds after the start: topics that nobody publishes, and a clock that does not come."""

import threading
from difflib import get_close_matches
from http.client import HTTPException
from typing import Callable, Iterable, Iterator, List
from xmlrpc.client import Error

import rosgraph
import rospy

from ..foundation import printable
from .counting import InputStatus
from .rostime import ros_now

PATIENCE = 10.0
"""Seconds that publishers have to come."""

_ALIKE = 0.7


def unpublished(inputs: Iterable[InputStatus], published: Iterable[str]) -> Iterator[str]:
    """Yield what is to be said of subscribed topics that nobody publishes.

    Args:
        inputs: what has come on each topic.
        published: the topics that somebody publishes.
    """
    names = list(published)
    for one in inputs:
        if one.publishers or one.messages or one.topic in names:
            continue
        near = get_close_matches(one.topic, names, 1, _ALIKE)
        hint = f"; did you mean {near[0]}?" if near else ""
        yield f"nobody publishes topic {one.topic} ({one.type}) {PATIENCE:g} s after the start{hint}"


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
            found = rosgraph.Master(rospy.get_name()).getPublishedTopics("")
        except (
            OSError,
            Error,
            HTTPException,
            rosgraph.MasterException,
        ):  # the master is not there: that is said elsewhere
            return
        for text in unpublished(waiting, [topic for topic, _ in found]):
            rospy.logwarn("%s", printable(text))
