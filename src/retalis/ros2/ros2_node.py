"""Node ``retalis`` of ROS 2: a `ProgramHost` on rclpy.

One node offers all services: the exchange of text between two nodes was a need of the original package only.
"""

import logging
import threading
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, List, Optional, TypeVar

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from ..engine.runtime.problem_reports import Reports
from ..foundation.displayed_text import printable
from ..foundation.errors import RetalisError, UsageError
from ..foundation.garbage_collection import limit_gc_pauses
from ..foundation.interrupts import check_interrupt
from ..node.goal_output import log_counts
from ..node.node_process import run_node_process, wait_while
from ..node.parameters import (
    PARAMETER_DESCRIPTIONS,
    Parameters,
    check_adjustable,
    read_adjustable_parameters,
    read_parameters,
)
from ..node.program_host import ProgramHost
from ..node.program_host_context import HostContext
from ..node.text_exchange import PlainTextExchange
from ..prolog.builtins.listing_and_messages import goal_log
from .installed_interfaces import ament_prefixes
from .rclpy_transport import (
    AUTOSTART,
    NODE_PARAMETERS,
    NodeExecutor,
    RclpyTransport,
    RequestThreads,
    declare_parameters,
    plain_value,
    read_node_parameters,
)
from .ros_clock import follow_clock

if TYPE_CHECKING:
    from rclpy.subscription import Subscription

log = logging.getLogger("retalis")

ResultType = TypeVar("ResultType")

MAX_SHUTDOWN_SECONDS = 8.0
"""Limit in seconds for the shutdown; ``ros2 launch`` sends SIGTERM and then SIGKILL from 10 s after SIGINT on."""


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

    Its parameters are read when it is configured; some can be changed later. A program that is activated again starts
    anew, or from its checkpoint.

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
        self._transition_lock = threading.Lock()
        """Held during a transition: the main thread starts the node, and the executor handles requests."""
        self._transition_count = 0
        """Number of transitions that have begun."""
        self._program_lock = threading.Lock()
        """Held while the next attributes change: the main thread ends the node at any moment."""
        self._transport: Optional[RclpyTransport] = None
        self._host: Optional[ProgramHost] = None
        self._is_ending = False
        self._program_parameters: Optional[Parameters] = None
        self._change_lock = threading.Lock()
        """Held during a change of parameters, which may wait for the engine; no callback of the executor needs it."""
        self._requests = RequestThreads()
        self._clock_subscription: Optional[Subscription] = None
        self._answer_refused_transitions()
        self._change_parameters_in_threads()
        self.add_on_set_parameters_callback(self._apply_changes)
        self._node_executor = NodeExecutor(self, self._reports.error)

    def start(self) -> bool:
        """Configure and activate the node; return whether it is active, or a request has changed its state before."""
        with self._transition_lock:
            for trigger in (self.trigger_configure, self.trigger_activate):
                result = self._run_transition(trigger)
                if result is None:
                    # The services of the life cycle exist before this method is called.
                    log.warning("the node does not activate itself: a request has changed its state")
                    return True
                if result != TransitionCallbackReturn.SUCCESS:
                    return False
        return True

    def _run_transition(self, trigger: Callable[[], ResultType]) -> Optional[ResultType]:
        """Run a transition; return its result, or None if the state of the node does not allow it.

        rclpy 7 raises an error for such a transition, rclpy 9 returns the result of one that has failed.
        """
        count = self._transition_count
        try:
            result = trigger()
        except RuntimeError:
            return None
        return None if self._transition_count == count else result

    def end(self) -> None:
        """End the program and the node, also while a transition is in work."""
        with self._program_lock:
            self._is_ending = True
        self._end_program()
        self._requests.stop()
        self._node_executor.stop()
        self.destroy_node()

    def _answer_refused_transitions(self) -> None:
        """Execute requests for transitions one after the other, and answer those that the state does not allow.

        rclpy 7 raises an error for these, and their clients would wait for an answer forever.
        """
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = partial(self._change_state, service.callback)

    def _change_state(
        self, change_state: Callable[[Any, Any], Any], request: ChangeState.Request, response: Any
    ) -> Any:
        with self._transition_lock:
            if self._run_transition(lambda: change_state(request, response)) is None:
                transition = request.transition.label or request.transition.id
                log.warning("transition %s is refused: the state of the node does not allow it", transition)
                response.success = False
        return response

    def _change_parameters_in_threads(self) -> None:
        """Handle requests that change parameters in threads of their own: the engine may be busy with an event."""
        group = ReentrantCallbackGroup()
        for service in self.services:
            if service.srv_type in (SetParameters, SetParametersAtomically):
                service.callback = self._run_in_thread(service.callback)
                # A request that waits would block the other callbacks of the node's group.
                service.callback_group = group
                group.add_entity(service)

    def _run_in_thread(self, handle: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback that runs the callback of a service in a thread."""

        async def run(request: Any, response: Any) -> Any:
            try:
                await self._requests.run(lambda: handle(request, response), self._node_executor.executor)
            except UsageError as error:
                result = SetParametersResult(successful=False, reason=str(error))
                if isinstance(request, SetParameters.Request):
                    response.results = [result] * len(request.parameters)
                else:
                    response.result = result
            return response

        return run

    def set_parameters_atomically(self, parameter_list: List[Parameter]) -> SetParametersResult:
        """See `Node`. Parameters that are fixed are rejected with the reason, which rclpy does not give."""
        try:
            self._check_names(parameter_list)
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        with self._change_lock:
            return super().set_parameters_atomically(parameter_list)

    def _check_names(self, changes: List[Parameter]) -> None:
        """Check that parameters can be changed.

        Raises:
            UsageError: if a parameter cannot be changed.
        """
        for parameter in changes:
            name = parameter.name
            if name.partition(".")[0] in NODE_PARAMETERS:
                raise UsageError(f"parameter {name}: it is read at the start: start the node with it")
            # Goals read other parameters that the node was started with.
            if name not in PARAMETER_DESCRIPTIONS and self.has_parameter(name):
                continue
            check_adjustable(name)
            if parameter.value is None:
                raise UsageError(f"parameter ~{name}: it cannot be deleted: set a value")

    def _apply_changes(self, changes: List[Parameter]) -> SetParametersResult:
        """Apply changes to the program, all or none. rclpy has checked them, and stores them if this succeeds."""
        try:
            self._change_program(changes)
        except RetalisError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:
            self._reports.error(error)
            reason = "internal error; the log of the node has the details"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _change_program(self, changes: List[Parameter]) -> None:
        """Wait for the engine, and apply changes to the program.

        Raises:
            RetalisError: if a value is invalid, or the changes cannot be applied.
        """
        values = read_node_parameters(self)
        values.update((parameter.name, plain_value(parameter)) for parameter in changes)
        adjusted = read_adjustable_parameters(values)
        with self._program_lock:
            host, before = self._host, self._program_parameters
            changed = None if before is None else before.adjust(adjusted)
            if changed is None or changed == before:
                return
            if host is None:
                # A program that is being started compares them.
                self._program_parameters = changed
                return
        host.change_parameters(changed)
        with self._program_lock:
            if self._host is not host:
                raise UsageError("the program has ended meanwhile: set the parameters again")
            self._program_parameters = changed

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters."""
        self._transition_count += 1
        try:
            # There is no other node that could offer a part of the services.
            parameters = read_parameters(read_node_parameters(self), find_default_program)
            with self._program_lock:
                self._program_parameters = parameters._replace(embedded=True)
        except Exception as error:
            self._report_failure(error)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the program."""
        self._transition_count += 1
        try:
            self._start_program()
        except Exception as error:
            self._report_failure(error)
            # Parts of the program may have started.
            self._end_program()
            return TransitionCallbackReturn.FAILURE
        # All objects of the program and of rclpy are exempted from later collections.
        limit_gc_pauses()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program."""
        self._transition_count += 1
        self._end_program()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the parameters."""
        self._transition_count += 1
        with self._program_lock:
            self._program_parameters = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program and the process."""
        self._transition_count += 1
        self._end_program()
        self.is_finalized = True
        return TransitionCallbackReturn.SUCCESS

    def _report_failure(self, error: Exception) -> None:
        """Log the error of a transition; rclpy does not log it."""
        if isinstance(error, RetalisError):
            log.critical("%s", error)
        else:
            self._reports.error(error)

    def _start_program(self) -> None:
        """Start the program.

        Raises:
            RetalisError: if the program cannot start.
        """
        with self._program_lock:
            if self._is_ending:
                raise UsageError("the program is not started: the node is ending")
            # Registered at once, so that the program can be ended while it is being loaded.
            transport = self._transport = RclpyTransport(self, self._node_executor.executor, self._reports)
            parameters = self._program_parameters
        if self._clock_subscription is not None:
            self.destroy_subscription(self._clock_subscription)
            self._clock_subscription = None
        assert parameters is not None
        context = HostContext(transport, parameters, self._reports)
        check_interrupt()
        host = ProgramHost(context, PlainTextExchange(context))
        while True:
            with self._program_lock:
                if self._transport is not transport:
                    raise UsageError("the program is not started: the node has ended meanwhile")
                applied, parameters = parameters, self._program_parameters
                if parameters is None or parameters is applied:
                    self._host = host
                    return
            # They were changed while the program was being loaded.
            host.change_parameters(parameters)

    def _end_program(self) -> None:
        """End the program if there is one; also one that is being started."""
        with self._program_lock:
            transport, self._transport, self._host = self._transport, None, None
        if transport is None:
            return
        transport.shut_down()
        with self._program_lock:
            if not self._is_ending:
                self._clock_subscription = follow_clock(self)


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the node until it is shut down or interrupted; return its exit status.

    The status is 1 if the node could not be constructed, and 0 if it was asked to end, at whatever moment.
    """
    return run_node_process(lambda shutdown: _run_until_shutdown(arguments, shutdown), MAX_SHUTDOWN_SECONDS)


def _run_until_shutdown(arguments: Optional[List[str]], shutdown: ExitStack) -> int:
    shutdown.callback(rclpy.try_shutdown)
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = RetalisNode()
    shutdown.callback(node.end)
    forward_log(log, node)
    if node.get_parameter(AUTOSTART).value and not node.start():
        return 1
    wait_while(lambda: node.context.ok() and not node.is_finalized)
    return 0


class _NodeHandler(logging.Handler):
    def __init__(self, node: Node):
        super().__init__()
        self._log = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._forward(record)
        except Exception:
            self.handleError(record)

    def _forward(self, record: logging.LogRecord) -> None:
        # Records contain text from outside, which must not look like another record.
        text = printable(self.format(record)).replace("\n", "\n    ")
        # rclpy requires that a place in the code always logs with one severity.
        if record.levelno >= logging.CRITICAL:
            self._log.fatal(text)
        elif record.levelno >= logging.ERROR:
            self._log.error(text)
        elif record.levelno >= logging.WARNING:
            self._log.warning(text)
        elif record.levelno >= logging.INFO:
            self._log.info(text)
        else:
            self._log.debug(text)


def forward_log(logger: logging.Logger, node: Node) -> None:
    """Forward the records of a logger to the log of a node, and count them in `log_counts`."""
    for handler in list(logger.handlers):
        logger.removeHandler(handler)
    logger.addHandler(log_counts)
    logger.addHandler(_NodeHandler(node))
    logger.setLevel(logging.INFO)
    logger.propagate = False
    # Rules may log for debugging: the node drops these records unless its level is lower.
    goal_log.setLevel(logging.DEBUG)
