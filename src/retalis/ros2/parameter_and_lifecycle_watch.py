"""Changes within other nodes: their parameters, and the states of their life cycles.

Nodes publish changes of parameters on ``/parameter_events``, and those of a life cycle on ``~/transition_event``.
The state before the first transition is known only to the node itself, so each node with a life cycle is asked for it
when it appears, and again from time to time: an event before the subscription is connected is lost.
"""

import json
import math
import threading
from time import monotonic
from typing import Any, Callable, Dict, Optional

from lifecycle_msgs.msg import TransitionEvent
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future

from ..foundation.displayed_text import shorten
from ..node.transport import GraphChange

PARAMETER_TOPIC = "/parameter_events"
TRANSITION_TOPIC = "/transition_event"
TRANSITION_TYPE = "lifecycle_msgs/msg/TransitionEvent"

CHECK_SECONDS = 1.0
"""Seconds between two searches for nodes with a life cycle."""

ASK_SECONDS = 10.0
"""Seconds between two questions for the state of one node."""

MAX_ANSWER_SECONDS = 5.0
"""Seconds after which an answer is not awaited any more."""

MAX_CALLS = 8
"""Number of questions that wait for an answer at the same time."""

MAX_NODES = 200
"""Number of nodes whose life cycles are watched."""

MAX_VALUE_CHARACTERS = 500
"""Number of characters of a parameter's value; longer ones are shortened."""

Report = Callable[[GraphChange], object]


class ParameterAndLifecycleWatch:
    """Watch of the parameters and life cycles of all nodes.

    Args:
        report: receives the changes, in the thread of the executor.
        warn: receives a warning.
        call_later: calls a function after some nanoseconds of real time.
    """

    def __init__(
        self,
        node: Node,
        report: Report,
        warn: Callable[[str], object],
        call_later: Callable[[int, Callable[[], object]], object],
    ):
        self._node = node
        self._report = report
        self._warn = warn
        self._call_later = call_later
        self._life_cycles: Dict[str, LifeCycle] = {}
        self._is_stopped = self._has_warned = False
        self._subscription = node.create_subscription(
            ParameterEvent, PARAMETER_TOPIC, self._on_parameters, qos_profile_parameter_events
        )
        self._check()

    def stop(self) -> None:
        """Watch no more."""
        self._is_stopped = True
        self._node.destroy_subscription(self._subscription)
        for life_cycle in self._life_cycles.values():
            life_cycle.close()

    def _on_parameters(self, event: ParameterEvent) -> None:
        for kind, parameters in (
            ("parameter_new", event.new_parameters),
            ("parameter_changed", event.changed_parameters),
            ("parameter_deleted", event.deleted_parameters),
        ):
            for parameter in parameters:
                self._report(GraphChange(kind, event.node, parameter.name, format_value(parameter)))

    def _check(self) -> None:
        if self._is_stopped:
            return
        try:
            self._find_nodes()
            self._ask_for_states()
        finally:
            self._call_later(int(CHECK_SECONDS * 1e9), self._check)

    def _find_nodes(self) -> None:
        names = {
            topic[: -len(TRANSITION_TOPIC)]
            for topic, types in self._node.get_topic_names_and_types()
            # The topic of a node that has ended is still subscribed here.
            if types == [TRANSITION_TYPE]
            and topic.endswith(TRANSITION_TOPIC)
            and self._node.count_publishers(topic)
        }
        for name in self._life_cycles.keys() - names:
            self._life_cycles.pop(name).close()
        for name in sorted(names - self._life_cycles.keys()):
            if len(self._life_cycles) >= MAX_NODES:
                if not self._has_warned:
                    self._has_warned = True
                    self._warn(
                        f"ros_graph: there are more than {MAX_NODES} nodes with a life cycle: others are ignored"
                    )
                return
            self._life_cycles[name] = LifeCycle(self._node, name, self._report)

    def _ask_for_states(self) -> None:
        """Ask the nodes that have not been asked for long; those whose answer is the oldest come first."""
        now = monotonic()
        life_cycles = self._life_cycles.values()
        for life_cycle in life_cycles:
            life_cycle.expire_question(now)
        waiting_count = sum(life_cycle.is_waiting for life_cycle in life_cycles)
        due = [life_cycle for life_cycle in life_cycles if life_cycle.is_due(now)]
        due.sort(key=lambda life_cycle: life_cycle.asked)
        for life_cycle in due[: MAX_CALLS - waiting_count]:
            life_cycle.ask(now)


class LifeCycle:
    """The life cycle of a node.

    Args:
        node: the node that watches.
        name: full name of the watched node.
        report: receives the changes.

    Attributes:
        asked: instant of the last question for the state, in seconds of the monotonic clock.
    """

    def __init__(self, node: Node, name: str, report: Report):
        self._node = node
        self._name = name
        self._report = report
        self._lock = threading.Lock()
        self._state = ""
        self._answer: Optional[Future] = None
        self.asked = -math.inf
        self._client = node.create_client(GetState, f"{name}/get_state")
        self._subscription = node.create_subscription(
            TransitionEvent, name + TRANSITION_TOPIC, self._on_transition, 10
        )

    def close(self) -> None:
        """Watch no more."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_client(self._client)

    @property
    def is_waiting(self) -> bool:
        """True if an answer is awaited."""
        return self._answer is not None

    def expire_question(self, now: float) -> None:
        """Await the answer no more if the question was long ago."""
        if now - self.asked >= MAX_ANSWER_SECONDS:
            self._cancel_question()

    def _cancel_question(self) -> None:
        with self._lock:
            question, self._answer = self._answer, None
        if question is not None:
            # A node that never answers must not leave a request for each question.
            self._client.remove_pending_request(question)

    def is_due(self, now: float) -> bool:
        """Return whether the node has to be asked for its state, and can be."""
        return (
            now - self.asked >= ASK_SECONDS and not self.is_waiting and bool(self._client.service_is_ready())
        )

    def ask(self, now: float) -> None:
        """Ask the node for its state."""
        self.asked = now
        self._answer = answer = self._client.call_async(GetState.Request())
        answer.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Future) -> None:
        with self._lock:
            # Otherwise an event has arrived after the question, or the answer is that of an earlier one.
            is_expected = answer is self._answer
            if is_expected:
                self._answer = None
        response: Any = answer.result()
        if is_expected and response is not None:
            self._set_state(response.current_state.label)

    def _on_transition(self, event: TransitionEvent) -> None:
        # The event is newer than the answer would be.
        self._cancel_question()
        self._set_state(event.goal_state.label)

    def _set_state(self, state: str) -> None:
        if state != self._state:
            before, self._state = self._state, state
            self._report(GraphChange("state_changed", self._name, state, before))


def format_value(parameter: Any) -> str:
    """Return the value of a parameter, given its message, as text: a text as it is, others as JSON."""
    value = Parameter.from_parameter_msg(parameter).value
    if value is None or isinstance(value, str):
        return shorten(value or "", MAX_VALUE_CHARACTERS)
    is_array = hasattr(value, "__len__")
    # The items of an array of bytes are bytes of length 1.
    text = json.dumps(list(value) if is_array else value, ensure_ascii=False, default=ord)
    return shorten(text, MAX_VALUE_CHARACTERS)
