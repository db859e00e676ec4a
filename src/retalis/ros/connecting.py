"""What both nodes do with the topics of a program, and what passes between them."""

from typing import Callable, Iterable

import rospy

from ..events.program import TOPICS, Topics, TopicType
from ..foundation import MessageError, RetalisError
from ..prolog.terms import functor
from .interface import Interface

OUTPUT_EVENT = functor("event", 3)
"""What is said of an output between the nodes: the term, its topic, and the id of the subscription."""


def connect(interface: Interface, topics: Topics, direct: Iterable[TopicType] = ()) -> None:
    """Subscribe and advertise what ``pub_sub.xml`` names, but for what node retalis subscribes by itself."""
    direct = tuple(direct)
    apart = {rospy.resolve_name(topic) for topic, _ in direct}
    learning = any(not interface.outputs.knows(kind) for _, kind in (*topics.subscribed, *direct))
    for topic, kind in topics.published:
        latched = topic in topics.latched
        _try(lambda: interface.outputs.advertise(topic, kind, latched), topic, learning)  # noqa: B023
    for topic, kind in topics.subscribed:
        if rospy.resolve_name(topic) not in apart:
            _try(lambda: interface.subscribe(topic, kind, topics.event_of(topic)), topic)  # noqa: B023


def _try(work: Callable[[], None], topic: str, may_come: bool = False) -> None:
    """Do what a line of ``pub_sub.xml`` asks for; say why it cannot be done, or that its type has to come first."""
    try:
        work()
    except RetalisError as error:
        if may_come and isinstance(error, MessageError):
            rospy.loginfo("%s: topic %s: %s; it may come with a message", TOPICS, topic, error)
        else:
            rospy.logerr("%s: topic %s: %s", TOPICS, topic, error)
