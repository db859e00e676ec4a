"""What reaches a node while its operator calls goals of the program: it is put off until the operator is done.

Such a goal may make events that come to the same node, have partial matches dropped, or set flags.
"""

from collections import deque
from typing import Any, Callable, Deque, Tuple

from ...prolog.machine import Frame
from ..dispatch import Dispatcher

PutOff = Callable[[Frame], Frame]
"""Does what was put off, and returns the frame that goes on with another."""


class Postponing:
    """What one node has put off; as code of a frame it does that, one after the other.

    Each is done with the event being served that was when it came, so that no chain of events goes on without end.

    Attributes:
        at_work: whether the operator is.
    """

    def __init__(self, dispatcher: Dispatcher):
        self._dispatcher = dispatcher
        self._steps: Deque[Tuple[Any, PutOff]] = deque()
        self.at_work = False

    def clear(self) -> None:
        """Forget what was put off, after an interrupt."""
        self.at_work = False
        self._steps.clear()

    def put_off(self, step: PutOff) -> None:
        """Do something later."""
        self._steps.append((self._dispatcher.current, step))

    def while_at_work(self, work: Callable[[], Any]) -> Any:
        """Return what work returns, which is that of the operator."""
        self.at_work = True
        try:
            return work()
        finally:
            self.at_work = False

    def before(self, after: Frame) -> Frame:
        """Return the frame that does what was put off, and goes on with ``after``."""
        return (self, self._dispatcher.current, after) if self._steps else after

    def run(self, frame: Frame) -> Frame:
        """Do the next of it."""
        dispatcher = self._dispatcher
        _, current, after = frame
        if not self._steps:
            dispatcher.restore(current, dispatcher.cause)
            return after  # type: ignore[no-any-return]
        event, step = self._steps.popleft()
        dispatcher.restore(event, dispatcher.cause)
        return step(frame)
