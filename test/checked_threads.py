"""Threads whose errors reach the test, and waiting with a time limit."""

import threading
import time
from typing import Any, Callable, Optional

TIMEOUT_SECONDS = 30.0


class CheckedThread(threading.Thread):
    """A daemon thread, which `end` joins; an error of its target is raised there."""

    def __init__(self, target: Callable[..., object], *arguments: Any, name: Optional[str] = None) -> None:
        super().__init__(name=name, daemon=True)
        self._work = target
        self._arguments = arguments
        self._error: Optional[BaseException] = None

    def run(self) -> None:
        """Call the target and store its error."""
        try:
            self._work(*self._arguments)
        except BaseException as error:  # raised by `end`
            self._error = error

    def end(self) -> None:
        """Wait for the end of the thread; raise the error of its target."""
        self.join(TIMEOUT_SECONDS)
        assert not self.is_alive(), f"{self.name} has not ended within {TIMEOUT_SECONDS:g} s"
        if self._error is not None:
            raise self._error


def wait_until(condition: Callable[[], object], description: str) -> None:
    """Wait until a condition is true; fail with its description after a time limit."""
    deadline = time.monotonic() + TIMEOUT_SECONDS
    while not condition():
        assert time.monotonic() < deadline, f"not within {TIMEOUT_SECONDS:g} s: {description}"
        time.sleep(0.001)
