"""Actions and services that a program observes, in nodes and in bags of ROS 1 and ROS 2."""

import sqlite3
from contextlib import closing
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Dict, List, Optional, Tuple

import pytest
from malicious_bags import TABLES
from messages.action_messages import DOCK, ROS1, ROS2, DockServer, Message, goal_text, uuid
from messages.ros2_types import find_text
from node.in_memory_hosts import DEFINITIONS, decode, start_host
from node.memory_transport import MemoryNetwork, MemoryTransport
from page_snippet_runner import FENCE, ROOT

from retalis import BagWriter, Definitions, MessageError, Playback
from retalis.messages.action_events import ACTION_EVENTS
from retalis.messages.message_dictionaries import make_message_term, read_message_term
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import InstalledTypes, parse_ros2_type
from retalis.node.diagnostics import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, Level
from retalis.playback.bag_locations import MergedBag
from retalis.prolog.syntax.event_text import to_text

SECOND = 10**9
START = 1_000 * SECOND
FORMATS = pytest.mark.parametrize("message_format", [ROS1, ROS2], ids=["ros1", "ros2"])

TOPICS = """
<publish_subscribe>
  <observe_action name="dock" action_type="lab/Dock" event="dock"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """
compile_event_file('rules.txt')
subscribe(stalled(Goal), [], std_msgs__0__String(Goal), alarm, s1)
"""
RULES = """
accepted(G) <- dock__status(G, S) where memberchk(S, ['"accepted"', '"executing"']).
ended(G) <- dock__status(G, S)
  where memberchk(S, ['"canceling"', '"succeeded"', '"canceled"', '"aborted"']).
:- state(running(G), from(accepted(G)), until(ended(G))).
near(G, N) <- dock__feedback(G, lab__0__Dock_Feedback(D, _)) where N is floor(D).
progress(G) <- near(G, N) with change(N, G).
active(G) <- accepted(G).
active(G) <- progress(G).
stalled(G) <- (active(G) seq absent((active(G) or ended(G)), 20)) where holds(running(G)).
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text(TOPICS)
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "rules.txt").write_text(RULES)
    return folder


def make_messages(server: DockServer) -> List[Tuple[int, Message]]:
    """Return the messages of three goals with their times: one ends, one is canceled, and one stalls."""
    rows = [
        (1, server.goal("a", "east")),
        (1, server.status(a="executing")),
        (2, server.feedback("a", 5.5)),
        (5, server.status(a="succeeded", b="executing")),
        (6, server.feedback("b", 3.5)),
        (10, server.cancel("b")),
        (11, server.status(b="canceling")),
        (12, server.status(b="canceled", c="executing")),
        (20, server.feedback("c", 3.5)),
        (35, server.feedback("c", 2.5)),
        (45, server.feedback("c", 2.4)),
        (70, server.status(c="aborted")),
    ]
    if server.format is ROS2:
        rows.append((71, server.result_request("c")))
    rows.append((72, server.result("c", "aborted", 58.0)))
    return [(START + second * SECOND, message) for second, message in rows]


def expected_events(message_format: SerializationFormat) -> List[str]:
    """Return the events of the action in the messages."""
    a, b, c = (f"'\"{goal_text(goal, message_format)}\"'" for goal in "abc")
    return [
        f"dock__goal({a},lab__0__Dock_Goal('\"east\"'))",
        f"dock__status({a},'\"executing\"')",
        f"dock__feedback({a},lab__0__Dock_Feedback(5.5,[1,2]))",
        f"dock__status({a},'\"succeeded\"')",
        f"dock__status({b},'\"executing\"')",
        f"dock__feedback({b},lab__0__Dock_Feedback(3.5,[1,2]))",
        f"dock__cancel({b})",
        f"dock__status({b},'\"canceling\"')",
        f"dock__status({b},'\"canceled\"')",
        f"dock__status({c},'\"executing\"')",
        f"dock__feedback({c},lab__0__Dock_Feedback(3.5,[1,2]))",
        f"dock__feedback({c},lab__0__Dock_Feedback(2.5,[1,2]))",
        f"dock__feedback({c},lab__0__Dock_Feedback(2.4,[1,2]))",
        f"dock__status({c},'\"aborted\"')",
        f"dock__result({c},'\"aborted\"',lab__0__Dock_Result(58.0))",
    ]


def record(engine: Any) -> List[str]:
    """Return the list to which the events of the action and the alarms are added, the latter with their times."""
    events: List[str] = []

    def add(term: Any, start: int, end: int) -> None:
        text = to_text(term)
        if text.startswith("dock__"):
            events.append(text)
        elif text.startswith("stalled"):
            events.append(f"{text} at {(end - START) // SECOND}")

    engine.on_event(add)
    return events


def check_events(events: List[str], message_format: SerializationFormat) -> None:
    expected = expected_events(message_format)
    # Between the last feedback and the end of the goal.
    expected.insert(-2, f"stalled('\"{goal_text('c', message_format)}\"') at 55")
    assert events == expected


@FORMATS
def test_node_reports_stalled_goal(program: Path, message_format: SerializationFormat) -> None:
    network = MemoryNetwork(START)
    server = DockServer(message_format)
    transport = MemoryTransport(network, "/server", message_format=message_format)
    host = start_host(network, program, message_format)
    try:
        events = record(host.engine)
        publications: Dict[str, Any] = {}
        for instant, (suffix, definition, data) in make_messages(server):
            network.move_time((instant - network.now) / SECOND)
            if suffix not in publications:
                publications[suffix] = transport.advertise(f"/dock{suffix}", definition, 10)
            publications[suffix].send(data)
        (alarm,) = network.publications["/alarm"]
    finally:
        host.transport.shut_down()
    check_events(events, message_format)
    assert len(alarm.messages) == 1


@FORMATS
def test_events_of_action_have_time_of_reception(program: Path, message_format: SerializationFormat) -> None:
    network = MemoryNetwork(START)
    server = DockServer(message_format)
    transport = MemoryTransport(network, "/server", message_format=message_format)
    host = start_host(network, program, message_format)
    times: List[int] = []
    host.engine.on_event(
        lambda term, start, end: times.append(end) if to_text(term).startswith("dock__status") else None
    )
    suffix, definition, data = server.status(a="executing", b="executing")
    transport.advertise(f"/dock{suffix}", definition, 10)
    (subscription,) = network.subscriptions[f"/dock{suffix}"]
    (receiver,) = subscription.receivers.values()
    receiver.receive([data], [START - 5])
    host.transport.shut_down()
    assert times == [START - 5, START - 4]


def test_list_has_topics_of_action(program: Path) -> None:
    network = MemoryNetwork(START)
    server = DockServer(ROS2)
    transport = MemoryTransport(network, "/server", message_format=ROS2)
    host = start_host(network, program, ROS2)
    try:
        suffix, definition, data = server.status(a="executing", b="accepted")
        transport.advertise(f"/dock{suffix}", definition, 10).send(data, data)
        listed = {topic["topic"]: topic for topic in network.call("/retalis/list", most=0, name="")["inputs"]}
        status = listed["/dock/status"]
        assert (status["type"], status["publishers"]) == ("lab/Dock__status", 1)
        assert (status["messages"], status["dropped"]) == (2, 0)
        assert listed["/dock/feedback"]["publishers"] == 0
    finally:
        host.transport.shut_down()


@FORMATS
def test_server_that_connects_again_repeats_no_status(
    program: Path, message_format: SerializationFormat
) -> None:
    network = MemoryNetwork(START)
    server = DockServer(message_format)
    transport = MemoryTransport(network, "/server", message_format=message_format)
    host = start_host(network, program, message_format)
    try:
        events = record(host.engine)
        for statuses in ({"a": "executing"}, {"a": "executing"}, {"a": "succeeded"}):
            suffix, definition, data = server.status(**statuses)
            publication = transport.advertise(f"/dock{suffix}", definition, 10)
            publication.send(data)
            publication.close()
    finally:
        host.transport.shut_down()
    goal = goal_text("a", message_format)
    assert events == [f"dock__status('\"{goal}\"','\"{status}\"')" for status in ("executing", "succeeded")]


def test_type_of_action_that_is_not_installed_is_one_error(
    program: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    subscribe = MemoryTransport.subscribe

    def refuse_types_of_lab(transport: Any, topic: str, message_type: str, *arguments: Any) -> Any:
        if message_type.startswith("lab/"):
            raise MessageError(f"the message type {message_type} is not installed")
        return subscribe(transport, topic, message_type, *arguments)

    monkeypatch.setattr(MemoryTransport, "subscribe", refuse_types_of_lab)
    host = start_host(MemoryNetwork(START), program, ROS2)
    host.transport.shut_down()
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == [
        "pub_sub.xml: action dock: the message type lab/Dock_FeedbackMessage is not installed"
    ]


@FORMATS
def test_only_read_topics_of_action_need_publishers(
    program: Path, message_format: SerializationFormat, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program reads status and feedback."""
    # The type of diagnostics must not depend on the installation of ROS.
    monkeypatch.setattr(MemoryTransport, "installed_types", lambda *arguments, **options: InstalledTypes())
    network = MemoryNetwork(START)
    listener = DiagnosticsListener(network, message_format)
    host = start_host(network, program, message_format, diagnostics=0.001)
    try:
        levels = listener.wait_for_levels()
    finally:
        host.transport.shut_down()
    assert levels == {
        "goal": Level.OK,
        "cancel": Level.OK,
        "feedback": Level.WARN,
        "status": Level.WARN,
        "result": Level.OK,
    }


class DiagnosticsListener:
    """Receiver of the status of the topics of the action.

    Args:
        network: network of the node.
        message_format: serialization of messages.
    """

    def __init__(self, network: MemoryNetwork, message_format: SerializationFormat) -> None:
        self._decode = DEFINITIONS.decoder(DIAGNOSTICS_TYPE, message_format).decode
        self._received: SimpleQueue[bytes] = SimpleQueue()
        transport = MemoryTransport(network, "/listener", message_format=message_format)
        transport.subscribe(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, lambda source: self, 10)

    def receive(self, messages: List[bytes]) -> None:
        for message in messages:
            self._received.put(message)

    def close(self, is_incomplete: bool) -> None:
        """Do nothing."""

    def wait_for_levels(self) -> Dict[str, int]:
        """Return the levels of the topics of the action in the next message, by the kinds of events."""
        definition = DEFINITIONS.find(DIAGNOSTICS_TYPE)
        message = read_message_term(definition, self._decode(self._received.get(timeout=60)))
        levels = {status["name"]: status["level"] for status in message["status"]}
        return {kind: levels[f"retalis: input /dock/{kind}"] for kind in ACTION_EVENTS}


def write_ros1_bag(path: Path, messages: List[Tuple[int, Message]]) -> Path:
    with BagWriter(path) as bag:
        connections: Dict[str, Any] = {}
        for instant, (suffix, definition, data) in messages:
            if suffix not in connections:
                connections[suffix] = bag.add(f"/dock{suffix}", definition)
            bag.write(connections[suffix], instant, data)
    return path


def write_ros2_bag(
    path: Path,
    messages: List[Tuple[int, Message]],
    definition: Optional[str],
    action: str = "lab/Dock",
    name: str = "/dock",
) -> Path:
    """Write a database as ``ros2 bag`` does.

    Args:
        path: path of the file.
        messages: the messages with their times.
        definition: definition of the action; None if the bag contains none, as of ROS 2 Jazzy.
        action: type of the action.
        name: name of the action.
    """
    action_package, _, action_type = action.partition("/")
    with closing(sqlite3.connect(str(path))) as database:
        database.executescript(TABLES)
        if definition is not None:
            full_name = f"{action_package}/action/{action_type}"
            row = (full_name, "ros2msg", f"{'=' * 80}\nACTION: {full_name}\n{definition}")
            database.execute("INSERT INTO message_definitions VALUES(1, ?, ?, ?, '')", row)
        topics: Dict[str, int] = {}
        for instant, (suffix, message_type, data) in messages:
            if suffix not in topics:
                topics[suffix] = len(topics) + 1
                package, _, type_name = message_type.name.partition("/")
                is_service = type_name.endswith("_Event")
                folder = "action" if package == action_package else "srv" if is_service else "msg"
                topic_row = (topics[suffix], f"{name}{suffix}", f"{package}/{folder}/{type_name}")
                database.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '', '')", topic_row)
            database.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
                (topics[suffix], instant, data),
            )
        database.commit()
    return path


def raise_problem(problem: Exception) -> None:
    raise problem


@FORMATS
def test_playback_reports_stalled_goal(
    program: Path, tmp_path: Path, message_format: SerializationFormat, caplog: pytest.LogCaptureFixture
) -> None:
    messages = make_messages(DockServer(message_format))
    if message_format is ROS1:
        path = write_ros1_bag(tmp_path / "a.bag", messages)
    else:
        path = write_ros2_bag(tmp_path / "a.db3", messages, DOCK)
    problems: List[Any] = []
    with MergedBag([path]) as bag:
        playback = Playback(program, problems.append, bag=bag)
        events = record(playback.engine)
        outputs = list(playback.run(bag))
    check_events(events, message_format)
    assert [decode(output.data) for output in outputs] == [goal_text("c", message_format)]
    assert (problems, caplog.messages) == ([], [])


@pytest.mark.parametrize(
    ("remappings", "message_format", "expected"),
    [
        ({}, ROS1, "/dock/status"),
        ({}, ROS2, "/dock/_action/status"),
        ({"/dock": "/base/dock"}, ROS1, "/base/dock/status"),
        ({"/dock": "/base/dock"}, ROS2, "/base/dock/_action/status"),
        ({"/dock/status": "/other"}, ROS1, "/other"),
        ({"/dock/_action/status": "/other"}, ROS2, "/other"),
        # The name of the action is resolved first.
        ({"/dock": "/base/dock", "/dock/status": "/other"}, ROS1, "/base/dock/status"),
        ({"/dock": "/base/dock", "/base/dock/status": "/other"}, ROS1, "/other"),
        ({"/dock": "/base/dock", "/base/dock": "/dock"}, ROS1, "/base/dock/status"),
        # Servers of ROS 2 have no topic of this name.
        ({"/dock/status": "/other"}, ROS2, "/dock/_action/status"),
    ],
)
def test_remapped_topics_of_action_are_subscribed(
    program: Path, remappings: Dict[str, str], message_format: SerializationFormat, expected: str
) -> None:
    network = MemoryNetwork(START)
    host = start_host(network, program, message_format, remappings=remappings)
    host.transport.shut_down()
    topics = [topic for topic in network.subscriptions if topic.endswith(("/status", "/other"))]
    assert topics == [expected]


def test_missing_action_of_bag_is_named(
    program: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        bag.write(bag.add("/word", DEFINITIONS.find("std_msgs/String")), START, b"\1\0\0\0a")
    with MergedBag([path]) as bags:
        list(Playback(program, raise_problem, bag=bags).run(bags))
    assert f"{path} has no messages on action dock; it has /word (std_msgs/String)" in caplog.messages


NAVIGATE = (
    "geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\nuint16 error_code\n---\n"
    "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
    "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
    "float32 distance_remaining\n"
)


def test_program_of_guide_reports_stalled_goal(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "how-to" / "stalled-goal.md").read_text(encoding="utf-8")
    for fence in FENCE.finditer(page):
        if fence["name"]:
            (tmp_path / fence["name"]).write_text(fence["text"])
    server = DockServer(ROS2)
    feedback_type = parse_ros2_type("nav2_msgs/action/NavigateToPose_FeedbackMessage", NAVIGATE, find_text)
    encode_feedback = Definitions().encoder(feedback_type, ROS2).encode
    messages: List[Tuple[int, Message]] = [(START, server.status(a="executing"))]
    for second in range(1, 60):
        # The robot stands at 3 m from 10 s on.
        fields = {"goal_id": uuid("a"), "feedback": {"distance_remaining": max(3.0, 13.0 - second)}}
        data = encode_feedback(make_message_term(feedback_type, fields))
        messages.append((START + second * SECOND, ("/_action/feedback", feedback_type, data)))
    path = write_ros2_bag(
        tmp_path / "a.db3", messages, NAVIGATE, action="nav2_msgs/NavigateToPose", name="/navigate_to_pose"
    )
    with MergedBag([path]) as bag:
        (output,) = Playback(tmp_path, raise_problem, bag=bag).run(bag)
    assert (decode(output.data), output.time - START) == (goal_text("a", ROS2), 30 * SECOND)


# ---- services ----------------------------------------------------------------------------------------


def test_events_of_service_are_events_of_program(tmp_path: Path) -> None:
    folder = tmp_path / "program"
    folder.mkdir()
    element = '<observe_service name="go" srv_type="lab/Go" event="go"/>'
    (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{element}</publish_subscribe>")
    (folder / "goalPredicates.txt").write_text("compile_event_file('rules.txt')")
    (folder / "rules.txt").write_text(
        "went(X) <- go(service_msgs__0__ServiceEventInfo(1, _, Client, N), [lab__0__Go_Request(X)], _)\n"
        "  seq go(service_msgs__0__ServiceEventInfo(2, _, Client, N), _, [lab__0__Go_Response(true)]).\n"
    )
    definition = parse_ros2_type("lab/srv/Go_Event", "int8 x\n---\nbool ok\n", lambda name: None)
    encoder = Definitions().encoder(definition, ROS2)
    network = MemoryNetwork(START)
    transport = MemoryTransport(network, "/server", message_format=ROS2)
    host = start_host(network, folder, ROS2)
    try:
        events: List[str] = []
        host.engine.on_event(lambda term, start, end: events.append(to_text(term)))
        publication = transport.advertise("/go/_service_event", definition, 10)
        fields: List[Dict[str, Any]] = [{"request": [{"x": 3}]}, {"response": [{"ok": True}]}]
        for event_type, contents in enumerate(fields, 1):
            info = {"event_type": event_type, "sequence_number": 5}
            publication.send(encoder.encode(make_message_term(definition, {"info": info, **contents})))
    finally:
        host.transport.shut_down()
    assert events[-1] == "went(3)"


# ---- installed types ---------------------------------------------------------------------------------


def test_bag_without_definitions_uses_types_of_folders(program: Path, tmp_path: Path) -> None:
    folder = tmp_path / "share" / "lab" / "action"
    folder.mkdir(parents=True)
    (folder / "Dock.action").write_text(DOCK)
    folders = [str(tmp_path / "share")]
    path = write_ros2_bag(tmp_path / "a.db3", make_messages(DockServer(ROS2)), None)
    with MergedBag([path], message_folders=folders) as bag:
        playback = Playback(program, raise_problem, bag=bag)
        events = record(playback.engine)
        list(playback.run(bag))
    check_events(events, ROS2)
