"""A piece of work whose caller waits, to be done by whoever is at work."""

import threading
from typing import Any, Callable, Optional


class Request:
    """A piece of work whose caller waits for the result.

    Args:
        work: does it.
        entry: what tells it from others, see `Runner`; by default what nothing else is.
    """

    def __init__(self, work: Callable[[], object], entry: object = None):
        self._work = work
        self.entry = (work,) if entry is None else entry
        self._ticket = [None]  # whoever takes it decides what becomes of the call: it is done, or given up
        self._woken = threading.Event()
        self._result: object = None
        self.error: Optional[BaseException] = None
        self.over = self.follows = False

    def __call__(self) -> None:
        """Do the work, unless it has been taken already."""
        if not self.take():
            return
        try:
            self._result = self._work()
        except Exception as error:  # handed over to the caller that waits, in `result`
            self.error = error
        except BaseException as error:  # an interrupt, which the one who waits must not take for a result
            self.error = error
            raise
        finally:
            self.end()

    def take(self) -> bool:
        """Take the call over; False where somebody has done so already."""
        try:
            self._ticket.pop()
        except IndexError:
            return False
        return True

    def end(self) -> None:
        """Note that it has been done."""
        self.over = True
        self._woken.set()

    @property
    def begun(self) -> bool:
        """Whether it is being done."""
        return not self._ticket and not self.over

    def abandon(self) -> None:
        """End it where an interrupt has ended the work on it, wherever that was."""
        if self.begun:
            self.error = self.error or KeyboardInterrupt()
            self.end()

    def wake(self) -> None:
        """Have who waits look again."""
        self._woken.set()

    def wait(self, seconds: float) -> bool:
        """Wait until it is over or somebody wakes the caller; False where the time is up."""
        woken = self._woken.wait(seconds)
        self._woken.clear()
        return woken or self.over

    def result(self) -> Any:
        """Return the result of work that is over, or raise what it raised."""
        if self.error is not None:
            raise self.error
        return self._result
