"""Several bags as one, parts of them, and bags of ROS 2."""

import json
import struct

import numpy
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from retalis.engine.playback import BagError, BagSeries, BagWriter, Playback, RunLook
from retalis.foundation import UsageError
from retalis.messages import Definitions

SECOND = 10**9
STRING = Definitions().add("std_msgs/String", "string data")


def bag(path, *seconds, topic="/chatter"):
    """Write a bag with a text at each of these seconds."""
    with BagWriter(path) as writer:
        connection = writer.add(topic, STRING)
        for second in seconds:
            writer.write(connection, second * SECOND, struct.pack("<I", 2) + b"%2d" % second)
    return path


def read(bags):
    return [(record.topic.name, record.time // SECOND) for record in bags.records()]


def test_bags_come_in_the_order_of_receipt(tmp_path):
    paths = [bag(tmp_path / "a.bag", 1, 4, 5), bag(tmp_path / "b.bag", 2, 4, 9, topic="/other")]
    with BagSeries(paths) as bags:
        assert read(bags) == [
            (n, s)
            for s, n in [
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


def test_a_part_begins_and_ends_where_it_is_told(tmp_path):
    paths = [bag(tmp_path / "a.bag", 11, 14, 15), bag(tmp_path / "b.bag", 12, 19)]
    with BagSeries(paths, start=3) as bags:
        assert [second for _, second in read(bags)] == [14, 15, 19]
    with BagSeries(paths, start=1, duration=3) as bags:
        assert [second for _, second in read(bags)] == [12, 14]
        assert bags.end == 15 * SECOND
    with BagSeries(paths, duration=0) as bags:
        assert read(bags) == []
    with pytest.raises(UsageError, match="nothing 9 s after the first message: the last is at 8 s"):
        BagSeries(paths, start=9)


def test_a_bag_is_not_played_twice(tmp_path):
    path = bag(tmp_path / "a.bag", 1)
    with pytest.raises(UsageError, match="is given twice"):
        BagSeries([path, tmp_path / "." / "a.bag"])
    with pytest.raises(BagError, match="there is no bag"):
        BagSeries([])


@pytest.mark.parametrize("kind", ["BZ2", "LZ4"])
def test_compressed_bags_are_read(tmp_path, kind):
    writer = rosbag1.Writer(tmp_path / "a.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat[kind])
    with writer:
        options = {"msgdef": STRING.full_text, "md5sum": STRING.md5sum}
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", **options)
        writer.write(connection, SECOND, struct.pack("<I", 2) + b"hi")
    assert kind.lower().encode() in (tmp_path / "a.bag").read_bytes()
    with BagSeries([tmp_path / "a.bag"]) as bags:
        assert read(bags) == [("/chatter", 1)]


# ---- ROS 2 -------------------------------------------------------------------------------------------

OWN = "std_msgs/Header header\nfloat64 level\nbuiltin_interfaces/Time since\nuint8[] raw\n"
STORAGES = list(getattr(rosbag2, "StoragePlugin", [None]))


def ros2_bag(folder, storage):
    """Write a bag of ROS 2 with a message of a usual type and one of a type of its own."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(OWN, "my_msgs/msg/Level"))
    kinds = store.types
    time = kinds["builtin_interfaces/msg/Time"]
    header = kinds["std_msgs/msg/Header"]
    options = {} if storage is None else {"version": 9, "storage_plugin": storage}
    with rosbag2.Writer(folder, **options) as writer:
        text = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        level = writer.add_connection("/level", "my_msgs/msg/Level", typestore=store)
        said = kinds["std_msgs/msg/String"](data="hello")
        writer.write(text, 3 * SECOND, store.serialize_cdr(said, "std_msgs/msg/String"))
        raw = numpy.array([1, 2, 3], dtype=numpy.uint8)
        stamped = header(stamp=time(sec=4, nanosec=5), frame_id="tank")
        message = kinds["my_msgs/msg/Level"](header=stamped, level=0.5, since=time(sec=1, nanosec=2), raw=raw)
        writer.write(level, 5 * SECOND, store.serialize_cdr(message, "my_msgs/msg/Level"))
    return folder


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_of_ros_2_gives_the_events_that_ros_1_would(tmp_path, storage):
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="chatter" msg_type="std_msgs/String"/>'
        '<subscribe_to name="level" msg_type="my_msgs/Level"/></publish_subscribe>'
    )
    (program / "goalPredicates.txt").write_text("")
    found, wrong = [], []
    playback = Playback(program, wrong.append)
    look = RunLook(playback, found.append)
    with BagSeries([ros2_bag(tmp_path / "two", storage)]) as bags:
        assert [topic.type for topic in bags.topics] == ["std_msgs/String", "my_msgs/Level"]
        assert list(playback.run(bags, lambda done: look.look())) == []
    assert wrong == []
    assert [(line["event"], line["start"]) for line in found] == [
        ("std_msgs__0__String('\"hello\"')", 3 * SECOND),
        (
            "my_msgs__0__Level(std_msgs__0__Header(0,[4,5],'\"tank\"'),0.5,[1,2],'\"FFFFFFFFFFAQID////\"')",
            4 * SECOND + 5,
        ),
    ]
    assert json.loads(json.dumps(found)) == found


def test_what_is_no_bag_of_ros_2_is_an_error(tmp_path):
    (tmp_path / "metadata.yaml").write_text("nothing: 1")
    with pytest.raises(BagError, match="is not a complete ROS 2 bag"):
        BagSeries([tmp_path])
    (tmp_path / "wrong.mcap").write_text("nothing")
    with pytest.raises(BagError, match="wrong.mcap"):
        BagSeries([tmp_path / "wrong.mcap"])
