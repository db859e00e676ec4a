"""What SIGINT and SIGTERM do to a node."""

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Callable, Optional, Union

PATIENCE = (("xmlrpc.", 2.0), ("rospy.", 0.2))
"""Seconds for which a signal is put off at most, by the modules that the main thread is in.

That is in a request to the master, which may be one that hangs; or in rospy, which may be between two steps that
belong together, or wait for a master that is not there.
"""

PAUSE = 0.05
"""Seconds from one look to the next whether it need not be put off any longer."""

LAST = 10.0
"""Seconds that taking a node down may take. Whoever started it often kills it after 15."""


class Interrupts:
    """Raises KeyboardInterrupt for a signal, but not amid a conversation with the master.

    A request that is cut off leaves its connection of no use, and the node would stay registered with the master. So
    a signal that comes while the node is set up is put off until such a request is over, for a moment mostly.
    """

    def __init__(self) -> None:
        self._allowed = self._raised = self._insisting = False
        self._since: Optional[float] = None

    def begin(self) -> None:
        """Take the signals from now on."""
        self._set(self._take)

    def allow(self) -> None:
        """Let signals interrupt at any moment from now on, and do so if one was put off."""
        self._allowed = True
        if self._since is not None:
            self._interrupt()

    def shut_down(self) -> None:
        """Interrupt what the main thread is doing, where the node is shut down before it was set up."""
        main = threading.main_thread().ident
        if not (self._allowed or self._raised or main is None):
            signal.pthread_kill(main, signal.SIGTERM)

    def end(self, status: int) -> None:
        """Let no signal cut off what the master has to be told at the end, nor the end wait for it forever."""
        self._raised = True
        self._set(signal.SIG_IGN)
        threading.Thread(target=_give_up, args=(status,), daemon=True, name="last resort").start()

    def _set(self, handler: Union[Callable[[int, Optional[FrameType]], None], signal.Handlers]) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)

    def _take(self, number: int, frame: Optional[FrameType]) -> None:
        if self._since is None:
            self._since = time.monotonic()
        if self._allowed or time.monotonic() - self._since >= _patience(frame):
            self._interrupt()
        if not self._insisting:
            self._insisting = True
            threading.Thread(target=self._insist, args=(number,), daemon=True, name="interrupt").start()

    def _interrupt(self) -> None:
        self._raised = True
        raise KeyboardInterrupt

    def _insist(self, number: int) -> None:
        """Send a signal that was put off again and again."""
        main = threading.main_thread().ident
        while True:
            time.sleep(PAUSE)
            if self._raised or main is None:
                return
            signal.pthread_kill(main, number)


def _patience(frame: Optional[FrameType]) -> float:
    """Return how long a signal may be put off for what runs in a frame, and in those that it was called from."""
    modules = []
    while frame is not None:
        modules.append(frame.f_globals.get("__name__") or "")
        frame = frame.f_back
    for begin, seconds in PATIENCE:
        if any(module.startswith(begin) for module in modules):
            return seconds
    return 0.0


def _give_up(status: int) -> None:
    """End the process, where a master that hangs, or a thread that does not end, keeps it from doing so."""
    time.sleep(LAST)
    try:
        print(f"not everything has ended after {LAST:.0f} s: the process ends all the same", file=sys.stderr)
        sys.stderr.flush()
        sys.stdout.flush()
    finally:
        os._exit(status)
