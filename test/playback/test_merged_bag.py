"""Merged bags: order, intervals, ROS 2 bags, types that cannot be read, and compressed files."""

import json
import struct
import tempfile
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy
import pytest
from asserting_accessors import fail
from malicious_bags import packed_zeros, zstd
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from retalis import BagError, BagWriter, Definitions, Playback, RetalisError, UsageError
from retalis.playback.bag_locations import MergedBag
from retalis.playback.playback import RunRecorder
from retalis.prolog.syntax.event_text import to_text

SECOND = 10**9
STRING = Definitions().add("std_msgs/String", "string data")


def bag(path: Any, *seconds: Any, topic: str = "/chatter") -> Any:
    """Write a bag with a text at each of the given seconds."""
    with BagWriter(path) as writer:
        connection = writer.add(topic, STRING)
        for second in seconds:
            writer.write(connection, second * SECOND, struct.pack("<I", 2) + b"%2d" % second)
    return path


def read(bags: Any) -> List[Tuple[Any, ...]]:
    return [(record.topic.name, record.time // SECOND) for record in bags.records()]


def test_records_are_sorted_by_receipt_time(tmp_path: Path) -> None:
    paths = [bag(tmp_path / "a.bag", 1, 4, 5), bag(tmp_path / "b.bag", 2, 4, 9, topic="/other")]
    with MergedBag(paths) as bags:
        assert read(bags) == [
            (topic, second)
            for second, topic in [
                (1, "/chatter"),
                (2, "/other"),
                (4, "/chatter"),
                (4, "/other"),
                (5, "/chatter"),
                (9, "/other"),
            ]
        ]
        assert [record.time // SECOND for record in bags.records(["other"])] == [2, 4, 9]
        assert (bags.start, bags.end) == (SECOND, 9 * SECOND)


def test_records_are_limited_to_interval(tmp_path: Path) -> None:
    paths = [bag(tmp_path / "a.bag", 11, 14, 15), bag(tmp_path / "b.bag", 12, 19)]
    with MergedBag(paths, start=3) as bags:
        assert [second for _, second in read(bags)] == [14, 15, 19]
    with MergedBag(paths, start=1, duration=3) as bags:
        assert [second for _, second in read(bags)] == [12, 14]
        assert bags.end == 15 * SECOND
    with MergedBag(paths, duration=0) as bags:
        assert read(bags) == []
    with pytest.raises(UsageError, match="nothing 9 s after the first message: the last is at 8 s"):
        MergedBag(paths, start=9)


def test_repeated_bag_is_an_error(tmp_path: Path) -> None:
    path = bag(tmp_path / "a.bag", 1)
    with pytest.raises(UsageError, match="is given twice"):
        MergedBag([path, tmp_path / "." / "a.bag"])
    with pytest.raises(BagError, match="no bag is given"):
        MergedBag([])


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_compressed_ros1_bag_is_read(tmp_path: Path, compression: str) -> None:
    writer = rosbag1.Writer(tmp_path / "a.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with writer:
        options: Dict[str, Any] = {"msgdef": STRING.full_text, "md5sum": STRING.md5sum}
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", **options)
        writer.write(connection, SECOND, struct.pack("<I", 2) + b"hi")
    assert compression.lower().encode() in (tmp_path / "a.bag").read_bytes()
    with MergedBag([tmp_path / "a.bag"]) as bags:
        assert read(bags) == [("/chatter", 1)]


# ---- ROS 2 -------------------------------------------------------------------------------------------

OWN = "std_msgs/Header header\nfloat64 level\nbuiltin_interfaces/Time since\nuint8[] raw\n"
STORAGES = list(getattr(rosbag2, "StoragePlugin", [None]))


def ros2_bag(folder: Any, storage: Any) -> Any:
    """Write a ROS 2 bag with a message of a standard type and one of a custom type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(OWN, "my_msgs/msg/Level"))
    types = store.types
    time = types["builtin_interfaces/msg/Time"]
    header = types["std_msgs/msg/Header"]
    options = {} if storage is None else {"version": 9, "storage_plugin": storage}
    with rosbag2.Writer(folder, **options) as writer:
        text = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        level = writer.add_connection("/level", "my_msgs/msg/Level", typestore=store)
        hello = types["std_msgs/msg/String"](data="hello")
        writer.write(text, 3 * SECOND, store.serialize_cdr(hello, "std_msgs/msg/String"))
        raw = numpy.array([1, 2, 3], dtype=numpy.uint8)
        stamped = header(stamp=time(sec=4, nanosec=5), frame_id="tank")
        message = types["my_msgs/msg/Level"](header=stamped, level=0.5, since=time(sec=1, nanosec=2), raw=raw)
        writer.write(level, 5 * SECOND, store.serialize_cdr(message, "my_msgs/msg/Level"))
    return folder


@pytest.mark.parametrize("storage", STORAGES)
def test_events_of_ros2_bag_are_those_of_ros1(tmp_path: Path, storage: Any) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="chatter" msg_type="std_msgs/String"/>'
        '<subscribe_to name="level" msg_type="my_msgs/msg/Level"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("")
    records: List[Any] = []
    problems: List[Any] = []
    playback = Playback(program, problems.append)
    recorder = RunRecorder(playback, records.append)
    with MergedBag([ros2_bag(tmp_path / "two", storage)]) as bags:
        assert [topic.type for topic in bags.topics] == ["std_msgs/String", "my_msgs/Level"]
        assert list(playback.run(bags, lambda record: recorder.update_waits())) == []
    assert problems == []
    assert [(line["event"], line["start"]) for line in records] == [
        ("std_msgs__0__String('\"hello\"')", 3 * SECOND),
        (
            "my_msgs__0__Level(std_msgs__0__Header(0,[4,5],'\"tank\"'),0.5,[1,2],'\"FFFFFFFFFFAQID////\"')",
            4 * SECOND + 5,
        ),
    ]
    assert json.loads(json.dumps(records)) == records


BOUNDED = """\
uint8 BOX=1
string<=10 name "a # name"   # with a default value
string<=10[<=2] names
float64[<=3] dimensions [1.0, 2.0]
wstring<=30 text
byte code 200
geometry_msgs/msg/Point[<=1] points
"""
IDL = """\
================================================================================
IDL: my_msgs/msg/Few
module my_msgs {
  module msg {
    struct Few {
      string<5> name;
      sequence<double, 3> few;
      std_msgs::msg::Header header;
    };
  };
};
"""


def cdr_message(*fields: Any) -> bytes:
    """Return a message in CDR with fields, each a format of `struct` and its values."""
    return b"\0\1\0\0" + b"".join(struct.pack(f"<{code}", *values) for code, *values in fields)


def typed_bag(folder: Any, storage: Any, *connections: Any) -> Any:
    """Write a ROS 2 bag with one message per second.

    Args:
        folder: the folder of the bag.
        storage: the storage plugin, None for the only one.
        connections: topic, type, definition and messages of each connection.
    """
    options = {} if storage is None else {"version": 9, "storage_plugin": storage}
    with rosbag2.Writer(folder, **options) as writer:
        second = 0
        for topic, type_name, text, *messages in connections:
            connection = writer.add_connection(topic, type_name, msgdef=text, rihs01="RIHS01_0")
            for data in messages:
                second += 1
                writer.write(connection, second * SECOND, data)
    return folder


HELLO = cdr_message(("I6s", 6, b"hello\0"))


@pytest.mark.parametrize("storage", STORAGES)
def test_unreadable_type_excludes_only_its_topics(
    tmp_path: Path, storage: Any, caplog: pytest.LogCaptureFixture
) -> None:
    folder = typed_bag(
        tmp_path / "two",
        storage,
        ("/broken", "my_msgs/msg/Broken", "float64[<3] x\n", HELLO),
        ("/gone", "my_msgs/msg/Gone", "Lost lost\n", HELLO),
        ("/gone_too", "my_msgs/msg/Gone", "Lost lost\n", HELLO),
        ("/nested", "my_msgs/msg/Nested", "lost_msgs/msg/Lost lost\n", HELLO),
        ("/chatter", "std_msgs/msg/String", "string data\n", HELLO),
    )
    with MergedBag([folder]) as bags:
        assert [topic.name for topic in bags.topics] == ["/chatter"]
        assert [record.data for record in bags.records()] == [HELLO]
    assert [record.getMessage() for record in caplog.records] == [
        f"{folder}: left out: topic /broken (my_msgs/Broken): my_msgs/Broken:1:1: expected 'type name' or "
        "'type NAME=value', found 'float64[<3] x'",
        f"{folder}: left out: topics /gone, /gone_too (my_msgs/Gone): the type my_msgs/Lost is not defined in "
        "the bag or on this system",
        f"{folder}: left out: topic /nested (my_msgs/Nested): the type lost_msgs/Lost is not defined in the bag or "
        "on this system",
    ]


@pytest.mark.parametrize(("topic", "is_named"), [("chatter", False), ("gone", True)])
def test_unreadable_topic_of_program_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, topic: str, is_named: bool
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        f'<publish_subscribe><subscribe_to name="{topic}" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("")
    folder = typed_bag(
        tmp_path / "two",
        STORAGES[-1],
        ("/gone", "my_msgs/msg/Gone", "Lost lost\n", HELLO),
        ("/chatter", "std_msgs/msg/String", "string data\n", HELLO),
    )
    with MergedBag([folder]) as bags:
        list(Playback(program, fail).run(bags))
    expected = (
        f"{folder}: left out: topic /gone (my_msgs/Gone): the type my_msgs/Lost is not defined in the bag or on "
        "this system"
    )
    assert [record.getMessage() for record in caplog.records] == [expected] * is_named


@pytest.mark.parametrize("storage", STORAGES)
def test_bounds_and_defaults_are_read(tmp_path: Path, storage: Any) -> None:
    text = '"Jü"'
    raw = cdr_message(
        ("I3sx", 3, b"hi\0"),
        ("II2s", 1, 2, b"a\0"),
        ("xxId", 1, 0.5),
        ("III", 2, ord("J"), ord("ü")),
        ("BxxxI", 200, 0),
    )
    folder = typed_bag(tmp_path / "two", storage, ("/bounded", "my_msgs/msg/Bounded", BOUNDED, raw))
    with MergedBag([folder]) as bags:
        (topic,) = bags.topics
        (record,) = bags.records()
    definitions = Definitions()
    definition = definitions.add(topic.type, topic.definition, topic.md5sum)
    event_text = to_text(definitions.decoder(definition, topic.format).decode(record.data))
    assert event_text == f"my_msgs__0__Bounded('\"hi\"',['\"a\"'],[0.5],'{text}',200,[])"


def test_idl_definition_is_read(tmp_path: Path) -> None:
    raw = cdr_message(("I3sx", 3, b"hi\0"), ("I4xd", 1, 0.5), ("iII1s", 4, 5, 1, b""))
    folder = typed_bag(tmp_path / "two", STORAGES[-1], ("/few", "my_msgs/msg/Few", IDL, raw))
    with MergedBag([folder]) as bags:
        slots = bags.topics[0].definition.split("\n")[:3]
        assert slots == ["string name", "float64[] few", "std_msgs/Header header"]
        assert [record.data for record in bags.records()] == [raw]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (IDL.replace("    };\n  };", "    }\n  };"), "my_msgs/Few:10:3: {}: expected ';', found '}}'"),
        (
            IDL.replace("module my_msgs", "modul my_msgs"),
            "my_msgs/Few:3:1: {}: expected '@' or 'bitmask' or",
        ),
        (IDL + "garbage\n", "my_msgs/Few:12:1: {}: expected '@' or"),
        (
            IDL.replace("std_msgs::msg::Header", "other::msg::Gone"),
            "the type other/Gone is not defined in the bag or on this system",
        ),
    ],
)
def test_invalid_idl_is_reported_with_position(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, text: str, problem: str
) -> None:
    raw = cdr_message(("I3sx", 3, b"hi\0"))
    folder = typed_bag(tmp_path / "two", STORAGES[-1], ("/few", "my_msgs/msg/Few", text, raw))
    with MergedBag([folder]) as bags:
        assert not bags.topics
        assert list(bags.records()) == []
    (record,) = caplog.records
    message = record.getMessage()
    assert len(message) < 1000
    assert problem.format("its definition in IDL cannot be parsed") in message


def raise_error(error: RetalisError) -> None:
    raise error


def test_messages_of_wrong_size_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = typed_bag(
        tmp_path / "two",
        STORAGES[-1],
        ("/chatter", "std_msgs/msg/String", "string data\n", HELLO, HELLO[:-2], b"", HELLO),
    )
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="chatter" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("")
    events: List[str] = []
    playback = Playback(program, report=raise_error)
    playback.engine.on_event(lambda term, start, end: events.append(to_text(term)))
    with MergedBag([folder]) as bags:
        assert len(bags.topics) == 1
        assert list(playback.run(bags)) == []
    assert events == ["std_msgs__0__String('\"hello\"')"] * 2
    assert [record.getMessage() for record in caplog.records] == [
        "a message on /chatter is dropped: 8 bytes of CDR are not a std_msgs/String",
        "2 times in all: a message on /chatter is dropped: 8 bytes of CDR are not a std_msgs/String",
    ]


@pytest.fixture
def compressed(tmp_path: Path) -> Any:
    """Return a function that writes one compressed file of a ROS 2 bag."""

    def write(storage: Any) -> Path:
        folder = typed_bag(
            tmp_path / "two", storage, ("/chatter", "std_msgs/msg/String", "string data\n", HELLO)
        )
        (path,) = [path for path in folder.iterdir() if path.suffix in (".db3", ".mcap")]
        compressed_path = tmp_path / f"alone{path.suffix}.zstd"
        compressed_path.write_bytes(zstd(path.read_bytes()))
        return compressed_path

    return write


@pytest.mark.parametrize("storage", STORAGES)
def test_compressed_file_is_unpacked_while_open(
    compressed: Any, storage: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    path = compressed(storage)
    with MergedBag([path]) as bags:
        assert read(bags) == [("/chatter", 1)]
        assert bags.path == str(path)
        assert len(list(scratch.iterdir())) == 1
    assert list(scratch.iterdir()) == []


def test_large_or_broken_compressed_file_is_an_error(
    compressed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    path = compressed(STORAGES[-1])
    content = path.read_bytes()
    path.write_bytes(packed_zeros("zstd", 2))
    with pytest.raises(BagError, match="too large: unpacked it would have more than 1000000 bytes"):
        MergedBag([path], max_chunk_megabytes=1)
    path.write_bytes(content)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(BagError, match="alone.* is not a complete ROS 2 bag"):
        MergedBag([path])
    assert list(scratch.iterdir()) == []


def test_invalid_ros2_bag_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("nothing: 1")
    with pytest.raises(BagError, match="is not a complete ROS 2 bag"):
        MergedBag([tmp_path])
    (tmp_path / "wrong.mcap").write_text("nothing")
    with pytest.raises(BagError, match="wrong.mcap"):
        MergedBag([tmp_path / "wrong.mcap"])
