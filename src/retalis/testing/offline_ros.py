"""ROS services and parameters for runs without ROS: prepared answers and values.

An answer is posted when the clock of the engine reaches its time, as an alarm.
"""

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ..engine.engine import Engine
from ..engine.service_calls import ServiceCall, ServiceRequest
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import strip_slashes
from ..messages.message_dictionaries import read_message_term
from ..messages.type_registry import Definitions
from ..prolog.terms import timestamps
from .case_definition import ServiceAnswer, Tolerance
from .message_comparison import SlotComparison
from .message_values import serialize_slots
from .yaml_documents import CaseFileError


class OfflineRos:
    """Services and parameters of one run.

    Args:
        services: answers; the first that fits a call is used. None if services cannot be called.
        parameters: ROS parameters by name; None if they cannot be read.
        definitions: known types.
    """

    def __init__(
        self,
        services: Optional[Sequence[ServiceAnswer]],
        parameters: Optional[Sequence[Tuple[str, Any]]],
        definitions: Definitions,
    ):
        self._answers_calls, self._has_parameters = services is not None, parameters is not None
        self._services = services or ()
        self._parameters = _nest_parameters(parameters or ())
        self._definitions = definitions
        self._remaining: List[Optional[int]] = [answer.max_calls for answer in self._services]
        self._comparison = SlotComparison(Tolerance(), {}, 0)

    def connect(self, engine: Engine) -> None:
        """Answer the calls of an engine, and provide its parameters."""
        if self._answers_calls:
            engine.on_service_call(lambda call: self._answer(engine, call))
        if self._has_parameters:
            engine.on_parameter_read(self._read_parameter)

    def _read_parameter(self, name: str) -> object:
        value: Any = self._parameters
        for part in _split_name(name):
            if not isinstance(value, dict):
                raise KeyError(name)
            value = value[part]
        return value

    def _answer(self, engine: Engine, call: ServiceCall) -> None:
        """Answer a call; see `retalis.engine.service_calls.CallService`. Errors in answers are reported."""
        try:
            answer = self._find_answer(call.request)
        except CaseFileError as error:
            _report_wrong_answer(engine, call, error)
            return
        if answer is None:
            call.fail("no answer is prepared for this call")
            return
        clock, limit = engine.clock, timestamps.from_seconds(call.request.seconds)
        definitions = self._definitions.with_strings(engine.strings)

        def end(instant: int) -> None:
            if answer.delay >= limit:
                call.fail(f"no reply within {call.request.seconds:g} s")
            elif answer.reply is None:
                call.fail(answer.error)
            else:
                try:
                    call.reply(serialize_slots(answer.reply, call.request.response, definitions, instant))
                except CaseFileError as error:
                    _report_wrong_answer(engine, call, error)
                except MessageError as error:
                    text = f"answer of service {answer.name}: {error.message}"
                    _report_wrong_answer(engine, call, CaseFileError(text, answer.place))

        if answer.delay:
            clock.call_at(clock.now() + min(answer.delay, limit), end)
        else:
            end(clock.now())

    def _find_answer(self, request: ServiceRequest) -> Optional[ServiceAnswer]:
        """Return the first answer that fits, and count its use."""
        for number, answer in enumerate(self._services):
            remaining = self._remaining[number]
            if (
                remaining != 0
                and strip_slashes(answer.name) == strip_slashes(request.name)
                and self._fits(answer, request)
            ):
                if remaining is not None:
                    self._remaining[number] = remaining - 1
                return answer
        return None

    def _fits(self, answer: ServiceAnswer, request: ServiceRequest) -> bool:
        if answer.request is None:
            return True
        # Also if another slot differs: the error must not depend on the request.
        self._comparison.check_names(request.request, answer.request)
        # The message of a type without slots is an atom.
        slots = read_message_term(request.request, request.term) if request.request.fields else {}
        return self._comparison.find_difference(request.request, answer.request, slots) is None


def _report_wrong_answer(engine: Engine, call: ServiceCall, error: CaseFileError) -> None:
    """Report an error in an answer, which lets a test case fail, and end the call."""

    def raise_error() -> None:
        raise error

    # The engine reports errors of work that it does later.
    engine.do_later(raise_error)
    call.fail(f"the prepared answer is wrong: {error.message}")


def _split_name(name: str) -> List[str]:
    """Return the parts of the name of a parameter; the first of a private name is ``~``."""
    return [part for part in name.replace("~", "~/").replace(".", "/").split("/") if part]


def _nest_parameters(parameters: Sequence[Tuple[str, Any]]) -> Mapping[str, Any]:
    nested: Dict[str, Any] = {}
    for name, value in parameters:
        *path, last = _split_name(name) or [""]
        group = nested
        for part in path:
            inner = group.get(part)
            if not isinstance(inner, dict):
                inner = group[part] = {}
            group = inner
        group[last] = value
    return nested
