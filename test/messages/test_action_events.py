"""Events of actions: names, conversion from the messages of ROS 1 and ROS 2, and malformed types and messages."""

from typing import Any, Dict, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from messages.action_messages import DOCK, ROS1, ROS2, ROS2_STATUSES, DockServer, goal_text
from messages.ros2_types import find_text
from retalis import Definitions, MessageError
from retalis.messages import action_events
from retalis.messages.action_events import (
    ACTION_EVENTS,
    ActionEvent,
    ActionMessages,
    find_action_event,
)
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import InstalledTypes, parse_ros2_type
from retalis.prolog.syntax.event_text import to_text

FORMATS = pytest.mark.parametrize("message_format", [ROS1, ROS2], ids=["ros1", "ros2"])


class Observer:
    """Converts the messages of an action to the texts of events.

    Args:
        server: server of the action.
    """

    def __init__(self, server: DockServer):
        self._server = server
        self._converters: Dict[str, ActionMessages] = {}

    def read(self, kind: str, data: bytes) -> List[str]:
        """Return the events of a message."""
        if kind not in self._converters:
            definition = self._server.definition(kind)
            self._converters[kind] = ActionMessages(
                ActionEvent("lab/Dock", kind), definition, self._server.format
            )
        converter = self._converters[kind]
        decode = Definitions().decoder(converter.definition).decode
        return [to_text(decode(event)) for event in converter.convert(data)]

    def forget_goals(self) -> None:
        """Begin again, as after a jump of the clock."""
        for converter in self._converters.values():
            converter.forget_goals()


@pytest.fixture
def server(message_format: SerializationFormat) -> DockServer:
    return DockServer(message_format)


@pytest.fixture
def observer(server: DockServer) -> Observer:
    return Observer(server)


@pytest.mark.parametrize("kind", ACTION_EVENTS)
def test_name_of_event_type_names_action_and_kind(kind: str) -> None:
    event = ActionEvent("lab/Dock", kind)
    assert find_action_event(event.type_name) == event
    assert event.action_topic(f"/robot/dock/{kind}") == "/robot/dock"
    assert event.action_topic("/robot/dock") is None


@pytest.mark.parametrize("name", ["lab/Dock", "lab/Dock_Feedback", "lab/Dock__feedbak", "__goal", "goal"])
def test_other_types_are_no_event_types(name: str) -> None:
    assert find_action_event(name) is None


@FORMATS
def test_feedback_is_equal_in_both_formats(
    server: DockServer, observer: Observer, message_format: SerializationFormat
) -> None:
    (event,) = observer.read("feedback", server.feedback("g1", 1.5)[2])
    goal = goal_text("g1", message_format)
    assert event == f"lab__0__Dock__feedback('\"{goal}\"',lab__0__Dock_Feedback(1.5,[1,2]))"


@FORMATS
def test_goal_and_cancellation_are_read(
    server: DockServer, observer: Observer, message_format: SerializationFormat
) -> None:
    goal = goal_text("g1", message_format)
    assert observer.read("goal", server.goal("g1", "east")[2]) == [
        f"lab__0__Dock__goal('\"{goal}\"',lab__0__Dock_Goal('\"east\"'))"
    ]
    assert observer.read("cancel", server.cancel("g1")[2]) == [f"lab__0__Dock__cancel('\"{goal}\"')"]


@FORMATS
def test_cancellation_of_all_goals_has_empty_id(server: DockServer, observer: Observer) -> None:
    assert observer.read("cancel", server.cancel("")[2]) == ["lab__0__Dock__cancel('\"\"')"]


@FORMATS
def test_result_has_id_and_status_of_goal(
    server: DockServer, observer: Observer, message_format: SerializationFormat
) -> None:
    if message_format is ROS2:
        assert observer.read("result", server.result_request("g1")[2]) == []
    goal = goal_text("g1", message_format)
    assert observer.read("result", server.result("g1", "succeeded", 2.5)[2]) == [
        f"lab__0__Dock__result('\"{goal}\"','\"succeeded\"',lab__0__Dock_Result(2.5))"
    ]


@FORMATS
def test_only_changed_states_are_events(
    server: DockServer, observer: Observer, message_format: SerializationFormat
) -> None:
    arrays: List[Dict[str, str]] = [
        {"a": "executing"},
        {"a": "executing", "b": "executing"},
        {"a": "executing", "b": "canceling"},
        {"a": "succeeded", "b": "canceled"},
        {"b": "canceled"},
        {},
    ]
    events = [observer.read("status", server.status(**states)[2]) for states in arrays]

    def event(goal: str, status: str) -> str:
        return f"lab__0__Dock__status('\"{goal_text(goal, message_format)}\"','\"{status}\"')"

    assert events == [
        [event("a", "executing")],
        [event("b", "executing")],
        [event("b", "canceling")],
        [event("a", "succeeded"), event("b", "canceled")],
        [],
        [],
    ]


@given(st.lists(st.dictionaries(st.sampled_from("abcdef"), st.sampled_from([*ROS2_STATUSES]))))
def test_events_of_states_are_differences(arrays: List[Dict[str, str]]) -> None:
    server = DockServer(ROS2)
    observer = Observer(server)
    before: Dict[str, str] = {}
    for states in arrays:
        events = observer.read("status", server.status(**states)[2])
        expected = [
            f"lab__0__Dock__status('\"{goal_text(goal, ROS2)}\"','\"{status}\"')"
            for goal, status in states.items()
            if before.get(goal) != status
        ]
        assert events == expected
        # Goals of another server are not in this message.
        before.update(states)


@FORMATS
def test_messages_of_two_servers_repeat_no_status(server: DockServer, observer: Observer) -> None:
    first, second = (server.status(**{goal: "executing"})[2] for goal in "ab")
    counts = [len(observer.read("status", data)) for data in (first, second, first, second)]
    assert counts == [1, 1, 0, 0]


@FORMATS
def test_states_are_reported_again_when_time_begins_again(server: DockServer, observer: Observer) -> None:
    data = server.status(a="executing")[2]
    assert [len(observer.read("status", data)) for _ in range(2)] == [1, 0]
    observer.forget_goals()
    assert len(observer.read("status", data)) == 1


def test_number_of_stored_goals_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_events, "MAX_GOALS", 10)
    server = DockServer(ROS2)
    observer = Observer(server)
    for number in range(11):
        observer.read("status", server.status(**{f"g{number}": "executing"})[2])
    assert observer.read("status", server.status(g1="executing")[2]) == []
    assert len(observer.read("status", server.status(g0="executing")[2])) == 1


def test_events_of_clients_are_ignored() -> None:
    server = DockServer(ROS2)
    request = {"goal_id": {"uuid": bytes(16)}, "goal": {"station": "east"}}
    messages = [
        server.message("goal", info={"event_type": number}, request=[request])[2] for number in range(4)
    ]
    event_counts = [len(Observer(server).read("goal", message)) for message in messages]
    assert event_counts == [0, 1, 0, 0]


def test_service_events_without_contents_are_ignored() -> None:
    server = DockServer(ROS2)
    message = server.message("goal", info={"event_type": 1})
    assert Observer(server).read("goal", message[2]) == []


def test_result_without_observed_request_is_ignored() -> None:
    server = DockServer(ROS2)
    observer = Observer(server)
    observer.read("result", server.result_request("g1", number=1)[2])
    assert observer.read("result", server.result("g1", "succeeded", 1.0, number=2)[2]) == []
    assert len(observer.read("result", server.result("g1", "succeeded", 1.0, number=1)[2])) == 1


def test_number_of_stored_requests_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_events, "MAX_PENDING_REQUESTS", 10)
    server = DockServer(ROS2)
    observer = Observer(server)
    for number in range(11):
        observer.read("result", server.result_request("g1", number)[2])
    assert observer.read("result", server.result("g1", "succeeded", 1.0, 0)[2]) == []
    assert len(observer.read("result", server.result("g1", "succeeded", 1.0, 1)[2])) == 1


@given(st.binary(max_size=80))
def test_malformed_messages_are_errors(data: bytes) -> None:
    for message_format in (ROS1, ROS2):
        server = DockServer(message_format)
        for kind in ACTION_EVENTS:
            observer = Observer(server)
            try:
                events = observer.read(kind, data)
            except MessageError:
                continue
            assert all(event.startswith(f"lab__0__Dock__{kind}(") for event in events)


@pytest.mark.parametrize("kind", ACTION_EVENTS)
@FORMATS
def test_type_without_slots_of_action_is_refused(message_format: SerializationFormat, kind: str) -> None:
    definition = Definitions().add("lab/Other", "float64 x\n")
    with pytest.raises(MessageError, match="lab/Other has no"):
        ActionMessages(ActionEvent("lab/Dock", kind), definition, message_format)


def test_event_types_of_installed_action_are_known(tmp_path: Any) -> None:
    folder = tmp_path / "lab" / "action"
    folder.mkdir(parents=True)
    (folder / "Dock.action").write_text(DOCK)
    definitions = Definitions(InstalledTypes([str(tmp_path)], include_rosbags=False))
    definition = definitions.find("lab/Dock__feedback")
    assert [(slot.name, slot.describe()) for slot in definition.fields] == [
        ("goal_id", "string"),
        ("feedback", "lab/Dock_Feedback"),
    ]
    assert definitions.misspelt("lab/Dok__feedback") == "lab/Dock__feedback"
    assert definitions.misspelt("lab/Dock__feedback") == ""


def test_event_types_of_actionlib_have_names_of_ros2(tmp_path: Any) -> None:
    folder = tmp_path / "lab" / "msg"
    folder.mkdir(parents=True)
    (folder / "DockResult.msg").write_text("float64 seconds\n")
    definitions = Definitions(InstalledTypes([str(tmp_path)], include_rosbags=False))
    assert [slot.describe() for slot in definitions.find("lab/Dock__result").fields] == [
        "string",
        "string",
        "lab/Dock_Result",
    ]


def test_event_type_of_unknown_action_is_an_error() -> None:
    definitions = Definitions(InstalledTypes([], include_rosbags=False))
    with pytest.raises(MessageError, match="lab/Dock_Feedback is installed or has been received"):
        definitions.find("lab/Dock__feedback")


def test_empty_feedback_is_read() -> None:
    feedback = parse_ros2_type("lab/action/Stop_FeedbackMessage", "---\n---\n", find_text)
    messages = ActionMessages(ActionEvent("lab/Stop", "feedback"), feedback, ROS2)
    (event,) = messages.convert(b"\0\1\0\0" + b"0123456789abcdef" + b"\0")
    decoded = Definitions().decoder(messages.definition).decode(event)
    assert to_text(decoded) == (
        f"lab__0__Stop__feedback('\"{b'0123456789abcdef'.hex()}\"',lab__0__Stop_Feedback)"
    )
