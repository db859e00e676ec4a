"""ROS 1 bags: writing and reading, damaged and malicious files, and the order and limits of chunks."""

import bz2
import resource
import signal
import threading
import tracemalloc
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any, Dict, Generator, List, Sequence, Tuple

import pytest
from asserting_accessors import compound
from malicious_bags import record, ros1_bag
from message_registries import empty_registry

from retalis import BagError, BagReader
from retalis.playback import decompression
from retalis.playback import rosbag1 as rosbag1_module
from retalis.playback.decompression import ChunkLimit
from retalis.playback.rosbag1 import MAX_CHUNKS_AHEAD, MAX_REPEATS, Chunk, read_chunks

pytest.importorskip("rosbags")


from retalis import BagWriter, Definitions, RetalisError, Topic, atom  # noqa: E402

BAGS = Path(__file__).parents[3] / "shared" / "bags"
RECORDED_BAGS = sorted(BAGS.glob("*.bag")) if BAGS.is_dir() else []


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of two topics; the second has two publishers."""
    path = tmp_path / "some.bag"
    definitions = empty_registry()
    string_type = definitions.add("std_msgs/String", "string data\n")
    number_type = definitions.add(
        "pkg/Number", "int8 x # of what\nUnit unit\n" + "=" * 80 + "\nMSG: pkg/Unit\nint8 y\n"
    )
    with BagWriter(path) as writer:
        talker = writer.add("/talk", string_type, latched=True, caller="/talker")
        first, second = (
            writer.add("/numbers", number_type, caller="/one"),
            writer.add("/numbers", number_type, caller="/other"),
        )
        writer.write(first, 3_000_000_001, b"\1\1")
        writer.write(talker, 1_000_000_001, b"\2\0\0\0hi")
        writer.write(second, 2_000_000_001, b"\2\2")
    return path


def test_written_records_are_read_by_time(bag: Path) -> None:
    with BagReader(bag) as reader:
        assert (reader.messages, reader.start, reader.end) == (3, 1_000_000_001, 3_000_000_001)
        assert [(topic.name, topic.type, topic.messages) for topic in reader.topics] == [
            ("/talk", "std_msgs/String", 1),
            ("/numbers", "pkg/Number", 1),
            ("/numbers", "pkg/Number", 1),
        ]
        assert reader.topics[0] == Topic(
            "/talk",
            "std_msgs/String",
            "string data\n",
            "992ce8a1687cec8c8bd883ec73ca41d1",
            1,
            True,
            "/talker",
        )
        assert [(record.topic.name, record.time, record.data) for record in reader.records()] == [
            ("/talk", 1_000_000_001, b"\2\0\0\0hi"),
            ("/numbers", 2_000_000_001, b"\2\2"),
            ("/numbers", 3_000_000_001, b"\1\1"),
        ]


@pytest.mark.parametrize("topics", [["/numbers"], ["numbers", "other"], {"/numbers"}])
def test_records_are_filtered_by_topic(bag: Path, topics: Any) -> None:
    with BagReader(bag) as reader:
        assert [record.data for record in reader.records(topics)] == [b"\2\2", b"\1\1"]
        assert list(reader.records(["other"])) == []


def test_definitions_are_stored_in_bag(bag: Path) -> None:
    definitions = empty_registry()
    with BagReader(bag) as reader:
        topic = reader.topics[1]
        definition = definitions.add(topic.type, topic.definition)
    assert definition.md5sum == topic.md5sum
    assert definition.dependencies()[0].name == "pkg/Unit"


def test_empty_bag_has_no_records(tmp_path: Path) -> None:
    BagWriter(tmp_path / "empty.bag").close()
    with BagReader(tmp_path / "empty.bag") as reader:
        assert (reader.messages, reader.start, reader.end, list(reader.records())) == (0, 0, 0, [])


def test_existing_bag_is_not_overwritten(bag: Path) -> None:
    with pytest.raises(BagError, match="already exists"):
        BagWriter(bag)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_exception_keeps_old_bag(bag: Path, error: Any) -> None:
    old = bag.read_bytes()

    def write_and_fail() -> None:
        with BagWriter(bag, overwrite=True) as writer:
            writer.write(writer.add("/a", Definitions().find("std_msgs/Empty")), 1, b"")
            raise error

    with pytest.raises(error):
        write_and_fail()
    assert bag.read_bytes() == old
    assert [path.name for path in bag.parent.iterdir()] == [bag.name]


@pytest.mark.parametrize("time", [-1, (1 << 32) * 10**9])
def test_time_that_bag_cannot_have_is_an_error(tmp_path: Path, time: int) -> None:
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        connection = writer.add("/a", Definitions().find("std_msgs/Empty"))
        with pytest.raises(
            BagError, match=f"expected a time from 0 to 4294967295999999999 ns, found {time} ns"
        ):
            writer.write(connection, time, b"")
    assert list(tmp_path.iterdir()) == []


def test_full_disk_keeps_old_bag(bag: Path) -> None:
    old = bag.read_bytes()
    size_limit = resource.getrlimit(resource.RLIMIT_FSIZE)

    def write_messages() -> None:
        with BagWriter(bag, overwrite=True) as writer:
            connection = writer.add("/a", Definitions().find("std_msgs/String"))
            for number in range(100):
                writer.write(connection, number, bytes(1_000_000))

    # The signal of a file that grows beyond the limit is ignored, so that writing raises an error, as on a full disk.
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, size_limit[1]))
    try:
        with pytest.raises(BagError, match="cannot be written: .*File too large"):
            write_messages()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, size_limit)
        signal.signal(signal.SIGXFSZ, handler)
    assert bag.read_bytes() == old
    assert [path.name for path in bag.parent.iterdir()] == [bag.name]


def test_closed_bag_can_be_closed_again(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "empty.bag")
    assert not (tmp_path / "empty.bag").exists()
    writer.close()
    writer.close()
    assert BagReader(tmp_path / "empty.bag").messages == 0


def test_bag_in_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="cannot be written"):
        BagWriter(tmp_path / "missing" / "a.bag")


def test_missing_bag_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RetalisError, match=r"a\.bag: there is no such file"):
        BagReader(tmp_path / "a.bag")


@pytest.mark.parametrize(
    "content", [b"", b"no bag", b"#ROSBAG V1.2\n", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\nxxxxxxxxxxx"]
)
def test_file_of_other_format_is_an_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(BagError, match="not a complete ROS 1 bag"):
        BagReader(path)


def test_overwritten_bytes_raise_bag_errors_only(bag: Path, tmp_path: Path) -> None:
    content = bag.read_bytes()
    broken = tmp_path / "broken.bag"
    errors: List[Any] = []
    for position in range(0, len(content), 31):
        broken.write_bytes(content[:position] + b"\xff" * 8 + content[position + 8 :])
        try:
            with BagReader(broken) as reader:
                list(reader.records())
        except BagError as error:
            errors.append(error)
    # Bytes in the padding of the header do not matter; those in the index and in the chunk do.
    assert 5 < len(errors) < len(content) // 31


HOSTILE = [
    (
        {"stated": 4},
        "the chunk at byte 4109: it has more than the 4 bytes that its header states",
    ),
    (
        {"stated": 100},
        "the chunk at byte 4109: it ends after 55 bytes: its header states 100",
    ),
    (
        {"stated": 2 << 30},
        "the chunk at byte 4109 states 2147483648 bytes: expected at most 512 MB",
    ),
    (
        {"compression": "bz2", "packed": b"BZh9"},
        "the chunk at byte 4109: it ends after 0 bytes: its header states",
    ),
    ({"compression": "xz", "packed": b""}, "compression 'xz' is unknown: expected none, bz2, lz4 or zstd"),
    ({"entries": [3]}, "."),
    ({"entries": [1 << 31]}, "."),
    ({"entries": [0] * 12}, "the index names a message in the chunk at byte 4109 more than once"),
    ({"index_count": 1 << 30}, "."),
    ({"connections": 2}, "connection 0 is defined twice"),
    ({"infos": [0, 0]}, "the chunk at byte 4109 is inside another one"),
    ({"infos": [0] * 3000}, "its index refers to the same bytes repeatedly"),
]


@pytest.mark.parametrize(("changes", "expected"), HOSTILE)
def test_malicious_header_or_index_is_an_error(tmp_path: Path, changes: Any, expected: str) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_bag([[b"hello"]], **changes))
    with pytest.raises(BagError, match=expected), BagReader(path) as reader:
        list(reader.records())


def test_lengths_beyond_end_of_file_take_no_memory(tmp_path: Path) -> None:
    """Each length of the headers is replaced by nearly 4 GB, one at a time."""
    content = ros1_bag([[b"hello"], [b"world"]])
    path = tmp_path / "a.bag"
    positions = [
        position
        for position in range(13, len(content) - 4)
        if 0 < int.from_bytes(content[position : position + 4], "little") < 5000
    ]
    tracemalloc.start()
    try:
        for position in positions:
            path.write_bytes(content[:position] + b"\xf0\xff\xff\xff" + content[position + 4 :])
            try:
                with BagReader(path) as reader:
                    list(reader.records())
            except BagError:
                pass
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()
    assert len(positions) > 50


@pytest.mark.parametrize(
    "path",
    RECORDED_BAGS or [pytest.param(None, marks=pytest.mark.skip(reason="needs recorded bags"))],
    ids=str,
)
def test_recorded_messages_round_trip(path: Any) -> None:
    definitions = empty_registry()
    with BagReader(path) as reader:
        assert reader.messages > 0
        for record in reader.records():
            definition = definitions.add(record.topic.type, record.topic.definition)
            assert definition.md5sum == record.topic.md5sum
            decoder = definitions.decoder(definition)
            term = decoder.decode(record.data)
            stamp = decoder.stamp(record.data)
            assert stamp is None or stamp > 0
            assert definitions.encoder(definition).encode(term) == record.data


@pytest.mark.skipif(not RECORDED_BAGS, reason="needs recorded bags")
def test_recorded_transform_is_decoded() -> None:
    definitions = empty_registry()
    with BagReader(BAGS / "pr2_mylaserdata.bag") as reader:
        record = next(iter(reader.records(["tf"])))
        term = definitions.decoder(definitions.add(record.topic.type, record.topic.definition)).decode(
            record.data
        )
    transform = compound(term)[1][1]
    assert transform[0].name == "geometry_msgs__0__TransformStamped"
    assert transform[1][3].__class__ is type(atom("a"))


def test_empty_file_is_named_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "empty.bag"
    path.touch()
    with pytest.raises(BagError) as raised:
        BagReader(path)
    assert str(raised.value) == f"{path} is not a complete ROS 1 bag: it does not begin with '#ROSBAG V2.0'"


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

    def unpack(*arguments: Any, original: Any = decompression.unpack) -> Any:
        calls.append(1)
        unpacked.release()
        return original(*arguments)

    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr(rosbag1_module, "unpack", unpack)
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

    def unpack(compression: Any, data: Any, size: Any, original: Any = decompression.unpack) -> Any:
        unpacked_sizes.append(size)
        return original(compression, data, size)

    monkeypatch.setattr("os.cpu_count", lambda: cores)
    monkeypatch.setattr(rosbag1_module, "unpack", unpack)
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
            pairs = [(left.time, right.time) for left, right in zip(first, second)]
    assert pairs == [(1, 1), (3, 2), (5, 3)]


def test_message_inside_another_one_is_an_error(tmp_path: Path) -> None:
    header = {b"op": b"\2", b"conn": bytes(4), b"time": (2).to_bytes(4, "little") + bytes(4)}
    inner = record(header, b"\2\0\0\0hi")
    offset = len(record(header, bytes(4)))
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_bag([[inner]], entries=[0, offset]))
    with pytest.raises(BagError, match="the index names a message in the chunk at byte 4109 more than once"):
        read_times(path)
