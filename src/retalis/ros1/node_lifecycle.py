"""Start and shutdown of a node, and handling of SIGINT and SIGTERM.

rospy's own signal handler calls the master within the handler, and deadlocks if the interrupted code was calling the
master, too. Here a signal raises KeyboardInterrupt in the main thread, and the node shuts down afterwards. During the
construction of the node a signal is delayed while the main thread is in a call of the master, because an aborted call
would leave the node registered (`Interrupts`). An interrupt that comes within a callback, where Python ignores it, is
repeated (`foundation/lost_interrupts.py`).
"""

import _thread
import logging
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Callable, Optional, Union

import rospy

from ..foundation.errors import RetalisError
from ..foundation.garbage_collection import collect_when_idle, limit_gc_pauses, stop_collecting
from ..foundation.lost_interrupts import repeat_lost_interrupts
from ..node.parameters import Parameters, read_parameters
from .master_watch import MasterWatch, wait_for_master
from .ros_log import forward_log, use_line_buffering
from .rospy_transport import find_default_program

SIGNAL_DELAY_SECONDS = (("xmlrpc.", 2.0), ("rospy.", 0.2))
"""Longest delay of a signal in seconds, by the module prefix of a function that the main thread is executing.

``xmlrpc.`` is a call of the master, which may hang. ``rospy.`` may be between two steps that belong together, or wait
for a master.
"""

RETRY_INTERVAL_SECONDS = 0.05
"""Seconds between two attempts to deliver a delayed signal."""

MAX_SHUTDOWN_SECONDS = 10.0
"""Limit in seconds for the shutdown; roslaunch sends SIGTERM and then SIGKILL from 15 s after SIGINT on."""


class Interrupts:
    """Raises KeyboardInterrupt for a signal, but not during a call of the master.

    An aborted call leaves its connection unusable, and the node would remain registered with the master. A signal
    during the node's construction is therefore delayed until the call has returned, usually for a few milliseconds.
    """

    def __init__(self) -> None:
        self._is_allowed = self._is_raised = self._is_repeating = self._is_ending = False
        self._first_signal: Optional[float] = None

    def install(self) -> None:
        """Install the signal handlers."""
        self._set_handlers(self._handle_signal)

    def allow(self) -> None:
        """Allow interrupts at any moment, and raise one if a signal was delayed."""
        self._is_allowed = True
        if self._first_signal is not None:
            self._interrupt()

    def shut_down(self) -> None:
        """Interrupt the main thread if the node is shut down before its construction has ended."""
        main = threading.main_thread().ident
        if not (self._is_allowed or self._is_raised or main is None):
            signal.pthread_kill(main, signal.SIGTERM)

    def limit_shutdown(self, status: int) -> None:
        """Ignore signals during the shutdown, and start a thread that limits its duration."""
        self._is_raised = self._is_ending = True
        self._set_handlers(signal.SIG_IGN)
        threading.Thread(target=_exit_after_timeout, args=(status,), daemon=True, name="last resort").start()

    def _set_handlers(
        self, handler: Union[Callable[[int, Optional[FrameType]], None], signal.Handlers]
    ) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)

    def _handle_signal(self, number: int, frame: Optional[FrameType]) -> None:
        if self._first_signal is None:
            self._first_signal = time.monotonic()
        # If an interrupt has been raised, it was lost, or this is another signal.
        self._is_raised = False
        if self._is_allowed or time.monotonic() - self._first_signal >= _max_delay(frame):
            self._interrupt()
        if not self._is_repeating:
            self._is_repeating = True
            # Not `threading.Thread`, which takes locks that the interrupted code may hold.
            _thread.start_new_thread(self._repeat_signal, (number,))

    def _interrupt(self) -> None:
        self._is_raised = True
        raise KeyboardInterrupt

    def _repeat_signal(self, number: int) -> None:
        """Repeat a delayed signal until the shutdown begins, unless its interrupt has been raised."""
        main = threading.main_thread().ident
        while main is not None:
            time.sleep(RETRY_INTERVAL_SECONDS)
            if self._is_ending:
                return
            if not self._is_raised:
                signal.pthread_kill(main, number)


def _max_delay(frame: Optional[FrameType]) -> float:
    """Return the longest delay of a signal in seconds for the functions on the stack of a frame."""
    modules = []
    while frame is not None:
        modules.append(frame.f_globals.get("__name__") or "")
        frame = frame.f_back
    for prefix, seconds in SIGNAL_DELAY_SECONDS:
        if any(module.startswith(prefix) for module in modules):
            return seconds
    return 0.0


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
    interrupts = Interrupts()
    status = 0
    try:
        interrupts.install()
        with repeat_lost_interrupts():
            status = _run_until_shutdown(name, create_node, interrupts)
    except KeyboardInterrupt:
        pass
    finally:
        interrupts.limit_shutdown(status)
        rospy.signal_shutdown("ended")
        # Another thread has begun the shutdown (``rosnode kill``).
        while not rospy.is_shutdown():
            time.sleep(RETRY_INTERVAL_SECONDS)
        # With 100,000 recorded events, each of the interpreter's collections at exit would take seconds.
        stop_collecting()
    return status


def _run_until_shutdown(
    name: str, create_node: Callable[[Parameters], object], interrupts: Interrupts
) -> int:
    # Both before `init_node`, in which rospy sets up its log and calls the master.
    use_line_buffering()
    wait_for_master()
    rospy.init_node(name, disable_signals=True)
    forward_log(logging.getLogger("retalis"))
    try:
        parameters = read_parameters(rospy.get_param("~", {}), lambda: find_default_program(sys.argv))
        rospy.on_shutdown(interrupts.shut_down)
        MasterWatch().start()
        node = create_node(parameters)
    except RetalisError as error:
        rospy.logfatal("%s", error)
        return 1
    # After construction: all objects of the program and of rospy are exempted from later collections.
    limit_gc_pauses()
    interrupts.allow()
    # `rospy.spin` would shut the node down within the interrupt.
    while not rospy.is_shutdown():
        cpu_time = time.process_time()
        time.sleep(SHUTDOWN_CHECK_SECONDS)
        if time.process_time() - cpu_time < MAX_IDLE_LOAD * SHUTDOWN_CHECK_SECONDS:
            # In another thread, because an interrupt during a callback of the garbage collector would be lost.
            collecting = threading.Thread(target=collect_when_idle, daemon=True)
            collecting.start()
            collecting.join()
    del node
    return 0
