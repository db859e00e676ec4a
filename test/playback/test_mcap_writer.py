"""Writing of MCAP files: contents, read by this package and by rosbags, and failures."""

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

from mcap.reader import make_reader  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

from retalis import BagError, Definitions  # noqa: E402
from retalis.events.program.topic_configuration import ANY_QUALITY, QualityOfService  # noqa: E402
from retalis.messages.cdr_encoder import CdrEncoder  # noqa: E402
from retalis.playback.bag_locations import open_bag  # noqa: E402
from retalis.playback.mcap_writer import INCOMPLETE_FILES_RECORD, McapWriter  # noqa: E402


def write_bag(path: Path, type_name: str, data: bytes = b"", quality: QualityOfService = ANY_QUALITY) -> None:
    with McapWriter(path) as bag:
        bag.write(bag.add("/topic", Definitions().find(type_name), quality), 1_500_000_000, data)


@pytest.mark.parametrize("type_name", ["geometry_msgs/PointStamped", "std_msgs/Empty"])
def test_bag_is_read(tmp_path: Path, type_name: str) -> None:
    definition = Definitions().find(type_name)
    data = CdrEncoder(definition).encode(
        Definitions().decoder(definition).decode(bytes(definition.measure.min_size))
    )
    write_bag(tmp_path / "a.mcap", type_name, data)
    with open_bag(tmp_path / "a.mcap") as bag:
        (record,) = bag.records()
    assert (record.time, record.data) == (1_500_000_000, data)
    assert (record.topic.name, record.topic.type, record.topic.md5sum) == (
        "/topic",
        type_name,
        definition.md5sum,
    )


def test_rosbags_reads_definition_and_message(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    definition = Definitions().find("geometry_msgs/PointStamped")
    term = Definitions().decoder(definition).decode(bytes(12) + b"\1\0\0\0m" + bytes(24))
    write_bag(path, definition.name, CdrEncoder(definition).encode(term))
    with path.open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert schema is not None
    assert (schema.name, schema.encoding) == ("geometry_msgs/msg/PointStamped", "ros2msg")
    assert (channel.topic, channel.message_encoding) == ("/topic", "cdr")
    assert (message.log_time, message.publish_time) == (1_500_000_000, 1_500_000_000)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    received: Any = store.deserialize_cdr(message.data, schema.name)
    assert received.header.frame_id == "m"
    # The hash of a definition covers all types that it contains.
    assert store.hash_rihs01(schema.name) == get_typestore(Stores.LATEST).hash_rihs01(schema.name)


def test_types_with_equal_texts_keep_their_names(tmp_path: Path) -> None:
    path, names = tmp_path / "a.mcap", ["std_msgs/Bool", "my_msgs/Door", "std_msgs/Bool"]
    definitions = Definitions()
    definitions.add("my_msgs/Door", definitions.find("std_msgs/Bool").text)
    with McapWriter(path) as bag:
        for number, name in enumerate(names):
            bag.write(bag.add(f"/t{number}", definitions.find(name), ANY_QUALITY), number, b"\0\1\0\0\1")
    with open_bag(path) as reader:
        assert [record.topic.type for record in reader.records()] == names
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert [schema.name for schema in summary.schemas.values()] == ["std_msgs/msg/Bool", "my_msgs/msg/Door"]


@pytest.mark.parametrize(
    ("quality", "numbers"),
    [
        (ANY_QUALITY, "depth: 10\n  reliability: 1\n  durability: 2"),
        (QualityOfService(is_transient_local=True), "depth: 1\n  reliability: 1\n  durability: 1"),
        (QualityOfService(False, True, 4), "depth: 4\n  reliability: 2\n  durability: 1"),
    ],
)
def test_offered_quality_is_metadata_of_channel(
    tmp_path: Path, quality: QualityOfService, numbers: str
) -> None:
    write_bag(tmp_path / "a.mcap", "std_msgs/Empty", b"\0\1\0\0\0", quality)
    with (tmp_path / "a.mcap").open("rb") as file:
        ((_, channel, _),) = make_reader(file).iter_messages()
    assert numbers in channel.metadata["offered_qos_profiles"]


def test_incomplete_files_are_metadata(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapWriter(path, incomplete_files=[{"incomplete": "in.bag", "messages": 3}]):
        pass
    with path.open("rb") as file:
        (record,) = make_reader(file).iter_metadata()
    assert record.name == INCOMPLETE_FILES_RECORD
    assert json.loads(record.metadata["files"]) == [{"incomplete": "in.bag", "messages": 3}]


@pytest.mark.parametrize(
    ("type_name", "warns"),
    [
        ("visualization_msgs/Marker", True),
        ("diagnostic_msgs/DiagnosticArray", False),
        ("sensor_msgs/CameraInfo", False),
        ("tf/tfMessage", False),
    ],
)
def test_type_with_other_slots_in_ros2_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, type_name: str, warns: bool
) -> None:
    write_bag(tmp_path / "a.mcap", type_name)
    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == warns
    assert all(
        text.startswith(f"topic /topic: {type_name} has other slots in ROS 2 Humble, Iron") for text in texts
    )


def test_error_discards_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_bag(path, "std_msgs/Empty")
    content = path.read_bytes()
    with pytest.raises(ZeroDivisionError), McapWriter(path, overwrite=True):
        raise ZeroDivisionError
    assert path.read_bytes() == content
    with pytest.raises(BagError, match="already exists"):
        McapWriter(path)
    assert list(tmp_path.iterdir()) == [path]


def test_time_before_1970_is_an_error(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "a.mcap") as bag:
        topic = bag.add("/topic", Definitions().find("std_msgs/Empty"), ANY_QUALITY)
        with pytest.raises(BagError, match="expected a time from 0 to 9223372036854775807 ns, found -1 ns"):
            bag.write(topic, -1, b"")
    assert list(tmp_path.iterdir()) == []
