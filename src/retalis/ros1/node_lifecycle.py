"""Start and shutdown of a node of rospy.

rospy's own signal handler calls the master within the handler, and deadlocks if the interrupted code was calling the
master, too. `run_node_process` handles the signals instead. The construction of the node registers topics and
services with the master, and is interrupted between the program's goals only.
"""

import logging
import signal
import sys
import threading
import time
from contextlib import ExitStack, suppress
from typing import Callable

import rospy

from ..foundation.errors import RetalisError
from ..foundation.garbage_collection import limit_gc_pauses
from ..foundation.interrupts import check_interrupt, interruptible
from ..node.node_process import run_node_process, wait_while
from ..node.parameters import Parameters, read_parameters
from .master_watch import MasterWatch, wait_for_master
from .ros_log import forward_log, use_line_buffering
from .rospy_transport import find_default_program
from .topic_names import MASTER_ERRORS

MAX_SHUTDOWN_SECONDS = 10.0
"""Limit in seconds for the shutdown; roslaunch sends SIGTERM and then SIGKILL from 15 s after SIGINT on."""

_SHUTDOWN_POLL_SECONDS = 0.05
"""Seconds between two checks whether another thread has completed the shutdown."""


def run_node(name: str, create_node: Callable[[Parameters], object]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    The status is 1 if the node could not be constructed, and 0 if it was asked to end, at whatever moment.

    Args:
        name: default name of the node.
        create_node: constructs the node from its parameters.
    """

    def run(shutdown: ExitStack) -> int:
        shutdown.callback(_shut_down)
        return _run_until_shutdown(name, create_node)

    return run_node_process(run, MAX_SHUTDOWN_SECONDS)


def _shut_down() -> None:
    """Shut the node down."""
    _clear_connection()
    rospy.signal_shutdown("ended")
    # Another thread has begun the shutdown (``rosnode kill``).
    while not rospy.is_shutdown():
        time.sleep(_SHUTDOWN_POLL_SECONDS)


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
    wait_while(lambda: not rospy.is_shutdown())
    del node
    return 0
