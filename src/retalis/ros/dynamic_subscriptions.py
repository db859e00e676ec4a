"""Topics that goals of the program subscribe, while it is loaded or while the node runs.

Node retalis subscribes them where it has the ROS interface itself. Otherwise it tells the node that has it: the whole
list each time, so that one that is started again has it.
"""

import json
import threading
from queue import Empty, SimpleQueue
from typing import Any, Callable, List, Optional, Set

import rospy
from std_msgs.msg import String

from ..engine.event_input import MAX_INPUT_TOPICS, AskedTopic
from ..engine.runtime.problem_reports import Reports
from ..events.language.event_declarations import event_fault
from ..foundation.errors import MessageError, RetalisError, UsageError, beginning
from .internal_topics import INPUT, OUTPUT, read_told_json, resolve
from .ros_interface import RosInterface

TOLD = "retalisSubscribe"
"""The topic on which node retalis says what to subscribe: JSON, a list of [topic, type, name of the events]."""


class DynamicSubscriptions:
    """Has subscribed what goals ask for, from when there is an interface on; by a thread: the master has to be told.

    How much waits is bounded by how many topics goals may subscribe.
    """

    def __init__(self) -> None:
        self._wanted: SimpleQueue[AskedTopic] = SimpleQueue()
        self.ask: Callable[[AskedTopic], None] = self._wanted.put

    def begin(self, interface: Optional[RosInterface]) -> None:
        """Have done what has been asked for so far, and from now on what comes.

        Args:
            interface: who subscribes; None where that is the other node.
        """
        take = _Teller().tell if interface is None else lambda wanted: _subscribe(interface, wanted)

        def run() -> None:
            while not rospy.is_shutdown():
                take(self._wanted.get())

        try:
            while True:
                take(self._wanted.get_nowait())
        except Empty:
            pass
        threading.Thread(target=run, daemon=True, name="topics of goals").start()


class _Teller:
    """Tells the other node which topics to subscribe."""

    def __init__(self) -> None:
        self._asked: List[AskedTopic] = []
        self._publisher = rospy.Publisher(TOLD, String, queue_size=10, latch=True)

    def tell(self, wanted: AskedTopic) -> None:
        """Have a topic subscribed, too."""
        self._asked.append(wanted)
        try:
            self._publisher.publish(String(json.dumps(self._asked)))
        except rospy.ROSException as error:  # the node is being shut down
            rospy.logdebug("%s: %s", TOLD, error)


class ToldTopics:
    """Subscribes what the other node says, each topic once.

    Args:
        interface: subscribes.
        reports: takes what is told and cannot be understood.
    """

    def __init__(self, interface: RosInterface, reports: Reports):
        self._interface = interface
        self._reports = reports
        self._done: Set[AskedTopic] = set()
        self._subscriber = rospy.Subscriber(TOLD, String, self._take, queue_size=10)

    def _take(self, message: Any) -> None:
        try:
            told = read_told(message.data)
        except MessageError as error:
            self._reports.warning(f"{TOLD}: {error}", TOLD)
            return
        for wanted in told:
            if wanted not in self._done and len(self._done) < MAX_INPUT_TOPICS:
                self._done.add(wanted)
                _subscribe(self._interface, wanted)


def read_told(text: str) -> List[AskedTopic]:
    """Return what a text tells to subscribe.

    Raises:
        MessageError: where it is not as it has to be.
    """
    wrong = MessageError(f"expected topics, types and names of events, found {beginning(text)}")
    found = read_told_json(text, wrong)
    if not isinstance(found, list):
        raise wrong
    for one in found:
        if not isinstance(one, list) or len(one) != 3 or not all(part.__class__ is str for part in one):
            raise wrong
        if one[2] and event_fault(one[2]):
            raise wrong
    return [AskedTopic(*one) for one in found]


def _subscribe(interface: RosInterface, wanted: AskedTopic) -> None:
    try:
        interface.subscribe(*wanted)
    except RetalisError as error:
        rospy.logerr("subscribe_to: %s", error)
    except rospy.ROSException as error:  # the node is being shut down
        rospy.logdebug("subscribe_to: topic %s: %s", beginning(wanted.topic), error)


def plain(topic: str) -> str:
    """Return the full name of a topic that a goal may subscribe.

    Raises:
        UsageError: for one that is no name, or is for what passes between the nodes.
    """
    name = resolve(topic)
    if name in map(rospy.resolve_name, (INPUT, OUTPUT)):
        raise UsageError(f"topic {topic} is for events as text, between the nodes")
    return name
