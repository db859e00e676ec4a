"""Forwarding to a real broker that is killed, stopped, restarted or refuses the connection."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any, Iterator, List

import pytest
from forwarding.mosquitto import NEEDS_BROKER, Broker, wait_until
from subprocess_python_path import python_path

from retalis import UsageError
from retalis.fleet.mqtt_bridge import MqttBridge
from retalis.fleet.robot_events import read_robot_event
from retalis.forwarding.disk_queue import DiskQueue, ForwardedEvent
from retalis.forwarding.event_forwarder import MAX_EVENT_CHARACTERS, EventForwarder
from retalis.forwarding.mqtt_sender import KEEPALIVE_SECONDS, MAX_RETRY_SECONDS

pytestmark = [pytest.mark.slow, NEEDS_BROKER]


def put(forwarder: EventForwarder, *numbers: int) -> None:
    for number in numbers:
        forwarder.put(ForwardedEvent(1.5, 1.5 + number, f"alarm({number})"))


def texts_of(numbers: Any) -> List[str]:
    return [f"alarm({number})" for number in numbers]


def test_events_arrive_in_order(broker: Broker, forward: Any) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, *range(1000))
    subscriber.wait_for(1000)
    first = subscriber.events[0]
    session = first.pop("session")
    assert first == {"robot": "r07", "id": 1, "time": 1.5, "event": "alarm(0)"}
    last = subscriber.events[-1]
    assert (last["start"], last["time"]) == (1.5, 1000.5)
    assert {event["session"] for event in subscriber.events[1:]} == {session}
    assert [event["id"] for event in subscriber.events] == list(range(1, 1001))
    # The fleet's side accepts the lines.
    assert read_robot_event(json.dumps(last)).text == "alarm(999)"
    wait_until(lambda: not forwarder.status().queued, "confirmations")
    status = forwarder.status()
    assert (status.confirmed, status.lost, status.repeated, status.connections) == (1000, 0, 0, 1)


def test_events_wait_for_broker(create_broker: Any, forward: Any) -> None:
    broker = create_broker()
    forwarder = forward(broker.url)
    put(forwarder, *range(10))
    wait_until(lambda: "refused" in forwarder.status().problem, "failure")
    assert (forwarder.status().is_connected, forwarder.status().queued) == (False, 10)
    broker.start()
    subscriber = broker.subscribe()
    subscriber.wait_for(10)
    assert list(subscriber.identified().values()) == texts_of(range(10))


@pytest.mark.parametrize("cuts", [3, pytest.param(40, marks=pytest.mark.nightly)])
def test_cut_connections_lose_no_event(broker: Broker, relay: Any, forward: Any, cuts: int) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(relay.url)
    random = Random(5)
    for cycle in range(cuts):
        wait_until(lambda: forwarder.status().is_connected, "connection")
        put(forwarder, *range(1000 * cycle, 1000 * cycle + 1000))
        time.sleep(random.uniform(0, 0.1))
        relay.cut()
        wait_until(lambda: not forwarder.status().is_connected, "end of the connection")
    subscriber.wait_for(1000 * cuts)
    wait_until(lambda: not forwarder.status().queued, "confirmations")
    assert list(subscriber.identified().values()) == texts_of(range(1000 * cuts))
    status = forwarder.status()
    assert (status.confirmed, status.lost) == (1000 * cuts, 0)
    # Those that were in flight at the ends of connections, and possibly had arrived.
    assert len(subscriber.events) - 1000 * cuts <= status.repeated <= 100 * cuts


@pytest.mark.parametrize("kills", [2, pytest.param(20, marks=pytest.mark.nightly)])
def test_killed_broker_receives_events_again(broker: Broker, forward: Any, kills: int) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    random = Random(7)
    for cycle in range(kills):
        put(forwarder, *range(1000 * cycle, 1000 * cycle + 500))
        time.sleep(random.uniform(0, 0.1))
        broker.kill()
        put(forwarder, *range(1000 * cycle + 500, 1000 * cycle + 1000))
        wait_until(lambda: not forwarder.status().is_connected, "end of the connection")
        broker.start()
        subscriber.await_resubscription()
        wait_until(lambda: not forwarder.status().queued, "confirmations")
    status = forwarder.status()
    assert (status.confirmed, status.lost, status.connections) == (1000 * kills, 0, kills + 1)
    # The broker itself has lost events: while it has no subscriber, it delivers nothing.
    arrived = [id for _, id in subscriber.identified()]
    assert arrived == sorted(arrived)


def test_stopped_broker_lets_queue_fill(broker: Broker, forward: Any) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(broker.url, max_bytes=1_000_000)
    wait_until(lambda: forwarder.status().is_connected, "connection")
    broker.send_signal(signal.SIGSTOP)
    texts = [f"alarm({number},'{'x' * 1000}')" for number in range(3000)]
    for text in texts:
        forwarder.put(ForwardedEvent(1, 1, text))
    wait_until(lambda: forwarder.status().dropped > 1500, "dropped events")
    status = forwarder.status()
    assert status.used_bytes <= 1_000_000
    broker.send_signal(signal.SIGCONT)
    wait_until(lambda: not forwarder.status().queued, "confirmations")
    count = 3000 - forwarder.status().dropped
    subscriber.wait_for(count)
    ids = [event["id"] for event in subscriber.events]
    # The newest events arrive, and the gaps of the ids are the dropped ones.
    assert ids == sorted(set(ids))
    assert (ids[-1], len(ids)) == (3000, count)
    assert [event["event"] for event in subscriber.events] == [texts[id - 1] for id in ids]


def test_end_sends_queued_events(broker: Broker, forward: Any) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    wait_until(lambda: forwarder.status().is_connected, "connection")
    put(forwarder, *range(200))
    forwarder.stop()
    assert forwarder.status().queued == 0
    subscriber.wait_for(200)


def test_restart_sends_the_rest(create_broker: Any, forward: Any) -> None:
    broker = create_broker()
    forwarder = forward(broker.url)
    put(forwarder, *range(100))
    forwarder.stop()
    broker.start()
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, 100)
    subscriber.wait_for(101)
    assert [event["id"] for event in subscriber.events] == list(range(1, 102))
    assert len({event["session"] for event in subscriber.events}) == 1


PROCESS = """
import sys, time
from pathlib import Path
from retalis import Reports
from retalis.forwarding.disk_queue import ForwardedEvent
from retalis.forwarding.event_forwarder import EventForwarder
from retalis.forwarding.forwarding_options import ForwardingOptions, read_broker

url, queue, first = sys.argv[1:]
options = ForwardingOptions(read_broker(url), "r07", ("*",), Path(queue), 10_000_000)
forwarder = EventForwarder(options, Reports())
print("started", flush=True)
for number in range(int(first), int(first) + 100_000):
    forwarder.put(ForwardedEvent(number, number, f"alarm({number})"))
    time.sleep(0.0005)
"""


@pytest.mark.parametrize("kills", [4, pytest.param(40, marks=pytest.mark.nightly)])
def test_killed_process_loses_no_stored_event(
    broker: Broker, forward: Any, tmp_path: Path, kills: int
) -> None:
    pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt")
    subscriber = broker.subscribe()
    random = Random(3)
    queue = tmp_path / "queue.db"
    for cycle in range(kills):
        arguments = [broker.url, str(queue), str(100_000 * cycle)]
        with subprocess.Popen(
            [sys.executable, "-c", PROCESS, *arguments],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": python_path()},
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(random.uniform(0, 0.4))
            process.kill()
    forwarder = forward(broker.url, queue)
    put(forwarder, 10**9)
    wait_until(lambda: "alarm(1000000000)" in subscriber.identified().values(), "the last event")
    identified = subscriber.identified()
    # Each id has arrived, first in order, and each process has lost only its newest events.
    assert [id for _, id in identified] == list(range(1, len(identified) + 1))
    numbers = [int(text[len("alarm(") : -1]) for text in identified.values()]
    for cycle in range(kills):
        of_process = [number for number in numbers if number // 100_000 == cycle]
        assert of_process == list(range(100_000 * cycle, 100_000 * cycle + len(of_process)))


def test_long_event_is_dropped_and_counted(broker: Broker, forward: Any) -> None:
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, 0)
    subscriber.wait_for(1)
    forwarder.put(ForwardedEvent(1, 1, "a" * (MAX_EVENT_CHARACTERS + 1)))
    put(forwarder, 1)
    subscriber.wait_for(2)
    assert [event["id"] for event in subscriber.events] == [1, 3]
    assert (forwarder.status().oversized, forwarder.status().lost) == (1, 1)


def test_bridge_accepts_longest_event(broker: Broker, forward: Any, tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt.enums", reason="needs paho-mqtt 2")
    bridge = MqttBridge(broker.address, broker.port, tmp_path / "log")
    forwarder = forward(broker.url)

    def is_received() -> bool:
        # Again in each turn: the broker delivers nothing before the bridge has subscribed.
        forwarder.put(ForwardedEvent(1, 1, "\U0001f600" * MAX_EVENT_CHARACTERS))
        return bridge.event_count + bridge.refused_count > 0

    bridge.run(is_received)
    assert bridge.refused_count == 0


def test_wrong_password_is_reported(create_broker: Any, forward: Any, tmp_path: Path) -> None:
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "r07", "secret"], check=True)
    broker = create_broker(f"password_file {passwords}")
    broker.start()
    subscriber = broker.subscribe("-u", "r07", "-P", "secret")
    url = broker.url.replace("mqtt://", "mqtt://r07@")
    forwarder = forward(url, password="wrong")
    put(forwarder, 1)
    wait_until(lambda: "uthori" in forwarder.status().problem, "refusal")
    forwarder.stop()
    forward(url, password="secret")
    subscriber.wait_for(1)


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    """Return a certificate of ``localhost``, which is its own authority, with its key beside it."""
    path = tmp_path / "broker.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
        + ["-addext", "subjectAltName=DNS:localhost", "-keyout", f"{path}.key", "-out", str(path)],
        check=True,
        stderr=subprocess.DEVNULL,
    )
    return path


def test_tls_checks_certificate_of_broker(create_broker: Any, forward: Any, certificate: Path) -> None:
    broker = create_broker(f"certfile {certificate}", f"keyfile {certificate}.key")
    broker.start()
    subscriber = broker.subscribe(
        "--cafile", str(certificate), "-L", f"mqtts://localhost:{broker.port}/retalis/#"
    )
    forwarder = forward(f"mqtts://localhost:{broker.port}")
    put(forwarder, *range(1000))
    wait_until(lambda: "certificate verify failed" in forwarder.status().problem, "refusal")
    forwarder.stop()
    forward(f"mqtts://localhost:{broker.port}", ca_file=certificate)
    subscriber.wait_for(1000)


def test_missing_certificates_are_an_error_at_start(forward: Any, tmp_path: Path) -> None:
    for _ in range(2):
        # The queue of the first attempt is closed.
        with pytest.raises(UsageError, match="missing.pem: the certificates cannot be read"):
            forward("mqtts://localhost:1", ca_file=tmp_path / "missing.pem")


def test_slow_disk_drops_oldest_events(broker: Broker, forward: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    is_written = threading.Event()
    append = DiskQueue.append

    def append_late(queue: DiskQueue, events: Any) -> int:
        is_written.wait()
        return append(queue, events)

    monkeypatch.setattr(DiskQueue, "append", append_late)
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, *range(11_000))
    assert forwarder.status().unstored >= 400
    assert forwarder.status().storage_problem == "the disk is too slow"
    is_written.set()
    subscriber.wait_for(11_000 - forwarder.status().unstored)
    # The receiver notices the loss by the gap of the ids.
    assert subscriber.events[-1]["id"] == 11_000
    assert forwarder.status().storage_problem == ""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder on a disk of 3 MB, which can be filled."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(folder)]
    if subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode:
        pytest.skip("needs the permission to mount a file system")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_full_disk_drops_events_until_there_is_space(
    create_broker: Any, forward: Any, small_disk: Path
) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(b"x" * 1_500_000)
    broker = create_broker()
    forwarder = forward(broker.url, small_disk / "queue.db")
    texts = [f"alarm({number},'{'x' * 1000}')" for number in range(3000)]
    for text in texts[:2000]:
        forwarder.put(ForwardedEvent(1, 1, text))
    wait_until(lambda: forwarder.status().storage_problem, "a full disk")
    assert forwarder.status().storage_problem.endswith("database or disk is full")
    assert forwarder.status().unstored > 0
    # What is stored is sent, also if the disk is still full.
    broker.start()
    subscriber = broker.subscribe()
    wait_until(lambda: not forwarder.status().queued, "confirmations")
    ballast.unlink()
    for text in texts[2000:]:
        forwarder.put(ForwardedEvent(1, 1, text))
    wait_until(lambda: subscriber.events[-1:] and subscriber.events[-1]["id"] == 3000, "the last event")
    status = forwarder.status()
    assert (status.storage_problem, status.damaged_files) == ("", 0)
    ids = [event["id"] for event in subscriber.events]
    assert len(ids) == len(set(ids)) == 3000 - status.unstored
    assert [event["event"] for event in subscriber.events] == [texts[id - 1] for id in ids]


def test_node_starts_with_full_disk(broker: Broker, forward: Any, small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    with ballast.open("wb") as file, suppress(OSError):
        file.write(b"x" * 4_000_000)
    subscriber = broker.subscribe()
    forwarder = forward(broker.url, small_disk / "queue.db")
    put(forwarder, 1)
    wait_until(lambda: forwarder.status().unstored == 1, "a full disk")
    ballast.unlink()
    put(forwarder, 2)
    subscriber.wait_for(1)
    assert list(subscriber.identified().values()) == ["alarm(2)"]
    # The receiver notices the loss by the id.
    assert subscriber.events[0]["id"] == 2
    assert forwarder.status().storage_problem == ""


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Any]:
    """Return the words before a command in another network namespace, the broker's address there, and the link."""
    name = f"rt{os.getpid()}"
    link = f"{name}a"
    if shutil.which("ip") is None or subprocess.run(["ip", "netns", "add", name], check=False).returncode:
        pytest.skip("needs ip (iproute2), and the permission to create network namespaces")
    prefix = ["ip", "netns", "exec", name]
    for command in (
        ["ip", "link", "add", link, "type", "veth", "peer", "name", "peer", "netns", name],
        ["ip", "address", "add", "10.213.7.1/24", "dev", link],
        ["ip", "link", "set", link, "up"],
        [*prefix, "ip", "address", "add", "10.213.7.2/24", "dev", "peer"],
        [*prefix, "ip", "link", "set", "peer", "up"],
        [*prefix, "ip", "link", "set", "lo", "up"],
    ):
        subprocess.run(command, check=True)
    yield prefix, "10.213.7.2", link
    subprocess.run(["ip", "netns", "delete", name], check=True)


def set_link(link: str, state: str) -> None:
    subprocess.run(["ip", "link", "set", link, state], check=True)


def test_events_wait_for_network(create_broker: Any, forward: Any, network: Any) -> None:
    prefix, address, link = network
    broker = create_broker(prefix=prefix, address=address)
    broker.start()
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, 0)
    subscriber.wait_for(1)
    set_link(link, "down")
    put(forwarder, *range(1, 500))
    wait_until(lambda: forwarder.status().queued == 499, "stored events")
    set_link(link, "up")
    subscriber.wait_for(500)
    assert [event["event"] for event in subscriber.events] == texts_of(range(500))


@pytest.mark.nightly
def test_silent_network_ends_connection(create_broker: Any, forward: Any, network: Any) -> None:
    prefix, address, link = network
    broker = create_broker(prefix=prefix, address=address)
    broker.start()
    subscriber = broker.subscribe()
    forwarder = forward(broker.url)
    put(forwarder, 0)
    subscriber.wait_for(1)
    set_link(link, "down")
    put(forwarder, *range(1, 500))
    for _ in range(4):
        time.sleep(KEEPALIVE_SECONDS)
        if not forwarder.status().is_connected:
            break
    assert not forwarder.status().is_connected
    set_link(link, "up")
    for _ in range(3):
        # The next attempt to connect may be half a minute away.
        time.sleep(MAX_RETRY_SECONDS / 2)
    subscriber.wait_for(500)
    assert list(subscriber.identified().values()) == texts_of(range(500))
