"""Interrupts that act at safe points.

Python calls the handler of a signal between any two steps of the main thread. An exception that the handler raises
there may leave data half changed: a lock without an owner, an index without the item that was just stored. It may
even be lost, because Python ignores exceptions in the callbacks of weak references and of the garbage collector.

Within `deferred_interrupts`, the handlers therefore only record the signal in `PENDING`. The `Interrupt` is raised by
`raise_pending` at a *safe point*, where nothing is half changed: after an event or a query, between two messages of a
bag, between two lines of output. A long goal, or long matching of patterns, ends where it checks its limits; the
executor raises the interrupt after the end of the event (see `prolog.machine.resource_limits`).

Where the process only waits, for input, for a lock or for time to pass, no data is half changed at any step. Such
code is marked by `interruptible`, and the handler raises the interrupt at once. It is pending if Python ignores it.
A call by XML-RPC is such a wait without a mark, because its caller has to expect that the connection breaks.

If the process is in code without safe points, a second signal ends it after `MAX_RESPONSE_SECONDS`.
"""

import os
import signal
import sys
import threading
from contextlib import contextmanager
from threading import get_ident
from time import monotonic
from types import FrameType
from typing import Any, Dict, Iterator, Optional

from .errors import UsageError

PENDING: Dict[int, BaseException] = {}
"""Exception that a thread has to raise at its next safe point, by the thread's id.

The dictionary is never replaced, so other modules import it; it is empty nearly always, so that testing it costs an
event next to nothing.
"""

MAX_RESPONSE_SECONDS = 1.0
"""Time after a signal from which on a further signal ends the process, if no safe point has been reached."""

EXIT_STATUS = 130
"""Exit status after an interrupt; shells use it for SIGINT."""

_LAST_WORDS = b"\nretalis: interrupted twice: the process ends without cleaning up\n"


class SafeExit(BaseException):
    """An exception that is raised at safe points only, and is no error that an engine reports before it continues."""


class Interrupt(SafeExit, KeyboardInterrupt):
    """A `KeyboardInterrupt` that is raised at a safe point."""


class _HandlerState:
    """State of the handlers.

    Attributes:
        thread: the main thread while the handlers are installed, otherwise None.
        is_waiting: whether that thread runs a block of `interruptible`.
        signal_time: time of the first signal that has not been handled, on the monotonic clock in seconds.
    """

    thread: Optional[int] = None
    is_waiting = False
    signal_time: Optional[float] = None


@contextmanager
def deferred_interrupts(*signals: int) -> Iterator[None]:
    """Return a context in which signals interrupt the main thread at safe points only.

    A signal raises `Interrupt`, a `KeyboardInterrupt`, in the main thread. Callbacks are not interrupted. A signal
    handler of your own has to raise a `BaseException`, because an `Exception` is an error of the rule that runs.
    Signals that are ignored remain ignored, as in a program that a shell has started in the background.

    >>> engine = Engine()
    >>> with deferred_interrupts():
    ...     engine.event("smoke(kitchen)", 1)

    Args:
        signals: numbers of the signals; SIGINT by default.

    Raises:
        UsageError: in a thread that is not the main thread, because Python calls handlers only there.
    """
    if threading.current_thread() is not threading.main_thread():
        raise UsageError(
            "deferred_interrupts: signals are handled in the main thread only: call it in the main thread"
        )
    previous_handlers = {
        number: signal.signal(number, _handle_signal)
        for number in signals or (signal.SIGINT,)
        # None is a handler that was not installed by Python.
        if signal.getsignal(number) not in (signal.SIG_IGN, None)
    }
    outer_thread, _HandlerState.thread = _HandlerState.thread, get_ident()
    outer_hook = sys.unraisablehook

    def postpone_ignored(unraisable: Any) -> None:
        # Python ignores exceptions in callbacks of weak references, which also run while the process waits.
        if isinstance(unraisable.exc_value, Interrupt):
            postpone(unraisable.exc_value)
        else:
            outer_hook(unraisable)

    sys.unraisablehook = postpone_ignored
    try:
        yield
    finally:
        sys.unraisablehook = outer_hook
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
        _HandlerState.thread = outer_thread
        if outer_thread is None:
            check_interrupt()


def are_deferred() -> bool:
    """Return whether interrupts act at safe points."""
    return _HandlerState.thread is not None


def _is_remote_call(frame: Optional[FrameType]) -> bool:
    """Return whether a frame belongs to a call by XML-RPC."""
    while frame is not None and frame.f_globals.get("__name__") != "xmlrpc.client":
        frame = frame.f_back
    return frame is not None


def _handle_signal(number: int, frame: Optional[FrameType]) -> None:
    if _HandlerState.is_waiting or _is_remote_call(frame):
        # Reset first, because the code that handles the exception is not a wait.
        _HandlerState.is_waiting = False
        raise Interrupt
    if _HandlerState.signal_time is None:
        _HandlerState.signal_time = monotonic()
    elif monotonic() - _HandlerState.signal_time >= MAX_RESPONSE_SECONDS:
        os.write(2, _LAST_WORDS)
        os._exit(EXIT_STATUS)
    PENDING.setdefault(get_ident(), Interrupt())


def check_interrupt() -> None:
    """Raise the pending exception of this thread; called at safe points."""
    if PENDING:
        raise_pending()


def raise_pending() -> None:
    """Raise the pending exception of this thread, if it has one."""
    exception = PENDING.pop(get_ident(), None)
    if exception is not None:
        _HandlerState.signal_time = None
        raise exception


def is_interrupted() -> bool:
    """Return whether this thread has to raise an exception at its next safe point."""
    return get_ident() in PENDING


def postpone(exception: BaseException) -> None:
    """Have this thread raise an exception at its next safe point, unless another one is pending."""
    PENDING.setdefault(get_ident(), exception)


class interruptible:  # noqa: N801 - used like a function
    """Context in which the thread only waits, so that an interrupt may be raised at any step.

    The block must not change data that is used after an interrupt.
    """

    __slots__ = ("_was_waiting",)

    def __enter__(self) -> None:
        """Allow the handler to raise the interrupt at once, and raise one that is pending."""
        self._was_waiting = _HandlerState.is_waiting
        if _HandlerState.thread != get_ident():
            return
        # The flag is set before the test: a signal between both would otherwise wait as long as the block.
        _HandlerState.is_waiting = True
        if is_interrupted():
            _HandlerState.is_waiting = self._was_waiting
            raise_pending()

    def __exit__(self, *raised: object) -> None:
        """Record signals again."""
        if _HandlerState.thread == get_ident():
            _HandlerState.is_waiting = self._was_waiting


@contextmanager
def exit_by_exception() -> Iterator[None]:
    """Raise SystemExit after the signals that end a process.

    Unlike `deferred_interrupts`, for commands whose main thread runs no engine. Under nohup, SIGHUP is ignored and
    must stay so.
    """
    handlers = {
        number: signal.signal(number, _raise_system_exit)
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _raise_system_exit(signal_number: int, frame: Any) -> None:
    raise SystemExit(128 + signal_number)
