"""Calls of services by a node: permission, time limit, and counts."""

import threading
import time
from pathlib import Path
from typing import Any, Iterator, List

import pytest
from checked_threads import wait_until
from node.in_memory_hosts import Robot, start_host
from node.memory_transport import MemoryNetwork

from retalis import Clock, Engine, UsageError
from retalis.messages.type_definition import SerializationFormat
from retalis.node.parameters import read_parameters
from retalis.node.service_caller import MAX_CALL_THREADS, CallThreads

GOAL = "ros_service('{}', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, {})"
REPLY = b"\1\0\0\0\0"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """Return the folder of a program without rules."""
    (tmp_path / "goalPredicates.txt").write_text("")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    return tmp_path


def record_ends(host: Any) -> List[str]:
    """Return a list that receives the texts of the ends of calls."""
    events: List[str] = []

    def record(term: Any, start: int, end: int) -> None:
        if term[0].name != "service_call":
            events.append(host.engine.show(term))

    host.engine.on_event(record)
    return events


@pytest.fixture
def host(network: MemoryNetwork, program: Path) -> Iterator[Any]:
    """Return a host that may call services of the arm, with the ends of its calls in its attribute ``events``."""
    host = start_host(network, program, allow_services=["/arm/*"])
    host.events = record_ends(host)  # type: ignore[attr-defined]
    yield host
    host.transport.shut_down()


def test_service_is_called_by_full_name(host: Any, network: MemoryNetwork) -> None:
    assert host.engine.call(GOAL.format("arm/lift", "a"))
    network.calls["/arm/lift"].reply(REPLY)
    assert host.events == ["""service_reply('arm/lift',a,std_srvs__0__Trigger_Response(true,'""'))"""]


def test_requests_have_format_of_transport(network: MemoryNetwork, tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("")
    host = start_host(network, tmp_path, SerializationFormat.CDR, allow_services=["/dock"])
    assert host.engine.call(GOAL.format("/dock", "a"))
    assert network.calls["/dock"].request.data[:4] == b"\0\1\0\0"
    host.transport.shut_down()


@pytest.mark.parametrize("name", ["/dock", "/army/lift", "~arm"])
def test_service_that_is_not_allowed_is_not_called(host: Any, network: MemoryNetwork, name: str) -> None:
    assert host.engine.call(GOAL.format(name, "a"))
    assert network.calls == {}
    (event,) = host.events
    assert event.startswith(f"service_failed('{name}',a,'goals may not call /")
    assert "~allow_services, which lists /arm/*" in event


def test_call_without_reply_times_out(host: Any, network: MemoryNetwork) -> None:
    assert host.engine.call(GOAL.format("/arm/a", "slow"))
    network.move_time(1)
    assert host.engine.call(f"{GOAL.format('/arm/b', 'fast')[:-1]}, [timeout(2)])")
    assert host.engine.call(GOAL.format("/arm/c", "answered"))
    network.calls["/arm/c"].reply(REPLY)
    host.events.clear()
    network.move_time(1.9)
    assert host.events == []
    network.move_time(0.2)
    assert host.events == ["service_failed('/arm/b',fast,'no reply within 2 s')"]
    network.move_time(10)
    assert host.events[1:] == ["service_failed('/arm/a',slow,'no reply within 5 s')"]
    assert network.timers == []
    status = host.engine.status().services
    assert (status.under_way, status.failed) == (0, 2)


def test_call_fails_if_machine_time_is_set_back(host: Any, network: MemoryNetwork) -> None:
    assert host.engine.call(GOAL.format("/arm/a", "a"))
    (timer,) = network.timers
    network.now -= 3600 * 10**9
    timer.callback()
    assert host.engine.status().services.under_way == 0


def test_call_fails_if_simulated_time_is_set_back(network: MemoryNetwork, program: Path) -> None:
    host = start_host(network, program, is_time_simulated=True, allow_services=["/arm/*"])
    events = record_ends(host)
    for seconds in (4000, 10):
        network.now = seconds * 10**9
        for callback in host.transport.clock_callbacks:
            callback(network.now)
        if seconds == 4000:
            assert host.engine.call(GOAL.format("/arm/a", "a"))
    # The timer of the limit, which is almost 4,000 s away, is not called.
    wait_until(lambda: events, "the call ends")
    assert events == ["service_failed('/arm/a',a,'the time was set back before the reply')"]
    host.transport.shut_down()


def test_call_before_time_is_known_has_whole_limit(host: Any, network: MemoryNetwork) -> None:
    network.now = 0
    assert host.engine.call(GOAL.format("/arm/a", "a"))
    (timer,) = network.timers
    network.timers.clear()
    network.now = 1_000 * 10**9
    timer.callback()
    assert host.engine.status().services.under_way == 1
    network.move_time(5)
    assert host.engine.status().services.under_way == 0


@pytest.mark.parametrize("value", ["/arm", ["arm"], ["/arm x"], [3]])
def test_invalid_list_of_services_is_an_error(tmp_path: Path, value: Any) -> None:
    with pytest.raises(UsageError, match="parameter ~allow_services: expected"):
        read_parameters({"allow_services": value}, lambda: tmp_path)


def test_service_that_is_not_allowed_is_warned_of_at_start(
    network: MemoryNetwork, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')")
    (tmp_path / "rules.txt").write_text(f"go(X) do {GOAL.format('/dock', 'X')}.")
    host = start_host(network, tmp_path)
    assert (
        "rules.txt:1:10: goals may not call /dock: add it to the parameter ~allow_services, which lists no service "
        "[RT1112]" in caplog.text
    )
    host.transport.shut_down()


def test_interrupted_call_fails_after_restart(network: MemoryNetwork, tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text(
        "subscribe(service_failed(_, Id, _), [], std_msgs__0__String(Id), failures, s)."
    )
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe strings="plain">'
        '<publish_to name="failures" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    robot = Robot(network)
    robot.subscribe("/failures")
    checkpoint = str(tmp_path / "state.db")
    host = start_host(network, tmp_path, allow_services=["/arm/*"], checkpoint=checkpoint)
    assert host.engine.call(GOAL.format("/arm/lift", "a"))
    host.transport.shut_down()
    assert robot.received["/failures"] == []
    host = start_host(network, tmp_path, allow_services=["/arm/*"], checkpoint=checkpoint)
    end = time.monotonic() + 60
    while not robot.received["/failures"] and time.monotonic() < end:
        time.sleep(0.005)
    host.transport.shut_down()
    assert robot.received["/failures"] == ["a"]


def test_threads_of_calls_are_limited_and_errors_fail_calls() -> None:
    threads, resumed = CallThreads(), threading.Event()
    engine, events = Engine(Clock()), []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    calls: List[Any] = []
    engine.on_service_call(calls.append)
    assert engine.call(GOAL.format("/arm", "a"))
    (call,) = calls
    for _ in range(MAX_CALL_THREADS):
        threads.start(lambda name, call: resumed.wait(60), "/arm", call)
    with pytest.raises(UsageError, match="200 calls wait for the middleware"):
        threads.start(lambda name, call: None, "/arm", call)
    resumed.set()
    for thread in threading.enumerate():
        if thread.name == "service call":
            thread.join(60)
    threads.start(lambda name, call: 1 / 0, "/arm", call)
    wait_until(lambda: len(events) == 2, "the call ends")
    assert events[1] == "service_failed('/arm',a,'it cannot be called: ZeroDivisionError: division by zero')"
