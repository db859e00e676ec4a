"""Delivery of buffered texts to a node that joins late. Needs rospy, no master."""

import socket
from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports, RuleError  # noqa: E402
from retalis.ros1 import late_joiners  # noqa: E402
from retalis.ros1.late_joiners import ENGINE, INTERFACE, MAX_IDENTIFICATION_ATTEMPTS, LateJoinerBuffer  # noqa: E402


class Link:
    """A connection."""

    def __init__(self):
        self.got = []
        self.done = False


class TopicWriter:
    """Notes what is written to whom."""

    def __init__(self):
        self._open = []
        self.counts = SimpleNamespace(sent=0, dropped=0)

    def connections(self):
        return self._open

    def write(self, connections, frames, number):
        for link in connections:
            link.got.append(frames)

    def come(self):
        link = Link()
        self._open = [*self._open, link]
        return link


@pytest.fixture
def topic_writer():
    return TopicWriter()


@pytest.fixture
def reports():
    return Reports()


@pytest.fixture
def make(topic_writer, reports):
    return lambda queue=100, epoch=lambda: 0: LateJoinerBuffer(topic_writer, ENGINE, queue, reports, epoch)


def test_what_comes_before_node_retalis_is_held_for_it_in_order(topic_writer, make):
    it = make()
    it.send(b"1", 1)
    it.send(b"2", 1)
    engine = topic_writer.come()
    it.send(b"3", 1)
    assert engine.got == []
    it.identify(engine, True)
    it.send(b"4", 1)
    assert engine.got == [b"123", b"4"]


def test_others_get_what_comes_once_they_are_connected(topic_writer, make):
    it = make()
    it.send(b"1", 1)
    other = topic_writer.come()
    assert it.subscribers_to_identify() == [other]
    it.send(b"2", 1)
    it.identify(other, False)
    it.send(b"3", 1)
    engine = topic_writer.come()
    it.send(b"4", 1)
    it.identify(engine, True)
    it.send(b"5", 1)
    assert other.got == [b"2", b"3", b"4", b"5"]
    assert engine.got == [b"1234", b"5"]


def test_each_node_retalis_gets_the_newest_latched_messages_once(topic_writer, make):
    it = make()
    it.latch("map", lambda: b"A", 1)
    it.send(b"a", 1)
    it.send(b"1", 1)
    it.latch("map", lambda: b"B", 1)
    it.send(b"b", 1)
    first = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(first, True)
    it.send(b"2", 1)
    assert first.got == [b"a1b", b"2"]
    first.done = True
    it.send(b"3", 1)
    second = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(second, True)
    assert first.got == [b"a1b", b"2"]
    assert second.got == [b"B3"]


def test_a_receiver_that_turns_out_to_be_node_retalis_gets_the_rest_once(topic_writer, make):
    it = make()
    it.latch("map", lambda: b"A", 1)
    it.send(b"a", 1)
    engine = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(engine, False)
    it.send(b"1", 1)
    assert it.subscribers_to_identify() == [engine]
    it.identify(engine, True)
    it.send(b"2", 1)
    assert engine.got == [b"1", b"a", b"2"]
    assert it.subscribers_to_identify() == []


def test_who_only_looks_on_is_known_once_it_was_looked_up(topic_writer, make):
    it = make()
    engine, other = topic_writer.come(), topic_writer.come()
    assert it.subscribers_to_identify() == [engine, other]
    assert not it.is_third_party(other)
    it.identify(engine, True)
    it.identify(other, False)
    assert it.is_third_party(other)
    assert not it.is_third_party(engine)


def test_a_receiver_is_looked_up_only_so_often(topic_writer, make):
    it = make()
    other = topic_writer.come()
    looks = 0
    while it.subscribers_to_identify():
        it.identify(other, False)
        looks += 1
    assert looks == MAX_IDENTIFICATION_ATTEMPTS


def test_the_oldest_is_dropped_and_counted(topic_writer, make, reports, monkeypatch):
    it = make(queue=5)
    for number in range(4):
        it.send(b"%d%d" % (number, number), 2)
    assert (reports.warnings, topic_writer.counts.dropped, topic_writer.counts.sent) == (4, 4, 8)
    engine = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(engine, True)
    assert engine.got == [b"2233"]
    monkeypatch.setattr(late_joiners, "MAX_BUFFERED_BYTES", 10)
    engine.done = True
    for _ in range(3):
        it.send(b"12345", 1)
    assert reports.warnings == 5


def test_latched_messages_are_bounded(topic_writer, make, reports, monkeypatch):
    monkeypatch.setattr(late_joiners, "MAX_LATCHED_MESSAGES", 2)
    it = make()
    for key in ("a", "b", "b", "c"):
        it.latch(key, key.encode, 1)
        it.send(b"-", 1)
    assert set(it.latched_batch_numbers()) == {"b", "c"}
    monkeypatch.setattr(late_joiners, "MAX_BUFFERED_BYTES", 10)
    it.latch("d", b"d".upper, 9)
    assert set(it.latched_batch_numbers()) == {"c", "d"}
    assert reports.warnings == 2


def test_latched_messages_of_who_has_gone_are_forgotten_but_not_newer_ones(topic_writer, make):
    it = make()
    for key in ("a", "b"):
        it.latch(key, key.encode, 1)
        it.send(b"-", 1)
    gone = it.latched_batch_numbers()
    it.latch("b", b"B".upper, 1)
    it.send(b"-", 1)
    it.discard(gone)
    assert set(it.latched_batch_numbers()) == {"b"}


def test_only_the_peer_gets_marks(topic_writer, make):
    it = make()
    it.send(b"a", 1, b"<mark a>")
    engine, other = topic_writer.come(), topic_writer.come()
    it.send(b"b", 1, b"<mark b>")
    it.identify(engine, True)
    it.identify(other, False)
    it.send(b"c", 1, b"<mark c>")
    assert engine.got == [b"<mark a>a<mark b>b", b"<mark c>c"]
    assert other.got == [b"b", b"c"]


def test_what_the_peer_does_not_need_is_held_for_nobody_but_who_is_not_identified(topic_writer, make):
    it = make()
    it.send(b"a", 1, for_peer=False)
    other = topic_writer.come()
    it.send(b"b", 1, for_peer=False)
    it.identify(other, False)
    it.send(b"c", 1, for_peer=False)
    it.send(b"d", 1)
    peer = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(peer, True)
    assert other.got == [b"b", b"c", b"d"]
    assert peer.got == [b"bd"]


def test_nothing_is_dropped_that_the_peer_does_not_need(topic_writer, make, reports):
    it = make(queue=3)
    for _ in range(10):
        it.send(b"a", 1, for_peer=False)
    assert (reports.warnings, topic_writer.counts.dropped) == (0, 0)


def test_messages_name_the_peer(topic_writer, reports, caplog):
    it = LateJoinerBuffer(topic_writer, INTERFACE, 1, reports)
    for _ in range(2):
        it.send(b"a", 1)
    assert [record.getMessage() for record in caplog.records] == [
        "the ROS interface is not connected: the oldest event that is buffered for it is dropped"
    ]


def test_what_is_held_of_a_former_run_is_not_handed_over(topic_writer, make):
    epoch = [0]
    it = make(epoch=lambda: epoch[0])
    it.send(b"1", 1)
    epoch[0] = 1
    it.send(b"2", 1)
    engine = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(engine, True)
    assert engine.got == [b"2"]


def test_a_latched_message_that_cannot_be_written_again_is_reported(topic_writer, make, reports):
    def write():
        raise RuleError("no such year")

    it = make()
    it.latch("map", write, 1)
    it.send(b"a", 1)
    first = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(first, True)
    assert (first.got, reports.errors) == ([b"a"], 0)
    first.done = True
    second = topic_writer.come()
    it.subscribers_to_identify()
    it.identify(second, True)
    assert (second.got, reports.errors) == ([], 1)


def test_a_connection_that_has_ended_is_noticed_before_something_is_written_to_it():
    here, other = socket.socketpair()
    link = SimpleNamespace(_connection=SimpleNamespace(socket=here))
    assert not late_joiners.has_ended(link)
    other.close()
    assert late_joiners.has_ended(link)
    here.close()
    assert late_joiners.has_ended(link)
    assert late_joiners.has_ended(SimpleNamespace(socket=None, done=True))
    assert not late_joiners.has_ended(SimpleNamespace())


def test_node_retalis_gets_first_what_it_has_to_know_of_all(topic_writer, reports):
    it = LateJoinerBuffer(topic_writer, ENGINE, 100, reports, lambda: 0, lambda: b"run ")
    it.send(b"before", 1)
    node, other = topic_writer.come(), topic_writer.come()
    it.subscribers_to_identify()
    it.identify(node, True)
    it.identify(other, False)
    it.send(b"after", 1)
    assert node.got == [b"run before", b"after"]
    assert other.got[-1] == b"after"
    assert b"run " not in b"".join(other.got)
