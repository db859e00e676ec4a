"""Batched reading of connections. Needs rospy, no master."""

import socket
import struct
from io import BytesIO
from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from rospy.exceptions import TransportException, TransportTerminated  # noqa: E402

from retalis.ros1 import batched_socket_reader  # noqa: E402
from retalis.ros1.batched_socket_reader import (  # noqa: E402
    MAX_SINGLE_MESSAGE_WINDOWS,
    MAX_WINDOW_TIMEOUTS,
    WINDOW_WAKE_UPS,
    ConnectionReader,
    LowWaterMark,
    _ignore_end,
    read_in_batches,
)

HEADER = {"type": "std_msgs/String", "callerid": "/talker"}


def frame(data):
    return struct.pack("<I", len(data)) + data


@pytest.fixture
def pair():
    """Return both ends of a TCP connection."""
    with socket.socket() as listening:
        listening.bind(("localhost", 0))
        listening.listen(1)
        sender = socket.create_connection(listening.getsockname())
        receiver, _ = listening.accept()
    yield sender, receiver
    sender.close()
    receiver.close()


def new_link(receiver, read=b"", latched=False):
    buffer = BytesIO()
    buffer.write(read)
    return SimpleNamespace(
        socket=receiver,
        header=HEADER,
        read_buff=buffer,
        done=False,
        stat_bytes=0,
        stat_num_msg=0,
        is_latched=latched,
        latch=None,
        receive_once=None,
    )


def callback(message):
    raise AssertionError("rospy calls it, the reader does not")


def subscribed(callbacks=(callback,), **topic):
    topic = SimpleNamespace(callbacks=[(one, None) for one in callbacks], **topic)
    return SimpleNamespace(impl=topic, callback=callback)


def new_reader(link, taken, callbacks=(callback,)):
    return ConnectionReader(link, subscribed(callbacks), lambda header: taken.append, 0.001, _ignore_end)


def send_in_pieces(sender, data, size):
    for at in range(0, len(data), size):
        sender.sendall(data[at : at + size])
    sender.close()


@pytest.mark.parametrize("size", [1, 3, 5, 1000])
@pytest.mark.parametrize("read", [b"", frame(b"first"), frame(b"first")[:2], frame(b"first")[:7]])
def test_messages_are_handed_on_wherever_they_are_cut(pair, monkeypatch, size, read):
    sender, receiver = pair
    monkeypatch.setattr(batched_socket_reader, "MAX_READ_BYTES", size)
    messages = [b"first", b"", b"second", b"x" * 300]
    stream = b"".join(map(frame, messages))
    assert stream.startswith(read)
    link, taken = new_link(receiver, read), []
    send_in_pieces(sender, stream[len(read) :], 7)
    with pytest.raises(TransportTerminated):
        new_reader(link, taken)()
    assert [one for found in taken for one in found] == messages
    assert link.stat_num_msg == len(messages)
    assert link.stat_bytes == len(stream) - len(read)


def test_messages_that_come_together_are_handed_on_together(pair):
    sender, receiver = pair
    taken = []
    send_in_pieces(sender, frame(b"one") + frame(b"two"), 1000)
    with pytest.raises(TransportTerminated):
        new_reader(new_link(receiver), taken)()
    assert taken == [[b"one", b"two"]]


@pytest.mark.parametrize("callbacks", [(callback, print), (print,)], ids=["too", "only"])
def test_messages_go_to_rospy_where_others_have_called_for_them(pair, callbacks):
    sender, receiver = pair
    taken = []
    sender.sendall(frame(b"one") + frame(b"two"))
    messages = new_reader(new_link(receiver), taken, callbacks)()
    assert [message._buff for message in messages] == [b"one", b"two"]
    assert all(message._connection_header is HEADER for message in messages)
    assert taken == []


@pytest.mark.parametrize("missing", ["latch", "is_latched", "stat_num_msg", "socket"])
def test_connections_that_lack_something_stay_rospys(missing):
    link = new_link(None)
    delattr(link, missing)
    subscriber = subscribed(data_class=rospy.AnyMsg, connections=[link], add_connection=lambda link: True)
    read_in_batches(subscriber, print, 0.001)
    assert link.receive_once is None


@pytest.mark.parametrize("callbacks", [None, (), [callback], {callback: None}])
def test_topics_that_keep_their_callbacks_otherwise_stay_rospys(callbacks):
    link = new_link(None)
    subscriber = subscribed(data_class=rospy.AnyMsg, connections=[link], add_connection=lambda link: True)
    subscriber.impl.callbacks = callbacks
    read_in_batches(subscriber, print, 0.001)
    assert link.receive_once is None
    del subscriber.impl.callbacks
    read_in_batches(subscriber, print, 0.001)
    assert link.receive_once is None


def test_the_last_message_of_a_latched_topic_is_kept(pair):
    sender, receiver = pair
    link = new_link(receiver, latched=True)
    send_in_pieces(sender, frame(b"one") + frame(b"two"), 1000)
    with pytest.raises(TransportTerminated):
        new_reader(link, [])()
    assert link.latch._buff == b"two"


def test_a_connection_that_is_closed_ends(pair):
    _, receiver = pair
    reader = new_reader(new_link(receiver), [])
    receiver.close()
    with pytest.raises((TransportTerminated, OSError)):
        reader()
    with pytest.raises(TransportException):
        new_reader(new_link(None), [])()


@pytest.mark.parametrize(
    ("data", "is_incomplete"),
    [
        (b"", False),
        (frame(b"one"), False),
        (frame(b"one")[:2], True),
        (frame(b"one") + frame(b"two")[:6], True),
    ],
)
def test_end_of_connection_is_reported(pair, data, is_incomplete):
    sender, receiver = pair
    ends = []
    link = new_link(receiver)
    reader = ConnectionReader(
        link, subscribed(), lambda header: lambda messages: None, 0.001, lambda *end: ends.append(end)
    )
    send_in_pieces(sender, data, 1000)
    with pytest.raises(TransportTerminated):
        reader()
    assert ends == [(HEADER, is_incomplete)]


def test_connection_that_this_node_closes_has_no_loss(pair):
    sender, receiver = pair
    ends = []
    link = new_link(receiver)

    def close(messages):
        link.done = True

    reader = ConnectionReader(link, subscribed(), lambda header: close, 0.001, lambda *end: ends.append(end))
    send_in_pieces(sender, frame(b"one") + frame(b"two")[:6], 1000)
    assert reader() == []
    assert ends == []


def test_a_message_alone_arrives_where_several_are_waited_for(pair, monkeypatch):
    sender, receiver = pair
    link, taken = new_link(receiver), []

    def take(messages):
        taken.extend(messages)
        link.done = True

    class Patient(LowWaterMark):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.set_min_bytes(1000)

    monkeypatch.setattr(batched_socket_reader, "LowWaterMark", Patient)
    reader = ConnectionReader(link, subscribed(), lambda header: take, 0.001, _ignore_end)
    sender.sendall(frame(b"alone"))
    assert reader() == []
    assert taken == [b"alone"]


def subscriber(data_class=rospy.AnyMsg, connections=(), statistics=None):
    added = []
    found = subscribed(
        data_class=data_class,
        connections=list(connections),
        statistics_logger=statistics,
        add_connection=added.append,
    )
    return found, added


def ignore(header):
    return lambda messages: None


def test_connections_present_and_future_are_read(pair):
    present, future = new_link(pair[1]), new_link(pair[1])
    found, added = subscriber(connections=[present])
    read_in_batches(found, ignore, 0.001)
    found.impl.add_connection(future)
    assert isinstance(present.receive_once, ConnectionReader)
    assert isinstance(future.receive_once, ConnectionReader)
    assert added == [future]
    reader = present.receive_once
    found.impl.add_connection(present)
    assert present.receive_once is reader


@pytest.mark.parametrize("options", [{"data_class": rospy.Header}, {"statistics": object()}])
def test_topics_that_are_rospys_own_are_left_to_it(pair, options):
    link = new_link(pair[1])
    found, _ = subscriber(connections=[link], **options)
    read_in_batches(found, ignore, 0.001)
    assert link.receive_once is None


def test_connections_of_another_make_are_left_to_rospy():
    link = SimpleNamespace(receive_once=None)
    found, _ = subscriber(connections=[link])
    read_in_batches(found, ignore, 0.001)
    assert link.receive_once is None
    read_in_batches(SimpleNamespace(), ignore, 0.001)


class Options:
    """A socket that notes what it is told."""

    def __init__(self):
        self.min_bytes = 1
        self.timeout = None

    def setsockopt(self, level, option, value):
        if option == socket.SO_RCVLOWAT:
            self.min_bytes = value
        else:
            self.timeout = value


@pytest.fixture
def paced():
    """Return a socket, its pace, and a function that lets a window of wake-ups pass."""
    time = [0.0]
    sock = Options()
    pace = LowWaterMark(sock, 0.001, lambda: time[0])

    def window(seconds, messages, size=100, windows=1):
        for _ in range(windows * WINDOW_WAKE_UPS):
            time[0] += seconds / WINDOW_WAKE_UPS
            pace.record_wake_up(messages * size, messages)

    return sock, pace, window


linux = pytest.mark.skipif(
    not batched_socket_reader.sys.platform.startswith("linux"), reason="for Linux's sockets"
)


@linux
@pytest.mark.parametrize(("rate", "min_bytes"), [(500, 1), (1900, 1), (2500, 201), (9900, 901)])
def test_how_much_is_waited_for_goes_with_the_rate(paced, rate, min_bytes):
    sock, pace, window = paced
    window(WINDOW_WAKE_UPS / rate, 1)
    assert sock.min_bytes == pace.min_bytes == min_bytes
    assert (sock.timeout is None) == (min_bytes == 1)


@linux
def test_bursts_are_not_waited_for(paced):
    sock, _, window = paced
    window(4 * WINDOW_WAKE_UPS / 2500, 4)
    assert sock.min_bytes == 1


@linux
def test_when_it_gets_slower_each_message_is_read_at_once_again(paced):
    sock, _, window = paced
    window(WINDOW_WAKE_UPS / 2500, 1)
    assert sock.min_bytes > 1
    window(2 * WINDOW_WAKE_UPS / 900, 2)
    assert sock.min_bytes == 1
    assert sock.timeout == batched_socket_reader.NO_TIMEOUT


@linux
def test_where_waiting_is_in_vain_it_is_tried_ever_more_seldom(paced):
    sock, pace, window = paced
    pauses = []
    for _ in range(9):
        pauses.append(0)
        while sock.min_bytes == 1:
            window(WINDOW_WAKE_UPS / 2500, 1)
            pauses[-1] += 1
        for _ in range(MAX_WINDOW_TIMEOUTS + 1):
            pace.record_wake_up(0, 0)
        assert sock.min_bytes == 1
    assert pauses == [
        1,
        2,
        4,
        8,
        16,
        32,
        MAX_SINGLE_MESSAGE_WINDOWS,
        MAX_SINGLE_MESSAGE_WINDOWS,
        MAX_SINGLE_MESSAGE_WINDOWS,
    ]


def test_a_socket_that_cannot_wait_is_read_as_before(paced):
    sock, pace, window = paced

    def refuse(*arguments):
        raise OSError("no such option")

    sock.setsockopt = refuse
    window(WINDOW_WAKE_UPS / 2500, 1)
    assert pace.min_bytes == 1
