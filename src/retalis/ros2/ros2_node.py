"""Node ``retalis`` of ROS 2: a `ProgramHost` on rclpy.

One node offers all services: the exchange of text between two nodes was a need of the original package only.
"""

import logging
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import List, Optional

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError, UsageError
from ..foundation.garbage_collection import collect_when_idle, limit_gc_pauses, stop_collecting
from ..foundation.interrupts import check_interrupt, deferred_interrupts, interruptible
from ..node.host_context import HostContext
from ..node.parameters import read_parameters
from ..node.plain_text_exchange import PlainTextExchange
from ..node.program_host import ProgramHost
from .installed_interfaces import ament_prefixes
from .rclpy_log import forward_log
from .rclpy_transport import RclpyTransport, declare_parameters, read_node_parameters

log = logging.getLogger("retalis")

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

MAX_SHUTDOWN_SECONDS = 8.0
"""Limit in seconds for the shutdown; ``ros2 launch`` sends SIGTERM and then SIGKILL from 10 s after SIGINT on."""

SHUTDOWN_CHECK_SECONDS = 0.5
"""Seconds between two checks whether the node has been shut down."""

MAX_IDLE_LOAD = 0.02
"""Share of one core below which a node counts as idle, so that the garbage collector may run."""


def find_default_program() -> Path:
    """Return the folder of the program if no parameter names it: ``application_source`` of this package.

    Raises:
        UsageError: if it is not installed.
    """
    for prefix in ament_prefixes():
        folder = Path(prefix) / "share" / "retalis" / "application_source"
        if folder.is_dir():
            return folder
    raise UsageError(
        "package retalis is not in AMENT_PREFIX_PATH: give the program's folder as parameter program"
    )


class RetalisNode:
    """The node with its program.

    Args:
        node: the node of rclpy.

    Raises:
        UsageError: if a parameter is invalid.
    """

    def __init__(self, node: Node):
        reports = Reports()
        self.transport = RclpyTransport(node, reports)
        try:
            parameters = read_parameters(read_node_parameters(node), find_default_program)
            # There is no other node that could offer a part of the services.
            context = HostContext(self.transport, parameters._replace(embedded=True), reports)
            check_interrupt()
            self.host = ProgramHost(context, PlainTextExchange(context))
        except BaseException:
            self.transport.shut_down()
            raise


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the node until it is shut down or interrupted; return its exit status.

    The status is 1 if the node could not be constructed, and 0 if it was asked to end, at whatever moment.
    """
    status = 0
    with suppress(KeyboardInterrupt), deferred_interrupts(*_SIGNALS):
        try:
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
            status = _run_until_shutdown()
        except KeyboardInterrupt:
            pass
        finally:
            _ignore_signals()
            _start_last_resort(status)
            rclpy.try_shutdown()
            stop_collecting()
    _ignore_signals()
    return status


def _run_until_shutdown() -> int:
    node = rclpy.create_node(
        "retalis", allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True
    )
    forward_log(log, node)
    declare_parameters(node)
    try:
        retalis_node = RetalisNode(node)
    except RetalisError as error:
        log.critical("%s", error)
        return 1
    try:
        # After construction: all objects of the program and of rclpy are exempted from later collections.
        limit_gc_pauses()
        _wait_for_shutdown(retalis_node.transport)
    finally:
        _ignore_signals()
        _start_last_resort(0)
        retalis_node.transport.shut_down()
        node.destroy_node()
    return 0


def _wait_for_shutdown(transport: RclpyTransport) -> None:
    while not transport.is_shut_down():
        cpu_time = time.process_time()
        with interruptible():
            time.sleep(SHUTDOWN_CHECK_SECONDS)
        if time.process_time() - cpu_time < MAX_IDLE_LOAD * SHUTDOWN_CHECK_SECONDS:
            collect_when_idle()


def _ignore_signals() -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _start_last_resort(status: int) -> None:
    """Exit the process after a while if a thread does not end."""

    def exit_after_timeout() -> None:
        time.sleep(MAX_SHUTDOWN_SECONDS)
        try:
            print(
                f"the shutdown has not ended after {MAX_SHUTDOWN_SECONDS:.0f} s: the process exits now",
                file=sys.stderr,
                flush=True,
            )
        finally:
            os._exit(status)

    threading.Thread(target=exit_after_timeout, daemon=True, name="last resort").start()
