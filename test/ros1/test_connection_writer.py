"""Writing of serialized messages to connections. Needs rospy, no master."""

import socket
import threading
import time
from struct import pack, unpack_from
from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from reachability import reachable  # noqa: E402
from rospy.exceptions import TransportTerminated  # noqa: E402

from retalis import Reports  # noqa: E402
from retalis.ros1 import connection_writer, late_joiners, text_topics  # noqa: E402
from retalis.ros1.connection_writer import TopicWriter  # noqa: E402
from retalis.ros1.text_topics import EventTextPublisher, OutputTextPublisher, serialize_string  # noqa: E402

BODY = b"b" * 20_000


class Link:
    """A connection of rospy's, and the other end of it."""

    def __init__(self):
        self.socket, self.other = socket.socketpair()
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 5000)
        self.other.settimeout(60)
        self.stat_bytes = self.stat_num_msg = 0
        self.endpoint_id = "/listener"
        self.closed = False

    def close(self):
        self.closed = True

    def read(self, upto):
        """Return the numbers of the messages until that one."""
        numbers, data = [], b""
        while upto not in numbers:
            received = self.other.recv(1 << 16)
            assert received
            data += received
            while len(data) >= 4 and len(data) >= 4 + unpack_from("<I", data)[0]:
                size, number = unpack_from("<II", data)
                assert data[8 : 4 + size] == BODY
                numbers.append(number)
                data = data[4 + size :]
        assert not data
        return numbers


def anybody(link):
    return True


def numbered(number):
    return pack("<II", len(BODY) + 4, number) + BODY


@pytest.fixture(autouse=True)
def end_identification(monkeypatch):
    """End the threads that identify subscribers, as the end of a node does."""
    identifiers = []
    start = late_joiners.SubscriberIdentifier.start

    def start_and_record(identifier, *arguments):
        identifiers.append(identifier)
        start(identifier, *arguments)

    monkeypatch.setattr(late_joiners.SubscriberIdentifier, "start", start_and_record)
    yield
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    for identifier in identifiers:
        identifier.peer_subscribe("/topic", None, None)
    for thread in threading.enumerate():
        if thread.name == "identifying subscribers":
            thread.join(20)


@pytest.fixture
def link():
    it = Link()
    yield it
    it.socket.close()
    it.other.close()


@pytest.fixture
def reports():
    return Reports()


@pytest.fixture
def outlet(monkeypatch, link, reports):
    """Return a function that makes an outlet with the connection."""

    def publisher(topic, kind, listener, latch, queue_size):
        return SimpleNamespace(name=topic, impl=SimpleNamespace(connections=[link]), listener=listener)

    monkeypatch.setattr(rospy, "Publisher", publisher)
    return lambda queue=1000, patient=connection_writer.never_wait, latched=False, hint="": TopicWriter(
        "/topic", object, queue, reports, patient, latched, wait_hint=hint
    )


def test_what_a_connection_takes_is_written_at_once(outlet, link):
    outlet().send(b"frame", 3)
    assert link.other.recv(100) == b"frame"
    assert (link.stat_bytes, link.stat_num_msg) == (5, 3)


def test_a_receiver_that_comes_late_gets_all_in_order(outlet, link, reports):
    it = outlet()
    for number in range(30):
        it.send(numbered(number))
    assert link.read(29) == list(range(30))
    it.send(numbered(30))
    assert link.read(30) == [30]
    assert reports.warnings == 0


def test_for_a_receiver_that_does_not_keep_up_the_oldest_are_dropped_and_no_message_is_cut(
    outlet, link, reports, caplog
):
    it = outlet(queue=5)
    for number in range(100):
        it.send(numbered(number))
    numbers = link.read(99)
    assert numbers == sorted(set(numbers))
    assert numbers[0] == 0
    assert numbers[-5:] == [95, 96, 97, 98, 99]
    reports.sum_up()
    text = "/listener does not keep up with topic /topic: a message is dropped for it"
    shown = [record.getMessage() for record in caplog.records]
    assert (shown[0], shown[-1]) == (text, f"{100 - len(numbers)} times in all: {text}")


def test_who_sends_patiently_loses_nothing(outlet, link, reports):
    it = outlet(queue=5, patient=anybody)
    numbers = []
    receiving = threading.Thread(target=lambda: numbers.extend(link.read(99)))
    receiving.start()
    for number in range(100):
        it.send(numbered(number))
    receiving.join()
    assert numbers == list(range(100))
    assert reports.warnings == 0


def test_there_is_room_again_before_much_of_what_waits_is_read(outlet, link, reports, monkeypatch):
    it = outlet(queue=40, patient=anybody)
    read = []
    monkeypatch.setattr(
        connection_writer, "wallsleep", lambda seconds: read.append(len(link.other.recv(1000)))
    )
    for number in range(100):
        read.clear()
        it.send(numbered(number))
        assert sum(read) <= connection_writer.COMBINED_WRITE_BYTES + 4 * len(numbered(0))
    assert reports.warnings == 0


def test_who_sends_waits_as_long_as_anything_is_taken(outlet, link, reports, monkeypatch):
    now = 0.0

    def read_some(seconds):
        nonlocal now
        # Some checks see no progress: the thread that writes has sent as much as was read, and not counted it yet.
        now += 0.2 * connection_writer.RECEIVER_WAIT_SECONDS
        assert link.other.recv(8000)

    monkeypatch.setattr(connection_writer, "wallsleep", read_some)
    monkeypatch.setattr(connection_writer, "time", SimpleNamespace(monotonic=lambda: now))
    it = outlet(queue=5, patient=anybody)
    for number in range(90):
        it.send(numbered(number))
    assert now > 10 * connection_writer.RECEIVER_WAIT_SECONDS
    assert reports.warnings == 0


def test_nobody_waits_for_one_who_has_gone(outlet, link, monkeypatch):
    waits, sock = [], link.socket

    def go(seconds):
        waits.append(seconds)
        link.socket = None

    monkeypatch.setattr(connection_writer, "wallsleep", go)
    it = outlet(queue=5, patient=anybody)
    while not waits:
        it.send(numbered(0))
    link.socket = sock
    assert len(waits) == 1


def test_nobody_is_held_up_for_one_who_only_looks_on(outlet, link, reports, monkeypatch):
    def wait(seconds):
        raise AssertionError

    monkeypatch.setattr(connection_writer, "wallsleep", wait)
    it = outlet(queue=5, patient=lambda found: found is not link)
    for number in range(100):
        it.send(numbered(number))
    assert reports.warnings > 0


def test_patience_is_tried_once(outlet, link, reports, monkeypatch):
    monkeypatch.setattr(connection_writer, "RECEIVER_WAIT_SECONDS", 0.01)
    waits = []
    monkeypatch.setattr(connection_writer, "wallsleep", lambda seconds: waits.append(seconds))
    it = outlet(queue=5, patient=anybody)
    while not reports.warnings:
        it.send(numbered(0))
    count = len(waits)
    assert count > 0
    it.send(numbered(1))
    assert len(waits) == count


def test_wait_for_slow_receiver_is_reported_once(outlet, link, reports, caplog):
    it = outlet(queue=5, patient=anybody, hint="be quick")
    for _ in range(2):
        receiving = threading.Thread(target=link.read, args=(99,))
        receiving.start()
        for number in range(100):
            it.send(numbered(number))
        receiving.join()
    expected = "/listener does not keep up with topic /topic: messages wait; be quick"
    assert 1 <= reports.warnings <= 2
    assert {record.getMessage() for record in caplog.records} == {expected}


def test_a_connection_that_has_ended_is_closed(outlet, link):
    link.other.close()
    outlet().send(b"frame")
    assert link.closed


@pytest.mark.parametrize("topic", [SimpleNamespace(closed=True), None])
def test_a_connection_that_ends_while_rospy_takes_its_topic_down_is_left_to_it(outlet, link, topic):
    def close():
        it.publisher.impl = topic
        raise TypeError("'NoneType' object is not iterable")

    link.close = close
    link.other.close()
    it = outlet()
    it.send(b"frame")
    assert it.publisher.impl is topic
    assert list(it.connections()) == []


def test_another_error_of_closing_is_not_hidden(outlet, link):
    def close():
        it.publisher.impl.closed = False
        raise TypeError("something else")

    link.close = close
    link.other.close()
    it = outlet()
    with pytest.raises(TypeError, match="something else"):
        it.send(b"frame")


def test_a_connection_that_ends_while_it_is_slow_is_closed(outlet, link):
    it = outlet()
    for number in range(5):
        it.send(numbered(number))
    writing = [one for one in threading.enumerate() if one.name == "to /topic"]
    assert writing
    link.other.close()
    for one in writing:
        one.join(60)
    assert link.closed


def test_connections_of_another_make_get_their_messages_by_their_own_way(outlet, link):
    class Other:
        def __init__(self):
            self.sent = []
            self.closed = False

        def write_data(self, data):
            if self.sent:
                raise TransportTerminated("connection closed")
            self.sent.append(data)

        def close(self):
            self.closed = True

    other, it = Other(), outlet()
    it.publisher.impl.connections = [other]
    it.send(b"frame")
    assert other.sent == [b"frame"]
    assert not other.closed
    it.send(b"frame")
    assert other.closed


def test_connections_that_are_gone_are_forgotten(outlet, link):
    it = outlet()
    it.send(b"frame")
    assert link in reachable(it, Link)
    it.publisher.impl.connections = []
    it.send(b"frame")
    assert reachable(it, Link) == []
    it.publisher.impl = None
    it.send(b"frame")
    assert list(it.connections()) == []


def come(it, new):
    """Have a connection be made, as rospy does: among the topic's first, then told of."""
    it.publisher.impl.connections = [*it.publisher.impl.connections, new]
    return lambda: it.publisher.listener.peer_subscribe("/topic", print, print)


def test_the_last_message_of_a_latched_topic_goes_once_to_who_comes_later(outlet, link):
    it = outlet(latched=True)
    for number in range(2):
        it.send(numbered(number))
    assert link.read(1) == [0, 1]
    before, between, after = Link(), Link(), Link()
    come(it, before)()
    tell = come(it, between)
    it.send(numbered(2))
    tell()
    tell()
    come(it, after)()
    it.send(numbered(3))
    assert [one.read(3) for one in (link, before, between, after)] == [[2, 3], [1, 2, 3], [2, 3], [2, 3]]


def test_latched_topic_without_message_sends_nothing_to_new_subscriber(outlet, link):
    writer, subscriber = outlet(latched=True), Link()
    come(writer, subscriber)()
    writer.send(numbered(0))
    assert link.read(0) == [0]
    subscriber.socket.close()
    subscriber.other.close()


def test_texts_go_out_together_in_order(outlet, link, monkeypatch):
    monkeypatch.setattr(late_joiners, "find_nodes_offering", lambda service: {link.endpoint_id})
    it, turn = EventTextPublisher("/topic", 1000, Reports(), lambda: 0), threading.Lock()
    it.start_identification(turn, set)
    it.add("a")
    it.add("b\udcff")
    link.other.setblocking(False)
    with pytest.raises(BlockingIOError):
        link.other.recv(100)
    link.other.settimeout(60)
    with turn:
        it.flush()
    assert link.other.recv(100) == serialize_string("a") + pack("<II", 6, 2) + b"b\xff"
    end = time.monotonic() + 20
    while link.stat_num_msg != 2 and time.monotonic() < end:  # it is counted after it was sent
        time.sleep(0.01)
    assert link.stat_num_msg == 2
    monkeypatch.setattr(text_topics, "MAX_TEXTS_PER_WRITE", 2)
    with turn:
        it.add("c")
        it.add("d")
    assert link.other.recv(100) == serialize_string("c") + serialize_string("d")


def received(link, text):
    """Return what comes until a text."""
    data = b""
    while not data.endswith(serialize_string(text)):
        part = link.other.recv(1000)
        assert part
        data += part
    return data


def test_outputs_go_to_the_interface_in_order(outlet, link, monkeypatch):
    asked = []

    def offering(service):
        asked.append(service)
        return {link.endpoint_id}

    monkeypatch.setattr(late_joiners, "find_nodes_offering", offering)
    it = OutputTextPublisher("/topic", 1000, Reports(), ["out", "foo bar"], [])
    for topic, text in (("out", "a"), ("watched", "b"), ("/out", "c"), ("not a name", "d")):
        it.send(topic, text.__str__)
    assert received(link, "d") == b"".join(map(serialize_string, "abcd"))
    assert set(asked) == {"add_input_subscription"}


def test_outputs_that_the_interface_publishes_wait_for_it_and_others_are_not_even_written(monkeypatch):
    connections, written, listeners = [], [], []

    def publisher(topic, kind, listener, latch, queue_size):
        listeners.append(listener)
        return SimpleNamespace(name=topic, impl=SimpleNamespace(connections=connections), listener=listener)

    def write(text):
        return lambda: written.append(text) or text

    monkeypatch.setattr(rospy, "Publisher", publisher)
    reports = Reports()
    it = OutputTextPublisher("/topic", 2, reports, ["out", "state"], ["state"])
    for topic, text in (("state", "s"), ("watched", "w"), ("out", "a"), ("out", "b")):
        it.send(topic, write(text))
    assert (written, reports.warnings) == (["s", "a", "b"], 1)  # the queue holds two
    for after in (b"sab", b"sc"):
        link = Link()
        monkeypatch.setattr(
            late_joiners, "find_nodes_offering", lambda service, name=link.endpoint_id: {name}
        )
        connections[:] = []
        if after == b"sc":
            it.send("out", write("c"))
        connections[:] = [link]
        listeners[-1].peer_subscribe("/topic", None, None)
        assert received(link, chr(after[-1])) == b"".join(serialize_string(chr(one)) for one in after)
        link.socket.close()
        link.other.close()
