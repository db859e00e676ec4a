"""Diagnostics: the health of the parts of a node, and its publication."""

import threading
from typing import Any, Dict, Iterator, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import Definitions, Engine, MessageError, Reports, StreamClock, Work
from retalis.messages.message_dictionaries import read_message_term
from retalis.messages.type_registry import InstalledTypes
from retalis.node.diagnostics import (
    DIAGNOSTICS_TOPIC,
    DIAGNOSTICS_TYPE,
    MAX_REPORTED_TOPICS,
    MAX_STATUS_VALUES,
    RECENT_SECONDS,
    STALE_AFTER_SECONDS,
    CounterTrends,
    Diagnostics,
    EngineHealth,
    Health,
    InputHealth,
    InputRole,
    Level,
    NodeHealth,
    evaluate_memory,
    evaluate_output,
    evaluate_program,
)
from retalis.node.topic_statistics import InputCounts, InputStatus, OutputStatus

DEFINITIONS = Definitions()
DEFINITION = DEFINITIONS.find(DIAGNOSTICS_TYPE)
HEALTH = NodeHealth(list, list, lambda: [Health("queue", Level.WARN, "two\nlines", [("a", "\x1b[31m")])])


class Listener:
    """Receiver of messages on ``/diagnostics``.

    Args:
        network: network of the node.

    Attributes:
        messages: the received messages.
    """

    def __init__(self, network: MemoryNetwork) -> None:
        self.messages: List[Any] = []
        self._received = threading.Event()
        transport = MemoryTransport(network, "/listener")
        transport.subscribe(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, lambda source: self, 10)

    def receive(self, messages: Any) -> None:
        decode = DEFINITIONS.decoder(DEFINITION).decode
        self.messages += [read_message_term(DEFINITION, decode(data)) for data in messages]
        self._received.set()

    def close(self, is_incomplete: Any) -> None:
        pass

    def wait(self) -> Any:
        """Return the first message."""
        assert self._received.wait(60)
        return self.messages[0]

    def wait_for(self, hardware_id: str) -> None:
        """Wait for a message with a hardware id."""
        while hardware_id not in str(self.messages[-1]):
            self._received.clear()
            assert self._received.wait(60)


@pytest.fixture
def network() -> Any:
    return MemoryNetwork(now=1_000_000_002)


@pytest.fixture
def transport(network: MemoryNetwork, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return a transport with the type of diagnostics, which does not depend on the installation of ROS."""
    transport = MemoryTransport(network, "/ns/retalis")
    monkeypatch.setattr(transport, "installed_types", lambda include_rosbags=True: InstalledTypes())
    yield transport
    transport.shut_down()


@pytest.fixture
def listener(network: MemoryNetwork) -> Listener:
    return Listener(network)


def test_each_part_is_a_status_of_node(transport: Any, listener: Listener) -> None:
    Diagnostics(transport, 0.001, HEALTH, Reports(), "robot7")
    message = listener.wait()
    assert message["header"]["stamp"] == 1_000_000_002
    status = message["status"][0]
    assert (status["name"], status["level"], status["message"]) == ("ns/retalis: queue", 1, "two lines")
    assert status["values"] == [{"key": "a", "value": "\\x1b[31m"}]
    assert [status["name"] for status in message["status"]] == [
        "ns/retalis: queue",
        "ns/retalis: process memory",
    ]
    assert {status["hardware_id"] for status in message["status"]} == {"robot7"}


def test_nothing_is_published_without_period(network: MemoryNetwork, transport: Any) -> None:
    Diagnostics(transport, None, HEALTH, Reports())
    assert network.publications == {}


def test_period_and_hardware_id_change(transport: Any, listener: Listener) -> None:
    diagnostics = Diagnostics(transport, None, HEALTH, Reports())
    diagnostics.set_options(0.001, "robot8")
    assert {status["hardware_id"] for status in listener.wait()["status"]} == {"robot8"}
    diagnostics.set_options(0.002, "robot9")
    listener.wait_for("robot9")


def test_publishing_starts_after_failed_attempt(transport: Any, listener: Listener) -> None:
    diagnostics = Diagnostics(transport, None, HEALTH, Reports(), "robot7")
    advertise, transport.advertise = transport.advertise, refuse_topic
    with pytest.raises(MessageError):
        diagnostics.set_options(0.001, "robot8")
    transport.advertise = advertise
    diagnostics.set_options(0.001, "robot9")
    assert {status["hardware_id"] for status in listener.wait()["status"]} == {"robot9"}


def refuse_topic(*arguments: Any) -> Any:
    raise MessageError("topic /diagnostics: it exists with another type")


def test_missing_package_is_warned_of_once(
    network: MemoryNetwork, transport: Any, caplog: pytest.LogCaptureFixture
) -> None:
    transport.installed_types = lambda include_rosbags=True: InstalledTypes([], include_rosbags=False)
    Diagnostics(transport, 1.0, HEALTH, Reports())
    warnings = [record.getMessage() for record in caplog.records]
    assert warnings == ["/diagnostics is not published: the package diagnostic_msgs is not installed"]
    assert network.publications == {}


def test_error_of_evaluation_does_not_end_publishing(transport: Any, listener: Listener) -> None:
    evaluations, reports = [], Reports()

    def evaluate() -> List[Any]:
        evaluations.append(1)
        if len(evaluations) == 1:
            raise RuntimeError("changed size during iteration")
        return []

    Diagnostics(transport, 0.001, NodeHealth(list, list, evaluate), reports)
    assert listener.wait()["status"]
    assert reports.errors == 1


TOPIC = InputStatus(
    topic="/tf",
    type="tf/tfMessage",
    publishers=1,
    messages=0,
    dropped=0,
    refused=0,
    missing=0,
    age=None,
    lag=None,
)


def engine_health(engine: Engine, now: float = 0.0, health: Any = None, **changed: Any) -> Dict[Any, Any]:
    parts = (health or EngineHealth(1.0, 10.0)).evaluate(now, engine.status()._replace(**changed))
    return {part.name: part for part in parts}


def test_topic_has_rate() -> None:
    trends = CounterTrends()
    health = InputHealth(trends)
    for now, message_count in ((0.0, 0), (1.0, 50), (2.0, 150)):
        part = health.evaluate(now, TOPIC._replace(messages=message_count, age=0.0, lag=250_000_000))
        trends.remove_unrecorded()
    assert (part.name, part.level, part.message) == ("input /tf", Level.OK, "100.0 messages/s")
    assert dict(part.values)["lag (s)"] == "0.250"


def test_topic_without_publisher_is_a_warning() -> None:
    health = InputHealth(CounterTrends())
    assert health.evaluate(0.0, TOPIC._replace(publishers=0)).level is Level.WARN
    assert health.evaluate(1.0, TOPIC).level is Level.OK


@pytest.mark.parametrize(
    ("interval", "pause", "level"), [(0.1, 6, Level.STALE), (0.1, 4, Level.OK), (60, 300, Level.OK)]
)
def test_topic_is_stale_after_multiple_of_interval(interval: float, pause: int, level: Any) -> None:
    health = InputHealth(CounterTrends())
    for number in range(1, 20):
        health.evaluate(number * interval, TOPIC._replace(messages=number, age=0.0))
    last = TOPIC._replace(messages=19, age=float(pause))
    assert health.evaluate(19 * interval + pause, last).level is level


@pytest.mark.parametrize(
    ("role", "silent", "unpublished", "lost"),
    [
        (InputRole.NEEDED, Level.STALE, Level.WARN, Level.ERROR),
        (InputRole.LINK, Level.OK, Level.WARN, Level.ERROR),
        (InputRole.OPTIONAL, Level.OK, Level.OK, Level.ERROR),
        (InputRole.UNREAD, Level.OK, Level.OK, Level.OK),
    ],
)
def test_level_of_topic_depends_on_role(role: Any, silent: Any, unpublished: Any, lost: Any) -> None:
    health = InputHealth(CounterTrends(), lambda topic: role)
    for number in range(1, 20):
        health.evaluate(number * 0.1, TOPIC._replace(messages=number, age=0.0))
    status = TOPIC._replace(messages=19, age=30.0)
    assert health.evaluate(32.0, status).level is silent
    assert health.evaluate(33.0, status._replace(publishers=0)).level is unpublished
    assert health.evaluate(34.0, status._replace(refused=1)).level is lost


def test_latched_topic_is_never_stale() -> None:
    health = InputHealth(CounterTrends())
    assert STALE_AFTER_SECONDS < 1000
    for now in range(0, 1100, 100):
        assert health.evaluate(now, TOPIC._replace(messages=1, age=float(now))).level is Level.OK


def test_restarted_topic_has_new_interval() -> None:
    health = InputHealth(CounterTrends())
    for number in range(100, 110):
        health.evaluate(float(number), TOPIC._replace(messages=number, age=0.0))
    for number in range(1, 20):
        health.evaluate(200.0 + number, TOPIC._replace(messages=number, age=0.0))
    assert health.evaluate(300.0, TOPIC._replace(messages=19, age=81.0)).level is Level.STALE


def test_removed_topic_has_no_interval() -> None:
    health = InputHealth(CounterTrends())
    for number in range(1, 20):
        health.evaluate(float(number), TOPIC._replace(messages=number, age=0.0))
    late = TOPIC._replace(messages=19, age=81.0)
    health.retain_topics({"/tf"})
    assert health.evaluate(100.0, late).level is Level.STALE
    health.retain_topics({"/other"})
    assert health.evaluate(100.0, late).level is Level.OK  # its interval is unknown


def test_loss_is_an_error_for_limited_time() -> None:
    health = InputHealth(CounterTrends())
    health.evaluate(0.0, TOPIC)
    assert health.evaluate(1.0, TOPIC._replace(refused=1)).level is Level.ERROR
    assert health.evaluate(RECENT_SECONDS, TOPIC._replace(refused=1)).level is Level.ERROR
    assert health.evaluate(RECENT_SECONDS + 2, TOPIC._replace(refused=1)).level is Level.OK
    status = health.evaluate(RECENT_SECONDS + 3, TOPIC._replace(refused=1, missing=2))
    assert (status.level, dict(status.values)["missing"]) == (Level.ERROR, "2")


def test_dropped_output_is_a_warning() -> None:
    trends, status = CounterTrends(), OutputStatus("/pose", "geometry_msgs/PoseStamped", 1, 5, 0)
    assert evaluate_output(0.0, trends, status).level is Level.OK
    trends.remove_unrecorded()
    assert evaluate_output(1.0, trends, status._replace(dropped=3)).level is Level.WARN


def test_idle_engine_is_ok() -> None:
    assert {part.level for part in engine_health(Engine()).values()} == {Level.OK}


def test_full_queue_is_a_warning_and_loss_an_error() -> None:
    engine = Engine()
    assert engine_health(engine, queued=engine.settings.queue - 1)["queue"].level is Level.WARN
    health = EngineHealth(1.0, 10.0)
    engine_health(engine, 0.0, health)
    assert engine_health(engine, 1.0, health, dropped=1)["queue"].level is Level.ERROR
    assert engine_health(engine, 20.0, health, dropped=1)["queue"].level is Level.OK


@pytest.mark.parametrize(("seconds", "level"), [(0.5, Level.OK), (2.0, Level.WARN), (11.0, Level.ERROR)])
def test_level_of_work_depends_on_duration(seconds: float, level: Any) -> None:
    work = Work("fire", seconds, "rule alarm: goal endless", "fire", "mine:1:1")
    part = engine_health(Engine(), work=work)["work"]
    assert part.level is level
    assert dict(part.values)["goal"] == "rule alarm: goal endless"


def test_rules_with_errors_are_named() -> None:
    engine = Engine()
    engine.load(rules="hot: a <- b(X) where X > 1.\nc <- b(_).", source="mine")
    engine.event("b(many)", 1)
    health = EngineHealth(1.0, 10.0)
    part = engine_health(engine, 0.0, health)["rules"]
    assert (part.level, part.values) == (Level.ERROR, [("hot mine:1:1", "1 error")])
    assert part.message == "1 error in 1 rule: hot (mine:1)"
    assert engine_health(engine, 2 * RECENT_SECONDS, health)["rules"].level is Level.WARN


def test_rule_without_label_is_named_beside_its_key() -> None:
    engine = Engine()
    engine.load(rules="c(X) <- b(X) where X > 1.", source="/program/mine")
    engine.event("b(many)", 1)
    part = engine_health(engine)["rules"]
    assert part.message == "1 error in 1 rule: c(X) (mine:1)"
    assert part.values == [("/program/mine:1:1", "1 error"), ("name of /program/mine:1:1", "c(X)")]


def test_long_wait_of_query_is_a_warning() -> None:
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(seen, true, [[m, 9]]) <- marker.")
    engine.event("a", 2)
    engine.event("marker", 5)
    health = EngineHealth(1.0, 10.0)
    assert engine_health(engine, 0.0, health)["waiting queries"].level is Level.OK
    part = engine_health(engine, 11.0, health)["waiting queries"]
    assert part.level is Level.WARN
    assert part.values == [("seen", "since 5.000, for 11 s: waits for m (7.000 s behind)")]


def test_number_of_values_is_limited() -> None:
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(seen(X), true, [[m, 9]]) <- marker(X).")
    for number in range(500):
        engine.event(f"marker({number})", 5)
    part = engine_health(engine)["waiting queries"]
    assert part.message == "500 wait"
    assert len(part.values) == MAX_STATUS_VALUES + 1
    assert part.values[-1] == (
        "further queries",
        str(500 - MAX_STATUS_VALUES),
    )
    program = evaluate_program([], [str(number) for number in range(100)])
    assert program.level is Level.WARN
    assert program.values[-1] == (
        "further ones",
        str(100 - MAX_STATUS_VALUES),
    )


def test_topics_with_problems_precede_others() -> None:
    lossy_topic = TOPIC._replace(topic="/wrong", dropped=1)
    topics = [
        *(TOPIC._replace(topic=f"/t{number}") for number in range(300)),
        TOPIC._replace(publishers=0),
        lossy_topic,
    ]
    parts = NodeHealth(lambda: topics, list, list).evaluate()
    assert [part.name for part in parts[:2]] == ["input /wrong", "input /tf"]
    assert len(parts) == MAX_REPORTED_TOPICS + 2
    assert parts[-2].name == "further inputs"
    assert parts[-2].message.startswith("102 ")


def test_number_of_rules_with_errors_is_limited() -> None:
    engine = Engine()
    engine.load(rules="\n".join(f"a{number} <- b({number}) where 1 < X." for number in range(150)))
    for number in range(150):
        engine.event(f"b({number})", 1)
    engine.event("b(149)", 2)
    part = engine_health(engine)["rules"]
    assert part.message == "101 errors in 100 rules or more"


def test_failed_load_is_an_error() -> None:
    assert evaluate_program(["mine:1:1: expected a term"], []).level is Level.ERROR
    assert evaluate_program([], []).level is Level.OK


def test_memory_of_process_is_reported() -> None:
    values = dict(evaluate_memory().values)
    assert int(values["resident (MB)"]) > 1


def test_node_has_health_of_all_parts() -> None:
    engine = Engine()
    health = EngineHealth(1.0, 10.0)
    output = OutputStatus("/pose", "geometry_msgs/PoseStamped", 1, 5, 0)
    node = NodeHealth(lambda: [TOPIC], lambda: [output], lambda: health.evaluate(0.0, engine.status()))
    assert [part.name for part in node.evaluate()] == [
        "input /tf",
        "output /pose",
        "queue",
        "work",
        "rules",
        "waiting queries",
        "process memory",
    ]


def test_lag_is_measured_by_stamp() -> None:
    counts = InputCounts(lambda: 5_000)
    counts.measure_lag(lambda data: 3_000, b"")
    assert (counts.lag, counts.needs_lag) == (2_000, False)
    counts.measure_lag(lambda data: None, b"")
    assert counts.lag is None


def test_rules_with_largest_state_are_named() -> None:
    engine = Engine()
    engine.load(rules="few : a(K) <- b(K) with change(K, K).")
    engine.load(rules="many : c(K, A) <- aggregate(avg(V), d(K, V), A, last(3, events)).")
    engine.event("b(1)", 1)
    for number in range(100):
        engine.event(f"d({number}, 1)", number + 1)
    values = dict(engine_health(engine)["rules"].values)
    assert list(values)[0].startswith("held by many")
    assert "100 items, 100 keys, about 0.2 MB" in list(values.values())[0]
    assert list(values)[1].startswith("held by few")


def test_lags_and_delays_are_reported() -> None:
    engine = Engine(StreamClock(10_000_000_000))
    engine.load(rules="lost <- beat seq absent(beat, 2).", source="mine")
    assert "late events" not in engine_health(engine)
    engine.event("beat", 9.75)
    health = engine_health(engine)["late events"]
    assert (health.level, health.message) == (Level.OK, "alarms wait up to 0.250 s")
    assert dict(health.values) == {
        "lag of beat/0 (s)": "0.250",
        "delay of mine:1:1 (s)": "0.250",
        "name of mine:1:1": "lost",
    }


def test_failed_call_of_service_is_a_warning() -> None:
    engine = Engine(StreamClock(1))
    health = EngineHealth(1.0, 10.0)
    assert "services" not in engine_health(engine, 0.0, health)
    engine.on_service_call(lambda call: None)
    goal = "ros_service('/dock', 'std_srvs/Trigger', {}, a)"
    engine.call(goal.format("std_srvs__0__Trigger_Request"))
    part = engine_health(engine, 1.0, health)["services"]
    assert (part.level, part.message, dict(part.values)["under way"]) == (Level.OK, "1 call", "1")
    engine.call(goal.format("wrong"))
    assert engine_health(engine, 2.0, health)["services"].level is Level.WARN
    assert engine_health(engine, 2.0 + 2 * RECENT_SECONDS, health)["services"].level is Level.OK
