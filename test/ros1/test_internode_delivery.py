"""Delivery of buffered texts to a node that joins late. Needs rospy, no master."""

import socket
from types import SimpleNamespace
from typing import Any, List

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports, RuleError  # noqa: E402
from retalis.ros1 import internode_delivery  # noqa: E402
from retalis.ros1.internode_delivery import ENGINE, INTERFACE, MAX_IDENTIFICATION_ATTEMPTS, LatePeerBuffer  # noqa: E402


class Link:
    """A connection."""

    def __init__(self) -> None:
        self.received: List[Any] = []
        self.done = False


class TopicWriter:
    """Records the frames that are written to each connection."""

    def __init__(self) -> None:
        self._open: List[Any] = []
        self.counts = SimpleNamespace(sent=0, dropped=0)

    def connections(self) -> Any:
        return self._open

    def write(self, connections: Any, frames: Any, number: Any) -> None:
        for link in connections:
            link.received.append(frames)

    def connect(self) -> Any:
        link = Link()
        self._open = [*self._open, link]
        return link


@pytest.fixture
def topic_writer() -> TopicWriter:
    return TopicWriter()


@pytest.fixture
def reports() -> Any:
    return Reports()


@pytest.fixture
def make_buffer(topic_writer: Any, reports: Any) -> Any:
    return lambda queue=100, epoch=lambda: 0: LatePeerBuffer(topic_writer, ENGINE, queue, reports, epoch)


def test_texts_before_connection_are_buffered(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.send(b"1", 1)
    buffer.send(b"2", 1)
    engine = topic_writer.connect()
    buffer.send(b"3", 1)
    assert engine.received == []
    buffer.identify(engine, True)
    buffer.send(b"4", 1)
    assert engine.received == [b"123", b"4"]


def test_other_subscribers_get_later_texts(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.send(b"1", 1)
    other = topic_writer.connect()
    assert buffer.subscribers_to_identify() == [other]
    buffer.send(b"2", 1)
    buffer.identify(other, False)
    buffer.send(b"3", 1)
    engine = topic_writer.connect()
    buffer.send(b"4", 1)
    buffer.identify(engine, True)
    buffer.send(b"5", 1)
    assert other.received == [b"2", b"3", b"4", b"5"]
    assert engine.received == [b"1234", b"5"]


def test_each_peer_gets_newest_latched_messages_once(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.latch("map", lambda: b"A", 1)
    buffer.send(b"a", 1)
    buffer.send(b"1", 1)
    buffer.latch("map", lambda: b"B", 1)
    buffer.send(b"b", 1)
    first = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(first, True)
    buffer.send(b"2", 1)
    assert first.received == [b"a1b", b"2"]
    first.done = True
    buffer.send(b"3", 1)
    second = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(second, True)
    assert first.received == [b"a1b", b"2"]
    assert second.received == [b"B3"]


def test_late_identified_peer_gets_missing_texts(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.latch("map", lambda: b"A", 1)
    buffer.send(b"a", 1)
    engine = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(engine, False)
    buffer.send(b"1", 1)
    assert buffer.subscribers_to_identify() == [engine]
    buffer.identify(engine, True)
    buffer.send(b"2", 1)
    assert engine.received == [b"1", b"a", b"2"]
    assert buffer.subscribers_to_identify() == []


def test_third_party_is_known_after_identification(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    engine, other = topic_writer.connect(), topic_writer.connect()
    assert buffer.subscribers_to_identify() == [engine, other]
    assert not buffer.is_third_party(other)
    buffer.identify(engine, True)
    buffer.identify(other, False)
    assert buffer.is_third_party(other)
    assert not buffer.is_third_party(engine)


def test_identification_attempts_are_limited(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    other = topic_writer.connect()
    attempts = 0
    while buffer.subscribers_to_identify():
        buffer.identify(other, False)
        attempts += 1
    assert attempts == MAX_IDENTIFICATION_ATTEMPTS


def test_full_buffer_drops_and_counts_oldest_texts(topic_writer: Any, make_buffer: Any, reports: Any) -> None:
    buffer = make_buffer(queue=5)
    for number in range(4):
        buffer.send(b"%d%d" % (number, number), 2)
    assert (reports.warnings, topic_writer.counts.dropped, topic_writer.counts.sent) == (4, 4, 8)
    engine = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(engine, True)
    assert engine.received == [b"2233"]


def test_size_of_buffered_texts_is_limited(
    make_buffer: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(internode_delivery, "MAX_BUFFERED_BYTES", 10)
    buffer = make_buffer()
    for _ in range(2):
        buffer.send(b"12345", 1)
    assert reports.warnings == 0
    buffer.send(b"12345", 1)
    assert reports.warnings == 1


def test_number_of_latched_messages_is_limited(
    make_buffer: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(internode_delivery, "MAX_LATCHED_MESSAGES", 2)
    buffer = make_buffer()
    for key in ("a", "b", "b", "c"):
        buffer.latch(key, key.encode, 1)
        buffer.send(b"-", 1)
    assert set(buffer.latched_batch_numbers()) == {"b", "c"}
    assert reports.warnings == 1


def test_size_of_latched_messages_is_limited(
    make_buffer: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(internode_delivery, "MAX_BUFFERED_BYTES", 10)
    buffer = make_buffer()
    for key, size in (("a", 1), ("b", 1), ("c", 9)):
        buffer.latch(key, key.encode, size)
    assert set(buffer.latched_batch_numbers()) == {"b", "c"}
    assert reports.warnings == 1


def test_latched_message_beyond_limit_leaves_others(
    make_buffer: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(internode_delivery, "MAX_BUFFERED_BYTES", 10)
    buffer = make_buffer()
    for key, size in (("a", 1), ("b", 1), ("b", 11), ("c", 11)):
        buffer.latch(key, key.encode, size)
    # An old message is not stored in place of a newer one.
    assert set(buffer.latched_batch_numbers()) == {"a"}
    assert reports.warnings == 2


def test_discard_keeps_newer_latched_messages(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    for key in ("a", "b"):
        buffer.latch(key, key.encode, 1)
        buffer.send(b"-", 1)
    old = buffer.latched_batch_numbers()
    buffer.latch("b", b"B".upper, 1)
    buffer.send(b"-", 1)
    buffer.discard(old)
    assert set(buffer.latched_batch_numbers()) == {"b"}


def test_marks_are_sent_to_peer_only(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.send(b"a", 1, b"<mark a>")
    engine, other = topic_writer.connect(), topic_writer.connect()
    buffer.send(b"b", 1, b"<mark b>")
    buffer.identify(engine, True)
    buffer.identify(other, False)
    buffer.send(b"c", 1, b"<mark c>")
    assert engine.received == [b"<mark a>a<mark b>b", b"<mark c>c"]
    assert other.received == [b"b", b"c"]


def test_unneeded_texts_wait_for_identification(topic_writer: Any, make_buffer: Any) -> None:
    buffer = make_buffer()
    buffer.send(b"a", 1, for_peer=False)
    other = topic_writer.connect()
    buffer.send(b"b", 1, for_peer=False)
    buffer.identify(other, False)
    buffer.send(b"c", 1, for_peer=False)
    buffer.send(b"d", 1)
    peer = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(peer, True)
    assert other.received == [b"b", b"c", b"d"]
    assert peer.received == [b"bd"]


def test_unneeded_texts_count_as_no_loss(topic_writer: Any, make_buffer: Any, reports: Any) -> None:
    buffer = make_buffer(queue=3)
    for _ in range(10):
        buffer.send(b"a", 1, for_peer=False)
    assert (reports.warnings, topic_writer.counts.dropped) == (0, 0)


def test_warning_names_peer(topic_writer: Any, reports: Any, caplog: pytest.LogCaptureFixture) -> None:
    buffer = LatePeerBuffer(topic_writer, INTERFACE, 1, reports)
    for _ in range(2):
        buffer.send(b"a", 1)
    assert [record.getMessage() for record in caplog.records] == [
        "the ROS interface is not connected: the oldest event that is buffered for it is dropped"
    ]


def test_texts_of_previous_epoch_are_discarded(topic_writer: Any, make_buffer: Any) -> None:
    epoch = [0]
    buffer = make_buffer(epoch=lambda: epoch[0])
    buffer.send(b"1", 1)
    epoch[0] = 1
    buffer.send(b"2", 1)
    engine = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(engine, True)
    assert engine.received == [b"2"]


def test_error_of_latched_message_is_reported(topic_writer: Any, make_buffer: Any, reports: Any) -> None:
    def write() -> None:
        raise RuleError("no such year")

    buffer = make_buffer()
    buffer.latch("map", write, 1)
    buffer.send(b"a", 1)
    first = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(first, True)
    assert (first.received, reports.errors) == ([b"a"], 0)
    first.done = True
    second = topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(second, True)
    assert (second.received, reports.errors) == ([], 1)


def test_closed_connection_is_detected() -> None:
    own_socket, other = socket.socketpair()
    link = SimpleNamespace(_connection=SimpleNamespace(socket=own_socket))
    assert not internode_delivery.has_ended(link)
    other.close()
    assert internode_delivery.has_ended(link)
    own_socket.close()
    assert internode_delivery.has_ended(link)
    assert internode_delivery.has_ended(SimpleNamespace(socket=None, done=True))
    assert not internode_delivery.has_ended(SimpleNamespace())


def test_peer_gets_preamble_first(topic_writer: Any, reports: Any) -> None:
    buffer = LatePeerBuffer(topic_writer, ENGINE, 100, reports, lambda: 0, lambda: b"run ")
    buffer.send(b"before", 1)
    node, other = topic_writer.connect(), topic_writer.connect()
    buffer.subscribers_to_identify()
    buffer.identify(node, True)
    buffer.identify(other, False)
    buffer.send(b"after", 1)
    assert node.received == [b"run before", b"after"]
    assert other.received[-1] == b"after"
    assert b"run " not in b"".join(other.received)
