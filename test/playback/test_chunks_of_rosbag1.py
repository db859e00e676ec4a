"""Chunks of ROS 1 bags: order, damaged chunks, decompression ahead, and chunks that are read again."""

import bz2
import threading
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any, Dict, Generator, List, Sequence, Tuple

import pytest
from malicious_bags import record, ros1_bag

from retalis import BagError, BagReader
from retalis.playback import decompression
from retalis.playback import rosbag1 as module
from retalis.playback.decompression import ChunkLimit
from retalis.playback.rosbag1 import MAX_CHUNKS_AHEAD, MAX_REPEATS, Chunk, read_chunks

LIMIT = ChunkLimit(1)
ChunkFile = Tuple[BytesIO, Dict[int, Chunk]]
TEXTS = [bytes([number]) * (number * 1000) for number in range(1, 9)]


def make_chunk_file(compression: str, texts: Sequence[bytes] = TEXTS) -> ChunkFile:
    """Return a file of chunks and their positions by number."""
    data = b""
    chunks: Dict[int, Chunk] = {}
    for number, text in enumerate(texts):
        chunk = bz2.compress(text) if compression == "bz2" else text
        chunks[number] = Chunk(len(data), len(chunk), len(text), compression)
        data += chunk
    return BytesIO(data), chunks


@pytest.fixture(params=["none", "bz2"])
def chunk_file(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ChunkFile:
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    return make_chunk_file(request.param)


def decompression_threads() -> List[Any]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("chunks of a bag")]


@pytest.mark.parametrize("cores", [1, 2, 8])
def test_chunks_are_yielded_in_requested_order(
    chunk_file: ChunkFile, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    order = [0, 0, 0, 1, 2, 2, 1, 7, 0, 0, 3]
    assert list(read_chunks(*chunk_file, order, LIMIT)) == [TEXTS[number] for number in (0, 1, 2, 1, 7, 0, 3)]
    assert list(read_chunks(*chunk_file, [], LIMIT)) == []
    assert decompression_threads() == []


def test_broken_chunk_is_an_error_in_its_turn(chunk_file: ChunkFile) -> None:
    file, chunks = chunk_file
    good = chunks[2]
    for broken in (
        good._replace(position=len(file.getvalue()) + 10),
        good._replace(size=good.size + 1),
        good._replace(size=good.size - 1),
        good._replace(size=2 << 20),
        good._replace(compression="xz"),
        None,
    ):
        if broken is None:
            del chunks[2]
        else:
            chunks[2] = broken
        texts = read_chunks(file, chunks, [0, 1, 2, 3], LIMIT)
        assert [next(texts), next(texts)] == TEXTS[:2]
        with pytest.raises(ValueError, match="chunk at byte 2"):
            next(texts)
    assert decompression_threads() == []


def test_number_of_chunks_ahead_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = threading.Semaphore(0)
    calls: List[Any] = []

    def unpack(*arguments: Any, really: Any = decompression.unpack) -> Any:
        calls.append(1)
        unpacked.release()
        return really(*arguments)

    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr(module, "unpack", unpack)
    texts = read_chunks(*make_chunk_file("bz2"), range(8), LIMIT)
    assert next(texts) == TEXTS[0]
    for _ in range(MAX_CHUNKS_AHEAD + 1):
        assert unpacked.acquire(timeout=60)
    assert len(calls) == MAX_CHUNKS_AHEAD + 1
    texts.close()
    assert len(calls) == MAX_CHUNKS_AHEAD + 1
    assert decompression_threads() == []


@pytest.mark.parametrize("cores", [1, 4])
def test_repeated_chunk_is_held_within_limit(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked_sizes: List[Any] = []

    def unpack(compression: Any, data: Any, size: Any, really: Any = decompression.unpack) -> Any:
        unpacked_sizes.append(size)
        return really(compression, data, size)

    monkeypatch.setattr("os.cpu_count", lambda: cores)
    monkeypatch.setattr(module, "unpack", unpack)
    texts = [bytes(300_000), bytes(400_000), bytes(900_000)]
    file, positions = make_chunk_file("bz2", texts)
    order = [0, 1] * 50
    assert [len(chunk) for chunk in read_chunks(file, positions, order, LIMIT)] == [300_000, 400_000] * 50
    assert sorted(unpacked_sizes) == [300_000, 400_000]
    unpacked_sizes.clear()
    # Both chunks together exceed the limit of held chunks.
    chunks = read_chunks(file, positions, [1, 2] * 50, LIMIT)
    with pytest.raises(ValueError, match="messages of large chunks alternate in time too often"):
        for _ in chunks:
            pass
    assert 0 < unpacked_sizes.count(900_000) <= MAX_REPEATS * 2 + 1


def test_compressed_bag_has_same_records(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    records_by_compression: List[Any] = []
    for name in ("NONE", "BZ2"):
        writer = rosbag1.Writer(tmp_path / f"{name}.bag")
        if name != "NONE":
            writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, name))
        writer.chunk_threshold = 1000
        writer.open()
        talk = writer.add_connection("/talk", "std_msgs/msg/String", msgdef="string data\n", md5sum="0" * 32)
        for number in range(1, 300):
            writer.write(talk, number, bytes([number % 256]) * number)
        writer.close()
        with BagReader(tmp_path / f"{name}.bag") as bag:
            records_by_compression.append(
                [(record.time, record.data) for record in bag.records(start=5, stop=290)]
            )
    assert records_by_compression[0] == records_by_compression[1]
    assert len(records_by_compression[0]) == 285


def write_bag(path: Any, times_by_topic: Any, chunk_size: int = 1) -> Any:
    """Write one topic after the other, each message in a chunk of its own by default."""
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    writer = rosbag1.Writer(path)
    writer.chunk_threshold = chunk_size
    writer.open()
    for topic, times in times_by_topic.items():
        connection = writer.add_connection(
            topic, "std_msgs/msg/String", msgdef="string data\n", md5sum="0" * 32
        )
        for time in times:
            writer.write(connection, time, bytes(100))
    writer.close()
    return path


def read_times(path: Any) -> List[Tuple[Any, ...]]:
    with BagReader(path) as bag:
        return [(record.topic.name, record.time) for record in bag.records()]


def test_topics_written_one_after_the_other_are_merged(tmp_path: Path) -> None:
    times = {"/a": range(1, 100, 2), "/b": range(2, 101, 2)}
    path = write_bag(tmp_path / "a.bag", times, chunk_size=1_000_000)
    assert read_times(path) == [("/a" if time % 2 else "/b", time) for time in range(1, 101)]


def test_messages_of_equal_time_are_in_order_of_their_topics(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag", {"/a": [1, 2], "/b": [1, 2]})
    assert read_times(path) == [("/a", 1), ("/b", 1), ("/a", 2), ("/b", 2)]


def test_passes_over_one_bag_are_independent(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag", {"/a": [1, 3, 5], "/b": [2, 4, 6]})
    with BagReader(path) as bag:
        first, second = bag.records(["/a"]), bag.records()
        assert isinstance(first, Generator)
        assert isinstance(second, Generator)
        with closing(first), closing(second):
            pairs = [(one.time, other.time) for one, other in zip(first, second)]
    assert pairs == [(1, 1), (3, 2), (5, 3)]


def test_message_inside_another_one_is_an_error(tmp_path: Path) -> None:
    header = {b"op": b"\2", b"conn": bytes(4), b"time": (2).to_bytes(4, "little") + bytes(4)}
    inner = record(header, b"\2\0\0\0hi")
    offset = len(record(header, bytes(4)))
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_bag([[inner]], entries=[0, offset]))
    with pytest.raises(BagError, match="the index names a message in the chunk at byte 4109 more than once"):
        read_times(path)
