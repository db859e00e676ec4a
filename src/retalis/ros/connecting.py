"""What both nodes do with the topics of a program, and what passes between them."""

from typing import Callable, Iterable

import rospy

from ..events.program import TOPICS, Topics, TopicType
from ..foundation import RetalisError
from ..prolog.terms import functor
from .interface import Interface

OUTPUT_EVENT = functor("event", 3)
"""What is said of an output between the nodes: the term, its topic, and the id of the subscription."""


def connect(interface: Interface, topics: Topics, direct: Iterable[TopicType] = ()) -> None:
    """Subscribe and advertise what ``pub_sub.xml`` names, but for what node retalis subscribes by itself."""
    apart = {rospy.resolve_name(topic) for topic, _ in direct}
    for topic, kind in topics.published:
        _try(interface.outputs.advertise, topic, kind)
    for topic, kind in topics.subscribed:
        if rospy.resolve_name(topic) not in apart:
            _try(interface.subscribe, topic, kind)


def _try(work: Callable[[str, str], None], topic: str, kind: str) -> None:
    try:
        work(topic, kind)
    except RetalisError as error:
        rospy.logerr("%s: topic %s: %s", TOPICS, topic, error)
