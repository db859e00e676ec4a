"""Messages before subscribers have connected."""

import socket
import threading
from http.client import HTTPException
from types import SimpleNamespace
from typing import Any, Iterator, List
from xmlrpc.client import Fault

import pytest

from retalis import Reports

rospy = pytest.importorskip("rospy")

from retalis.ros1 import publisher_startup_queue  # noqa: E402
from retalis.ros1.publisher_startup_queue import StartupQueue, SubscriberWait  # noqa: E402


class RecordingWriter:
    """Stand-in of a `TopicWriter` that records what it writes."""

    def __init__(self) -> None:
        self.publisher = SimpleNamespace(name="/topic")
        self.counts = SimpleNamespace(dropped=0)
        self.connected: List[Any] = []
        self.written: List[Any] = []

    def connections(self) -> List[Any]:
        return [SimpleNamespace(_connection=SimpleNamespace(endpoint_id=name)) for name in self.connected]

    def send(self, message: bytes) -> None:
        self.written.append(message)


@pytest.fixture
def listening_uri() -> Iterator[Any]:
    """Return the URI of a server that accepts connections."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}/"


@pytest.fixture
def writer() -> RecordingWriter:
    return RecordingWriter()


@pytest.fixture
def queue(writer: Any) -> Any:
    return StartupQueue(writer, 3, Reports())


def test_messages_wait_for_release(writer: RecordingWriter, queue: Any) -> None:
    queue.send(b"1")
    queue.send(b"2")
    assert writer.written == []
    queue.release()
    queue.send(b"3")
    assert writer.written == [b"1", b"2", b"3"]


def test_excess_messages_are_counted_as_dropped(writer: RecordingWriter, queue: Any) -> None:
    for number in range(5):
        queue.send(b"%d" % number)
    queue.release()
    assert (writer.written, writer.counts.dropped) == ([b"2", b"3", b"4"], 2)


def make_master(subscribers: Any, running: Any) -> Any:
    """Return a stand-in of the master: nodes by topic, and the URI of each node."""
    return SimpleNamespace(
        getSystemState=lambda: (1, "", [[], [[topic, nodes] for topic, nodes in subscribers.items()], []]),
        lookupNode=lambda node: (1, "", running.get(node, "http://127.0.0.1:1/")),
    )


@pytest.fixture
def start_wait(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that waits for subscribers, and returns when all queues are released."""

    def start(queues: Any, master: Any, is_connected: Any = lambda checks: None) -> Any:
        checks: List[Any] = []

        def check(seconds: Any) -> None:
            checks.append(seconds)
            is_connected(len(checks))

        monkeypatch.setattr(rospy, "get_master", lambda: master)
        monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
        monkeypatch.setattr(publisher_startup_queue, "wallsleep", check)
        reports = Reports()
        wait = SubscriberWait(reports)
        # The body of the thread runs below.
        thread = SimpleNamespace(start=lambda: None)
        monkeypatch.setattr(
            publisher_startup_queue,
            "threading",
            SimpleNamespace(Lock=threading.Lock, Thread=lambda target, **options: thread),
        )
        for topic, queue in queues.items():
            wait.add(topic, queue)
        wait._run()  # noqa: SLF001 - the body of the thread
        return reports.warnings

    return start


def test_topic_without_subscribers_is_released(writer: RecordingWriter, queue: Any, start_wait: Any) -> None:
    queue.send(b"1")
    assert start_wait({"/topic": queue}, make_master({}, {})) == 0
    assert writer.written == [b"1"]


def test_queue_is_released_if_subscriber_connects(
    writer: RecordingWriter, queue: Any, start_wait: Any, listening_uri: str
) -> None:
    queue.send(b"1")
    written_before: List[Any] = []

    def connect(check: Any) -> None:
        written_before.append(list(writer.written))
        if check == 3:
            writer.connected.append("/listener")

    master = make_master({"/topic": ["/listener"]}, {"/listener": listening_uri})
    assert start_wait({"/topic": queue}, master, connect) == 0
    assert written_before[:3] == [[], [], []]
    assert writer.written == [b"1"]


def test_crashed_subscriber_is_not_awaited(writer: RecordingWriter, queue: Any, start_wait: Any) -> None:
    queue.send(b"1")
    assert start_wait({"/topic": queue}, make_master({"/topic": ["/crashed"]}, {})) == 0
    assert writer.written == [b"1"]


def test_missing_connection_is_reported(
    monkeypatch: pytest.MonkeyPatch, writer: RecordingWriter, queue: Any, start_wait: Any, listening_uri: str
) -> None:
    monkeypatch.setattr(publisher_startup_queue, "MAX_SUBSCRIBER_WAIT_SECONDS", 0.0)
    queue.send(b"1")
    master = make_master({"/topic": ["/listener"]}, {"/listener": listening_uri})
    assert start_wait({"/topic": queue}, master) == 1
    assert writer.written == [b"1"]


def test_topic_without_subscribers_has_no_deadline(
    monkeypatch: pytest.MonkeyPatch, writer: RecordingWriter, queue: Any, start_wait: Any
) -> None:
    monkeypatch.setattr(publisher_startup_queue, "MAX_SUBSCRIBER_WAIT_SECONDS", 0.0)
    queue.send(b"1")
    assert start_wait({"/topic": queue}, make_master({}, {})) == 0
    assert writer.written == [b"1"]


@pytest.mark.parametrize("uri", ["http://127.0.0.1:port/", "nonsense", "http://[::1"])
def test_invalid_subscriber_is_not_awaited(
    writer: RecordingWriter, queue: Any, start_wait: Any, uri: str
) -> None:
    queue.send(b"1")
    master = make_master({"/topic": ["/listener"]}, {"/listener": uri})
    assert start_wait({"/topic": queue}, master) == 0
    assert writer.written == [b"1"]


@pytest.mark.parametrize("error", [HTTPException("cut off"), Fault(1, "no"), ConnectionRefusedError()])
def test_error_of_master_releases_the_queue(
    writer: RecordingWriter, queue: Any, start_wait: Any, error: Any
) -> None:
    def raise_error() -> None:
        raise error

    queue.send(b"1")
    assert start_wait({"/topic": queue}, SimpleNamespace(getSystemState=raise_error)) == 0
    assert writer.written == [b"1"]
