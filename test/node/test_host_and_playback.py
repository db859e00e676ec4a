"""Program host and playback: equal results on a network in memory and on a bag of the same messages."""

import time
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import BagReader, BagWriter, Definitions, Playback, Reports
from retalis.messages.message_dictionaries import make_message_term
from retalis.node.parameters import read_parameters
from retalis.node.program_host import ProgramHost
from retalis.node.program_host_context import HostContext
from retalis.node.text_exchange import PlainTextExchange
from retalis.prolog.syntax.event_text import to_text

SECOND = 10**9
START = 1_000 * SECOND
HEADER = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
RULE = "=" * 80 + "\n"
TYPES = {
    "lab/Heat": f"Header header\nfloat64 degrees\n{RULE}{HEADER}",
    "lab/Door": "bool open\n",
    "tf2_msgs/TFMessage": (
        f"geometry_msgs/TransformStamped[] transforms\n{RULE}"
        f"MSG: geometry_msgs/TransformStamped\nHeader header\nstring child_frame_id\nTransform transform\n{RULE}"
        f"{HEADER}{RULE}"
        f"MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n{RULE}"
        f"MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{RULE}"
        "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    ),
}
TOPICS = """
<publish_subscribe>
  <subscribe_to name="heat" msg_type="lab/Heat" event="heat"/>
  <subscribe_to name="/word" msg_type="std_msgs/String" event="word"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
  <publish_to name="gate" msg_type="lab/Door"/>
</publish_subscribe>
"""
GOALS = """
compile_event_file('rules.txt')
subscribe_to(door, 'lab/Door', door)
subscribe(std_msgs__0__String(_), [], _, alarm, s1)
subscribe(lab__0__Door(_), [], _, '/gate', s2)
subscribe(silence, [], _, untyped, s3)
"""
RULES = """
std_msgs__0__String(X) <- word(X).
std_msgs__0__String(hotter) <- heat(_, X) seq heat(_, Y) where Y > X.
lab__0__Door(X) <- door(X).
lab__0__Door(wrong) <- word('"b"').
silence <- word(_) seq absent(word(_), 5).
std_msgs__0__String(X) <- word('"where"') where (
    tf_lookup(map, camera, 0, P), format(atom(X), '~w', [P])
).
"""


@pytest.fixture(scope="module")
def definitions() -> Definitions:
    definitions = Definitions()
    for name, text in TYPES.items():
        definitions.add(name, text)
    return definitions


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "pub_sub.xml").write_text(TOPICS)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text(RULES)
    return tmp_path


def messages(definitions: Any) -> List[Tuple[Any, ...]]:
    """Return time, topic, type and bytes of each message."""

    def serialize(message_type: str, **fields: Any) -> bytes:
        definition = definitions.find(message_type)
        return definitions.encoder(definition).encode(make_message_term(definition, fields))

    def heat(second: int, degrees: float) -> bytes:
        header = {"stamp": START + second * SECOND, "frame_id": "oven"}
        return serialize("lab/Heat", header=header, degrees=degrees)

    transform = {
        "header": {"stamp": START, "frame_id": "map"},
        "child_frame_id": "camera",
        "transform": {"translation": {"x": 1.5}, "rotation": {"w": 1.0}},
    }
    rows = [
        (1, "/tf", "tf2_msgs/TFMessage", serialize("tf2_msgs/TFMessage", transforms=[transform])),
        (2, "/word", "std_msgs/String", serialize("std_msgs/String", data="a")),
        (3, "/heat", "lab/Heat", heat(3, 20.0)),
        # A damaged message and one of another type: one error and one warning.
        (4, "/heat", "lab/Heat", b"\0\0"),
        (5, "/heat", "std_msgs/String", serialize("std_msgs/String", data="hot")),
        (6, "/heat", "lab/Heat", heat(6, 30.0)),
        (7, "/door", "lab/Door", serialize("lab/Door", open=True)),
        (8, "/word", "std_msgs/String", serialize("std_msgs/String", data="where")),
        (9, "/word", "std_msgs/String", serialize("std_msgs/String", data="b")),
        (16, "/door", "lab/Door", serialize("lab/Door", open=False)),
    ]
    return [(START + second * SECOND, *row) for second, *row in rows]


def record_events(engine: Any) -> Any:
    """Return the list to which the events of an engine are added, with their times."""
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append((to_text(term), start, end)))
    return events


def run_on_network(program: Any, definitions: Any) -> Tuple[Any, ...]:
    """Return events, outputs as messages, and the number of errors of a node."""
    network = MemoryNetwork(START)
    robot = MemoryTransport(network, "/robot")
    transport = MemoryTransport(network, parameters={"program": str(program), "diagnostics": 0})
    reports = Reports()
    context = HostContext(transport, read_parameters(transport.parameters(), lambda: program), reports)
    host = ProgramHost(context, PlainTextExchange(context))
    try:
        events = record_events(host.engine)
        # A node subscribes to transforms in a thread.
        while "/tf_static" not in network.subscriptions:
            time.sleep(0.001)
        publications: Dict[Any, Any] = {}
        for instant, topic, message_type, data in messages(definitions):
            network.move_time((instant - network.now) / SECOND)
            key = topic, message_type
            if key not in publications:
                publications[key] = robot.advertise(topic, definitions.find(message_type), 10)
            publications[key].send(data)
        outputs = {
            topic: [data for publication in network.publications[topic] for data in publication.messages]
            for topic in ("/alarm", "/gate")
        }
    finally:
        transport.shut_down()
    return events, outputs, reports.errors


def run_on_bag(program: Any, definitions: Any, folder: Path, rows: Any) -> Tuple[Any, ...]:
    """Return events, outputs, outputs on a topic without a type, and errors of the playback of a bag."""
    path = folder / "recorded.bag"
    with BagWriter(path) as writer:
        connections: Dict[Any, Any] = {}
        for instant, topic, message_type, data in rows:
            key = topic, message_type
            if key not in connections:
                connections[key] = writer.add(topic, definitions.find(message_type))
            writer.write(connections[key], instant, data)
    errors: List[Any] = []
    with BagReader(path) as bag:
        playback = Playback(program, errors.append, bag=bag)
        events = record_events(playback.engine)
        outputs: Dict[Any, Any] = {"/alarm": [], "/gate": []}
        untyped: List[Any] = []
        for output in playback.run(bag):
            if output.topic == "untyped":
                untyped.append(to_text(output.term))
            elif output.data is not None:
                outputs[f"/{output.topic.strip('/')}"].append(output.data)
    return events, outputs, untyped, errors


def test_network_and_bag_have_equal_results(
    program: Path, definitions: Definitions, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    events, outputs, error_count = run_on_network(program, definitions)
    network_texts = [record.getMessage() for record in caplog.records]
    caplog.clear()
    bag_events, bag_outputs, untyped, bag_errors = run_on_bag(
        program, definitions, tmp_path, messages(definitions)
    )
    bag_texts = [record.getMessage() for record in caplog.records]
    assert bag_events == events
    assert bag_outputs == outputs
    texts = [text for text, _, _ in events]
    for text in ("word('\"a\"')", "door(true)", "silence", "hotter", "where"):
        assert any(text in event for event in texts), text
    assert [len(outputs[topic]) for topic in ("/alarm", "/gate")] == [5, 2]
    assert untyped == ["silence"] * 2
    dropped = [text for text in network_texts if text.startswith("a message on /heat is dropped")]
    assert len(dropped) == 1
    assert set(dropped) <= set(bag_texts)
    assert error_count == 2
    assert [str(error) for error in bag_errors] == [
        "topic /heat: expected lab/Heat, found std_msgs/String; 1 message dropped"
    ]


def test_bag_has_transforms_for_later_goal(program: Path, definitions: Definitions, tmp_path: Path) -> None:
    # The rules do not show that the program reads transforms, so that the first goal starts to read them.
    goal = "atom_concat(tf_, lookup, N), G =.. [N, map, camera, 0, [[X|_]|_]], call(G)"
    (program / "rules.txt").write_text(f"located(X) <- word(_) where ({goal}).\n")
    transform, word, *rows = messages(definitions)
    instant, *fields = transform
    rows = [word, (instant + 2 * SECOND, *fields), *rows]
    events, _, _, _ = run_on_bag(program, definitions, tmp_path, rows)
    located = [(text, end) for text, _, end in events if text.startswith("located")]
    assert located == [("located(1.5)", START + 8 * SECOND), ("located(1.5)", START + 9 * SECOND)]
