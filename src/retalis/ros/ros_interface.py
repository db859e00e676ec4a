"""Between ROS topics and events: messages become terms, terms become messages.

What both nodes do with the topics of a program, and what passes between them.
"""

import threading
import time
from collections import deque
from typing import Any, Callable, ContextManager, Dict, Iterable, Iterator, List, Optional, Set, Tuple

import rospy

from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.clock_skew import ClockSkewMonitor, Early, Refused
from ..engine.runtime.problem_reports import Reports
from ..events.program.program_folder import TOPICS, Topics, TopicType, topic_type
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, RetalisError, UsageError, beginning, printable
from ..messages.decoder import Decoder
from ..messages.type_registry import Definitions
from ..prolog.terms.types import functor
from .connection_reader import read_by
from .connection_writer import raw_bytes
from .internal_topics import INPUT, OUTPUT, resolve
from .latched_inputs import LatchedConnection, LatchedInputs
from .message_publishers import OutputTopics
from .text_topics import text_taker
from .topic_statistics import InputCounts, InputStatus

Take = Callable[[bytes], Any]
"""Takes a message; returns what is handed on of it, None for one that has gone on its way."""

HandOn = Callable[[Iterable[Any]], object]
"""Takes what was made of messages that were received together, each when it is asked for."""

Publisher = Tuple[str, str]
"""A topic, and a node that publishes it."""

LatchedTaker = Callable[[Decoder, Publisher, LatchedConnection], Take]
"""Gives what takes the messages of a latched connection."""

MessageTaker = Callable[[Decoder], Take]
"""Gives what takes the messages that a decoder reads."""

LINKS = 1000
"""Connections of a topic that are remembered."""

TakeAll = Callable[[List[bytes]], None]
"""Takes messages that were received together."""

_Link = Tuple[Dict[str, str], TakeAll]
"""A connection's header, and who takes its messages."""

HOLD = 0.0012
"""Seconds for which a message may wait for the next ones, where they come fast."""


exhaust: HandOn = deque(maxlen=0).extend
"""Has all that was received together taken, and does nothing with it."""


class RosInterface:
    """Subscribes topics for an engine and publishes what comes out of it.

    Args:
        taker: gives what takes the messages of a type.
        queue: length of the queues.
        reports: takes what goes wrong while messages flow.
        definitions: the message types that are known.
        hand_on: takes what is made of messages that were received together.
        hold: seconds for which a message may wait for the next ones, where they come fast.
        skew: looks at the stamps of messages.
        latched: gives what takes the messages of latched connections, where that is something else.
        runs: holds messages of a run that has not begun.

    Attributes:
        turn: the lock under which messages are taken.
        outputs: the topics that are published.
    """

    def __init__(
        self,
        taker: MessageTaker,
        queue: int,
        reports: Reports,
        definitions: Optional[Definitions] = None,
        hand_on: HandOn = exhaust,
        hold: float = HOLD,
        skew: Optional[ClockSkewMonitor] = None,
        latched: Optional[LatchedTaker] = None,
        runs: Optional[ClockEpochs] = None,
    ):
        self._runs = runs
        self._taker = taker
        self._latched = None if latched is None else self._learning(latched)
        self._hand_on = hand_on
        self._hold = hold
        self._skew = skew
        self._queue = queue
        self._definitions = Definitions() if definitions is None else definitions
        self._inputs: Dict[str, InputTopic] = {}
        self.outputs = OutputTopics(self._definitions, queue, reports)
        self._texts: List[InputTopic] = []
        self._elsewhere: Set[str] = set()
        self._reserved = {rospy.resolve_name(topic) for topic in (INPUT, OUTPUT)}
        self._lock = threading.Lock()
        self.turn = threading.Lock()
        self._reports = reports

    def subscribe(self, topic: str, kind: str, event: str = "") -> None:
        """Have the messages of a topic become events, called by their type or as it is said.

        Raises:
            UsageError: for a topic that is subscribed already, or names that are none.
        """
        topic, kind = topic_type(topic, kind)
        name = resolve(topic)
        if name in self._reserved:
            raise UsageError(f"topic {topic} is for events as text, between the nodes")
        if name in self._elsewhere:
            raise UsageError(f"topic {topic} is subscribed by node retalis itself (its parameter ~direct)")
        with self._lock:
            if name in self._inputs:
                raise UsageError(f"topic {topic} is already subscribed (as {self._inputs[name].kind})")
            self._inputs[name] = InputTopic(
                self._definitions,
                name,
                kind,
                self._learned,
                self._queue,
                self.turn,
                self._reports,
                self._hand_on,
                self._hold,
                self._skew,
                self._latched,
                event,
                self._runs,
            )

    def publishers(self) -> Set[Publisher]:
        """Return all from whom messages come."""
        with self._lock:
            topics = list(self._inputs.items())
        return {(name, node) for name, topic in topics for node in topic.publishers()}

    def _learned(self, decoder: Decoder) -> Take:
        """Return what takes the messages of a connection that has just been made: it may have brought a type."""
        self.outputs.learned()
        return self._taker(decoder)

    def _learning(self, latched: LatchedTaker) -> LatchedTaker:
        """Return what does as `_learned` for latched connections."""

        def taker(decoder: Decoder, publisher: Publisher, connection: LatchedConnection) -> Take:
            self.outputs.learned()
            return latched(decoder, publisher, connection)

        return taker

    def subscribe_texts(
        self,
        topic: str,
        take: Callable[[str], object],
        runs: Optional[ClockEpochs] = None,
        latched: Optional[LatchedInputs] = None,
    ) -> ContextManager[object]:
        """Have the texts of one of the topics between the nodes taken; return the lock under which they are.

        Args:
            topic: its name.
            take: takes a text.
            runs: holds the texts of a run that has not begun.
            latched: recognizes the texts of latched messages that were taken already.
        """
        name = rospy.resolve_name(topic)
        taker = text_taker(take, runs, latched)
        turn = threading.Lock()
        self._texts.append(
            InputTopic(self._definitions, name, "std_msgs/String", taker, self._queue, turn, self._reports)
        )
        return turn

    def leave(self, topics: Iterable[TopicType]) -> None:
        """Refuse topics that node retalis subscribes by itself, so that none enters twice."""
        self._elsewhere = {rospy.resolve_name(topic) for topic, _ in topics}

    def learn(self, topic: str, kind: str) -> None:
        """Learn a type that is not known from a topic that node retalis subscribes by itself; take no messages."""
        if self.outputs.knows(kind):
            return
        known = threading.Event()

        def taker(decoder: Decoder) -> Take:
            self.outputs.learned()
            known.set()
            return lambda data: None

        listening = InputTopic(
            self._definitions, resolve(topic), kind, taker, self._queue, self.turn, self._reports
        )

        def close() -> None:
            known.wait()
            listening.close()

        threading.Thread(target=close, daemon=True, name=f"learning {kind}").start()

    def inputs(self) -> List[InputStatus]:
        """Return what has come on each subscribed topic."""
        return [one.status() for one in [*self._inputs.values(), *self._texts]]

    def unsubscribe(self, topic: str) -> None:
        """Stop a subscription.

        Raises:
            UsageError: where there is none.
        """
        with self._lock:
            found = self._inputs.pop(resolve(topic), None)
        if found is None:
            raise UsageError(f"topic {topic} is not subscribed")
        found.close()


class InputTopic:
    """One subscribed topic: its messages are read by the type it was given.

    A type that is not installed is learned from the publisher's connection header. ``event`` is what the events are
    called, where that is not what their type says.

    rospy has a thread for each publisher. ``turn`` lets one of them at a time hand on what it has: the others wait,
    and those who send to them, instead of piling up messages before the engine.
    """

    def __init__(
        self,
        definitions: Definitions,
        name: str,
        kind: str,
        taker: MessageTaker,
        queue: int,
        turn: ContextManager[object],
        reports: Reports,
        hand_on: HandOn = exhaust,
        hold: float = HOLD,
        skew: Optional[ClockSkewMonitor] = None,
        latched: Optional[LatchedTaker] = None,
        event: str = "",
        runs: Optional[ClockEpochs] = None,
    ):
        self._latched = latched
        self._event = event
        self._runs = runs
        self.kind = kind
        self._skew = skew
        self._reports = reports
        self._turn = turn
        self._hand_on = hand_on
        self._definitions = definitions
        self._name = name
        self._taker = taker
        self.counts = InputCounts()
        self._links: Cache[int, _Link] = Cache(LINKS, 16 << 20, 4 << 20)
        self._subscriber = rospy.Subscriber(
            name, rospy.AnyMsg, self._receive, queue_size=queue, tcp_nodelay=True
        )
        read_by(self._subscriber, self._taking, hold)

    def status(self) -> InputStatus:
        """Return what has come so far, and have the lag of the next message noted."""
        counts = self.counts
        counts.wanted = True
        age = None if counts.last is None else time.monotonic() - counts.last
        return InputStatus(
            self._name,
            self.kind,
            self._subscriber.get_num_connections(),
            counts.messages,
            counts.dropped,
            counts.refused,
            age,
            counts.lag,
        )

    def close(self) -> None:
        """Stop receiving."""
        self._subscriber.unregister()

    def publishers(self) -> List[str]:
        """Return the nodes to which there is a connection."""
        topic = getattr(self._subscriber, "impl", None)
        links = getattr(topic, "connections", None) or ()
        headers = [link.header for link in links if getattr(link, "socket", None) is not None]
        return [header["callerid"] for header in headers if header and "callerid" in header]

    def _receive(self, message: Any) -> None:
        """Take a message that rospy has read."""
        # The connection's own header, the same object for each of its messages; rospy has no other name for either.
        header = message._connection_header
        data = message._buff if message.__class__ is rospy.AnyMsg else raw_bytes(message)
        self._taking(header)([data])

    def _taking(self, header: Dict[str, str]) -> TakeAll:
        """Return what takes the messages of a connection."""
        link = self._links.get(id(header))
        if link is None:
            link = self._connected(header)
        return link[1]

    def _one_by_one(self, take: Take, stamp: Callable[[bytes], Optional[int]], publisher: str) -> TakeAll:
        """Return what takes messages that were received together, or has them held."""
        turn, counts, runs = self._turn, self.counts, self._runs
        take_them = self._reporting(take, publisher)

        def take_all(messages: List[bytes]) -> None:
            counts.note(len(messages))
            if counts.wanted:
                counts.look(stamp, messages[-1])
            with turn:
                if runs is not None and runs.holding and runs.holds(publisher):
                    runs.keep(take_them, messages)
                else:
                    take_them(messages)

        return take_all

    def _reporting(self, take: Take, publisher: str) -> TakeAll:
        """Return what takes messages and hands them on, and reports those that cannot be taken."""
        hand_on, counts = self._hand_on, self.counts

        def taken(messages: List[bytes]) -> Iterator[Any]:
            for at, data in enumerate(messages):
                try:
                    found = take(data)
                except Refused:  # reported where it was seen
                    counts.refused += 1
                except Early:
                    if self._runs is not None:
                        self._runs.keep_early(publisher, take_them, messages[at:])
                        return
                except Exception as error:  # one message must not end the connection
                    self._drop(error)
                else:
                    if found is not None:
                        yield found

        def take_them(messages: List[bytes]) -> None:
            hand_on(taken(messages))

        return take_them

    def _drop(self, error: Exception) -> None:
        """Count and report a message that cannot be taken."""
        self.counts.dropped += 1
        if isinstance(error, MessageError):
            text = f"a message on {self._name} is dropped: {error}"
            self._reports.error(RetalisError(text), ("in", self._name))
        else:
            self._reports.error(error)

    def _connected(self, header: Dict[str, str]) -> _Link:
        """Note who takes the messages of a connection; its header is kept, so that its id stays its own."""
        try:
            decoder = self._learn(header)
            stamp = decoder.stamp
            if self._skew is not None:
                decoder = self._skew.watch(decoder, self._name, header.get("callerid", ""))
            take = self._one_by_one(self._taker_of(header, decoder), stamp, header.get("callerid", ""))
        except Exception as error:  # rospy would try again at once, and forever
            if not isinstance(error, MessageError):
                self._reports.error(error)
            reason = getattr(error, "message", "internal error")
            publisher = header.get("callerid", "somebody")
            take = self._refuser(f"topic {self._name}: {reason}: a message of {publisher} is dropped")
        size = sum(map(len, header.values()))
        return self._links.keep(id(header), (header, take), 2 * size)

    def _taker_of(self, header: Dict[str, str], decoder: Decoder) -> Take:
        """Return what takes the messages of a connection."""
        if self._latched is not None and header.get("latching") == "1":
            publisher = (self._name, header.get("callerid", ""))
            return self._latched(decoder, publisher, LatchedConnection(*publisher, self._address(header)))
        return self._taker(decoder)

    def _address(self, header: Dict[str, str]) -> str:
        """Return where the publisher at the other end of a connection answers other nodes; "" if unknown."""
        topic = getattr(self._subscriber, "impl", None)
        links = getattr(topic, "connections", None) or ()
        return next((str(link.endpoint_id) for link in links if link.header is header), "")

    def _refuser(self, reason: str) -> TakeAll:
        """Return what drops messages, and reports and counts them."""

        def refuse(messages: List[bytes]) -> None:
            self.counts.note(len(messages))
            self.counts.refused += len(messages)
            for _ in messages:
                self._reports.warning(reason)

        return refuse

    def _learn(self, header: Dict[str, str]) -> Decoder:
        """Return the decoder for a publisher's messages.

        Raises:
            MessageError: where they are of another type.
        """
        sent = header.get("type", "*")
        learned = self._definitions.learn(
            self.kind, sent, header.get("message_definition", ""), header.get("md5sum", ""), self._event
        )
        if learned.instead:
            rospy.logwarn(
                "topic %s is subscribed as %s, which is unknown here; %s publishes %s, which is used instead",
                self._name,
                self.kind,
                printable(beginning(header.get("callerid", "somebody"))),
                printable(beginning(sent)),
            )
        return learned.decoder


OUTPUT_EVENT = functor("event", 3)
"""What is said of an output between the nodes: the term, its topic, and the id of the subscription."""


def connect(interface: RosInterface, topics: Topics, direct: Iterable[TopicType] = ()) -> None:
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
