"""Handing texts to node retalis: what comes before it is there is kept, and latched messages for the next one.

Which receiver of the texts is node retalis the master knows: it is the node that offers the service ``add_memory`` of
this namespace. Nothing in a connection says so, and a name would be wrong in the next launch file. The node offers it
before it connects. Until it is known who a receiver is, it gets nothing, and then what it has missed.
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
    Set,
    Tuple,
)
from xmlrpc.client import Error

import rosgraph
import rospy

from ..engine.runtime import Reports
from ..foundation import RetalisError
from .sending import Outlet

SERVICE = "add_memory"
"""What node retalis offers, and nobody else in its namespace."""

HELD_BYTES = 64 << 20
"""Bytes of texts that are held at most, and of the messages that are kept because they are latched."""

LATCHED = 1000
"""Latched messages that are kept at most: one for each topic and publisher."""

LOOKS = 10
"""How often a receiver is looked at that is not node retalis, while that is not there: it may be only starting."""

PAUSE = 1.0
"""Seconds between two such looks."""


Publishers = Callable[[], Set[Tuple[str, str]]]
"""Gives topic and publisher of all connections from which messages come."""


class _Batch(NamedTuple):
    """Texts that were made together, framed as on the wire."""

    order: int
    frames: bytes
    number: int


class _Latched(NamedTuple):
    """The last message of a latched topic."""

    order: int
    write: Callable[[], bytes]
    size: int


class _Other(NamedTuple):
    """A receiver that is not node retalis: the batches that came before it, and how often it was looked up."""

    before: int
    looks: int


class Handover:
    """Sends texts to node retalis and to whoever else listens. All but `run` is called in turn, not at once.

    Args:
        outlet: the topic.
        queue: how many texts are held at most while node retalis is not there.
        reports: takes a warning of each text that is dropped.
        runs: tells how often time has gone back; what is held belongs to one run.
        first: gives what node retalis gets first, framed as on the wire; nothing by default.
    """

    def __init__(
        self,
        outlet: Outlet,
        queue: int,
        reports: Reports,
        runs: Callable[[], int],
        first: Callable[[], bytes] = bytes,
    ):
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
        """Receivers that are not node retalis."""
        self._engines: List[Any] = []
        self._held: Deque[_Batch] = deque()
        self._held_texts = self._held_bytes = 0
        self._handed = 0
        """The last batch that node retalis has got."""
        self._latched: Dict[Hashable, _Latched] = {}
        self._latched_bytes = 0

    def send(self, frames: bytes, number: int) -> None:
        """Send texts, or hold them."""
        links = self._outlet.links()
        if links is not self._links or not self._engines or has_ended(self._engines[0]):
            self._look(links)
        self._order += 1
        self._outlet.counts.sent += number
        if self._engines:
            self._handed = self._order
        if self._new or not self._engines:
            self._hold(frames, number)
            links = [*self._engines, *self._others]
        self._outlet.write(links, frames, number)

    def latch(self, key: Hashable, write: Callable[[], bytes], size: int) -> None:
        """Keep the message that makes the next text for each node retalis that comes.

        Args:
            key: of which the newest is kept: topic and publisher.
            write: gives the text again, framed as on the wire.
            size: the bytes that are kept.
        """
        self._forget(key)
        while self._latched and (len(self._latched) >= LATCHED or self._latched_bytes + size > HELD_BYTES):
            self._forget(next(iter(self._latched)))
            self._reports.warning(
                "too many latched messages: the oldest one is not kept for a node retalis that is started later"
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
        """Return the receivers of which it is not known whether they are node retalis."""
        self._look(self._outlet.links())
        if self._engines:
            return list(self._new)
        return [*self._new, *(link for link, other in self._others.items() if other.looks < LOOKS)]

    def is_other(self, link: Any) -> bool:
        """Tell whether a receiver is known not to be node retalis."""
        return link in self._others

    def settle(self, link: Any, is_engine: bool) -> None:
        """Take note of who a receiver is, and give it what it has missed."""
        known = self._others.pop(link, None)
        before = self._new.pop(link, self._order) if known is None else known.before
        if is_engine:
            missed = self._missed(min(before, self._handed))
            self._engines.append(link)
            self._handed = self._order
        else:
            self._others[link] = _Other(before, 1 if known is None else known.looks + 1)
            missed = [one for one in self._held if one.order > before]
        if known is not None:  # it has got what came since
            missed = [one for one in missed if is_engine and one.order <= before]
        first = self._first() if is_engine else b""
        if missed or first:
            self._outlet.write(
                [link], first + b"".join([one.frames for one in missed]), sum(one.number for one in missed)
            )
        if self._engines and not self._new:
            self._drop_held()

    def _missed(self, since: int) -> List[_Batch]:
        """Return what was held since a batch, and before or between it the latched messages, each once."""
        missed = {one.order: one for one in self._held if one.order > since}
        for key, (order, write, _) in self._latched.items():
            if order not in missed:
                try:
                    missed[order] = _Batch(order, write(), 1)
                except RetalisError as error:
                    self._reports.error(error, key)
        return [missed[order] for order in sorted(missed)]

    def _look(self, links: Any) -> None:
        """Note who has come, and forget who has gone."""
        self._links = links
        there = [link for link in links if not has_ended(link)]
        self._engines = [link for link in self._engines if link in there]
        self._others = {link: looks for link, looks in self._others.items() if link in there}
        new, self._new = self._new, {}
        for link in there:
            if link not in self._engines and link not in self._others:
                self._new[link] = new.get(link, self._order)

    def _hold(self, frames: bytes, number: int) -> None:
        run = self._runs()
        if run != self._run:
            self._run = run
            self._drop_held()
        self._held.append(_Batch(self._order, frames, number))
        self._held_texts += number
        self._held_bytes += len(frames)
        while self._held_texts > self._queue or self._held_bytes > HELD_BYTES:
            oldest = self._held.popleft()
            self._held_texts -= oldest.number
            self._held_bytes -= len(oldest.frames)
            if oldest.order > self._handed:
                self._outlet.counts.dropped += oldest.number
                for _ in range(oldest.number):
                    self._reports.warning(
                        "node retalis is not there: the oldest of the events that wait for it is dropped"
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

    def begin(self, handover: Handover, turn: ContextManager[object], publishers: Publishers) -> None:
        """Look at each receiver from now on.

        Args:
            handover: is told.
            turn: the lock by which texts are sent in turn.
            publishers: gives topic and publisher of all connections from which messages come.
        """

        def run() -> None:
            known = True
            while not rospy.is_shutdown():
                self._come.wait(None if known else PAUSE)
                self._come.clear()
                known = _introduce(handover, turn, publishers)

        self._come.set()
        threading.Thread(target=run, daemon=True, name="introducing receivers").start()


def _introduce(handover: Handover, turn: ContextManager[object], publishers: Publishers) -> bool:
    """Look at the receivers that are not known; return whether all are now."""
    with turn:
        unknown, latched = handover.unknown(), handover.latched()
    if not unknown:
        return True
    engines = offering(SERVICE)
    there: Collection[Hashable] = publishers()
    with turn:
        # What was latched by who is gone now, a node that subscribes its topics itself would not get either.
        handover.forget({key: order for key, order in latched.items() if key not in there})
        for link in set(unknown) & set(handover.unknown()):
            handover.settle(link, getattr(link, "endpoint_id", None) in engines)
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
