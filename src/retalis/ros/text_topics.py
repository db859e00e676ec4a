"""Events as text on the String topics between the nodes."""

import threading
from functools import partial
from struct import Struct
from typing import Any, Callable, ContextManager, Iterable, List, Optional, Tuple

from std_msgs.msg import String

from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.problem_reports import Reports
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, UsageError
from .connection_writer import Outlet
from .internal_topics import resolve
from .latched_inputs import MARK as LATCHED_MARK
from .latched_inputs import LatchedInputs, LatchedMessage, latched_message
from .late_joiners import ENGINE, INTERFACE, Introducer, LateJoinerBuffer, Publishers
from .topic_statistics import OutputStatus

MAX_TEXTS_PER_WRITE = 64
"""Texts that are written at once at most."""

_SIZE = Struct("<I")
_SIZES = Struct("<II")


def text_frame(text: str) -> bytes:
    """Return a text as a ``std_msgs/String`` message, framed as on the wire."""
    data = text.encode("utf-8", "surrogateescape")
    size = len(data)
    return _SIZES.pack(size + 4, size) + data


class TextPublisher:
    """Publishes texts for node retalis: those that are made together with one write. Not for two threads at once.

    Args:
        topic: its name.
        queue: how many texts may wait.
        reports: takes a warning of each text that is dropped.
        runs: see `LateJoinerBuffer`.
        simulated: the runs of a simulated clock, of which the receivers are told.
    """

    def __init__(
        self,
        topic: str,
        queue: int,
        reports: Reports,
        runs: Callable[[], int],
        simulated: Optional[ClockEpochs] = None,
    ):
        self._simulated = simulated
        self._introducer = Introducer()
        self._outlet = Outlet(topic, String, queue, reports, self._is_patient, listener=self._introducer)
        self._handover = LateJoinerBuffer(self._outlet, ENGINE, queue, reports, runs, self._mark)
        self._waiting: List[bytes] = []

    def begin(self, turn: ContextManager[object], publishers: Publishers) -> None:
        """Find out who listens from now on.

        Args:
            turn: the lock under which all else here is called.
            publishers: gives topic and publisher of all connections from which messages come.
        """
        self._introducer.begin(self._handover, turn, publishers)

    def _mark(self) -> bytes:
        """Return the text that tells of the run at hand, framed as on the wire; nothing where there are no runs."""
        return b"" if self._simulated is None else text_frame(mark_of(self._simulated.run))

    def begin_run(self, ended: int) -> None:
        """Tell that a run begins."""
        self.flush()
        self._handover.send(self._mark(), 1)

    def _is_patient(self, link: Any) -> bool:
        """Tell whether those who send are held up for a receiver: not for one that only looks on, slowly maybe."""
        return not self._handover.is_other(link)

    def add(self, text: str) -> None:
        """Add a text to those that go out next."""
        self._waiting.append(text_frame(text))
        if len(self._waiting) >= MAX_TEXTS_PER_WRITE:
            self.flush()

    def links(self) -> Any:
        """Return the connections to those who listen."""
        return self._outlet.links()

    def status(self) -> OutputStatus:
        """Return what has gone out so far."""
        return self._outlet.status("std_msgs/String")

    def add_latched(
        self,
        text: str,
        message: LatchedMessage,
        publisher: Tuple[str, str],
        again: Callable[[], str],
        size: int,
    ) -> None:
        """Send the text of a latched message, also to each node retalis that connects later.

        Args:
            text: is sent now.
            message: describes the message, so that node retalis recognizes a repetition.
            publisher: the message's topic and publisher; the newest message of each is kept.
            again: returns the text for a node that connects later.
            size: the bytes that are kept.
        """
        self.flush()
        # A node whose connection has only dropped and returned has the message already.
        mark_again = text_frame(message._replace(is_first=True).mark())
        self._handover.latch(publisher, lambda: mark_again + text_frame(again()), size)
        self._handover.send(text_frame(text), 1, text_frame(message.mark()))

    def flush(self) -> None:
        """Write the texts that were added."""
        waiting = self._waiting
        if waiting:
            self._handover.send(b"".join(waiting), len(waiting))
            waiting.clear()


class OutputTexts:
    """Sends outputs as text to the ROS interface, when it runs in another node, and to all other subscribers.

    An output to a topic that the interface publishes is held until the interface has connected. The last output to a
    latched topic is sent again to an interface that is restarted. May be called by any thread.

    Args:
        topic: the topic of the texts.
        queue: how many texts may wait.
        reports: takes a warning of each text that is dropped.
        published: the topics that the interface publishes.
        latched: those of them that are latched.
    """

    def __init__(
        self, topic: str, queue: int, reports: Reports, published: Iterable[str], latched: Iterable[str]
    ):
        self._published = frozenset(map(_full_name, published))
        self._latched = frozenset(map(_full_name, latched))
        self._names: Cache[str, str] = Cache(1000, 1 << 20)
        """Full names of topics by what programs call them."""
        self._introducer = Introducer()
        self._outlet = Outlet(topic, String, queue, reports, listener=self._introducer)
        self._handover = LateJoinerBuffer(self._outlet, INTERFACE, queue, reports)
        self._turn = threading.Lock()
        self._introducer.begin(self._handover, self._turn)

    def send(self, topic: str, write: Callable[[], str]) -> None:
        """Send an output to a topic, or hold it; ``write`` returns the text."""
        name = self._names.get(topic) or self._names.keep(topic, _full_name(topic), 2 * len(topic))
        is_published = name in self._published
        if not is_published and not self.links():  # as for topics that somebody only watches
            return
        frame = text_frame(write())
        with self._turn:
            if name in self._latched:
                self._handover.latch(name, lambda: frame, len(frame))
            self._handover.send(frame, 1, for_peer=is_published)

    def links(self) -> Any:
        """Return the connections to the subscribers."""
        return self._outlet.links()

    def status(self) -> OutputStatus:
        """Return what has gone out so far."""
        return self._outlet.status("std_msgs/String")


def _full_name(topic: str) -> str:
    """Return the full name of a topic, or what is no name as it is: such outputs are text only."""
    try:
        return resolve(topic)
    except UsageError:
        return topic


MARK = "event(retalis_run("
"""How the text begins that tells of which run those after it are. To whoever does not know it, it is an event."""

_MARK_END = "))"


def mark_of(run: int) -> str:
    """Return the text that tells that those after it are of a run."""
    return f"{MARK}{run}{_MARK_END}"


def _marked(text: str) -> Optional[int]:
    """Return the run that a text tells of; None for an event."""
    number = text[len(MARK) : -len(_MARK_END)]
    is_mark = len(number) < 10 and number.isascii() and number.isdigit() and text.endswith(_MARK_END)
    return int(number) if is_mark else None


_ANY_MARK = "event(retalis_"
"""The beginning of all marks."""


def text_taker(
    take: Callable[[str], object],
    runs: Optional[ClockEpochs] = None,
    latched: Optional[LatchedInputs] = None,
) -> Callable[[object], Callable[[bytes], None]]:
    """Return what `InputTopic` needs to pass the texts of ``std_msgs/String`` messages to ``take``.

    Args:
        take: takes a text.
        runs: holds the texts of a run that has not begun.
        latched: recognizes texts of latched messages that ``take`` had already.
    """
    return lambda decoder: _TextReceiver(take, runs, latched).receive


class _TextReceiver:
    """Takes the texts of one connection; see `text_taker`."""

    def __init__(
        self, take: Callable[[str], object], runs: Optional[ClockEpochs], latched: Optional[LatchedInputs]
    ):
        self._take = take
        self._runs = runs
        self._latched = latched
        self._message: Optional[LatchedMessage] = None
        """The latched message whose text comes next."""

    def receive(self, data: bytes) -> None:
        if len(data) < 4 or _SIZE.unpack_from(data)[0] != len(data) - 4:
            raise MessageError("expected a std_msgs/String, found other bytes")
        text = str(data[4:], "utf-8", "replace")
        if text.startswith(_ANY_MARK) and self._is_mark(text):
            return
        runs, message = self._runs, self._message
        if message is not None:
            self._message = None
        if runs is not None and runs.holding and runs.holds_texts(self):
            # A text of a latched message is compared when it is taken: another run may have begun by then.
            runs.keep(self._take_all if message is None else partial(self._take_latched, message), [text])
        elif message is None:
            self._take(text)
        else:
            self._take_latched(message, [text])

    def _is_mark(self, text: str) -> bool:
        """Take note of a mark; return whether the text is one."""
        run = _marked(text) if text.startswith(MARK) else None
        if run is not None and self._runs is not None:
            self._runs.tell(self, run)
            return True
        message = latched_message(text) if text.startswith(LATCHED_MARK) else None
        if message is not None:
            self._message = message
        return message is not None

    def _take_all(self, texts: List[str]) -> None:
        for text in texts:
            self._take(text)

    def _take_latched(self, message: LatchedMessage, texts: List[str]) -> None:
        if self._latched is None or not self._latched.repeats(message):
            self._take_all(texts)
