"""Start, log and shutdown of a node of rospy.

rospy's own signal handler calls the master within the handler, and deadlocks if the interrupted code was calling the
master, too. `run_node_process` handles the signals instead. The construction of the node registers topics and
services with the master, and is interrupted between the program's goals only.
"""

import io
import logging
import signal
import sys
import threading
import time
from contextlib import ExitStack, suppress
from typing import Callable

import rospy

from ..engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from ..foundation.displayed_text import printable
from ..foundation.errors import RetalisError
from ..foundation.garbage_collection import limit_gc_pauses
from ..foundation.interrupts import check_interrupt, interruptible
from ..node.goal_output import log_counts
from ..node.node_process import run_node_process, wait_while
from ..node.parameters import Parameters, read_parameters
from ..prolog.builtins.listing_and_messages import goal_log
from .master_watch import MASTER_ERRORS, MasterWatch, wait_for_master
from .rospy_transport import find_default_program

MAX_SHUTDOWN_SECONDS = 10.0
"""Limit in seconds for the shutdown; roslaunch sends SIGTERM and then SIGKILL from 15 s after SIGINT on."""

_SHUTDOWN_POLL_SECONDS = 0.05
"""Seconds between two checks whether another thread has completed the shutdown."""


def run_node(name: str, create_node: Callable[[Parameters], object]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    The status is 1 if the node could not be constructed, and 0 if it was asked to end, at whatever moment.
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


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        with log_counts.skipping(getattr(record, COUNTED_ATTRIBUTE, False)):
            self._send(record)

    def _send(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:
            rospy.logerr("%s", text)
        elif record.levelno >= logging.WARNING:
            rospy.logwarn("%s", text)
        elif record.levelno >= logging.INFO:
            rospy.loginfo("%s", text)
        else:
            rospy.logdebug("%s", text)


def use_line_buffering() -> None:
    """Switch stdout to line buffering.

    rospy prints messages of level INFO there and does not flush. In a file or a pipe, the stdout of a node that
    roslaunch starts, they would be delayed until 8 KiB are full or the node ends.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # None if the node was started with stdout closed.
        sys.stdout.reconfigure(line_buffering=True)


def forward_log(logger: logging.Logger) -> None:
    """Forward the records of a logger to rospy's log functions, for the screen and ``/rosout``.

    All later records of rospy are counted in `log_counts`, and escaped by `escape_record`.
    """
    rosout = logging.getLogger("rosout")
    rosout.addHandler(log_counts)
    # Filters of a logger are not applied to records of its children, so the handlers get the filter, too.
    for filtered in (rosout, *rosout.handlers, *logging.getLogger().handlers):
        filtered.addFilter(escape_record)
    logger.addHandler(_RosHandler())
    logger.setLevel(logging.INFO)
    logger.propagate = False
    # Rules may log for debugging: rospy drops these records unless its level is lower.
    goal_log.setLevel(logging.DEBUG)


def escape_record(record: logging.LogRecord) -> bool:
    """Escape the text of a log record so that it cannot look like another record; return True, as a log filter.

    Records contain text from outside, for example from messages. Control characters are escaped, and further lines
    are indented. ``${`` is escaped because rospy's console handler would substitute it, and fail if the bracket is
    not closed.
    """
    # A record passes several handlers, and must be escaped once.
    if not hasattr(record, "is_escaped"):
        try:
            text = printable(record.getMessage())
        except Exception:
            # Arguments that do not fit the format: rospy's handler would raise in the caller.
            text = printable(f"{record.msg} {record.args}")
        record.msg, record.args = text.replace("\n", "\n    ").replace("${", "\\x24{"), ()
        record.is_escaped = True
    return True
