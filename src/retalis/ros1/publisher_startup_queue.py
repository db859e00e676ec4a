"""First outputs of a node: none is lost because its subscribers have not connected yet.

A subscriber connects some milliseconds after a topic is advertised. Outputs may exist before: goals of the program
emit events while it is loaded, and latched inputs arrive at once. `StartupQueue` stores the messages of a topic until
the subscribers that the master knows have connected, at most `MAX_SUBSCRIBER_WAIT_SECONDS`; `SubscriberWait` checks
this in a thread, so that the engine does not wait.
"""

import socket
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Deque, Dict, Iterable, Set
from urllib.parse import urlsplit

import rospy
from rospy.rostime import wallsleep

from ..engine.runtime.problem_reports import Reports
from ..foundation.displayed_text import format_count
from .connection_writer import TopicWriter
from .master_watch import MASTER_ERRORS

MAX_SUBSCRIBER_WAIT_SECONDS = 5.0
"""Maximum time in seconds for which messages wait for the subscribers that the master knows."""

_CHECK_SECONDS = 0.02
"""Interval in seconds between two checks of the connections."""

_PROBE_SECONDS = 0.5
"""Maximum time in seconds for finding out whether a registered node is running."""

_MAX_PROBES = 32
"""Number of nodes that are probed at the same time."""


class StartupQueue:
    """Messages of a topic that wait for its known subscribers.

    Args:
        max_messages: number of messages to queue; beyond it the oldest are dropped.
        reports: receives a warning for each dropped message.
    """

    def __init__(self, topic_writer: TopicWriter, max_messages: int, reports: Reports):
        self._topic_writer = topic_writer
        self._max_messages = max_messages
        self._reports = reports
        self._lock = threading.Lock()
        self._messages: Deque[bytes] = deque()
        self._is_released = False

    def send(self, message: bytes) -> None:
        """Write a serialized message to the topic, or queue it."""
        if not self._is_released:
            with self._lock:
                # Tested again: `release` may have written the queue meanwhile.
                if not self._is_released:
                    self._append(message)
                    return
        self._topic_writer.send(message)

    def _append(self, message: bytes) -> None:
        if len(self._messages) >= self._max_messages:
            self._messages.popleft()
            self._topic_writer.counts.dropped += 1
            self._reports.warning(
                f"topic {self._topic_writer.publisher.name}: a message is dropped before its subscribers connect"
            )
        self._messages.append(message)

    def subscribers(self) -> Set[str]:
        """Return the names of the nodes that have connected."""
        # The connection of a node inside rospy's QueuedConnection.
        connections = [getattr(each, "_connection", each) for each in self._topic_writer.connections()]
        return {each.endpoint_id for each in connections}

    def release(self) -> None:
        """Write the queued messages, and all later ones at once."""
        with self._lock:
            for message in self._messages:
                self._topic_writer.send(message)
            self._messages.clear()
            self._is_released = True


class SubscriberWait:
    """Thread that releases the startup queues of topics when their known subscribers have connected.

    Args:
        reports: receives a warning if subscribers do not connect.
    """

    def __init__(self, reports: Reports):
        self._reports = reports
        self._lock = threading.Lock()
        self._queues: Dict[str, StartupQueue] = {}
        self._is_running = False

    def add(self, topic: str, queue: StartupQueue) -> None:
        """Wait for the subscribers that the master knows of an advertised topic."""
        with self._lock:
            self._queues[topic] = queue
            if not self._is_running:
                self._is_running = True
                threading.Thread(target=self._run, daemon=True, name="first outputs").start()

    def _run(self) -> None:
        while True:
            with self._lock:
                queues, self._queues = self._queues, {}
                if not queues:
                    self._is_running = False
                    return
            self._release_connected(queues)

    def _release_connected(self, queues: Dict[str, StartupQueue]) -> None:
        """Release queues as their subscribers connect; all of them at the deadline, or if this fails."""
        try:
            awaited = _known_subscribers(queues)
            deadline = time.monotonic() + MAX_SUBSCRIBER_WAIT_SECONDS
            _release_complete(queues, awaited)
            while queues and time.monotonic() < deadline and not rospy.is_shutdown():
                # Wall time: simulated time may stand still.
                wallsleep(_CHECK_SECONDS)
                _release_complete(queues, awaited)
            # The end of the node closes the connections.
            for topic, queue in () if rospy.is_shutdown() else queues.items():
                missing = sorted(awaited[topic] - queue.subscribers())
                self._reports.warning(
                    f"topic {topic}: {format_count(len(missing), 'registered subscriber')} has not connected within "
                    f"{MAX_SUBSCRIBER_WAIT_SECONDS:g} s: {', '.join(missing)}: its first messages are not sent to it"
                )
        # Any other error would end the thread, and the messages of later topics would wait forever.
        except Exception as error:
            self._reports.error(error)
        finally:
            for queue in queues.values():
                queue.release()


def _release_complete(queues: Dict[str, StartupQueue], awaited: Dict[str, Set[str]]) -> None:
    """Release and remove the queues whose subscribers have connected."""
    for topic, queue in list(queues.items()):
        if awaited[topic] <= queue.subscribers():
            queue.release()
            del queues[topic]


def _known_subscribers(topics: Iterable[str]) -> Dict[str, Set[str]]:
    """Return the running nodes that the master knows as subscribers, by topic."""
    known: Dict[str, Set[str]] = {topic: set() for topic in topics}
    try:
        subscriptions = rospy.get_master().getSystemState()[2][1]
        known.update((topic, set(nodes)) for topic, nodes in subscriptions if topic in known)
        uris = {node: rospy.get_master().lookupNode(node) for nodes in known.values() for node in nodes}
    except MASTER_ERRORS:
        # Without the master no subscriber can find the topics either.
        return {topic: set() for topic in known}
    # In parallel: many nodes that have crashed may still be registered, and each takes the whole time of a probe.
    with ThreadPoolExecutor(_MAX_PROBES) as pool:
        probes = pool.map(_accepts_connections, (uri if code == 1 else "" for code, _, uri in uris.values()))
        running = {node for node, is_running in zip(uris, probes) if is_running}
    return {topic: nodes & running for topic, nodes in known.items()}


def _accepts_connections(uri: str) -> bool:
    """Return whether a node accepts connections at its address; one that has crashed stays registered."""
    try:
        address = urlsplit(uri)
        with socket.create_connection((address.hostname or "", address.port or 0), _PROBE_SECONDS):
            return True
    except (OSError, ValueError):
        return False
