"""Small bags with large stated or unpacked sizes, for tests and for the fuzzer."""

import bz2
import sqlite3
import struct
from contextlib import closing
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import lz4.frame

MEGABYTE = 1_000_000
TEXT = "string data\n"
HELLO = b"\0\1\0\0" + struct.pack("<I6s", 6, b"hello\0")


def zstd(data: Any) -> Any:
    """Return data packed by zstd, with the installed package."""
    # By name, so that the types can be checked with either package.
    name = "zstandard" if find_spec("zstandard") is not None else "backports.zstd"
    return import_module(name).compress(data)


PACK = {"none": bytes, "": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstd}


def packed_zeros(compression: Any, megabytes: Any) -> Any:
    """Return packed zeros, made without memory for them."""
    block = b"\0" * MEGABYTE
    if compression == "zstd":
        return zstd(block) * megabytes  # frames one after the other
    packer: Any = bz2.BZ2Compressor() if compression == "bz2" else lz4.frame.LZ4FrameCompressor()
    parts = [packer.begin()] if compression == "lz4" else []
    parts += [packer.compress(block) for _ in range(megabytes)]
    parts.append(packer.flush())
    return b"".join(parts)


# ---- ROS 1 -------------------------------------------------------------------------------------------


def record(fields: Any, data: bytes) -> bytes:
    """Return a record of a ROS 1 bag."""
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def number(value: int, code: str = "I") -> bytes:
    return struct.pack(f"<{code}", value)


def ros1_bag(
    chunks: Any,
    entries: Any = None,
    connections: int = 1,
    infos: Any = None,
    compression: str = "none",
    stated: Any = None,
    packed: Any = None,
    index_count: Any = None,
) -> Any:
    """Return a bag with a topic /a of strings.

    Args:
        chunks: for each chunk the texts of its messages.
        entries: the offsets in the index of each chunk, by default one for each message.
        connections: how many times the connection is listed.
        infos: numbers of the chunks that the index names, by default each once.
        compression: of the chunks.
        stated: the size that their headers state, by default the right one.
        packed: their bytes in the file, by default the right ones.
        index_count: the number of entries that each index states.
    """
    about = {b"topic": b"/a", b"type": b"std_msgs/String", b"md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}
    about[b"message_definition"] = TEXT.encode()
    header = b"".join(number(len(k) + 1 + len(v)) + k + b"=" + v for k, v in about.items())
    connection = record({b"op": b"\7", b"conn": number(0), b"topic": b"/a"}, header)
    body, places, second = b"", [], 0
    start = len(b"#ROSBAG V2.0\n") + 4096
    for texts in chunks:
        data, offsets = b"", []
        for text in texts:
            second += 1
            offsets.append((second, len(data)))
            fields = {b"op": b"\2", b"conn": number(0), b"time": struct.pack("<II", second, 0)}
            data += record(fields, number(len(text)) + text)
        fields = {b"op": b"\5", b"compression": compression.encode()}
        fields[b"size"] = number(len(data) if stated is None else stated)
        places.append((start + len(body), offsets))
        body += record(fields, PACK[compression](data) if packed is None else packed)
        if entries is not None:
            offsets = [(second, offset) for second, offset in enumerate(entries, 1)]
        index = b"".join(struct.pack("<III", instant, 0, offset) for instant, offset in offsets)
        count = len(offsets) if index_count is None else index_count
        fields = {b"op": b"\4", b"ver": number(1), b"conn": number(0), b"count": number(count)}
        body += record(fields, index)
    infos = range(len(chunks)) if infos is None else infos
    tail = connection * connections
    for chunk_number in infos:
        place, offsets = places[chunk_number]
        fields = {b"op": b"\6", b"ver": number(1), b"chunk_pos": number(place, "Q"), b"count": number(1)}
        fields[b"start_time"] = fields[b"end_time"] = struct.pack("<II", 1, 0)
        tail += record(fields, struct.pack("<II", 0, len(offsets)))
    fields = {b"op": b"\3", b"index_pos": number(start + len(body), "Q")}
    fields.update({b"conn_count": number(connections), b"chunk_count": number(len(infos))})
    first = record(fields, b"")
    first = first[:-4] + number(4096 - len(first)) + b" " * (4096 - len(first))
    return b"#ROSBAG V2.0\n" + first + body + tail


# ---- mcap --------------------------------------------------------------------------------------------

MAGIC = b"\x89MCAP0\r\n"


def op(code: int, body: Any) -> Any:
    return struct.pack("<BQ", code, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def mcap_message(second: Any, data: Any = HELLO) -> Any:
    return op(5, struct.pack("<HIQQ", 1, 0, second * 10**9, second * 10**9) + data)


def mcap_topic(type_name: str, encoding: str, definition: Any, message_format: str = "cdr") -> Any:
    """Return the records of a schema and of the topic /a."""
    schema = op(3, struct.pack("<H", 1) + text(type_name) + text(encoding) + text(definition))
    return schema + op(4, struct.pack("<HH", 1, 1) + text("/a") + text(message_format) + struct.pack("<I", 0))


TOPIC = mcap_topic("std_msgs/msg/String", "ros2msg", TEXT)


def mcap(
    chunks: Any,
    compression: str = "",
    stated: Any = None,
    packed: Any = None,
    has_index: bool = True,
    times: Any = None,
    repeated: int = 1,
    profile: str = "ros2",
    has_counts: bool = True,
    topic: Any = TOPIC,
    indexed_channels: Any = None,
) -> Any:
    """Return an mcap file with a topic /a of strings.

    Args:
        chunks: the records of each chunk; nothing for messages beside chunks.
        compression: of the chunks.
        stated: the size that they state, by default the right one.
        packed: their bytes in the file, by default the right ones.
        has_index: whether there is a summary.
        times: the seconds that the index gives each chunk, by default from 0 to 100.
        repeated: how often the index names each chunk.
        profile: the profile that the header names.
        has_counts: whether the summary has the number of messages of the topic.
        topic: the records of the topic, as `mcap_topic` returns them.
        indexed_channels: for each chunk the bytes of the channels in its index entry; by default there are none.
    """
    body = MAGIC + op(1, text(profile) + text("test")) + topic
    index = b""
    for number, data in enumerate(chunks):
        place = len(body)
        first, last = (0, 100 * 10**9) if times is None else (second * 10**9 for second in times[number])
        content = PACK[compression](data) if packed is None else packed
        chunk = struct.pack("<QQQI", first, last, len(data) if stated is None else stated, 0)
        body += op(6, chunk + text(compression) + struct.pack("<Q", len(content)) + content)
        channels = struct.pack("<I", 0) if indexed_channels is None else indexed_channels[number]
        entry = struct.pack("<QQQQ", first, last, place, len(body) - place) + channels
        entry += struct.pack("<Q", 0) + text(compression) + struct.pack("<QQ", len(content), len(data))
        index += op(8, entry) * repeated
    summary = 0
    if has_index:
        summary = len(body)
        totals = struct.pack("<QHIIIIQQ", len(chunks), 1, 1, 0, 0, len(chunks), 0, 100 * 10**9)
        counts = struct.pack("<IHQ", 10, 1, len(chunks)) if has_counts else struct.pack("<I", 0)
        body += topic + index + op(11, totals + counts)
    return body + op(2, struct.pack("<QQI", summary, 0, 0)) + MAGIC


# ---- SQLite ------------------------------------------------------------------------------------------

TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
ROWS = """
INSERT INTO schema VALUES(4, 'test');
INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/String', 'cdr', '', '');
INSERT INTO message_definitions VALUES(1, 'std_msgs/msg/String', 'ros2msg', 'string data', '');
"""


def sqlite_bag(
    path: Any, tables: Any = TABLES, rows: Any = ROWS, messages: Any = ((1, HELLO),), after: str = ""
) -> Any:
    """Write a database with a topic /a of strings; `after` is SQL that changes it."""
    with closing(sqlite3.connect(str(path))) as database:
        database.executescript(tables + rows)
        for second, data in messages:
            database.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", (second * 10**9, data)
            )
        database.commit()
        database.executescript(after)
    return path


def folder_bag(folder: Path, name: Any, storage: Any, mode: str = "none", topics: Any = ()) -> Any:
    """Write the metadata of a bag of ROS 2 with one file."""
    folder.mkdir(exist_ok=True)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n"
        f"  storage_identifier: {storage}\n  relative_file_paths: [{name}]\n"
        f"  compression_format: {'zstd' if mode != 'none' else ''}\n  compression_mode: {mode}\n"
    )
    return folder
