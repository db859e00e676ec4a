"""Start and shutdown of a node, and handling of SIGINT and SIGTERM.

rospy's own signal handler calls the master within the handler, and deadlocks if the interrupted code was calling the
master, too. Here a signal interrupts the main thread at a safe point (`foundation/interrupts.py`), and the node shuts
down afterwards. During the construction of the node, which registers topics and services with the master, the safe
points are those of the program's goals; afterwards the main thread only waits.
"""

import logging
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Callable

import rospy

from ..foundation.errors import RetalisError
from ..foundation.garbage_collection import collect_when_idle, limit_gc_pauses, stop_collecting
from ..foundation.interrupts import check_interrupt, deferred_interrupts, interruptible
from ..node.parameters import Parameters, read_parameters
from .master_watch import MasterWatch, wait_for_master
from .ros_log import forward_log, use_line_buffering
from .rospy_transport import find_default_program
from .topic_names import MASTER_ERRORS

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

MAX_SHUTDOWN_SECONDS = 10.0
"""Limit in seconds for the shutdown; roslaunch sends SIGTERM and then SIGKILL from 15 s after SIGINT on."""


def _exit_after_timeout(status: int) -> None:
    """Exit the process if a master that hangs, or a thread that does not end, prevents its normal exit."""
    time.sleep(MAX_SHUTDOWN_SECONDS)
    try:
        print(
            f"the shutdown has not ended after {MAX_SHUTDOWN_SECONDS:.0f} s: the process exits now",
            file=sys.stderr,
        )
        sys.stderr.flush()
        sys.stdout.flush()
    finally:
        os._exit(status)


_SHUTDOWN_POLL_SECONDS = 0.05
"""Seconds between two checks whether another thread has completed the shutdown."""

SHUTDOWN_CHECK_SECONDS = 0.5
"""Seconds between two checks whether the node has been shut down."""

MAX_IDLE_LOAD = 0.02
"""Share of one core below which a node counts as idle, so that the garbage collector may run."""


def run_node(name: str, create_node: Callable[[Parameters], object]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    The status is 1 if the node could not be constructed, and 0 if it was asked to end, at whatever moment.

    Args:
        name: default name of the node.
        create_node: constructs the node from its parameters.
    """
    status = 0
    # A second signal may be recorded before the shutdown begins, and is raised at the end of the context.
    with suppress(KeyboardInterrupt), deferred_interrupts(*_SIGNALS):
        try:
            status = _run_until_shutdown(name, create_node)
        except KeyboardInterrupt:
            pass
        finally:
            _shut_down(status)
    _ignore_signals()
    return status


def _ignore_signals() -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _shut_down(status: int) -> None:
    """Shut the node down; signals are ignored meanwhile."""
    _ignore_signals()
    threading.Thread(target=_exit_after_timeout, args=(status,), daemon=True, name="last resort").start()
    _clear_connection()
    rospy.signal_shutdown("ended")
    # Another thread has begun the shutdown (``rosnode kill``).
    while not rospy.is_shutdown():
        time.sleep(_SHUTDOWN_POLL_SECONDS)
    # With 100,000 recorded events, each of the interpreter's collections at exit would take seconds.
    stop_collecting()


def _clear_connection() -> None:
    """Call the master once, so that the next call, by which rospy unregisters everything, succeeds.

    An interrupt may have left the connection within a call. `xmlrpc.client` closes it after errors, but a
    `KeyboardInterrupt` is none; the next call fails, and closes it.
    """
    if rospy.core.is_initialized():
        with suppress(*MASTER_ERRORS):
            rospy.get_master().getPid()


def _run_until_shutdown(name: str, create_node: Callable[[Parameters], object]) -> int:
    # Both before `init_node`, in which rospy sets up its log and calls the master.
    use_line_buffering()
    with interruptible():
        wait_for_master()
    rospy.init_node(name, disable_signals=True)
    forward_log(logging.getLogger("retalis"))
    is_constructed = threading.Event()

    def end_construction() -> None:
        """Interrupt the construction of the node if it is shut down meanwhile."""
        main = threading.main_thread().ident
        if main is not None and not is_constructed.is_set():
            signal.pthread_kill(main, signal.SIGTERM)

    try:
        parameters = read_parameters(rospy.get_param("~", {}), lambda: find_default_program(sys.argv))
        rospy.on_shutdown(end_construction)
        MasterWatch().start()
        check_interrupt()
        node = create_node(parameters)
    except RetalisError as error:
        rospy.logfatal("%s", error)
        return 1
    finally:
        is_constructed.set()
    # After construction: all objects of the program and of rospy are exempted from later collections.
    limit_gc_pauses()
    # `rospy.spin` would shut the node down within the interrupt.
    while not rospy.is_shutdown():
        cpu_time = time.process_time()
        with interruptible():
            time.sleep(SHUTDOWN_CHECK_SECONDS)
        if time.process_time() - cpu_time < MAX_IDLE_LOAD * SHUTDOWN_CHECK_SECONDS:
            collect_when_idle()
    del node
    return 0
