"""Recognition of latched messages that enter the running engine a second time.

ROS sends the last message of a latched topic to each new connection. A connection that drops and returns, or an
interface node that is restarted, therefore receives a message that the engine has processed already. Nothing in the
message says so. A message counts as a repetition if all of this holds:

* its connection header marks the topic as latched, and it is the first message on this connection;
* it comes from the same topic, node and process as before. The process is identified by the address at which it
  answers other nodes, which contains its port. The name of the node is not enough: a publisher that is
  restarted and publishes the same content again causes a new event;
* its bytes are those of the last message that the engine has processed of this publisher.

The node in which the engine runs decides, because only this node knows what the engine has processed. If another node
receives the messages and sends them as text, it sends a mark with these facts before the text.
"""

import re
import threading
from hashlib import blake2b
from typing import Callable, Dict, NamedTuple, Optional

MAX_PUBLISHERS = 1000
"""Maximum number of publishers of latched topics whose last messages are stored."""

LATCHED_MARK_PREFIX = "event(retalis_latched("
"""Prefix of the mark that precedes a latched message. Receivers that do not know marks parse it as an event."""

_MARK = re.compile(r"event\(retalis_latched\('([0-9a-f]{32})','([0-9a-f]{32})',([01])\)\)", re.ASCII)


class LatchedMessage(NamedTuple):
    """Description of a message of a latched topic.

    Attributes:
        publisher_digest: identifies the topic, the node and the process that publishes it.
        content_digest: identifies the bytes.
        may_be_repetition: whether it may be a repetition, as the first message on a connection.
    """

    publisher_digest: str
    content_digest: str
    may_be_repetition: bool

    def to_mark(self) -> str:
        """Return the mark that describes the message; see `parse_latched_mark`."""
        flag = int(self.may_be_repetition)
        return f"{LATCHED_MARK_PREFIX}'{self.publisher_digest}','{self.content_digest}',{flag}))"


def parse_latched_mark(mark: str) -> Optional[LatchedMessage]:
    """Return the latched message that a mark describes; None if the text is an event."""
    match = _MARK.fullmatch(mark)
    return None if match is None else LatchedMessage(match[1], match[2], match[3] == "1")


class LatchedConnection:
    """Connection to a publisher of a latched topic.

    Args:
        topic: its full name.
        node: the name of the publisher.
        address: XML-RPC address of the publisher's process; if it is "", no message counts as a repetition.
    """

    def __init__(self, topic: str, node: str, address: str):
        self._publisher = _digest("\n".join((topic, node, address)).encode("utf-8", "surrogateescape"))
        self._may_repeat = bool(address)

    def describe_message(self, data: bytes) -> LatchedMessage:
        """Return the description of a message that was received on this connection."""
        may_be_repetition, self._may_repeat = self._may_repeat, False
        return LatchedMessage(self._publisher, _digest(data), may_be_repetition)


class LatchedMessageDeduplicator:
    """Recognition of repeated latched messages, by the last one that the engine has processed of each publisher.

    Args:
        epoch: returns the number of the epoch of a simulated clock. The engine clears its memories when an epoch
            begins, so a message of a former epoch is not a repetition.
    """

    def __init__(self, epoch: Callable[[], int] = int):
        self._get_epoch = epoch
        self._epoch = epoch()
        self._last_content_digests: Dict[str, str] = {}
        self._lock = threading.Lock()

    def record_message(self, message: LatchedMessage) -> bool:
        """Record a message as the last one of its publisher; return whether it is a repetition."""
        with self._lock:
            epoch = self._get_epoch()
            if epoch != self._epoch:
                self._epoch = epoch
                self._last_content_digests.clear()
            # Removed and added again, so that the least recently active publisher is evicted first.
            last_digest = self._last_content_digests.pop(message.publisher_digest, None)
            self._last_content_digests[message.publisher_digest] = message.content_digest
            if len(self._last_content_digests) > MAX_PUBLISHERS:
                del self._last_content_digests[next(iter(self._last_content_digests))]
            return message.may_be_repetition and message.content_digest == last_digest


def _digest(data: bytes) -> str:
    return blake2b(data, digest_size=16).hexdigest()
