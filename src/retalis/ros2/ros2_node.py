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
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError, UsageError
from ..foundation.garbage_collection import collect_when_idle, limit_gc_pauses, stop_collecting
from ..foundation.interrupts import check_interrupt, deferred_interrupts, interruptible
from ..node.host_context import HostContext
from ..node.parameters import Parameters, read_parameters
from ..node.plain_text_exchange import PlainTextExchange
from ..node.program_host import ProgramHost
from .installed_interfaces import ament_prefixes
from .node_executor import NodeExecutor
from .rclpy_log import forward_log
from .rclpy_transport import AUTOSTART, RclpyTransport, declare_parameters, read_node_parameters

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


class RetalisNode(LifecycleNode):
    """A node with a life cycle, whose program runs while it is active.

    Its parameters are read when it is configured. A program that is activated again starts anew, or from its
    checkpoint.

    Attributes:
        is_finalized: whether the node has reached the end of its life cycle.
    """

    def __init__(self) -> None:
        super().__init__(
            "retalis", allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True
        )
        declare_parameters(self)
        self.is_finalized = False
        self._reports = Reports()
        self._program_parameters: Optional[Parameters] = None
        self._transport: Optional[RclpyTransport] = None
        self._host: Optional[ProgramHost] = None
        self._node_executor = NodeExecutor(self, self._reports.error)

    def start(self) -> bool:
        """Configure and activate the node; return whether it is active."""
        success = TransitionCallbackReturn.SUCCESS
        return bool(self.trigger_configure() == success and self.trigger_activate() == success)

    def end(self) -> None:
        """End the program and the node."""
        self._end_program()
        self._node_executor.stop()
        self.destroy_node()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters."""
        try:
            self._program_parameters = read_parameters(read_node_parameters(self), find_default_program)
        except RetalisError as error:
            log.critical("%s", error)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the program."""
        try:
            self._start_program()
        except RetalisError as error:
            log.critical("%s", error)
            self._end_program()
            return TransitionCallbackReturn.FAILURE
        # All objects of the program and of rclpy are exempted from later collections.
        limit_gc_pauses()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program."""
        self._end_program()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the parameters."""
        self._program_parameters = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program and the process."""
        self._end_program()
        self.is_finalized = True
        return TransitionCallbackReturn.SUCCESS

    def _start_program(self) -> None:
        assert self._program_parameters is not None
        self._transport = RclpyTransport(self, self._node_executor.executor, self._reports)
        # There is no other node that could offer a part of the services.
        context = HostContext(
            self._transport, self._program_parameters._replace(embedded=True), self._reports
        )
        check_interrupt()
        self._host = ProgramHost(context, PlainTextExchange(context))

    def _end_program(self) -> None:
        if self._transport is not None:
            self._transport.shut_down()
        self._transport = self._host = None


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
    node = RetalisNode()
    forward_log(log, node)
    try:
        if node.get_parameter(AUTOSTART).value and not node.start():
            return 1
        _wait_for_shutdown(node)
    finally:
        _ignore_signals()
        _start_last_resort(0)
        node.end()
    return 0


def _wait_for_shutdown(node: RetalisNode) -> None:
    while node.context.ok() and not node.is_finalized:
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
