"""Events of actions, in one form for ROS 1 and ROS 2.

A program observes an action by the topics of its server; it is no client. The topics and their types differ between
actionlib of ROS 1 and the actions of ROS 2. Each message is therefore converted to messages of an *event type*,
which is equal on both: ``pkg/Type__feedback`` for the feedback of the action ``pkg/Type``. ROS allows no type with
two underscores in a row. The converted messages are serialized as in ROS 1, and processed as those of other topics.

In ROS 2, goals, cancellations and results are no topics but requests and responses of services. They are read from
the events that servers publish of their services if introspection is enabled. The result of a goal is in a response,
the id of the goal in the request before, which has the same client and number.
"""

from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..foundation.errors import MessageError
from ..prolog.terms.byte_texts import text_bytes
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.types import Term, atom, deref, functor
from .cdr_decoder import CdrDecoder
from .decoder import Decoder
from .encoder import Encoder
from .type_definition import (
    QUOTED_STRINGS,
    Definition,
    Field,
    SerializationFormat,
    functor_name,
    parse,
)

GOAL, CANCEL, FEEDBACK, STATUS, RESULT = "goal", "cancel", "feedback", "status", "result"

ACTION_EVENTS: Dict[str, str] = {
    GOAL: "string goal_id\n{action}_Goal goal\n",
    CANCEL: "string goal_id\n",
    FEEDBACK: "string goal_id\n{action}_Feedback feedback\n",
    STATUS: "string goal_id\nstring status\n",
    RESULT: "string goal_id\nstring status\n{action}_Result result\n",
}
"""Events of an action, with the definitions of their types."""

_ENDPOINTS = {
    SerializationFormat.ROS1: {
        GOAL: ("/goal", "{action}ActionGoal"),
        CANCEL: ("/cancel", "actionlib_msgs/GoalID"),
        FEEDBACK: ("/feedback", "{action}ActionFeedback"),
        STATUS: ("/status", "actionlib_msgs/GoalStatusArray"),
        RESULT: ("/result", "{action}ActionResult"),
    },
    SerializationFormat.CDR: {
        GOAL: ("/_action/send_goal/_service_event", "{action}_SendGoal_Event"),
        CANCEL: ("/_action/cancel_goal/_service_event", "action_msgs/CancelGoal_Event"),
        FEEDBACK: ("/_action/feedback", "{action}_FeedbackMessage"),
        STATUS: ("/_action/status", "action_msgs/GoalStatusArray"),
        RESULT: ("/_action/get_result/_service_event", "{action}_GetResult_Event"),
    },
}
"""Suffixes of the topics of an action, and their types."""

_ROS1_STATUSES = (
    "pending",
    "executing",
    "canceled",
    "succeeded",
    "aborted",
    "rejected",
    "canceling",
    "canceling",
    "canceled",
    "lost",
)
"""Names of the states of goals by the numbers in ``actionlib_msgs/GoalStatus``; those of ROS 2 where it has them."""

_ROS2_STATUSES = ("unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted")
"""Names of the states of goals by the numbers in ``action_msgs/GoalStatus``."""

STATUSES = tuple(dict.fromkeys((*_ROS2_STATUSES, *_ROS1_STATUSES)))
"""Names of all states of goals in events."""

MAX_GOALS = 1_000
"""Maximum number of goals of a source whose states are remembered."""

MAX_PENDING_REQUESTS = 1000
"""Number of requests for results that are stored until their response."""

_REQUEST_RECEIVED, _RESPONSE_SENT = 1, 2
"""Types of the events that the server of a service publishes."""

_MARK = "__"


class ActionEvent(NamedTuple):
    """An event of an action.

    Attributes:
        action: type of the action, ``pkg/Type``.
        kind: kind of the event: one of `ACTION_EVENTS`.
    """

    action: str
    kind: str

    @property
    def type_name(self) -> str:
        """Name of the event type."""
        return f"{self.action}{_MARK}{self.kind}"

    @property
    def text(self) -> str:
        """Definition of the event type, without those of nested types."""
        return ACTION_EVENTS[self.kind].format(action=self.action)

    def endpoint(self, action_topic: str, serialization_format: SerializationFormat) -> Tuple[str, str]:
        """Return the topic and the type of the messages that are converted.

        Args:
            action_topic: full name of the action.
            serialization_format: that of ROS 1 or of ROS 2.
        """
        suffix, message_type = _ENDPOINTS[serialization_format][self.kind]
        return f"{action_topic}{suffix}", message_type.format(action=self.action)

    def action_topic(self, topic: str) -> Optional[str]:
        """Return the name of the action from ``action/kind``, the name of this event's topic; None for others."""
        suffix = f"/{self.kind}"
        return topic[: -len(suffix)] if topic.endswith(suffix) else None


def find_action_event(type_name: str) -> Optional[ActionEvent]:
    """Return the event of an event type; None for other types.

    >>> find_action_event("nav2_msgs/NavigateToPose__feedback")
    ActionEvent(action='nav2_msgs/NavigateToPose', kind='feedback')
    """
    action, mark, kind = type_name.rpartition(_MARK)
    return ActionEvent(action, kind) if mark and action and kind in ACTION_EVENTS else None


def event_name(base: str, kind: str) -> str:
    """Return the name of an event of an action, from the name that the program has given to the action's events."""
    return f"{base}{_MARK}{kind}"


def actionlib_name(type_name: str) -> Optional[str]:
    """Return the name in actionlib of a type that an action of ROS 2 has: ``pkg/DockGoal`` for ``pkg/Dock_Goal``."""
    name, mark, part = type_name.rpartition("_")
    return f"{name}{part}" if mark and part in ("Goal", "Result", "Feedback") else None


_Slots = Tuple[Term, ...]
"""Slots of a message of an event type."""

_Read = Callable[[Term], Iterable[_Slots]]
"""Function from a message of an action's topic to the events in it."""


class ActionMessages:
    """Conversion of the messages of one source of an action's topic to messages of an event type.

    Args:
        source: type of the source's messages.
        serialization_format: that of these messages.

    Attributes:
        definition: the event type, with goal, feedback or result as the source defines them.

    Raises:
        MessageError: if the type is not that of an action's topic.
    """

    def __init__(self, event: ActionEvent, source: Definition, serialization_format: SerializationFormat):
        is_of_ros1 = serialization_format is SerializationFormat.ROS1
        # The events are serialized again, and decoded in the form of strings that the program has.
        source = source.with_strings(QUOTED_STRINGS)
        if is_of_ros1:
            source = _rename_payload(source, event)
        nested_types = {nested.name: nested for nested in source.dependencies()}

        def find(name: str, package: str) -> Definition:
            if name not in nested_types:
                raise MessageError(
                    f"{source.name} has no {name}: expected the type of an action's {event.kind}"
                )
            return nested_types[name]

        self.definition = parse(event.type_name, event.text, find)
        self._decode = Decoder(source).decode if is_of_ros1 else CdrDecoder(source).decode
        self._create_reader = (_ROS1_READERS if is_of_ros1 else _ROS2_READERS)[event.kind]
        self._source = source
        self._read = self._create_reader(source)
        self._functor = functor(functor_name(event.type_name), len(self.definition.fields))
        self._encode = Encoder(self.definition).encode

    def forget_goals(self) -> None:
        """Forget the states of all goals and the requests without response, since time begins again."""
        self._read = self._create_reader(self._source)

    def convert(self, data: bytes) -> List[bytes]:
        """Return the events of a message, serialized as in ROS 1. Each message is to be converted once.

        Raises:
            MessageError: if the bytes are not a message of the source's type.
        """
        return [self._encode((self._functor, *slots)) for slots in self._read(self._decode(data))]


def _rename_payload(source: Definition, event: ActionEvent) -> Definition:
    """Return a type of actionlib in which the type of goal, feedback or result has its name of ROS 2."""
    payload_name = f"{event.action}_{event.kind.capitalize()}"
    fields = tuple(
        slot._replace(type=payload_name, definition=slot.definition.renamed(payload_name))
        if slot.name == event.kind and slot.definition is not None
        else slot
        for slot in source.fields
    )
    return Definition(source.name, fields, (), source.text)


def _find_field(definition: Definition, name: str) -> Tuple[int, Field]:
    """Return the position in terms, and the field, of a slot."""
    for position, slot in enumerate(definition.fields, 1):
        if slot.name == name:
            return position, slot
    raise MessageError(f"{definition.name} has no slot {name}: expected the type of an action's topic")


def _make_getter(definition: Definition, path: str) -> Callable[[Any], Any]:
    """Return the function from a message to the value of a slot, by the names on the path to it."""
    positions: List[int] = []
    nested: Optional[Definition] = definition
    for name in path.split("."):
        if nested is None:
            raise MessageError(
                f"{definition.name} has no slot {path}: expected the type of an action's topic"
            )
        position, slot = _find_field(nested, name)
        positions.append(position)
        nested = slot.definition

    def get(term: Any) -> Any:
        for position in positions:
            term = deref(term[position])
        return term

    return get


def _make_list_getter(definition: Definition, name: str) -> Tuple[Callable[[Any], List[Term]], Definition]:
    """Return the function from a message to the items of an array of messages, and the type of the items."""
    position, slot = _find_field(definition, name)
    if slot.length is None or slot.definition is None:
        raise MessageError(f"{definition.name} has no array {name}: expected the type of an action's topic")
    return lambda term: [deref(item) for item in list_items(deref(term[position])) or ()], slot.definition


def _text(text: str) -> Term:
    return atom(f'"{text}"')


_NO_GOAL = _text("")
"""The id in requests to cancel all goals."""


def _make_id_getter(definition: Definition, path: str) -> Callable[[Any], Term]:
    """Return the function from a message to the id of a goal; that of ROS 2 as hexadecimal digits."""
    get = _make_getter(definition, path)

    def get_id(term: Any) -> Term:
        digits = (text_bytes(get(term)) or b"").hex()
        return _text(digits) if digits.strip("0") else _NO_GOAL

    return get_id


def _make_status_getter(definition: Definition, path: str, names: Sequence[str]) -> Callable[[Any], Term]:
    """Return the function from a message to the name of the status of a goal."""
    get, texts = _make_getter(definition, path), [*map(_text, names)]
    unknown = _text("unknown")

    def get_status(term: Any) -> Term:
        status = get(term)
        return texts[status] if 0 <= status < len(texts) else unknown

    return get_status


def _read_slots(*getters: Callable[[Any], Term]) -> _Read:
    """Return the reader of messages that are one event."""
    return lambda term: [tuple(get(term) for get in getters)]


def _read_changes(
    get_items: Callable[[Any], List[Term]], get_id: Callable[[Any], Term], get_status: Callable[[Any], Term]
) -> _Read:
    """Return the reader of arrays with the states of all goals, which yields those that have changed."""
    states: Dict[Term, Term] = {}

    def read(term: Term) -> Iterator[_Slots]:
        for item in get_items(term):
            goal, status = get_id(item), get_status(item)
            # Added again, so that the goal that has had no status for longest is forgotten first. Goals that are
            # missing in a message are kept: several servers of ROS 2 may be one source.
            before = states.pop(goal, None)
            states[goal] = status
            if len(states) > MAX_GOALS:
                del states[next(iter(states))]
            if before is not status:
                yield goal, status

    return read


def _read_ros1_goal(source: Definition) -> _Read:
    return _read_slots(_make_getter(source, "goal_id.id"), _make_getter(source, "goal"))


def _read_ros1_cancel(source: Definition) -> _Read:
    return _read_slots(_make_getter(source, "id"))


def _read_ros1_feedback(source: Definition) -> _Read:
    return _read_slots(_make_getter(source, "status.goal_id.id"), _make_getter(source, "feedback"))


def _read_ros1_result(source: Definition) -> _Read:
    return _read_slots(
        _make_getter(source, "status.goal_id.id"),
        _make_status_getter(source, "status.status", _ROS1_STATUSES),
        _make_getter(source, "result"),
    )


def _read_ros1_status(source: Definition) -> _Read:
    get_items, item = _make_list_getter(source, "status_list")
    return _read_changes(
        get_items, _make_getter(item, "goal_id.id"), _make_status_getter(item, "status", _ROS1_STATUSES)
    )


def _read_ros2_feedback(source: Definition) -> _Read:
    return _read_slots(_make_id_getter(source, "goal_id.uuid"), _make_getter(source, "feedback"))


def _read_ros2_status(source: Definition) -> _Read:
    get_items, item = _make_list_getter(source, "status_list")
    get_id = _make_id_getter(item, "goal_info.goal_id.uuid")
    return _read_changes(get_items, get_id, _make_status_getter(item, "status", _ROS2_STATUSES))


def _read_requests(source: Definition, get_slots: Callable[[Definition], _Read]) -> _Read:
    """Return the reader of the events of a service that yields each request once, when the server receives it."""
    get_type = _make_getter(source, "info.event_type")
    get_requests, request = _make_list_getter(source, "request")
    read_request = get_slots(request)

    def read(term: Term) -> Iterator[_Slots]:
        # Without contents, the events of the service have no request.
        if get_type(term) == _REQUEST_RECEIVED:
            for item in get_requests(term):
                yield from read_request(item)

    return read


def _read_ros2_goal(source: Definition) -> _Read:
    return _read_requests(
        source,
        lambda request: _read_slots(_make_id_getter(request, "goal_id.uuid"), _make_getter(request, "goal")),
    )


def _read_ros2_cancel(source: Definition) -> _Read:
    return _read_requests(
        source, lambda request: _read_slots(_make_id_getter(request, "goal_info.goal_id.uuid"))
    )


def _read_ros2_result(source: Definition) -> _Read:
    get_type = _make_getter(source, "info.event_type")
    get_client, get_number = (
        _make_getter(source, "info.client_gid"),
        _make_getter(source, "info.sequence_number"),
    )
    get_requests, request = _make_list_getter(source, "request")
    get_responses, response = _make_list_getter(source, "response")
    get_id = _make_id_getter(request, "goal_id.uuid")
    get_status, get_result = (
        _make_status_getter(response, "status", _ROS2_STATUSES),
        _make_getter(response, "result"),
    )
    pending: Dict[Tuple[Term, Term], Term] = {}

    def read(term: Term) -> Iterator[_Slots]:
        key = get_client(term), get_number(term)
        if get_type(term) == _REQUEST_RECEIVED:
            for item in get_requests(term):
                pending[key] = get_id(item)
            if len(pending) > MAX_PENDING_REQUESTS:
                del pending[next(iter(pending))]
        elif get_type(term) == _RESPONSE_SENT:
            goal = pending.pop(key, None)
            # The request may have been sent before this node was started.
            if goal is not None:
                for item in get_responses(term):
                    yield goal, get_status(item), get_result(item)

    return read


_ROS1_READERS: Dict[str, Callable[[Definition], _Read]] = {
    GOAL: _read_ros1_goal,
    CANCEL: _read_ros1_cancel,
    FEEDBACK: _read_ros1_feedback,
    STATUS: _read_ros1_status,
    RESULT: _read_ros1_result,
}
_ROS2_READERS: Dict[str, Callable[[Definition], _Read]] = {
    GOAL: _read_ros2_goal,
    CANCEL: _read_ros2_cancel,
    FEEDBACK: _read_ros2_feedback,
    STATUS: _read_ros2_status,
    RESULT: _read_ros2_result,
}
