"""Writing of serialized messages to connections. Needs rospy, no master."""

import socket
import threading
import time
from struct import pack, unpack_from
from types import SimpleNamespace
from typing import Any, Callable, Iterator, List, Set

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from reachable_objects import reachable  # noqa: E402
from rospy.exceptions import TransportTerminated  # noqa: E402

from retalis import Reports  # noqa: E402
from retalis.ros1 import connection_writer, internode_delivery, text_topics  # noqa: E402
from retalis.ros1.connection_writer import TopicWriter  # noqa: E402
from retalis.ros1.text_topics import EventTextPublisher, OutputTextPublisher, serialize_string  # noqa: E402

BODY = b"b" * 20_000


class Link:
    """A connection of rospy, and its other end."""

    def __init__(self) -> None:
        self.socket, self.other = socket.socketpair()
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 5000)
        self.other.settimeout(60)
        self.stat_bytes = self.stat_num_msg = 0
        self.endpoint_id = "/listener"
        self.closed = False

    def close(self) -> None:
        self.closed = True

    def read(self, upto: int) -> Any:
        """Return the numbers of the messages until that one."""
        numbers, data = [], b""
        while upto not in numbers:
            read_until = self.other.recv(1 << 16)
            assert read_until
            data += read_until
            while len(data) >= 4 and len(data) >= 4 + unpack_from("<I", data)[0]:
                size, number = unpack_from("<II", data)
                assert data[8 : 4 + size] == BODY
                numbers.append(number)
                data = data[4 + size :]
        assert not data
        return numbers


def wait_for_all(link: Any) -> bool:
    return True


def numbered_message(number: int) -> Any:
    return pack("<II", len(BODY) + 4, number) + BODY


@pytest.fixture(autouse=True)
def end_identification(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """End the threads that identify subscribers, as the end of a node does."""
    identifiers: List[Any] = []
    start = internode_delivery.SubscriberIdentifier.start

    def start_and_record(identifier: Any, *arguments: Any) -> None:
        identifiers.append(identifier)
        start(identifier, *arguments)

    monkeypatch.setattr(internode_delivery.SubscriberIdentifier, "start", start_and_record)
    yield
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    for identifier in identifiers:
        identifier.peer_subscribe("/topic", None, None)
    for thread in threading.enumerate():
        if thread.name == "identifying subscribers":
            thread.join(20)


@pytest.fixture
def make_link() -> Iterator[Callable[[], Any]]:
    """Return a function that makes a connection; all are closed after the test."""
    links: List[Link] = []

    def make() -> Link:
        links.append(Link())
        return links[-1]

    yield make
    for connection in links:
        connection.socket.close()
        connection.other.close()


@pytest.fixture
def link(make_link: Any) -> Any:
    return make_link()


@pytest.fixture
def reports() -> Any:
    return Reports()


@pytest.fixture
def make_writer(monkeypatch: pytest.MonkeyPatch, link: Any, reports: Any) -> Any:
    """Return a function that makes a writer with the connection."""

    def publisher(topic: Any, message_class: Any, listener: Any, latch: Any, queue_size: Any) -> Any:
        return SimpleNamespace(name=topic, impl=SimpleNamespace(connections=[link]), listener=listener)

    monkeypatch.setattr(rospy, "Publisher", publisher)
    return lambda queue=1000, waits_for=connection_writer.never_wait, latched=False, hint="": TopicWriter(
        "/topic", object, queue, reports, waits_for, latched, wait_hint=hint
    )


def test_message_is_written_at_once(make_writer: Any, link: Any) -> None:
    make_writer().send(b"frame", 3)
    assert link.other.recv(100) == b"frame"
    assert (link.stat_bytes, link.stat_num_msg) == (5, 3)


def test_late_receiver_gets_messages_in_order(make_writer: Any, link: Any, reports: Any) -> None:
    writer = make_writer()
    for number in range(30):
        writer.send(numbered_message(number))
    assert link.read(29) == list(range(30))
    writer.send(numbered_message(30))
    assert link.read(30) == [30]
    assert reports.warnings == 0


def test_slow_receiver_loses_oldest_messages(
    make_writer: Any, link: Any, reports: Any, caplog: pytest.LogCaptureFixture
) -> None:
    writer = make_writer(queue=5)
    for number in range(100):
        writer.send(numbered_message(number))
    numbers = link.read(99)
    assert numbers == sorted(set(numbers))
    assert numbers[0] == 0
    assert numbers[-5:] == [95, 96, 97, 98, 99]
    reports.sum_up()
    text = "/listener does not keep up with topic /topic: a message is dropped for it"
    messages = [record.getMessage() for record in caplog.records]
    assert (messages[0], messages[-1]) == (text, f"{100 - len(numbers)} times in all: {text}")


def test_waiting_writer_loses_no_message(make_writer: Any, link: Any, reports: Any) -> None:
    writer = make_writer(queue=5, waits_for=wait_for_all)
    numbers: List[Any] = []
    receiving = threading.Thread(target=lambda: numbers.extend(link.read(99)))
    receiving.start()
    for number in range(100):
        writer.send(numbered_message(number))
    receiving.join()
    assert numbers == list(range(100))
    assert reports.warnings == 0


def test_writer_waits_only_for_room_in_queue(
    make_writer: Any, link: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = make_writer(queue=40, waits_for=wait_for_all)
    read_sizes: List[Any] = []
    monkeypatch.setattr(
        connection_writer, "wallsleep", lambda seconds: read_sizes.append(len(link.other.recv(1000)))
    )
    for number in range(100):
        read_sizes.clear()
        writer.send(numbered_message(number))
        assert sum(read_sizes) <= connection_writer.COMBINED_WRITE_BYTES + 4 * len(numbered_message(0))
    assert reports.warnings == 0


def test_writer_waits_while_receiver_reads(
    make_writer: Any, link: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0

    def read_some(seconds: Any) -> None:
        nonlocal now
        # Some checks see no progress: the thread that writes has sent as much as was read, and not counted it yet.
        now += 0.2 * connection_writer.RECEIVER_WAIT_SECONDS
        assert link.other.recv(8000)

    monkeypatch.setattr(connection_writer, "wallsleep", read_some)
    monkeypatch.setattr(connection_writer, "time", SimpleNamespace(monotonic=lambda: now))
    writer = make_writer(queue=5, waits_for=wait_for_all)
    for number in range(90):
        writer.send(numbered_message(number))
    assert now > 10 * connection_writer.RECEIVER_WAIT_SECONDS
    assert reports.warnings == 0


def test_writer_does_not_wait_for_closed_connection(
    make_writer: Any, link: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, sock = [], link.socket

    def go(seconds: Any) -> None:
        waits.append(seconds)
        link.socket = None

    monkeypatch.setattr(connection_writer, "wallsleep", go)
    writer = make_writer(queue=5, waits_for=wait_for_all)
    while not waits:
        writer.send(numbered_message(0))
    link.socket = sock
    assert len(waits) == 1


def test_writer_does_not_wait_for_other_nodes(
    make_writer: Any, link: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wait(seconds: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(connection_writer, "wallsleep", wait)
    writer = make_writer(queue=5, waits_for=lambda connection: connection is not link)
    for number in range(100):
        writer.send(numbered_message(number))
    assert reports.warnings > 0


def test_writer_waits_once_for_stalled_receiver(
    make_writer: Any, link: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_writer, "RECEIVER_WAIT_SECONDS", 0.01)
    waits: List[Any] = []
    monkeypatch.setattr(connection_writer, "wallsleep", lambda seconds: waits.append(seconds))
    writer = make_writer(queue=5, waits_for=wait_for_all)
    while not reports.warnings:
        writer.send(numbered_message(0))
    count = len(waits)
    assert count > 0
    writer.send(numbered_message(1))
    assert len(waits) == count


def test_wait_for_slow_receiver_is_reported_once(
    make_writer: Any, link: Any, reports: Any, caplog: pytest.LogCaptureFixture
) -> None:
    writer = make_writer(queue=5, waits_for=wait_for_all, hint="be quick")
    for _ in range(2):
        receiving = threading.Thread(target=link.read, args=(99,))
        receiving.start()
        for number in range(100):
            writer.send(numbered_message(number))
        receiving.join()
    expected = "/listener does not keep up with topic /topic: messages wait; be quick"
    assert 1 <= reports.warnings <= 2
    assert {record.getMessage() for record in caplog.records} == {expected}


def test_ended_connection_is_closed(make_writer: Any, link: Any) -> None:
    link.other.close()
    make_writer().send(b"frame")
    assert link.closed


@pytest.mark.parametrize("topic", [SimpleNamespace(closed=True), None])
def test_error_while_topic_is_closed_is_ignored(make_writer: Any, link: Any, topic: Any) -> None:
    def close() -> None:
        writer.publisher.impl = topic
        raise TypeError("'NoneType' object is not iterable")

    link.close = close
    link.other.close()
    writer = make_writer()
    writer.send(b"frame")
    assert writer.publisher.impl is topic
    assert list(writer.connections()) == []


def test_other_error_of_closing_is_raised(make_writer: Any, link: Any) -> None:
    def close() -> None:
        writer.publisher.impl.closed = False
        raise TypeError("something else")

    link.close = close
    link.other.close()
    writer = make_writer()
    with pytest.raises(TypeError, match="something else"):
        writer.send(b"frame")


def test_slow_connection_that_ends_is_closed(make_writer: Any, link: Any) -> None:
    writer = make_writer()
    for number in range(5):
        writer.send(numbered_message(number))
    threads = [thread for thread in threading.enumerate() if thread.name == "to /topic"]
    assert threads
    link.other.close()
    for thread in threads:
        thread.join(60)
    assert link.closed


def test_other_connection_class_writes_its_messages(make_writer: Any, link: Any) -> None:
    class OtherConnection:
        def __init__(self) -> None:
            self.sent: List[Any] = []
            self.closed = False

        def write_data(self, data: Any) -> None:
            if self.sent:
                raise TransportTerminated("connection closed")
            self.sent.append(data)

        def close(self) -> None:
            self.closed = True

    connection, writer = OtherConnection(), make_writer()
    writer.publisher.impl.connections = [connection]
    writer.send(b"frame")
    assert connection.sent == [b"frame"]
    assert not connection.closed
    writer.send(b"frame")
    assert connection.closed


def test_removed_connections_are_released(make_writer: Any, link: Any) -> None:
    writer = make_writer()
    writer.send(b"frame")
    assert link in reachable(writer, Link)
    writer.publisher.impl.connections = []
    writer.send(b"frame")
    assert reachable(writer, Link) == []
    writer.publisher.impl = None
    writer.send(b"frame")
    assert list(writer.connections()) == []


def connect(writer: Any, new_link: Any) -> Any:
    """Add a connection as rospy does; return the function that notifies the listener afterwards."""
    writer.publisher.impl.connections = [*writer.publisher.impl.connections, new_link]
    return lambda: writer.publisher.listener.peer_subscribe("/topic", print, print)


def test_late_subscriber_gets_latched_message_once(make_writer: Any, link: Any, make_link: Any) -> None:
    writer = make_writer(latched=True)
    for number in range(2):
        writer.send(numbered_message(number))
    assert link.read(1) == [0, 1]
    before, between, after = make_link(), make_link(), make_link()
    connect(writer, before)()
    notify = connect(writer, between)
    writer.send(numbered_message(2))
    notify()
    notify()
    connect(writer, after)()
    writer.send(numbered_message(3))
    assert [connection.read(3) for connection in (link, before, between, after)] == [
        [2, 3],
        [1, 2, 3],
        [2, 3],
        [2, 3],
    ]


def test_latched_topic_without_message_sends_nothing(make_writer: Any, link: Any, make_link: Any) -> None:
    writer, subscriber = make_writer(latched=True), make_link()
    connect(writer, subscriber)()
    writer.send(numbered_message(0))
    assert [connection.read(0) for connection in (link, subscriber)] == [[0], [0]]


def test_texts_are_written_together_in_order(
    make_writer: Any, link: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(internode_delivery, "find_nodes_offering", lambda service: {link.endpoint_id})
    writer, turn = EventTextPublisher("/topic", 1000, Reports(), lambda: 0), threading.Lock()
    writer.start_identification(turn, set)
    writer.add("a")
    writer.add("b\udcff")
    link.other.setblocking(False)
    with pytest.raises(BlockingIOError):
        link.other.recv(100)
    link.other.settimeout(60)
    with turn:
        writer.flush()
    assert link.other.recv(100) == serialize_string("a") + pack("<II", 6, 2) + b"b\xff"
    end = time.monotonic() + 20
    while link.stat_num_msg != 2 and time.monotonic() < end:  # messages are counted after they are sent
        time.sleep(0.01)
    assert link.stat_num_msg == 2
    monkeypatch.setattr(text_topics, "MAX_TEXTS_PER_WRITE", 2)
    with turn:
        writer.add("c")
        writer.add("d")
    assert link.other.recv(100) == serialize_string("c") + serialize_string("d")


def read_until(link: Any, text: str) -> Any:
    """Return the data of a connection up to the end of a text."""
    data = b""
    while not data.endswith(serialize_string(text)):
        part = link.other.recv(1000)
        assert part
        data += part
    return data


def test_outputs_are_sent_to_interface_in_order(
    make_writer: Any, link: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    services: List[Any] = []

    def offering(service: Any) -> Set[Any]:
        services.append(service)
        return {link.endpoint_id}

    monkeypatch.setattr(internode_delivery, "find_nodes_offering", offering)
    writer = OutputTextPublisher("/topic", 1000, Reports(), ["out", "foo bar"], [])
    for topic, text in (("out", "a"), ("watched", "b"), ("/out", "c"), ("not a name", "d")):
        writer.send(topic, text.__str__)
    assert read_until(link, "d") == b"".join(map(serialize_string, "abcd"))
    assert set(services) == {"add_input_subscription"}


def test_only_published_outputs_wait_for_interface(monkeypatch: pytest.MonkeyPatch, make_link: Any) -> None:
    connections: List[Any] = []
    written: List[Any] = []
    listeners: List[Any] = []

    def publisher(topic: Any, message_class: Any, listener: Any, latch: Any, queue_size: Any) -> Any:
        listeners.append(listener)
        return SimpleNamespace(name=topic, impl=SimpleNamespace(connections=connections), listener=listener)

    def write(text: str) -> Any:
        def convert() -> str:
            written.append(text)
            return text

        return convert

    monkeypatch.setattr(rospy, "Publisher", publisher)
    reports = Reports()
    writer = OutputTextPublisher("/topic", 2, reports, ["out", "state"], ["state"])
    for topic, text in (("state", "s"), ("watched", "w"), ("out", "a"), ("out", "b")):
        writer.send(topic, write(text))
    assert (written, reports.warnings) == (["s", "a", "b"], 1)  # the queue holds two
    for expected in (b"sab", b"sc"):
        link = make_link()
        monkeypatch.setattr(
            internode_delivery, "find_nodes_offering", lambda service, name=link.endpoint_id: {name}
        )
        connections[:] = []
        if expected == b"sc":
            writer.send("out", write("c"))
        connections[:] = [link]
        listeners[-1].peer_subscribe("/topic", None, None)
        assert read_until(link, chr(expected[-1])) == b"".join(
            serialize_string(chr(byte)) for byte in expected
        )
