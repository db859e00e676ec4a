"""Process of a node: SIGINT and SIGTERM, waiting for the shutdown, and exit if the shutdown hangs.

A signal interrupts the main thread at a safe point (`foundation/interrupts.py`), and the node shuts down afterwards;
signals are ignored from then on. While the node is constructed, the safe points are those of the program's goals;
afterwards the main thread only waits.
"""

import os
import signal
import sys
import threading
import time
from contextlib import ExitStack, suppress
from typing import Callable

from ..foundation.garbage_collection import collect_if_grown, collect_when_idle, stop_collecting
from ..foundation.interrupts import deferred_interrupts, interruptible

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a node."""

SHUTDOWN_CHECK_SECONDS = 0.5
"""Seconds between two checks whether the node has been shut down."""

MAX_IDLE_LOAD = 0.02
"""Share of one core below which a node counts as idle, so that the garbage collector may run."""


def run_node_process(run: Callable[[ExitStack], int], max_shutdown_seconds: float) -> int:
    """Run a node until it is shut down or interrupted; return the exit status of the process.

    The status is that of ``run``, and 0 if the node was asked to end, at whatever moment.

    Args:
        run: runs the node until it is shut down, and adds to the stack what its shutdown consists of; the last
            function is called first.
        max_shutdown_seconds: limit for the shutdown, after which the process exits with the same status.
    """
    # The status after an exception, which is raised again after the shutdown.
    status = 1
    # A second signal may be recorded before the shutdown begins, and is raised at the end of the context.
    with suppress(KeyboardInterrupt), deferred_interrupts(*SIGNALS), ExitStack() as shutdown:
        # Called last: with 100,000 recorded events, each of the interpreter's collections at exit takes seconds.
        shutdown.callback(stop_collecting)
        try:
            status = run(shutdown)
        except KeyboardInterrupt:
            status = 0
        finally:
            _ignore_signals()
            _exit_after(max_shutdown_seconds, status)
    _ignore_signals()
    return status


def wait_while(is_running: Callable[[], bool]) -> None:
    """Wait as long as a node is running; collect garbage while it is idle, or if there may be much of it."""
    while is_running():
        cpu_time = time.process_time()
        with interruptible():
            time.sleep(SHUTDOWN_CHECK_SECONDS)
        if time.process_time() - cpu_time < MAX_IDLE_LOAD * SHUTDOWN_CHECK_SECONDS:
            collect_when_idle()
        else:
            # The work of a node may consist of timers and transforms, without an event.
            collect_if_grown()


def _ignore_signals() -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _exit_after(seconds: float, status: int) -> None:
    """Exit the process after a time, if a middleware that hangs or a thread prevents its normal exit."""

    def exit_process() -> None:
        time.sleep(seconds)
        try:
            print(
                f"the shutdown has not ended after {seconds:g} s: the process exits now",
                file=sys.stderr,
                flush=True,
            )
            sys.stdout.flush()
        finally:
            os._exit(status)

    threading.Thread(target=exit_process, daemon=True, name="last resort").start()
