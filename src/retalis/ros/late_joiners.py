"""Delivery of texts between the two nodes, with buffering for a node that joins late.

Both directions use it: the interface sends events to node ``retalis``, and node ``retalis`` sends outputs to the
interface. ROS delivers a message only to subscribers that are connected already, so texts would be lost while the
other node, the *peer*, starts or restarts. This module adds two guarantees:

* texts that are sent while the peer is absent are buffered and delivered in order when it connects;
* the newest message of each latched topic is delivered to every new instance of the peer.

Other subscribers (``rostopic echo``, a logger) receive the plain stream. To tell them apart, the module asks the
master which node offers the peer's service in this namespace: connections carry no such information, and node names
differ between launch files. Each node offers its services before it connects. A subscriber that has not been
identified receives nothing, and then what it has missed.
"""

import socket
import threading
from collections import deque
from http.client import HTTPException
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
from xmlrpc.client import Error

import rosgraph
import rospy

from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError
from .connection_writer import Outlet

HELD_BYTES = 64_000_000
"""Bytes of texts that are held at most, and of the messages that are kept because they are latched."""

LATCHED = 1000
"""Latched messages that are kept at most: one for each topic and publisher."""

LOOKS = 10
"""Attempts to identify a receiver as the peer while no peer is connected: it may still be starting."""

PAUSE = 1.0
"""Seconds between two such looks."""


Publishers = Callable[[], Set[Tuple[str, str]]]
"""Gives topic and publisher of all connections from which messages come."""


class Peer(NamedTuple):
    """A node that texts are meant for.

    Attributes:
        service: the service that this node, and no other in its namespace, offers.
        title: its name in messages.
    """

    service: str
    title: str


ENGINE = Peer("add_memory", "node retalis")
INTERFACE = Peer("add_input_subscription", "the ROS interface")


class _Batch(NamedTuple):
    """Texts that were made together, framed as on the wire.

    Attributes:
        order: the number of the batch.
        mark: what the peer alone gets before the texts.
        frames: the texts.
        number: how many texts these are.
    """

    order: int
    mark: bytes
    frames: bytes
    number: int


class _Latched(NamedTuple):
    """The last message of a latched topic."""

    order: int
    write: Callable[[], bytes]
    size: int


class _Other(NamedTuple):
    """A receiver that is not the peer: the batches that came before it, and how often it was looked up."""

    before: int
    looks: int


class LateJoinerBuffer:
    """Sends texts to the peer and to all other subscribers. Not thread-safe: the caller holds a lock.

    Args:
        outlet: the topic.
        peer: the node that the texts are meant for.
        queue: how many texts are held at most while the peer is absent.
        reports: takes a warning of each text that is dropped.
        runs: returns how often time has gone back; texts that are held for a former run are discarded.
        first: returns what the peer gets first, framed as on the wire; nothing by default.

    Attributes:
        peer: see above.
    """

    def __init__(
        self,
        outlet: Outlet,
        peer: Peer,
        queue: int,
        reports: Reports,
        runs: Callable[[], int] = int,
        first: Callable[[], bytes] = bytes,
    ):
        self.peer = peer
        self._first = first
        self._outlet = outlet
        self._queue = queue
        self._reports = reports
        self._runs = runs
        self._run = 0
        self._order = 0
        """How many batches there were."""
        self._links: Any = None
        """The list of connections that was looked at last."""
        self._new: Dict[Any, int] = {}
        """Receivers that are not known yet, each with the batches that came before it."""
        self._others: Dict[Any, _Other] = {}
        """Receivers that are not the peer."""
        self._peers: List[Any] = []
        self._held: Deque[_Batch] = deque()
        self._held_texts = self._held_bytes = 0
        self._handed = 0
        """The last batch that the peer has got."""
        self._latched: Dict[Hashable, _Latched] = {}
        self._latched_bytes = 0

    def send(self, frames: bytes, number: int, mark: bytes = b"", for_peer: bool = True) -> None:
        """Send texts, or hold them.

        Args:
            frames: the texts, framed as on the wire.
            number: how many texts these are.
            mark: what the peer alone gets before them, framed as well.
            for_peer: whether the peer needs them, so that they are held while it is absent.
        """
        links = self._outlet.links()
        if links is not self._links or not self._peers or has_ended(self._peers[0]):
            self._look(links)
        self._order += 1
        self._outlet.counts.sent += number
        if self._peers:
            self._handed = self._order
        if self._new or not self._peers:
            # Who has not been identified gets them from what is held, whether the peer needs them or not.
            if self._new or for_peer:
                self._hold(_Batch(self._order, mark, frames, number))
            links = [*self._peers, *self._others]
        if mark:
            self._outlet.write(self._peers, mark + frames, number)
            links = [link for link in links if link not in self._peers]
        self._outlet.write(links, frames, number)

    def latch(self, key: Hashable, write: Callable[[], bytes], size: int) -> None:
        """Keep the message that makes the next text for each instance of the peer that connects later.

        Args:
            key: of which the newest is kept: topic and publisher.
            write: returns the text again, after its mark, framed as on the wire.
            size: the bytes that are kept.
        """
        self._forget(key)
        while self._latched and (len(self._latched) >= LATCHED or self._latched_bytes + size > HELD_BYTES):
            self._forget(next(iter(self._latched)))
            self._reports.warning(
                f"too many latched messages: {self.peer.title} does not get the oldest one if it is started again"
            )
        self._latched[key] = _Latched(self._order + 1, write, size)
        self._latched_bytes += size

    def latched(self) -> Dict[Hashable, int]:
        """Return for each topic and publisher which latched message is kept."""
        return {key: one.order for key, one in self._latched.items()}

    def forget(self, latched: Dict[Hashable, int]) -> None:
        """Keep some latched messages no longer, where no newer ones have come."""
        for key, order in latched.items():
            if key in self._latched and self._latched[key].order == order:
                self._forget(key)

    def unknown(self) -> List[Any]:
        """Return the receivers of which it is not known whether they are the peer."""
        self._look(self._outlet.links())
        if self._peers:
            return list(self._new)
        return [*self._new, *(link for link, other in self._others.items() if other.looks < LOOKS)]

    def is_other(self, link: Any) -> bool:
        """Tell whether a receiver is known not to be the peer."""
        return link in self._others

    def settle(self, link: Any, is_peer: bool) -> None:
        """Take note of who a receiver is, and give it what it has missed."""
        known = self._others.pop(link, None)
        before = self._new.pop(link, self._order) if known is None else known.before
        if is_peer:
            missed = self._missed(min(before, self._handed))
            self._peers.append(link)
            self._handed = self._order
        else:
            self._others[link] = _Other(before, 1 if known is None else known.looks + 1)
            missed = [one for one in self._held if one.order > before]
        if known is not None:  # it has got what came since
            missed = [one for one in missed if is_peer and one.order <= before]
        frames = [self._first()] if is_peer else []
        for one in missed:
            frames += (one.mark, one.frames) if is_peer else (one.frames,)
        if any(frames):
            self._outlet.write([link], b"".join(frames), sum(one.number for one in missed))
        if self._peers and not self._new:
            self._drop_held()

    def _missed(self, since: int) -> List[_Batch]:
        """Return what was held since a batch, and before or between it the latched messages, each once."""
        missed = {one.order: one for one in self._held if one.order > since}
        for key, (order, write, _) in self._latched.items():
            if order not in missed:
                try:
                    missed[order] = _Batch(order, b"", write(), 1)
                except RetalisError as error:
                    self._reports.error(error, key)
        return [missed[order] for order in sorted(missed)]

    def _look(self, links: Any) -> None:
        """Note who has come, and forget who has gone."""
        self._links = links
        there = [link for link in links if not has_ended(link)]
        self._peers = [link for link in self._peers if link in there]
        self._others = {link: looks for link, looks in self._others.items() if link in there}
        new, self._new = self._new, {}
        for link in there:
            if link not in self._peers and link not in self._others:
                self._new[link] = new.get(link, self._order)

    def _hold(self, batch: _Batch) -> None:
        run = self._runs()
        if run != self._run:
            self._run = run
            self._drop_held()
        self._held.append(batch)
        self._held_texts += batch.number
        self._held_bytes += len(batch.mark) + len(batch.frames)
        while self._held_texts > self._queue or self._held_bytes > HELD_BYTES:
            oldest = self._held.popleft()
            self._held_texts -= oldest.number
            self._held_bytes -= len(oldest.mark) + len(oldest.frames)
            if oldest.order > self._handed:
                self._outlet.counts.dropped += oldest.number
                for _ in range(oldest.number):
                    self._reports.warning(
                        f"{self.peer.title} is not there: the oldest of the events that wait for it is dropped"
                    )

    def _drop_held(self) -> None:
        self._held.clear()
        self._held_texts = self._held_bytes = 0

    def _forget(self, key: Hashable) -> None:
        found = self._latched.pop(key, None)
        if found is not None:
            self._latched_bytes -= found.size


class Introducer(rospy.SubscribeListener):  # type: ignore[misc]
    """Finds out who the receivers of the texts are, in a thread of its own: the master has to be asked."""

    def __init__(self) -> None:
        super().__init__()
        self._come = threading.Event()

    def peer_subscribe(self, topic: str, publish: object, publish_to_peer: object) -> None:
        """Have a look at a receiver that has come."""
        self._come.set()

    def begin(
        self,
        handover: LateJoinerBuffer,
        turn: ContextManager[object],
        publishers: Optional[Publishers] = None,
    ) -> None:
        """Look at each receiver from now on.

        Args:
            handover: is told.
            turn: the lock by which texts are sent in turn.
            publishers: returns topic and publisher of all connections from which messages come; latched messages of
                others are not kept. By default all are.
        """

        def run() -> None:
            known = True
            while not rospy.is_shutdown():
                self._come.wait(None if known else PAUSE)
                self._come.clear()
                known = _introduce(handover, turn, publishers)

        self._come.set()
        threading.Thread(target=run, daemon=True, name="introducing receivers").start()


def _introduce(
    handover: LateJoinerBuffer, turn: ContextManager[object], publishers: Optional[Publishers]
) -> bool:
    """Look at the receivers that are not known; return whether all are now."""
    with turn:
        unknown, latched = handover.unknown(), handover.latched()
    if not unknown:
        return True
    peers = offering(handover.peer.service)
    there: Collection[Hashable] = latched if publishers is None else publishers()
    with turn:
        # What was latched by who is gone now, a node that subscribes its topics itself would not get either.
        handover.forget({key: order for key, order in latched.items() if key not in there})
        for link in set(unknown) & set(handover.unknown()):
            handover.settle(link, getattr(link, "endpoint_id", None) in peers)
        return not handover.unknown()


def offering(service: str) -> Set[str]:
    """Return the nodes that offer a service, none where the master does not answer."""
    name = rospy.resolve_name(service)
    try:
        services = rosgraph.Master(rospy.get_name()).getSystemState()[2]
    except (OSError, Error, HTTPException, rosgraph.MasterException) as error:
        rospy.logdebug("the master does not say who offers %s: %s", name, error)
        return set()
    return {node for offered, nodes in services if offered == name for node in nodes}


def has_ended(link: Any) -> bool:
    """Tell whether a connection has ended: what is written would be lost without a word."""
    link = getattr(link, "_connection", link)  # of rospy's QueuedConnection
    sock = getattr(link, "socket", None)
    if sock is None:
        return bool(getattr(link, "done", False))
    try:
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True
