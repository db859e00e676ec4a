"""A running program on a transport in memory."""

from pathlib import Path
from typing import Any, Iterator, List

import pytest
from node.hosts import DEFINITIONS, Robot, encode, start_host
from node.memory_transport import MemoryNetwork

from retalis.events.program.topic_configuration import ANY_QUALITY, QualityOfService
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


def test_message_of_wrong_type_is_counted(network: MemoryNetwork, start: Any) -> None:
    start(ECHO)
    number = DEFINITIONS.find("std_msgs/Int32")
    Robot(network).transport.advertise("/scan", number, 10).send(b"\0\0\0\0")
    (scan,) = (
        status for status in network.call("/retalis/list", most=0)["inputs"] if status["topic"] == "/scan"
    )
    assert (scan["messages"], scan["refused"]) == (1, 1)


def test_damaged_message_does_not_stop_next_one(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    host = start(ECHO)
    robot.publish("/scan").send(b"\x09", encode("b"))
    assert robot.received["/alarm"] == ["b"]
    assert host.reports.errors == 1


def test_latched_message_is_processed_once(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start(ECHO)
    publication = robot.publish("/scan", is_latched=True)
    publication.send(encode("map"))
    (subscription,) = network.subscriptions["/scan"]
    network.connect(publication, subscription)
    assert robot.received["/alarm"] == ["map"]


def test_services_change_program(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start("", topics=TOPICS.replace('name="scan"', 'name="other"'))
    assert network.call("/add_input_subscription", topic="scan", message_type="std_msgs/String") == {
        "result": "ok"
    }
    added = network.call(
        "/retalis/add_rule", rule="std_msgs__0__String(louder) <- std_msgs__0__String('\"soft\"')", label=""
    )
    assert added["result"] == "ok"
    robot.publish("/scan").send(encode("soft"))
    assert "louder" in robot.received["/alarm"]
    assert network.call("/retalis/delete_rule", label=added["label"]) == {"result": "ok"}


def test_query_answers_with_bindings(network: MemoryNetwork, start: Any) -> None:
    start("", goals="assert(door(open))\n")
    answer = network.call(
        "/retalis/query",
        goal="door(X)",
        max_solutions=0,
        seconds=0.0,
        inferences=0,
        wait_for=[],
        stamp=0,
        timeout=0.0,
    )
    assert answer["solutions"] == [{"bindings": [{"name": "X", "text": "open", "json": '"open"'}]}]


def test_topic_of_goal_is_subscribed(network: MemoryNetwork, start: Any) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    start("std_msgs__0__String(X) <- said(X).\n", GOALS + "subscribe_to(speech, 'std_msgs/String', said)\n")
    robot.publish("/speech").send(encode("hello"))
    assert robot.received["/alarm"] == ["hello"]


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
