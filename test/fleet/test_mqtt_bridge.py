"""Lines for the messages of a broker: events of a robot's own topic, and refusals with their reasons."""

import json
import socket
import time
from pathlib import Path

import pytest

from retalis.fleet import mqtt_bridge
from retalis.fleet.mqtt_bridge import MqttBridge, read_payload


def test_event_of_own_topic_is_unchanged() -> None:
    payload = b'{"robot": "r07", "time": 1}'
    assert read_payload("retalis/r07/events", payload) == (payload.decode(), True)


def test_event_of_several_lines_is_one_line() -> None:
    line, is_event = read_payload("retalis/r07/events", b'{"robot": "r07",\n"time": 1}')
    assert (line, is_event) == ('{"robot": "r07", "time": 1}', True)


def test_largest_payload_is_an_event() -> None:
    payload = b'{"robot": "r07", "time": 1}'.ljust(1_000_000)
    assert read_payload("retalis/r07/events", payload)[1]


@pytest.mark.parametrize(
    ("topic", "payload", "reason"),
    [
        ("retalis/r07/events", b'{"robot": "r08", "time": 1}', "expected an event of robot 'r07'"),
        ("retalis/r07/events", b"[1]", "expected an event of robot 'r07'"),
        ("retalis/r07/events", b"not json", "no JSON: Expecting value"),
        ("retalis/r07/events", b"\xff", "no JSON: 'utf-8' codec"),
        ("retalis/r07/events", b"[" * 100_000, "no JSON: maximum recursion depth"),
        ("retalis/r07/events", b" " * 1_000_001, "1000001 bytes: expected 1000000 at most"),
        ("retalis/r07/x/events", b"{}", "the topic is not that of a robot"),
        ("retalis/r07/events", b'{"robot": "r07", "refused": "x"}', "expected an event of robot 'r07'"),
    ],
)
def test_other_message_is_refused(topic: str, payload: bytes, reason: str) -> None:
    line, is_event = read_payload(topic, payload)
    assert not is_event
    assert len(line) < 6000
    assert json.loads(line)["refused"].startswith(f"topic '{topic}': {reason}")


def test_bridge_waits_after_end_of_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("paho.mqtt.enums", reason="needs paho-mqtt 2")
    monkeypatch.setattr(mqtt_bridge, "RETRY_SECONDS", 0.05)
    ends = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)

        def end_connection() -> bool:
            try:
                server.accept()[0].close()
            except BlockingIOError:
                return False
            ends.append(time.monotonic())
            return len(ends) == 3

        MqttBridge("127.0.0.1", server.getsockname()[1], tmp_path / "log").run(end_connection)
    assert ends[2] - ends[0] >= 0.1
