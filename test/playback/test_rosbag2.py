"""ROS 2 bags: comparison with the package rosbags, metadata, split bags, and definitions."""

import struct
from pathlib import Path
from typing import Any, List, Tuple

import pytest

rosbag2 = pytest.importorskip("rosbags.rosbag2")

from malicious_bags import HELLO, folder_bag, mcap, mcap_message, mcap_topic, sqlite_bag  # noqa: E402
from messages.ros2_types import decode_text  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from retalis import BagError, Definitions  # noqa: E402
from retalis.cli.command_line import main  # noqa: E402
from retalis.messages.type_definition import SerializationFormat  # noqa: E402
from retalis.playback.bag_locations import MergedBag  # noqa: E402

SECOND = 10**9
MODES = ["NONE", "FILE", "MESSAGE"]
STORAGES_AND_MODES = [
    (storage, mode) for storage in getattr(rosbag2, "StoragePlugin", [None]) for mode in MODES
]
if hasattr(rosbag2, "StoragePlugin"):  # an older version writes databases only
    STORAGES_AND_MODES.append((rosbag2.StoragePlugin.MCAP, "STORAGE"))


def write_bag(folder: Any, storage: Any, mode: Any) -> Any:
    """Write a bag with the package ``rosbags``: 300 messages of different sizes on three topics."""
    options = {} if storage is None else {"version": 9, "storage_plugin": storage}
    writer = rosbag2.Writer(folder, **options)
    if mode != "NONE":
        names = rosbag2 if hasattr(rosbag2, "CompressionMode") else writer
        writer.set_compression(names.CompressionMode[mode], names.CompressionFormat.ZSTD)
    types = get_typestore(Stores.ROS2_HUMBLE)
    with writer:
        topics = [
            writer.add_connection(f"/t{number}", "std_msgs/msg/String", typestore=types)
            for number in range(3)
        ]
        for number in range(300):
            text = b"x" * (number * 7 % 90)
            data = b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"
            writer.write(topics[number * number % 3], (number * 37 % 300) * SECOND, data)
    return folder


@pytest.mark.parametrize(("storage", "mode"), STORAGES_AND_MODES)
def test_records_equal_those_of_rosbags(tmp_path: Path, storage: Any, mode: Any) -> None:
    folder = write_bag(tmp_path / "bag", storage, mode)
    with rosbag2.Reader(folder) as reader:
        for start, stop in ((None, None), (40 * SECOND, 200 * SECOND)):
            expected = [
                (connection.topic, time, data[8:-1])
                for connection, time, data in reader.messages(start=start, stop=stop)
            ]
            with MergedBag([folder]) as bags:
                records = [
                    (record.topic.name, record.time, record.data[8:-1])
                    for record in bags.records(None, start, stop)
                ]
                assert records == expected
                assert len(records) > 100
                assert (bags.start, bags.end) == (reader.start_time, reader.end_time - 1)
                assert {topic.name: topic.messages for topic in bags.topics} == {
                    connection.topic: connection.msgcount for connection in reader.connections
                }


def read(path: Any) -> List[Tuple[Any, ...]]:
    with MergedBag([path], max_chunk_megabytes=1) as bags:
        return [(record.time // SECOND, record.data[8:-1]) for record in bags.records()]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("relative_file_paths: [a.db3, a.db3]", "a file is named twice"),
        ("relative_file_paths: [b.db3]", "its file b.db3 is missing"),
        (
            "relative_file_paths: [/etc/passwd]",
            "the name 'passwd' does not have the suffix of storage 'sqlite3'",
        ),
        ("relative_file_paths: 3", "the name '3' does not have the suffix of storage 'sqlite3'"),
        ("version: 5", "metadata.yaml names no files: expected relative_file_paths"),
        (
            "compression_mode: file\n  relative_file_paths: [a.db3]",
            "compression by 'file' with '' is unknown",
        ),
        ("# " + "x" * 4_000_000, "has 4000[0-9]* bytes: expected at most 4000000"),
        ("relative_file_paths: " + "[" * 100_000, "."),
        ("relative_file_paths:\n" + "  - a\n" * 100_000, "a file is named twice"),
        ("relative_file_paths: [\n" * 50_000, "."),
    ],
    ids=range(10),
)
def test_invalid_metadata_is_an_error(tmp_path: Path, text: str, expected: str) -> None:
    folder = folder_bag(tmp_path / "bag", "a.db3", "sqlite3")
    sqlite_bag(folder / "a.db3")
    assert [time for time, _ in read(folder)] == [1]
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n  {text}\n"
    )
    with pytest.raises(BagError, match=expected):
        read(folder)


@pytest.mark.parametrize(
    "text",
    [
        "relative_file_paths: [a.db3]\n  storage_identifier: sqlite3\n  compression_mode: ''",
        'relative_file_paths: ["a.db3"]  # one\n  storage_identifier: sqlite3\n  compression_mode: NONE',
        "storage_identifier: sqlite3\n  relative_file_paths:\n    - a.db3\n  files:\n    - path: b.db3",
        "topics:\n    storage_identifier: mcap\n  relative_file_paths:\n  - 'a.db3'\n  storage_identifier: sqlite3",
        "relative_file_paths: [\n    some/where/a.db3\n    ]\n  storage_identifier: sqlite3",
    ],
    ids=range(5),
)
def test_each_form_of_metadata_is_read(tmp_path: Path, text: str) -> None:
    folder = folder_bag(tmp_path / "bag", "", "")
    sqlite_bag(folder / "a.db3")
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {text}\n")
    assert [time for time, _ in read(folder)] == [1]


def test_folder_with_several_files_is_one_bag(tmp_path: Path) -> None:
    folder = folder_bag(tmp_path / "bag", "b.mcap, a.mcap", "mcap")
    for name, second in (("b", 1), ("a", 2)):
        (folder / f"{name}.mcap").write_bytes(mcap([mcap_message(second)]))
    with MergedBag([folder]) as bags:
        assert [record.time // SECOND for record in bags.records()] == [1, 2]
        assert [topic.messages for topic in bags.topics] == [2]


@pytest.mark.parametrize("names", ["a.mcap, b.mcap, c.mcap, d.mcap", "d.mcap, b.mcap, a.mcap, c.mcap"])
def test_files_of_split_bag_are_merged_by_time(tmp_path: Path, names: str) -> None:
    folder = folder_bag(tmp_path / "bag", names, "mcap")
    seconds = {"a": [5, 7], "b": [3, 6], "c": [10], "d": [0, 8]}
    for name, times in seconds.items():
        (folder / f"{name}.mcap").write_bytes(
            mcap([mcap_message(time) for time in times], times=[(time, time) for time in times])
        )
    assert [time for time, _ in read(folder)] == [0, 3, 5, 6, 7, 8, 10]
    with MergedBag([folder]) as bags:
        times = [record.time // SECOND for record in bags.records(None, 3 * SECOND, 8 * SECOND)]
    assert times == [3, 5, 6, 7]


def test_databases_of_split_bag_are_merged_by_time(tmp_path: Path) -> None:
    folder = folder_bag(tmp_path / "bag", "a.db3, b.db3", "sqlite3")
    for name, times in (("a", [2, 4]), ("b", [1, 3])):
        sqlite_bag(folder / f"{name}.db3", messages=[(time, HELLO) for time in times])
    assert [time for time, _ in read(folder)] == [1, 2, 3, 4]


@pytest.mark.parametrize("identifier", ['""', "", "null"])
def test_suffix_decides_without_storage_identifier(tmp_path: Path, identifier: str) -> None:
    folder = folder_bag(tmp_path / "bag", "a.mcap", identifier)
    (folder / "a.mcap").write_bytes(mcap([mcap_message(1)]))
    assert [time for time, _ in read(folder)] == [1]


# ---- definitions -------------------------------------------------------------------------------------


def read_message(path: Any) -> Tuple[Any, ...]:
    """Return the topic of a bag with one message, and the message."""
    with MergedBag([path]) as bags:
        (topic,) = bags.topics
        (record,) = bags.records()
    return topic, record.data


def test_type_with_empty_definition_has_no_slots(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    topic = mcap_topic("my_msgs/msg/Go", "ros2msg", "")
    path.write_bytes(mcap([mcap_message(1, b"\0\1\0\0\0")], topic=topic))
    topic, data = read_message(path)
    assert (topic.type, topic.definition, data) == ("my_msgs/Go", "", b"\0\1\0\0\0")


def test_missing_definition_is_advised_and_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A recorder that does not find a type writes an empty definition, as of a type without slots."""
    bag, program, types = tmp_path / "a.mcap", tmp_path / "program", tmp_path / "types" / "my_msgs" / "msg"
    bag.write_bytes(mcap([mcap_message(1)], topic=mcap_topic("my_msgs/msg/Go", "ros2msg", "")))
    program.mkdir()
    (program / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (program / "eventRules.txt").write_text("went(X) <- my_msgs__0__Go(X).\n")
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe strings="plain"><subscribe_to name="a" msg_type="my_msgs/Go"/></publish_subscribe>'
    )
    options = ["bag", str(bag), "--program", str(program), "--events"]
    assert main(options) == 1
    assert (
        "bytes of CDR are not a my_msgs/Go: its definition is empty; --msg of retalis bag adds another one"
        in capsys.readouterr().err
    )
    types.mkdir(parents=True)
    (types / "Go.msg").write_text("string text\n")
    assert main([*options, "--msg", str(tmp_path / "types")]) == 0
    assert "event(went(hello)" in capsys.readouterr().out


def test_type_without_schema_is_searched(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap([mcap_message(1)], topic=mcap_topic("my_msgs/msg/Go", "", "")))
    with MergedBag([path]) as bags:
        assert [topic.problem for topic in bags.unreadable] == [
            "the type is not defined in the bag or on this system"
        ]
    path.write_bytes(mcap([mcap_message(1)], topic=mcap_topic("std_msgs/msg/String", "", "")))
    assert read_message(path)[1] == HELLO


def test_messages_of_ros1_in_mcap_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    topic = mcap_topic("std_msgs/String", "ros1msg", "string data", "ros1")
    path.write_bytes(mcap([mcap_message(1, b"\2\0\0\0hi")], profile="ros1", topic=topic))
    topic, data = read_message(path)
    assert (topic.type, topic.md5sum) == ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1")
    assert topic.format is SerializationFormat.ROS1
    assert data == b"\2\0\0\0hi"


def test_messages_in_other_formats_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap([mcap_message(1, b"{}")], topic=mcap_topic("a", "jsonschema", "{}", "json")))
    with MergedBag([path]) as bags:
        assert bags.unreadable == (("/a", "a", "its messages are in 'json': expected cdr or ros1"),)


SERVICE = f"{'=' * 80}\nSRV: my_msgs/srv/Go\nint8 x\n---\nint8 y\n"
EVENT = b"\0\1\0\0" + struct.pack("<BxxxiI16s4xq", 1, 4, 5, bytes(16), 7) + struct.pack("<IbxxxI", 1, 3, 0)


def test_service_events_of_mcap_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    topic = mcap_topic("my_msgs/srv/Go_Event", "unknown", SERVICE)
    path.write_bytes(mcap([mcap_message(1, EVENT)], topic=topic))
    topic, data = read_message(path)
    assert topic.type == "my_msgs/Go_Event"
    assert data == EVENT
    assert decode_text(Definitions().add(topic.type, topic.definition), data).endswith(
        ",7),[my_msgs__0__Go_Request(3)],[])"
    )


def test_service_events_of_database_are_read(tmp_path: Path) -> None:
    """The database has the definition under the name of the service."""
    rows = f"""
    INSERT INTO topics VALUES(1, '/go/_service_event', 'my_msgs/srv/Go_Event', 'cdr', '', '');
    INSERT INTO message_definitions VALUES(1, 'my_msgs/srv/Go', 'unknown', '{SERVICE}', '');
    """
    path = sqlite_bag(tmp_path / "a.db3", rows=rows, messages=[(1, EVENT)])
    topic, data = read_message(path)
    assert (topic.name, topic.type, data) == ("/go/_service_event", "my_msgs/Go_Event", EVENT)
