"""Recognition of latched messages that enter the running engine a second time.

ROS sends the last message of a latched topic to each new connection. A connection that drops and returns, or an
interface node that is restarted, therefore receives a message that the engine has processed already. Nothing in the
message says so. A message counts as a repetition if all of this holds:

* its connection header marks the topic as latched, and it is the first message on this connection;
* it comes from the same topic, node and process as before. The process is identified by the address at which it
  answers other nodes, as each process has a port of its own. The name of the node is not enough: a publisher that is
  restarted and publishes the same content again makes a new event;
* its bytes are those of the last message that the engine has processed of this publisher.

The node in which the engine runs decides, because only this node knows what the engine has processed. If another node
receives the messages and sends them as text, it sends a mark with these facts before the text.
"""

import re
import threading
from hashlib import blake2b
from typing import Callable, Dict, NamedTuple, Optional

MAX_PUBLISHERS = 1000
"""Limit for the publishers of latched topics whose last messages are stored."""

LATCHED_MARK = "event(retalis_latched("
"""Beginning of the mark that describes the latched message after it. Other receivers read the mark as an event."""

_MARK = re.compile(r"event\(retalis_latched\('([0-9a-f]{32})','([0-9a-f]{32})',([01])\)\)", re.ASCII)


class LatchedMessage(NamedTuple):
    """A message of a latched topic.

    Attributes:
        publisher: identifies the topic, the node and the process that publishes it.
        content: identifies the bytes.
        is_first: whether it may be a repetition, as the first message on a connection.
    """

    publisher: str
    content: str
    is_first: bool

    def mark(self) -> str:
        """Return the text that describes it; see `latched_message`."""
        return f"{LATCHED_MARK}'{self.publisher}','{self.content}',{int(self.is_first)}))"


def latched_message(mark: str) -> Optional[LatchedMessage]:
    """Return the latched message that a mark describes; None if the text is an event."""
    match = _MARK.fullmatch(mark)
    return None if match is None else LatchedMessage(match[1], match[2], match[3] == "1")


class LatchedConnection:
    """A connection to a publisher of a latched topic.

    Args:
        topic: its full name.
        node: the name of the publisher.
        address: XML-RPC address of the publisher's process; if it is "", no message counts as a repetition.
    """

    def __init__(self, topic: str, node: str, address: str):
        self._publisher = _digest("\n".join((topic, node, address)).encode("utf-8", "surrogateescape"))
        self._may_repeat = bool(address)

    def message(self, data: bytes) -> LatchedMessage:
        """Return the description of a message that was received on this connection."""
        is_first, self._may_repeat = self._may_repeat, False
        return LatchedMessage(self._publisher, _digest(data), is_first)


class LatchedInputs:
    """The last latched message that the engine has processed of each publisher.

    Args:
        epoch: returns the number of the epoch of a simulated clock. The engine clears its memories when an epoch
            begins, so a message of a former epoch is not a repetition.
    """

    def __init__(self, epoch: Callable[[], int] = int):
        self._current_epoch = epoch
        self._epoch = epoch()
        self._contents: Dict[str, str] = {}
        self._lock = threading.Lock()

    def is_repetition(self, message: LatchedMessage) -> bool:
        """Return whether a message is a repetition, and record it as the last one of its publisher."""
        with self._lock:
            epoch = self._current_epoch()
            if epoch != self._epoch:
                self._epoch = epoch
                self._contents.clear()
            # Removed and added again, so that the publisher with the longest silence is evicted first.
            last_content = self._contents.pop(message.publisher, None)
            self._contents[message.publisher] = message.content
            if len(self._contents) > MAX_PUBLISHERS:
                del self._contents[next(iter(self._contents))]
            return message.is_first and message.content == last_content


def _digest(data: bytes) -> str:
    return blake2b(data, digest_size=16).hexdigest()
