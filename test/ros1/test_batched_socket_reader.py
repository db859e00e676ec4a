"""Batched reading of connections. Needs rospy, no master."""

import socket
import struct
import sys
from io import BytesIO
from types import SimpleNamespace
from typing import Any, Dict, Iterator, List, Tuple

import pytest
from asserting_accessors import fail

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


def frame(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


@pytest.fixture
def pair() -> Iterator[Any]:
    """Return both ends of a TCP connection."""
    with socket.socket() as listening:
        listening.bind(("localhost", 0))
        listening.listen(1)
        sender = socket.create_connection(listening.getsockname())
        receiver, _ = listening.accept()
    yield sender, receiver
    sender.close()
    receiver.close()


def new_link(receiver: Any, read: bytes = b"", latched: bool = False) -> Any:
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


def callback(message: Any) -> None:
    raise AssertionError("only rospy calls it, not the reader")


def make_subscriber(callbacks: Any = (callback,), **topic: Any) -> Any:
    impl = SimpleNamespace(callbacks=[(function, None) for function in callbacks], **topic)
    return SimpleNamespace(impl=impl, callback=callback)


def new_reader(link: Any, batches: Any, callbacks: Any = (callback,)) -> ConnectionReader:
    return ConnectionReader(
        link, make_subscriber(callbacks), lambda header: batches.append, 0.001, _ignore_end
    )


def send_in_pieces(sender: Any, data: Any, size: int) -> None:
    for position in range(0, len(data), size):
        sender.sendall(data[position : position + size])
    sender.close()


@pytest.mark.parametrize("size", [1, 3, 5, 1000])
@pytest.mark.parametrize("read", [b"", frame(b"first"), frame(b"first")[:2], frame(b"first")[:7]])
def test_messages_are_read_at_any_cut(
    pair: Tuple[Any, ...], monkeypatch: pytest.MonkeyPatch, size: int, read: Any
) -> None:
    sender, receiver = pair
    monkeypatch.setattr(batched_socket_reader, "MAX_READ_BYTES", size)
    messages = [b"first", b"", b"second", b"x" * 300]
    stream = b"".join(map(frame, messages))
    assert stream.startswith(read)
    link = new_link(receiver, read)
    batches: List[Any] = []
    send_in_pieces(sender, stream[len(read) :], 7)
    with pytest.raises(TransportTerminated):
        new_reader(link, batches)()
    assert [message for batch in batches for message in batch] == messages
    assert link.stat_num_msg == len(messages)
    assert link.stat_bytes == len(stream) - len(read)


def test_adjacent_messages_are_one_batch(pair: Tuple[Any, ...]) -> None:
    sender, receiver = pair
    batches: List[Any] = []
    send_in_pieces(sender, frame(b"one") + frame(b"two"), 1000)
    with pytest.raises(TransportTerminated):
        new_reader(new_link(receiver), batches)()
    assert batches == [[b"one", b"two"]]


@pytest.mark.parametrize("callbacks", [(callback, print), (print,)], ids=["too", "only"])
def test_other_callbacks_receive_messages_of_rospy(pair: Tuple[Any, ...], callbacks: Tuple[Any, ...]) -> None:
    sender, receiver = pair
    batches: List[Any] = []
    sender.sendall(frame(b"one") + frame(b"two"))
    messages = new_reader(new_link(receiver), batches, callbacks)()
    assert [message._buff for message in messages] == [b"one", b"two"]
    assert all(message._connection_header is HEADER for message in messages)
    assert batches == []


@pytest.mark.parametrize("missing", ["latch", "is_latched", "stat_num_msg", "socket"])
def test_connection_without_attribute_is_unchanged(missing: str) -> None:
    link = new_link(None)
    delattr(link, missing)
    subscriber = make_subscriber(
        data_class=rospy.AnyMsg, connections=[link], add_connection=lambda link: True
    )
    read_in_batches(subscriber, lambda header: fail(header), 0.001)
    assert link.receive_once is None


@pytest.mark.parametrize("callbacks", [None, (), [callback], {callback: None}])
def test_topic_with_other_callbacks_is_unchanged(callbacks: Any) -> None:
    link = new_link(None)
    subscriber = make_subscriber(
        data_class=rospy.AnyMsg, connections=[link], add_connection=lambda link: True
    )
    subscriber.impl.callbacks = callbacks
    read_in_batches(subscriber, lambda header: fail(header), 0.001)
    assert link.receive_once is None
    del subscriber.impl.callbacks
    read_in_batches(subscriber, lambda header: fail(header), 0.001)
    assert link.receive_once is None


def test_last_message_of_latched_topic_is_stored(pair: Tuple[Any, ...]) -> None:
    sender, receiver = pair
    link = new_link(receiver, latched=True)
    send_in_pieces(sender, frame(b"one") + frame(b"two"), 1000)
    with pytest.raises(TransportTerminated):
        new_reader(link, [])()
    assert link.latch._buff == b"two"


def test_closed_connection_ends(pair: Tuple[Any, ...]) -> None:
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
def test_end_of_connection_is_reported(pair: Tuple[Any, ...], data: Any, is_incomplete: bool) -> None:
    sender, receiver = pair
    ends: List[Any] = []
    link = new_link(receiver)
    reader = ConnectionReader(
        link, make_subscriber(), lambda header: lambda messages: None, 0.001, lambda *end: ends.append(end)
    )
    send_in_pieces(sender, data, 1000)
    with pytest.raises(TransportTerminated):
        reader()
    assert ends == [(HEADER, is_incomplete)]


def test_connection_closed_by_node_has_no_loss(pair: Tuple[Any, ...]) -> None:
    sender, receiver = pair
    ends: List[Any] = []
    link = new_link(receiver)

    def close(messages: Any) -> None:
        link.done = True

    reader = ConnectionReader(
        link, make_subscriber(), lambda header: close, 0.001, lambda *end: ends.append(end)
    )
    send_in_pieces(sender, frame(b"one") + frame(b"two")[:6], 1000)
    assert reader() == []
    assert ends == []


def test_single_message_is_read_after_timeout(pair: Tuple[Any, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    sender, receiver = pair
    link, received = new_link(receiver), []

    def receive(messages: Any) -> None:
        received.extend(messages)
        link.done = True

    class HighLowWaterMark(LowWaterMark):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.set_min_bytes(1000)

    monkeypatch.setattr(batched_socket_reader, "LowWaterMark", HighLowWaterMark)
    reader = ConnectionReader(link, make_subscriber(), lambda header: receive, 0.001, _ignore_end)
    sender.sendall(frame(b"alone"))
    assert reader() == []
    assert received == [b"alone"]


def make_topic_subscriber(
    data_class: Any = rospy.AnyMsg, connections: Any = (), statistics: Any = None
) -> Tuple[Any, ...]:
    """Return a subscriber and the list of connections that are added to its topic."""
    added: List[Any] = []
    subscriber = make_subscriber(
        data_class=data_class,
        connections=list(connections),
        statistics_logger=statistics,
        add_connection=added.append,
    )
    return subscriber, added


def ignore(header: Any) -> Any:
    return lambda messages: None


def test_present_and_future_connections_are_read(pair: Tuple[Any, ...]) -> None:
    present, future = new_link(pair[1]), new_link(pair[1])
    subscriber, added = make_topic_subscriber(connections=[present])
    read_in_batches(subscriber, ignore, 0.001)
    subscriber.impl.add_connection(future)
    assert isinstance(present.receive_once, ConnectionReader)
    assert isinstance(future.receive_once, ConnectionReader)
    assert added == [future]
    reader = present.receive_once
    subscriber.impl.add_connection(present)
    assert present.receive_once is reader


@pytest.mark.parametrize("options", [{"data_class": rospy.Header}, {"statistics": object()}])
def test_topic_of_other_class_is_unchanged(pair: Tuple[Any, ...], options: Dict[str, Any]) -> None:
    link = new_link(pair[1])
    subscriber, _ = make_topic_subscriber(connections=[link], **options)
    read_in_batches(subscriber, ignore, 0.001)
    assert link.receive_once is None


def test_connection_of_other_class_is_unchanged() -> None:
    link = SimpleNamespace(receive_once=None)
    subscriber, _ = make_topic_subscriber(connections=[link])
    read_in_batches(subscriber, ignore, 0.001)
    assert link.receive_once is None
    read_in_batches(SimpleNamespace(), ignore, 0.001)


class OptionSocket:
    """A socket that records its options."""

    def __init__(self) -> None:
        self.min_bytes = 1
        self.timeout = None

    def setsockopt(self, level: Any, option: Any, value: Any) -> None:
        if option == socket.SO_RCVLOWAT:
            self.min_bytes = value
        else:
            self.timeout = value


@pytest.fixture
def socket_mark_window() -> Tuple[Any, ...]:
    """Return a socket, its low water mark, and a function that records windows of wake-ups."""
    time = [0.0]
    sock: Any = OptionSocket()
    mark = LowWaterMark(sock, 0.001, lambda: time[0])

    def window(seconds: Any, messages: int, size: int = 100, windows: int = 1) -> None:
        for _ in range(windows * WINDOW_WAKE_UPS):
            time[0] += seconds / WINDOW_WAKE_UPS
            mark.record_wake_up(messages * size, messages)

    return sock, mark, window


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="for Linux's sockets")


@linux
@pytest.mark.parametrize(("rate", "min_bytes"), [(500, 1), (1900, 1), (2500, 201), (9900, 901)])
def test_low_water_mark_follows_rate(socket_mark_window: Tuple[Any, ...], rate: int, min_bytes: int) -> None:
    sock, mark, window = socket_mark_window
    window(WINDOW_WAKE_UPS / rate, 1)
    assert sock.min_bytes == mark.min_bytes == min_bytes
    assert (sock.timeout is None) == (min_bytes == 1)


@linux
def test_bursts_have_no_low_water_mark(socket_mark_window: Tuple[Any, ...]) -> None:
    sock, _, window = socket_mark_window
    window(4 * WINDOW_WAKE_UPS / 2500, 4)
    assert sock.min_bytes == 1


@linux
def test_lower_rate_resets_low_water_mark(socket_mark_window: Tuple[Any, ...]) -> None:
    sock, _, window = socket_mark_window
    window(WINDOW_WAKE_UPS / 2500, 1)
    assert sock.min_bytes > 1
    window(2 * WINDOW_WAKE_UPS / 900, 2)
    assert sock.min_bytes == 1
    assert sock.timeout == batched_socket_reader.NO_TIMEOUT


@linux
def test_vain_waits_become_rarer(socket_mark_window: Tuple[Any, ...]) -> None:
    sock, mark, window = socket_mark_window
    pauses: List[Any] = []
    for _ in range(9):
        pauses.append(0)
        while sock.min_bytes == 1:
            window(WINDOW_WAKE_UPS / 2500, 1)
            pauses[-1] += 1
        for _ in range(MAX_WINDOW_TIMEOUTS + 1):
            mark.record_wake_up(0, 0)
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


def test_socket_without_option_has_no_low_water_mark(socket_mark_window: Tuple[Any, ...]) -> None:
    sock, mark, window = socket_mark_window

    def refuse(*arguments: Any) -> None:
        raise OSError("no such option")

    sock.setsockopt = refuse
    window(WINDOW_WAKE_UPS / 2500, 1)
    assert mark.min_bytes == 1
