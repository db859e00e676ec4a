"""Events as text on the String topics between the nodes."""

from struct import Struct
from typing import Any, Callable, ContextManager, List, Optional, Tuple

from std_msgs.msg import String

from ..engine.runtime import ClockRuns, Reports
from ..foundation import MessageError
from .counting import OutputStatus
from .handover import Handover, Introducer, Publishers
from .sending import Outlet

MOST = 64
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
        runs: see `Handover`.
        simulated: the runs of a simulated clock, of which the receivers are told.
    """

    def __init__(
        self,
        topic: str,
        queue: int,
        reports: Reports,
        runs: Callable[[], int],
        simulated: Optional[ClockRuns] = None,
    ):
        self._simulated = simulated
        self._introducer = Introducer()
        self._outlet = Outlet(topic, String, queue, reports, self._is_patient, listener=self._introducer)
        self._handover = Handover(self._outlet, queue, reports, runs, self._mark)
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
        if len(self._waiting) >= MOST:
            self.flush()

    def links(self) -> Any:
        """Return the connections to those who listen."""
        return self._outlet.links()

    def status(self) -> OutputStatus:
        """Return what has gone out so far."""
        return self._outlet.status("std_msgs/String")

    def add_latched(self, text: str, publisher: Tuple[str, str], again: Callable[[], str], size: int) -> None:
        """Add the text of a message that each node retalis gets that is started later.

        Args:
            text: is sent now.
            publisher: the message's topic and publisher; of each the newest message is kept.
            again: gives the text for the next one.
            size: the bytes that it takes to keep.
        """
        self.flush()
        self._handover.latch(publisher, lambda: text_frame(again()), size)
        self.add(text)
        self.flush()

    def flush(self) -> None:
        """Write the texts that were added."""
        waiting = self._waiting
        if waiting:
            self._handover.send(b"".join(waiting), len(waiting))
            waiting.clear()


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


def text_taker(
    take: Callable[[str], object], runs: Optional[ClockRuns] = None
) -> Callable[[object], Callable[[bytes], None]]:
    """Return what `InputTopic` needs to hand the texts of ``std_msgs/String`` messages to ``take``.

    Args:
        take: takes a text.
        runs: holds the texts of a run that has not begun.
    """

    def read(data: bytes) -> str:
        if len(data) < 4 or _SIZE.unpack_from(data)[0] != len(data) - 4:
            raise MessageError("expected a std_msgs/String, found other bytes")
        return str(data[4:], "utf-8", "replace")

    def take_all(texts: List[str]) -> None:
        for text in texts:
            take(text)

    def taker(decoder: object) -> Callable[[bytes], None]:
        sender = object()

        def receive(data: bytes) -> None:
            text = read(data)
            if runs is None:
                take(text)
                return
            run = _marked(text) if text.startswith(MARK) else None
            if run is not None:
                runs.tell(sender, run)
            elif runs.holding and runs.holds_texts(sender):
                runs.keep(take_all, [text])
            else:
                take(text)

        return receive

    return taker
