"""Delivery of texts between the two nodes, with buffering for a node that joins late.

Both directions use it: the interface sends events to node ``retalis``, and node ``retalis`` sends outputs to the
interface. ROS delivers a message only to subscribers that are connected already, so texts would be lost while the
other node, the *peer*, starts or restarts. This module adds two guarantees:

* texts that are sent while the peer is absent are buffered and delivered in order when it connects;
* the newest message of each latched topic is delivered to every new instance of the peer.

Other subscribers (``rostopic echo``, a logger) receive the plain stream. To tell them apart, the module asks the
master which node offers the peer's service in this namespace: connections do not contain this information, and node
names differ between launch files. Each node offers its services before it connects. A subscriber therefore starts as
*unidentified*. It receives nothing until it has been identified, and then everything that it has missed.

States of a subscriber::

    unidentified --identify(is_peer=True)--> peer        backlog, latched messages, then the live stream
         |                                    |
         |                                    +-- disconnects --> buffering starts again
         +------identify(is_peer=False)--> third party   texts since it connected, then the live stream

Batches of texts are numbered in publication order. Delivery never skips a batch, so one number per subscriber is
enough to decide which batches it has missed.
"""

import socket
import threading
from collections import deque
from typing import (
    Any,
    Callable,
    Collection,
    ContextManager,
    Deque,
    Dict,
    Hashable,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

import rosgraph
import rospy

from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError
from .connection_writer import TopicWriter
from .master_watch import MASTER_ERRORS

MAX_BUFFERED_BYTES = 64_000_000
"""Limit for buffered texts, and separately for latched messages."""

MAX_LATCHED_MESSAGES = 1000
"""Limit for latched messages; there is at most one per topic and publisher."""

MAX_IDENTIFICATION_ATTEMPTS = 10
"""Attempts to identify a third party as the peer while no peer is connected; it may still be registering."""

IDENTIFICATION_INTERVAL_SECONDS = 1.0
"""Seconds between two attempts."""


Publishers = Callable[[], Set[Tuple[str, str]]]
"""Returns topic and publisher of all connections that deliver messages."""


class Peer(NamedTuple):
    """The node that the texts are intended for.

    Attributes:
        service: service that identifies the node within its namespace.
        title: name of the node in warnings.
    """

    service: str
    title: str


ENGINE = Peer("add_memory", "node retalis")
INTERFACE = Peer("add_input_subscription", "the ROS interface")


class _Batch(NamedTuple):
    """Texts that are published together, as serialized messages.

    Attributes:
        mark: message that only the peer receives, before the texts.
        text_count: number of texts.
    """

    number: int
    mark: bytes
    messages: bytes
    text_count: int


class _LatchedText(NamedTuple):
    """The newest message of a latched topic as text, with the number of its batch and its size in bytes."""

    number: int
    serialize: Callable[[], bytes]
    size: int


class _ThirdParty(NamedTuple):
    """A subscriber that is not the peer.

    Attributes:
        last_missed: number of the last batch before it connected.
        attempts: number of attempts to identify it.
    """

    last_missed: int
    attempts: int


class LatePeerBuffer:
    """Buffer that delivers texts to the peer and to third parties. Not thread-safe: the caller holds a lock.

    Args:
        topic_writer: writes to the connections of the topic.
        peer: the node that the texts are intended for.
        queue_size: number of texts to buffer while the peer is absent; the oldest are dropped and reported.
        reports: receives a warning for every dropped text.
        epoch: returns the current clock epoch, see `ClockEpochs`. Texts of an earlier epoch are meaningless to a peer
            that starts now, so they are discarded.
        greeting: returns the serialized message that a new peer receives first; empty by default.
    """

    def __init__(
        self,
        topic_writer: TopicWriter,
        peer: Peer,
        queue_size: int,
        reports: Reports,
        epoch: Callable[[], int] = int,
        greeting: Callable[[], bytes] = bytes,
    ):
        self.peer = peer
        self._greeting = greeting
        self._topic_writer = topic_writer
        self._queue_size = queue_size
        self._reports = reports
        self._get_epoch = epoch
        self._epoch = 0
        self._last_batch_number = 0
        """Number of the last batch; 0 if there is none."""
        self._known_connections: Any = None
        """The list of connections at the last update, as rospy's object."""
        self._unidentified: Dict[Any, int] = {}
        """Unidentified subscribers, each with the number of the last batch before it connected."""
        self._third_parties: Dict[Any, _ThirdParty] = {}
        """Subscribers that are not the peer."""
        self._peers: List[Any] = []
        self._buffered: Deque[_Batch] = deque()
        self._buffered_texts = self._buffered_bytes = 0
        self._last_delivered_number = 0
        """Number of the last batch that was delivered to a peer."""
        self._latched: Dict[Hashable, _LatchedText] = {}
        self._latched_bytes = 0

    def send(self, messages: bytes, count: int, mark: bytes = b"", for_peer: bool = True) -> None:
        """Send texts to all identified subscribers, and buffer them if a subscriber may have to catch up.

        Args:
            messages: the texts, as serialized messages.
            count: number of texts.
            mark: message that only the peer receives, before the texts.
            for_peer: whether the peer needs the texts, so that they are buffered while it is absent.
        """
        connections = self._topic_writer.connections()
        # The connection list is replaced whenever a subscriber comes or goes, so comparing its identity is enough.
        # A dead peer may remain in an unchanged list; buffering must begin before rospy notices.
        if connections is not self._known_connections or not self._peers or has_ended(self._peers[0]):
            self._update_subscribers(connections)
        self._last_batch_number += 1
        self._topic_writer.counts.sent += count
        if self._peers:
            self._last_delivered_number = self._last_batch_number
        if self._unidentified or not self._peers:
            # An unidentified subscriber receives the texts from the buffer when it has been identified, whether
            # the peer needs them or not.
            if self._unidentified or for_peer:
                self._buffer(_Batch(self._last_batch_number, mark, messages, count))
            connections = [*self._peers, *self._third_parties]
        if mark:
            self._topic_writer.write(self._peers, mark + messages, count)
            connections = [connection for connection in connections if connection not in self._peers]
        self._topic_writer.write(connections, messages, count)

    def latch(self, key: Hashable, serialize: Callable[[], bytes], size: int) -> None:
        """Store the latched message that the next call of `send` delivers, for peers that connect later.

        If there are too many, the oldest ones are dropped with a warning. A message that exceeds the limit alone is
        not stored, with a warning.

        Args:
            key: identifies the topic and, for input topics, the publisher; a newer message with the same key
                replaces this one.
            serialize: returns the text with its mark, as serialized messages.
            size: size of the stored message in bytes.
        """
        self._discard_latched(key)
        if size > MAX_BUFFERED_BYTES:
            self._reports.warning(
                f"a latched message has {size} bytes: {self.peer.title} does not get it if it is started again"
            )
            return
        while self._latched and (
            len(self._latched) >= MAX_LATCHED_MESSAGES or self._latched_bytes + size > MAX_BUFFERED_BYTES
        ):
            self._discard_latched(next(iter(self._latched)))
            self._reports.warning(
                f"too many latched messages: {self.peer.title} does not get the oldest one if it is started again"
            )
        # The message has the number of the batch that `send` is about to create: a peer that finds this batch in the
        # buffer must not receive the message a second time.
        self._latched[key] = _LatchedText(self._last_batch_number + 1, serialize, size)
        self._latched_bytes += size

    def latched_batch_numbers(self) -> Dict[Hashable, int]:
        """Return the batch numbers of the stored latched messages by their keys."""
        return {key: message.number for key, message in self._latched.items()}

    def discard(self, batch_numbers: Dict[Hashable, int]) -> None:
        """Discard latched messages by key and batch number, unless newer ones have replaced them."""
        for key, number in batch_numbers.items():
            if key in self._latched and self._latched[key].number == number:
                self._discard_latched(key)

    def subscribers_to_identify(self) -> List[Any]:
        """Return the unidentified subscribers and, while no peer is connected, third parties.

        A third party may be the peer that has not registered its service yet.
        """
        self._update_subscribers(self._topic_writer.connections())
        if self._peers:
            return list(self._unidentified)
        return [
            *self._unidentified,
            *(
                connection
                for connection, third_party in self._third_parties.items()
                if third_party.attempts < MAX_IDENTIFICATION_ATTEMPTS
            ),
        ]

    def is_third_party(self, connection: Any) -> bool:
        """Return whether a subscriber has been identified as a third party."""
        return connection in self._third_parties

    def identify(self, connection: Any, is_peer: bool) -> None:
        """Record whether a subscriber is the peer, and send the texts that it has missed.

        A third party may be identified again, because a starting peer connects before the master lists its service.
        """
        third_party = self._third_parties.pop(connection, None)
        last_missed = (
            self._unidentified.pop(connection, self._last_batch_number)
            if third_party is None
            else third_party.last_missed
        )
        if is_peer:
            # A restarted peer has lost its state, but batches that the previous instance received are not sent again:
            # an event must not be processed twice. Latched messages are the exception.
            missed = self._collect_backlog(min(last_missed, self._last_delivered_number))
            self._peers.append(connection)
            self._last_delivered_number = self._last_batch_number
        else:
            self._third_parties[connection] = _ThirdParty(
                last_missed, 1 if third_party is None else third_party.attempts + 1
            )
            missed = [batch for batch in self._buffered if batch.number > last_missed]
        if third_party is not None:
            # A former third party has received the live stream since it was identified.
            missed = [batch for batch in missed if is_peer and batch.number <= last_missed]
        messages = [self._greeting()] if is_peer else []
        for batch in missed:
            messages += (batch.mark, batch.messages) if is_peer else (batch.messages,)
        if any(messages):
            self._topic_writer.write(
                [connection], b"".join(messages), sum(batch.text_count for batch in missed)
            )
        if self._peers and not self._unidentified:
            self._clear_buffer()

    def _collect_backlog(self, after_batch: int) -> List[_Batch]:
        """Return the buffered batches after a batch, and the latched messages, in batch order, each once."""
        missed = {batch.number: batch for batch in self._buffered if batch.number > after_batch}
        for key, (number, serialize, _) in self._latched.items():
            if number not in missed:
                try:
                    missed[number] = _Batch(number, b"", serialize(), 1)
                except RetalisError as error:
                    self._reports.error(error, key)
        return [missed[number] for number in sorted(missed)]

    def _update_subscribers(self, connections: Any) -> None:
        """Update the sets of subscribers from the topic's connections."""
        self._known_connections = connections
        alive_connections = [connection for connection in connections if not has_ended(connection)]
        self._peers = [connection for connection in self._peers if connection in alive_connections]
        self._third_parties = {
            connection: third_party
            for connection, third_party in self._third_parties.items()
            if connection in alive_connections
        }
        unidentified, self._unidentified = self._unidentified, {}
        for connection in alive_connections:
            if connection not in self._peers and connection not in self._third_parties:
                self._unidentified[connection] = unidentified.get(connection, self._last_batch_number)

    def _buffer(self, batch: _Batch) -> None:
        # Texts of an earlier clock epoch refer to a time line that has ended; see `ClockEpochs`.
        epoch = self._get_epoch()
        if epoch != self._epoch:
            self._epoch = epoch
            self._clear_buffer()
        self._buffered.append(batch)
        self._buffered_texts += batch.text_count
        self._buffered_bytes += len(batch.mark) + len(batch.messages)
        while self._buffered_texts > self._queue_size or self._buffered_bytes > MAX_BUFFERED_BYTES:
            oldest = self._buffered.popleft()
            self._buffered_texts -= oldest.text_count
            self._buffered_bytes -= len(oldest.mark) + len(oldest.messages)
            # Batches that a peer has received are buffered only for unidentified subscribers, so their loss is no
            # loss of events.
            if oldest.number > self._last_delivered_number:
                self._topic_writer.counts.dropped += oldest.text_count
                for _ in range(oldest.text_count):
                    self._reports.warning(
                        f"{self.peer.title} is not connected: the oldest event that is buffered for it is dropped"
                    )

    def _clear_buffer(self) -> None:
        self._buffered.clear()
        self._buffered_texts = self._buffered_bytes = 0

    def _discard_latched(self, key: Hashable) -> None:
        message = self._latched.pop(key, None)
        if message is not None:
            self._latched_bytes -= message.size


class SubscriberIdentifier(rospy.SubscribeListener):  # type: ignore[misc]
    """Identification of the subscribers of the texts, in a thread.

    A separate thread does it, because identification requires a call of the master, which may block for seconds.
    """

    def __init__(self) -> None:
        super().__init__()
        self._wake_up = threading.Event()

    def peer_subscribe(self, topic: str, publish: object, publish_to_peer: object) -> None:
        """Wake the thread for a new subscriber; rospy calls this."""
        self._wake_up.set()

    def start(
        self,
        peer_buffer: LatePeerBuffer,
        lock: ContextManager[object],
        publishers: Optional[Publishers] = None,
    ) -> None:
        """Start the thread that identifies subscribers.

        Args:
            peer_buffer: receives the result for each subscriber.
            lock: lock that the caller of ``peer_buffer`` holds.
            publishers: returns topic and publisher of all connections that deliver messages; latched messages of
                other publishers are discarded. By default all are stored.
        """

        def run() -> None:
            all_identified = True
            while not rospy.is_shutdown():
                self._wake_up.wait(None if all_identified else IDENTIFICATION_INTERVAL_SECONDS)
                self._wake_up.clear()
                all_identified = _identify_all(peer_buffer, lock, publishers)

        self._wake_up.set()
        threading.Thread(target=run, daemon=True, name="identifying subscribers").start()


def _identify_all(
    peer_buffer: LatePeerBuffer, lock: ContextManager[object], publishers: Optional[Publishers]
) -> bool:
    """Identify all unidentified subscribers; return whether all are identified."""
    with lock:
        unidentified, batch_numbers = (
            peer_buffer.subscribers_to_identify(),
            peer_buffer.latched_batch_numbers(),
        )
    if not unidentified:
        return True
    # The master is asked without the lock: texts are sent meanwhile, and subscribers come and go.
    peers = find_nodes_offering(peer_buffer.peer.service)
    current_publishers: Collection[Hashable] = batch_numbers if publishers is None else publishers()
    with lock:
        # A node that subscribed to the topics itself would receive nothing from publishers that have gone.
        peer_buffer.discard(
            {key: number for key, number in batch_numbers.items() if key not in current_publishers}
        )
        for connection in set(unidentified) & set(peer_buffer.subscribers_to_identify()):
            peer_buffer.identify(connection, getattr(connection, "endpoint_id", None) in peers)
        return not peer_buffer.subscribers_to_identify()


def find_nodes_offering(service: str) -> Set[str]:
    """Return the nodes that offer a service; none if the master does not answer."""
    name = rospy.resolve_name(service)
    try:
        services = rosgraph.Master(rospy.get_name()).getSystemState()[2]
    except MASTER_ERRORS as error:
        rospy.logdebug("the master does not say who offers %s: %s", name, error)
        return set()
    return {node for offered, nodes in services if offered == name for node in nodes}


def has_ended(connection: Any) -> bool:
    """Return whether the other side has closed a connection; data written to it would be lost silently."""
    # Of rospy's QueuedConnection.
    connection = getattr(connection, "_connection", connection)
    sock = getattr(connection, "socket", None)
    if sock is None:
        return bool(getattr(connection, "done", False))
    try:
        # A subscriber sends nothing after the handshake, so a readable socket means the end of the stream.
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True
