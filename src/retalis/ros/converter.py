"""Node ``retalis_ros_interface``: between ROS topics and events as text."""

import threading
from typing import Optional

import rospy
from std_msgs.msg import String

from ..errors import RetalisError
from ..program import TOPICS, Topics, read_topics
from ..syntax import EventReader, to_text
from ..terms import CONS, NIL, Term, deref, functor
from ..timestamps import datime
from ._log import shown
from .interface import INPUT, OUTPUT, Interface, send
from .node import OUTPUT_EVENT, connect
from .parameters import Parameters, direct_topics
from .running import run_node
from .services import InterfaceServices

EVENT = functor("event", 2)


class Converter:
    """The node: messages go out as text to node retalis, texts that come back go out as messages."""

    def __init__(self, parameters: Parameters):
        self._texts = rospy.Publisher(INPUT, String, queue_size=parameters.queue)
        self._reader = EventReader()
        self._reading = threading.Lock()  # rospy has a thread for each publisher
        self._interface = Interface(self._send, parameters.queue)
        try:
            topics = read_topics(parameters.program / TOPICS)
        except RetalisError as error:
            for line in shown(error):
                rospy.logerr("%s", line)
            topics = Topics()
        direct = direct_topics(parameters.direct, topics)
        self._interface.leave(direct)
        connect(self._interface, topics, direct)
        InterfaceServices(self._interface)
        rospy.Subscriber(OUTPUT, String, self._receive, queue_size=parameters.queue, buff_size=1 << 20)

    def _send(self, term: Term, instant: Optional[int]) -> None:
        if instant is None:
            instant = rospy.get_rostime().to_nsec()
        stamp = datime(instant)
        interval = (CONS, stamp, (CONS, stamp, NIL))
        send(self._texts, String(to_text((EVENT, term, interval))))

    def _receive(self, message: String) -> None:
        try:
            with self._reading:
                event = self._reader.read(message.data)
        except RetalisError as error:
            rospy.logerr("an output is not published: %s", error)
            return
        if event.__class__ is not tuple or event[0] is not OUTPUT_EVENT:
            rospy.logerr("an output is not published: expected event(Term,Topic,Id), found %s", message.data)
            return
        topic = deref(event[2])
        self._interface.publish(deref(event[1]), getattr(topic, "name", None) or to_text(topic))


def main() -> int:
    """Run the node until it is shut down; return its exit status."""
    return run_node("retalis_ros_converter", Converter)
