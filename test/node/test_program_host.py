"""A running program on a transport in memory."""

from pathlib import Path
from queue import SimpleQueue
from typing import Any, Dict, Iterator, List

import pytest
from node.in_memory_hosts import DEFINITIONS, Robot, encode, start_host
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import UsageError
from retalis.events.program.topic_configuration import ANY_QUALITY, QualityOfService
from retalis.messages.message_dictionaries import make_message_term, read_message_term
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import InstalledTypes
from retalis.node.diagnostics import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE
from retalis.node.parameters import read_adjustable_parameters
from retalis.node.text_exchange import read_text_message, serialize_text

TOPICS = """
<publish_subscribe>
  <subscribe_to name="scan" msg_type="std_msgs/String" event="scan"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """
compile_event_file('rules.txt')
subscribe(std_msgs__0__String(_), [], _, alarm, s1)
"""


@pytest.fixture
def start(network: MemoryNetwork, tmp_path: Path) -> Iterator[Any]:
    """Return a function that starts a host with rules and parameters."""
    transports: List[Any] = []

    def start(rules: str, goals: Any = GOALS, topics: Any = TOPICS, **values: Any) -> Any:
        (tmp_path / "pub_sub.xml").write_text(topics)
        (tmp_path / "goalPredicates.txt").write_text(goals)
        (tmp_path / "rules.txt").write_text(rules)
        host = start_host(network, tmp_path, **values)
        transports.append(host.transport)
        return host

    yield start
    for transport in transports:
        transport.shut_down()


ECHO = "std_msgs__0__String(X) <- scan(X).\n"


def test_output_of_rule_is_published(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start(ECHO)
    robot.publish("/scan").send(encode("fire"))
    assert robot.received["/alarm"] == ["fire"]


def test_demands_on_quality_of_service_reach_transport(network: MemoryNetwork, start: Any) -> None:
    topics = TOPICS.replace('event="scan"', 'event="scan" depth="5"').replace(
        'name="alarm"', 'name="alarm" reliability="best_effort"'
    )
    start(ECHO, topics=topics)
    assert network.qualities["/scan"] == QualityOfService(depth=5)
    assert network.qualities["/alarm"] == QualityOfService(is_reliable=False)
    assert network.qualities["/tf"] == ANY_QUALITY


def test_alarm_fires_by_time_of_transport(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start("std_msgs__0__String(silence) <- scan(X) seq absent(scan(_), 5).\n")
    robot.publish("/scan").send(encode("a"))
    network.move_time(4.9)
    assert robot.received["/alarm"] == []
    network.move_time(1.3)
    assert robot.received["/alarm"] == ["silence"]


def test_latched_message_is_processed_once(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start(ECHO)
    publication = robot.publish("/scan", is_latched=True)
    publication.send(encode("map"))
    (subscription,) = network.subscriptions["/scan"]
    network.connect(publication, subscription)
    assert robot.received["/alarm"] == ["map"]


def test_events_and_outputs_are_exchanged_as_text(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/retalisInputEvents")
    robot.subscribe("/retalisOutputEvents")
    robot.subscribe("/alarm")
    start(ECHO)
    robot.publish("/scan").send(encode("a"))
    assert robot.received["/retalisInputEvents"] == [
        "event(scan('\"a\"'),[datime(1970,1,1,0,16,40,0),datime(1970,1,1,0,16,40,0)])"
    ]
    assert robot.received["/retalisOutputEvents"] == ["event(std_msgs__0__String('\"a\"'),alarm,s1)"]
    robot.publish("/retalisInputEvents").send(serialize_text("event(scan(b))"))
    robot.publish("/retalisOutputEvents").send(serialize_text("event(std_msgs__0__String(c),alarm,x)"))
    assert robot.received["/alarm"] == ["a", "b", "c"]
    assert read_text_message(serialize_text("ä")) == "ä"


def query(network: MemoryNetwork, goal: str) -> str:
    """Return the result of a goal, or the text of its value ``X``."""
    answer = network.call(
        "/retalis/query",
        goal=goal,
        max_solutions=1,
        seconds=0.0,
        inferences=0,
        wait_for=[],
        stamp=0,
        timeout=0.0,
    )
    solutions = answer.get("solutions")
    return str(solutions[0]["bindings"][0]["text"] if solutions else answer["result"])


def test_limits_change_while_program_runs(network: MemoryNetwork, start: Any) -> None:
    host = start("", max_inferences=0)
    goal = "between(1, 9000, X), X >= 9000"
    assert query(network, goal) == "9000"
    host.change_parameters(
        host.parameters.adjust(read_adjustable_parameters({"diagnostics": 0, "max_inferences": 5000}))
    )
    assert "inferences" in query(network, goal)
    host.change_parameters(host.parameters)
    assert query(network, goal) == "9000"


def test_flag_follows_changed_parameter_only(network: MemoryNetwork, start: Any) -> None:
    host = start("", goals="set_etalis_flag(max_watermark_delay, 3)\n", max_gap=2)
    changed = host.parameters.adjust(read_adjustable_parameters({"diagnostics": 0, "max_gap": 5}))
    host.change_parameters(changed)
    assert query(network, "get_etalis_flag(max_gap, X)") == "5.0"
    assert query(network, "get_etalis_flag(max_watermark_delay, X)") == "3"
    host.change_parameters(host.parameters.adjust(read_adjustable_parameters({"diagnostics": 0})))
    assert query(network, "get_etalis_flag(max_gap, X)") == "-1"


def test_stamps_are_checked_by_changed_limit(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    topics = TOPICS.replace('"std_msgs/String" event="scan"', '"geometry_msgs/PointStamped" event="scan"')
    host = start("std_msgs__0__String(far) <- scan(_, _).\n", topics=topics)
    host.change_parameters(
        host.parameters.adjust(read_adjustable_parameters({"diagnostics": 0, "max_skew": 1}))
    )
    point = DEFINITIONS.find("geometry_msgs/PointStamped")
    publication = robot.transport.advertise("/scan", point, 10)

    def send(seconds: int) -> None:
        term = make_message_term(point, {"header": {"stamp": seconds * 10**9}})
        publication.send(DEFINITIONS.encoder(point).encode(term))

    send(1000)
    send(2000)
    assert robot.received["/alarm"] == ["far"]
    host.change_parameters(host.parameters)
    send(3000)
    assert robot.received["/alarm"] == ["far", "far"]


@pytest.mark.parametrize("failing", ["engine", "diagnostics"])
def test_failed_change_of_parameters_changes_nothing(
    network: MemoryNetwork, start: Any, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    topics = TOPICS.replace('"std_msgs/String" event="scan"', '"geometry_msgs/PointStamped" event="scan"')
    host = start("std_msgs__0__String(far) <- scan(_, _).\n", topics=topics, max_inferences=0)

    def fail(*arguments: Any) -> None:
        raise UsageError("not now")

    if failing == "engine":
        monkeypatch.setattr(host.engine, "change_settings", fail)
    else:
        monkeypatch.setattr(host.transport, "advertise", fail)
        # The type of diagnostics must not depend on the installation of ROS.
        monkeypatch.setattr(host.transport, "installed_types", lambda include_rosbags: InstalledTypes())
    values = {"diagnostics": 60, "max_skew": 1, "max_inferences": 5000}
    with pytest.raises(UsageError, match="not now"):
        host.change_parameters(host.parameters.adjust(read_adjustable_parameters(values)))
    monkeypatch.undo()
    assert query(network, "between(1, 9000, X), X >= 9000") == "9000"
    point = DEFINITIONS.find("geometry_msgs/PointStamped")
    publication = robot.transport.advertise("/scan", point, 10)
    for seconds in (1000, 2000):
        term = make_message_term(point, {"header": {"stamp": seconds * 10**9}})
        publication.send(DEFINITIONS.encoder(point).encode(term))
    assert robot.received["/alarm"] == ["far", "far"]


TWO_TOPICS = TOPICS.replace(
    "<publish_to",
    '<subscribe_to name="place" msg_type="geometry_msgs/PointStamped" event="place"/><publish_to',
)


@pytest.mark.parametrize("message_format", list(SerializationFormat))
def test_lag_is_reported_for_messages_with_stamp_only(
    network: MemoryNetwork, start: Any, monkeypatch: pytest.MonkeyPatch, message_format: SerializationFormat
) -> None:
    # The type of diagnostics must not depend on the installation of ROS.
    monkeypatch.setattr(MemoryTransport, "installed_types", lambda *arguments, **options: InstalledTypes())
    messages: SimpleQueue[bytes] = SimpleQueue()

    class Listener:
        def receive(self, batch: List[bytes]) -> None:
            for message in batch:
                messages.put(message)

        def close(self, is_incomplete: bool) -> None:
            """Do nothing."""

    peer = MemoryTransport(network, "/peer", message_format=message_format)
    peer.subscribe(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, lambda source: Listener(), 10)
    rules = "std_msgs__0__String(lost) <- (scan(_) or place(_, _)) seq absent((scan(_) or place(_, _)), 5).\n"
    start(rules, topics=TWO_TOPICS, diagnostics=0.001, message_format=message_format)
    for topic, message_type, values in (
        ("/scan", "std_msgs/String", {"data": "a"}),
        ("/place", "geometry_msgs/PointStamped", {"header": {"stamp": network.now - 10**9}}),
    ):
        definition = DEFINITIONS.find(message_type)
        encoder = DEFINITIONS.encoder(definition, message_format)
        peer.advertise(topic, definition, 10)
        (receiver,) = network.subscriptions[topic][0].receivers.values()
        receiver.receive([encoder.encode(make_message_term(definition, values))], [network.now - 1000])
    decode_health = DEFINITIONS.decoder(DIAGNOSTICS_TYPE, message_format).decode
    lags: Dict[str, str] = {}
    while "lag of place/2 (s)" not in lags:
        health = read_message_term(
            DEFINITIONS.find(DIAGNOSTICS_TYPE), decode_health(messages.get(timeout=60))
        )
        for status in health["status"]:
            lags.update(
                {each["key"]: each["value"] for each in status["values"] if each["key"].startswith("lag of")}
            )
    assert lags == {"lag of place/2 (s)": "1.000"}


def test_state_is_restored_from_checkpoint(network: MemoryNetwork, start: Any, tmp_path: Path) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    rules = "std_msgs__0__String(pair) <- scan(_) seq scan(_).\n"
    checkpoint = str(tmp_path / "state.db")
    host = start(rules, checkpoint=checkpoint)
    publication = robot.publish("/scan")
    publication.send(encode("a"))
    host.transport.shut_down()
    network.subscriptions["/scan"].clear()
    publication.close()
    resumed_host = start(rules, checkpoint=checkpoint)
    network.move_time(1)
    robot.publish("/scan").send(encode("b"))
    # The thread that runs missed alarms may have been at work, and processes the event then.
    resumed_host.engine.do(lambda: None)
    assert robot.received["/alarm"] == ["pair"]


def test_message_that_checkpoint_contains_is_ignored(
    network: MemoryNetwork, start: Any, tmp_path: Path
) -> None:
    """The middleware delivers the last messages of a publisher to the subscription of the restarted node."""
    robot = Robot(network)
    robot.subscribe("/alarm")
    checkpoint = str(tmp_path / "state.db")
    host = start(ECHO, checkpoint=checkpoint)
    publication = robot.publish("/scan")
    (receiver,) = network.subscriptions["/scan"][0].receivers.values()
    receiver.receive([encode("a"), encode("b")], [], [(5, 1), (5, 2)])
    host.transport.shut_down()
    network.subscriptions["/scan"].clear()
    publication.close()
    resumed_host = start(ECHO, checkpoint=checkpoint)
    robot.publish("/scan")
    (receiver,) = network.subscriptions["/scan"][0].receivers.values()
    # The last one has equal contents, and was sent later.
    receiver.receive([encode("a"), encode("b"), encode("b")], [], [(5, 1), (5, 2), (6, 3)])
    resumed_host.engine.do(lambda: None)
    assert robot.received["/alarm"] == ["a", "b", "b"]


def test_ros_parameters_are_read_at_start_and_by_reload(network: MemoryNetwork, start: Any) -> None:
    network.ros_parameters["/limit"] = 40
    host = start(ECHO)
    network.ros_parameters["/limit"] = 50
    assert host.engine.query("ros_param('/limit', L)") == [{"L": 40}]
    assert network.call("/retalis/reload")["result"] == "ok"
    assert host.engine.query("ros_param('/limit', L)") == [{"L": 50}]
