"""Forwarding of a node's outputs: selected topics, times, diagnostics."""

import logging
import re
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Dict, List

import pytest
from node.in_memory_hosts import DEFINITIONS, Robot, encode, start_host
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import UsageError
from retalis.engine.checkpoints import Checkpointer
from retalis.fleet.robot_engine import FleetProgram, RobotEngine
from retalis.fleet.robot_events import RobotEvent
from retalis.forwarding.disk_queue import DiskQueue
from retalis.forwarding.event_forwarder import ForwardingStatus
from retalis.messages.message_dictionaries import read_message_term
from retalis.messages.type_registry import InstalledTypes
from retalis.node.diagnostics import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, CounterTrends, Level
from retalis.node.output_forwarding import describe_forwarding, evaluate_forwarding

pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt")

FILES = {
    "pub_sub.xml": """
<publish_subscribe>
  <subscribe_to name="scan" msg_type="std_msgs/String" event="scan"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
""",
    "goalPredicates.txt": """
compile_event_file('rules.txt')
subscribe(std_msgs__0__String(_), [], _, alarm, s1)
subscribe(fire(_, _), [], _, fleet, s2)
subscribe(fire(_, _), [], _, other, s3)
""",
    "rules.txt": """
std_msgs__0__String(X) <- scan(X).
fire(X, Y) <- scan(X) seq scan(Y).
""",
}

UNREACHABLE = "mqtt://127.0.0.1:9"
"""Address without a broker; the port is reserved for another service."""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def parameters(program: Path, *topics: str) -> Dict[str, Any]:
    return {
        "forward": UNREACHABLE,
        "forward_robot": "r07",
        "forward_queue": str(program / "queue.db"),
        "forward_topics": list(topics),
    }


def queued(program: Path) -> List[Any]:
    """Return the events of the queue: intervals in seconds, and texts."""
    queue = DiskQueue(program / "queue.db", 1_000_000)
    events = [event for _, _, event in queue.take(100, 1_000_000)]
    queue.close()
    return [(event.start, event.end, event.text) for event in events]


def test_outputs_of_selected_topics_are_queued(network: MemoryNetwork, program: Path) -> None:
    robot = Robot(network)
    publisher = robot.publish("/scan")
    host = start_host(network, program, **parameters(program, "/al*", "fleet"))
    publisher.send(encode("a"))
    network.move_time(2)
    publisher.send(encode("b"))
    host.transport.shut_down()
    assert queued(program) == [
        (1000.0, 1000.0, "std_msgs__0__String('\"a\"')"),
        (1002.0, 1002.0, "std_msgs__0__String('\"b\"')"),
        (1000.0, 1002.0, "fire('\"a\"','\"b\"')"),
    ]


def test_outputs_of_last_checkpoint_are_queued(
    network: MemoryNetwork, program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = Robot(network).publish("/scan")
    stop = Checkpointer.stop

    def stop_after_event(checkpointer: Checkpointer) -> None:
        publisher.send(encode("a"))
        stop(checkpointer)

    monkeypatch.setattr(Checkpointer, "stop", stop_after_event)
    checkpoint = str(program / "state.db")
    host = start_host(network, program, checkpoint=checkpoint, **parameters(program, "alarm"))
    host.transport.shut_down()
    assert [text for _, _, text in queued(program)] == ["std_msgs__0__String('\"a\"')"]


def test_fleet_reads_forwarded_numbers(network: MemoryNetwork, program: Path) -> None:
    (program / "rules.txt").write_text("fire(X, Y) <- scan(_) where (X is inf, Y is -inf).\n")
    publisher = Robot(network).publish("/scan")
    host = start_host(network, program, **parameters(program, "fleet"))
    publisher.send(encode("a"))
    host.transport.shut_down()
    ((_, _, text),) = queued(program)
    (program / "rules.txt").write_text("fire(number, X) <- fire(X, _) where number(X).\n")
    robot = RobotEngine(FleetProgram(program))
    outputs = robot.process(RobotEvent("r07", 1, text)).outputs
    assert [output.text for output in outputs if output.topic == "fleet"] == [text, "fire(number,1.0Inf)"]


def test_forwarded_topic_needs_no_type(
    network: MemoryNetwork, program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "retalis")
    rule = "add(X) <- scan(X) where (subscribe(_, [], _, new, s4), subscribe(_, [], _, newer, s5)).\n"
    (program / "rules.txt").write_text(FILES["rules.txt"] + rule)
    publisher = Robot(network).publish("/scan")
    host = start_host(network, program, **parameters(program, "/fleet", "/n*w"))
    publisher.send(encode("a"))
    host.transport.shut_down()
    messages = [record.getMessage() for record in caplog.records if " has no type" in record.getMessage()]
    # Warnings of the program when it is loaded and of the output, and a message that it exists as text.
    topics = [message.partition(" has no type")[0].split()[-1] for message in messages]
    assert sorted(topics) == ["newer", "newer", "newer", "other"]


def test_topic_without_subscription_is_warned_of(
    network: MemoryNetwork, program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    host = start_host(network, program, **parameters(program, "fleet", "flet", "/al*"))
    host.transport.shut_down()
    messages = [record.getMessage() for record in caplog.records if "forward_topics" in record.getMessage()]
    assert messages == [
        "parameter ~forward_topics: no subscription has the topic flet; did you mean fleet?",
    ]


class Listener:
    """Receiver of the messages on ``/diagnostics``."""

    def __init__(self, network: MemoryNetwork) -> None:
        self._messages: SimpleQueue[bytes] = SimpleQueue()
        peer = MemoryTransport(network, "/listener")
        peer.subscribe(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, lambda source: self, 10)

    def receive(self, messages: List[bytes]) -> None:
        for data in messages:
            self._messages.put(data)

    def close(self, is_incomplete: bool) -> None:
        pass

    def wait_for(self, name: str) -> Any:
        """Return the status of a part in the next message."""
        term = DEFINITIONS.decoder(DIAGNOSTICS_TYPE).decode(self._messages.get(timeout=60))
        message = read_message_term(DEFINITIONS.find(DIAGNOSTICS_TYPE), term)
        (status,) = [status for status in message["status"] if status["name"] == name]
        return status


def test_diagnostics_have_state_of_forwarding(
    network: MemoryNetwork, program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The type of diagnostics must not depend on the installation of ROS.
    monkeypatch.setattr(MemoryTransport, "installed_types", lambda *arguments, **options: InstalledTypes())
    listener = Listener(network)
    host = start_host(network, program, diagnostics=0.01, **parameters(program, "fleet"))
    status = listener.wait_for("retalis: forwarding")
    host.transport.shut_down()
    # The reason follows when the first attempt has failed.
    assert (status["level"], status["message"][:13]) == (Level.WARN, "not connected")
    assert status["values"][0] == {"key": "broker", "value": UNREACHABLE}


def test_node_does_not_start_with_queue_of_other_node(network: MemoryNetwork, program: Path) -> None:
    (program / "queue.db").mkdir()
    with pytest.raises(UsageError, match="expected a file that can be read and written"):
        start_host(network, program, **parameters(program, "fleet"))


STATUS = ForwardingStatus(
    broker="mqtt://fleet:1883",
    is_connected=True,
    state_seconds=75.2,
    problem="",
    storage_problem="",
    queued=3,
    used_bytes=2_000_000,
    max_bytes=100_000_000,
    confirmed=10,
    repeated=0,
    dropped=0,
    unstored=0,
    oversized=0,
    connections=1,
    damaged_files=0,
)


@pytest.mark.parametrize(
    ("changes", "level", "message"),
    [
        ({}, Level.OK, "0.0 events/s; 3 events queued"),
        (
            {"is_connected": False, "problem": "refused"},
            Level.WARN,
            "not connected: refused; 3 events queued",
        ),
        ({"used_bytes": 50_000_000}, Level.WARN, "the queue is half full: 3 events queued"),
        ({"dropped": 5}, Level.ERROR, "events are lost: the queue is full; 3 events queued"),
        (
            {"unstored": 5, "storage_problem": "disk full"},
            Level.ERROR,
            "events are lost: disk full; 3 events queued",
        ),
        ({"oversized": 1}, Level.ERROR, "events are lost: see the log; 3 events queued"),
        ({"damaged_files": 1}, Level.ERROR, "events are lost: see the log; 3 events queued"),
    ],
)
def test_level_of_forwarding(changes: Any, level: Level, message: str) -> None:
    health = evaluate_forwarding(7.0, CounterTrends(), STATUS._replace(**changes))
    assert (health.level, health.message) == (level, message)


@pytest.mark.parametrize(
    ("changes", "state"),
    [
        ({}, "connected to mqtt://fleet:1883 for 1 min 15 s"),
        (
            {"is_connected": False, "problem": "refused", "state_seconds": 0.7},
            "not connected to mqtt://fleet:1883 (refused) for 1 s",
        ),
    ],
)
def test_description_has_state_and_counters(changes: Any, state: str) -> None:
    status = STATUS._replace(dropped=2, oversized=1, **changes)
    counters = "3 events queued (2.0 of 100 MB), 10 forwarded, 3 lost"
    assert describe_forwarding(status) == f"{state}, {counters}"


def test_description_has_storage_problem() -> None:
    text = describe_forwarding(STATUS._replace(unstored=2, storage_problem="disk full"))
    assert text.endswith(", 2 lost; events cannot be stored: disk full")


def test_list_has_state_of_forwarding(network: MemoryNetwork, program: Path) -> None:
    host = start_host(network, program, **parameters(program, "fleet"))
    state = network.call("/retalis/list", most=0)["forwarding"]
    host.transport.shut_down()
    assert re.fullmatch(
        rf"not connected to {UNREACHABLE}( \(.*\))? for \d+ s, 0 events queued \(0\.0 of \d+ MB\), "
        r"0 forwarded, 0 lost",
        state,
    )


def test_loss_is_an_error_for_some_seconds() -> None:
    trends, status = CounterTrends(), STATUS._replace(dropped=5)
    levels = [evaluate_forwarding(now, trends, status).level for now in (7.0, 16.0, 18.0)]
    assert levels == [Level.ERROR, Level.ERROR, Level.OK]


def test_topic_without_subscription_is_in_status() -> None:
    health = evaluate_forwarding(7.0, CounterTrends(), STATUS, ["flet", "/arm/*"])
    expected = (Level.WARN, "no subscription has the topic flet, /arm/*; 3 events queued")
    assert (health.level, health.message) == expected
