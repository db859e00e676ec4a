"""Calls of ROS services by goals: ``ros_service/4,5``.

An engine has no services itself: a node or a bag player sets the function that calls them. The goal serializes the
request, passes it to this function and succeeds at once. The call and its end are events, which are posted to the
engine like the messages of topics: ``service_call(Name, Id, Request)``, and ``service_reply(Name, Id, Reply)`` or
``service_failed(Name, Id, Reason)``. The id is chosen by the program, so that rules can join several calls of one
service with their ends.
"""

import itertools
import threading
from contextlib import ExitStack
from typing import Any, Callable, Dict, List, NamedTuple, Optional

from ..events.knowledge.knowledge_base import SERVICE_CALL, SERVICE_FAILED, SERVICE_REPLY
from ..foundation.displayed_text import shorten
from ..foundation.errors import MessageError, RetalisError
from ..foundation.ros_name_checks import ros1_type_name, topic_fault, type_fault
from ..messages.message_slots import SlotNames
from ..messages.type_definition import Definition, SerializationFormat
from ..prolog.machine.errors import domain_error, instantiation_error, type_error
from ..prolog.machine.machine import Machine
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import copy, variables
from ..prolog.terms.types import Term, atom, deref, functor
from ..serialization.state_fields import StateFields, StateOwner, field, rows_of
from ..serialization.stored_field_types import COUNT, TERM, TEXT
from .event_input import get_text
from .runtime.problem_reports import Reports
from .runtime.serial_executor import SerialExecutor

DEFAULT_CALL_SECONDS = 5.0
"""Default limit for the time between a call and its reply, in seconds."""

MAX_CALL_SECONDS = 3600.0
"""Largest limit for this time, in seconds."""

MAX_CALLS_UNDER_WAY = 100
"""Maximum number of calls whose end has not been processed; further ones are refused."""

_TIMEOUT = functor("timeout", 1)


class ServiceRequest(NamedTuple):
    """A call of a service.

    Attributes:
        name: name of the service as written in the goal.
        type: type of the service, ``pkg/Type``.
        request: type of the request.
        response: type of the response.
        data: the serialized request.
        seconds: limit for the time until the reply.
    """

    name: str
    type: str
    request: Definition
    response: Definition
    term: Term
    data: bytes
    seconds: float


class UnansweredCall(NamedTuple):
    """A call that has not ended.

    Attributes:
        service: name of the service as written in the goal.
    """

    service: str
    call_id: Term


class ServiceCall:
    """A call that waits for its reply. The first call of `reply` or `fail` ends it; others have no effect.

    All methods may be called from any thread.

    Args:
        end: called once, with the serialized response, or with None and the reason of the failure.

    Attributes:
        request: see above.
        is_ended: whether the call has ended, so that its request need not be sent any more.
    """

    def __init__(self, request: ServiceRequest, end: Callable[[Optional[bytes], str], object]):
        self.request = request
        self.is_ended = False
        self._end = end
        self._lock = threading.Lock()
        self._end_callbacks: List[Callable[[], object]] = []

    def reply(self, data: bytes) -> None:
        """End the call with a serialized response."""
        self._finish(data, "")

    def fail(self, reason: str) -> None:
        """End the call with the reason why there is no reply."""
        self._finish(None, reason)

    def on_end(self, callback: Callable[[], object]) -> None:
        """Call a function when the call ends; at once if it has ended."""
        with self._lock:
            if not self.is_ended:
                self._end_callbacks.append(callback)
                return
        callback()

    def _finish(self, data: Optional[bytes], reason: str) -> None:
        with self._lock:
            if self.is_ended:
                return
            self.is_ended = True
        # The stack calls the last function first, and each of them even if others raise errors.
        with ExitStack() as stack:
            stack.callback(self._end, data, reason)
            for callback in reversed(self._end_callbacks):
                stack.callback(callback)


CallService = Callable[[ServiceCall], object]
"""A function that calls a service; it must not wait, and it ends the pending call at any time, possibly at once."""


class ServiceCalls(StateOwner):
    """The calls of services by the goals of a program.

    A call is under way until the event of its end has been processed. This limits the events that wait in the queue
    of the executor, which does not drop them. The events of calls that are refused may be dropped, as messages are.

    Args:
        slots: the known types, with the program's form of strings.
        executor: does the work of the engine.
        dispatch: dispatches an event, in the engine's turn.
        run_callback: calls a callback of the user by its name in errors, and reports its errors.
        reports: receives the failures.

    Attributes:
        count: number of calls.
        failed_count: number of calls without a reply, including those that were refused.
        refused_count: number of calls that were refused because too many were under way.
    """

    STATE = StateFields(
        field("count", COUNT),
        field("failed_count", COUNT),
        field("refused_count", COUNT),
        field(
            "unanswered_calls",
            rows_of(
                UnansweredCall,
                service=TEXT,
                call_id=TERM,
            ),
        ),
    )

    def __init__(
        self,
        logic: PrologSystem,
        slots: SlotNames,
        executor: SerialExecutor,
        dispatch: Callable[[Term], object],
        run_callback: Callable[[str, Callable[[ServiceCall], object], ServiceCall], object],
        reports: Reports,
    ):
        self._slots = slots
        self._executor = executor
        self._dispatch = dispatch
        self._run_callback = run_callback
        self._reports = reports
        self._call: CallService = _fail_without_services
        self._format = SerializationFormat.ROS1
        self._numbers = itertools.count()
        self._under_way: Dict[int, UnansweredCall] = {}
        self._interrupted_calls: List[UnansweredCall] = []
        self.count = self.failed_count = self.refused_count = 0
        for arity in (4, 5):
            logic.define("ros_service", arity, self._call_service)

    @property
    def under_way_count(self) -> int:
        """Number of calls that wait for a reply."""
        return len(self._under_way)

    @property
    def unanswered_calls(self) -> List[UnansweredCall]:
        """Calls without an end, also those of the program before it was restored."""
        return [*self._interrupted_calls, *self._under_way.values()]

    @unanswered_calls.setter
    def unanswered_calls(self, calls: List[UnansweredCall]) -> None:
        """Restore the newest calls as interrupted ones; count others as failed."""
        self._interrupted_calls = calls[-MAX_CALLS_UNDER_WAY:]
        self.failed_count += len(calls) - len(self._interrupted_calls)

    def fail_interrupted(self) -> None:
        """Fail the calls whose replies were expected when the state of the program was stored."""
        self._executor.post_kept(self._fail_all_interrupted)

    def _fail_all_interrupted(self) -> None:
        while self._interrupted_calls:
            self._fail_oldest_interrupted()

    def _fail_oldest_interrupted(self) -> None:
        number = self._add(self._interrupted_calls.pop(0))
        self._fail(number, "the program ended before the reply")

    def set_caller(self, call: CallService, serialization_format: SerializationFormat) -> None:
        """Set the function that calls services, and the serialization of requests and responses."""
        self._call, self._format = call, serialization_format

    def _call_service(
        self, machine: Machine, name: Term, service_type: Term, request: Term, call_id: Term, *options: Term
    ) -> bool:
        """Execute the goal ``ros_service(Name, Type, Request, Id)``, or ``ros_service/5`` with options."""
        service = get_text(name)
        type_name = ros1_type_name(get_text(service_type))
        _check_argument("service", name, topic_fault(service))
        _check_argument("service_type", service_type, type_fault(type_name))
        if variables(call_id):
            raise instantiation_error()
        seconds = _read_options(*options) if options else DEFAULT_CALL_SECONDS
        self.count += 1
        # Copied, because the bindings of the goal are undone before the call ends.
        request, call = copy(request), UnansweredCall(service, copy(call_id))
        event = (SERVICE_CALL, atom(service), call.call_id, request)
        if len(self._under_way) >= MAX_CALLS_UNDER_WAY:
            self._refuse(call, event)
            return True
        if len(self._under_way) + len(self._interrupted_calls) >= MAX_CALLS_UNDER_WAY:
            # An engine may never fail them at once; then they would accumulate over restorations.
            self._fail_oldest_interrupted()
        number = self._add(call)
        self._executor.post_kept(self._dispatch, event)
        self._start(number, service, type_name, request, seconds)
        return True

    def _refuse(self, call: UnansweredCall, event: Term) -> None:
        """Refuse a call; a goal may make any number of them, so their events may be dropped."""
        reason = f"{MAX_CALLS_UNDER_WAY} calls are under way: this one is refused"
        self.refused_count += 1
        self._count_failure(call, reason)
        self._executor.post(self._dispatch, event)
        self._executor.post(self._dispatch, _failure_event(call, reason))

    def _start(self, number: int, service: str, type_name: str, term: Term, seconds: float) -> None:
        definitions = self._slots.definitions
        try:
            request_type = definitions.find(f"{type_name}_Request")
            response_type = definitions.find(f"{type_name}_Response")
        except MessageError as error:
            closest = definitions.misspelt_interface(type_name, "srv")
            hint = f"did you mean {closest}?" if closest else error.message
            self._fail(number, f"the service type {shorten(type_name)} is unknown: {hint}")
            return
        try:
            data = definitions.encoder(request_type, self._format).encode(term)
        except RetalisError as error:
            self._fail(number, f"the request does not fit {type_name}: {error.message}")
            return
        request = ServiceRequest(service, type_name, request_type, response_type, term, data, seconds)
        call = ServiceCall(request, lambda response, reason: self._end(number, request, response, reason))
        self._run_callback("a callback of on_service_call", self._pass_to_caller, call)

    def _pass_to_caller(self, call: ServiceCall) -> None:
        try:
            self._call(call)
        except RetalisError as error:
            call.fail(error.message)
        except BaseException as error:
            call.fail(f"the callback of on_service_call raised {type(error).__name__}")
            raise

    def _end(self, number: int, request: ServiceRequest, response: Optional[bytes], reason: str) -> None:
        """Post the event of a call that has ended; called from any thread."""
        if response is not None:
            try:
                decoder = self._slots.definitions.decoder(request.response, self._format)
                reply = decoder.decode(response)
            except RetalisError as error:
                reason = f"the reply does not fit {request.type}: {error.message}"
            else:
                call = self._under_way[number]
                event = (SERVICE_REPLY, atom(call.service), call.call_id, reply)
                self._executor.post_kept(self._process_end, event, number)
                return
        self._fail(number, reason)

    def _fail(self, number: int, reason: str) -> None:
        """Post the event of a call without a reply; called from any thread."""
        event = _failure_event(self._under_way[number], reason)
        self._executor.post_kept(self._process_failure, event, number, reason)

    def _add(self, call: UnansweredCall) -> int:
        """Add a call to those under way, and return its number."""
        number = next(self._numbers)
        self._under_way[number] = call
        return number

    def _process_failure(self, event: Term, number: int, reason: str) -> None:
        self._count_failure(self._under_way[number], reason)
        self._process_end(event, number)

    def _process_end(self, event: Term, number: int) -> None:
        del self._under_way[number]
        self._dispatch(event)

    def _count_failure(self, call: UnansweredCall, reason: str) -> None:
        self.failed_count += 1
        self._reports.warning(
            f"service {shorten(call.service)}: {reason}", ("service", call.service), texts=5
        )


def _failure_event(call: UnansweredCall, reason: str) -> Term:
    return SERVICE_FAILED, atom(call.service), call.call_id, atom(reason)


def _fail_without_services(call: ServiceCall) -> None:
    call.fail("services are called only in a node: use --answers FILE, or the key services of a test case")


def _check_argument(domain: str, term: Term, fault: Optional[str]) -> None:
    if fault is not None:
        raise domain_error(domain, deref(term), fault)


def _read_options(options: Term) -> float:
    """Return the time limit in a list of options."""
    seconds = DEFAULT_CALL_SECONDS
    items = list_items(options)
    if items is None:
        raise type_error("list", deref(options))
    for item in items:
        option: Any = deref(item)
        if option.__class__ is not tuple or option[0] is not _TIMEOUT:
            raise domain_error("service_option", option, "expected timeout(Seconds)")
        value: Any = deref(option[1])
        if not isinstance(value, (int, float)):
            raise type_error("number", value)
        if not 0 < value <= MAX_CALL_SECONDS:
            raise domain_error("timeout", value, f"expected more than 0 and at most {MAX_CALL_SECONDS:g} s")
        seconds = float(value)
    return seconds
