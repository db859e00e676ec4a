"""Files of ROS 2 bags: as another reader reads them, and those that would take too much."""

import gc
import os
import sqlite3
import struct
import sys
from contextlib import closing

import pytest

rosbag2 = pytest.importorskip("rosbags.rosbag2")

from malicious_bags import HELLO, ROWS, TABLES, folder_bag, mcap, mcap_message, sqlite_bag  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from retalis import BagError  # noqa: E402
from retalis.playback.bag_locations import MergedBag  # noqa: E402
from retalis.playback.decompression import ChunkLimit  # noqa: E402
from retalis.playback.rosbag2 import McapFile, SqliteFile  # noqa: E402

SECOND = 10**9
MODES = ["NONE", "FILE", "MESSAGE"]
KINDS = [(storage, mode) for storage in getattr(rosbag2, "StoragePlugin", [None]) for mode in MODES]
if hasattr(rosbag2, "StoragePlugin"):  # an older version writes databases only
    KINDS.append((rosbag2.StoragePlugin.MCAP, "STORAGE"))


def written(folder, storage, mode):
    """Write a bag with the package ``rosbags``: 300 messages of three topics, each with its own size."""
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


@pytest.mark.parametrize(("storage", "mode"), KINDS)
def test_bags_are_read_as_by_another_reader(tmp_path, storage, mode):
    folder = written(tmp_path / "bag", storage, mode)
    with rosbag2.Reader(folder) as reader:
        for start, stop in ((None, None), (40 * SECOND, 200 * SECOND)):
            expected = [
                (connection.topic, time, data[8:-1])
                for connection, time, data in reader.messages(start=start, stop=stop)
            ]
            with MergedBag([folder]) as bags:
                found = [
                    (record.topic.name, record.time, record.data[4:])
                    for record in bags.records(None, start, stop)
                ]
                assert found == expected
                assert len(found) > 100
                assert (bags.start, bags.end) == (reader.start_time, reader.end_time - 1)
                assert {topic.name: topic.messages for topic in bags.topics} == {
                    connection.topic: connection.msgcount for connection in reader.connections
                }


def read(path):
    with MergedBag([path], max_chunk_megabytes=1) as bags:
        return [(record.time // SECOND, record.data[4:]) for record in bags.records()]


# ---- mcap --------------------------------------------------------------------------------------------

CHUNKS = [
    mcap_message(5) + mcap_message(1),
    mcap_message(3) + mcap_message(9),
    mcap_message(10) + mcap_message(12),
]


@pytest.mark.parametrize("has_index", [True, False])
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_chunks_are_merged_by_time(tmp_path, compression, has_index):
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap(CHUNKS, compression, has_index=has_index))
    assert [time for time, _ in read(path)] == [1, 3, 5, 9, 10, 12]


def test_messages_beside_chunks_are_read_in_their_order(tmp_path):
    path = tmp_path / "a.mcap"

    def loose(messages, chunks=()):
        data = mcap(chunks, has_index=False)
        end = len(data) - 37
        path.write_bytes(data[:end] + b"".join(map(mcap_message, messages)) + data[end:])

    loose([1, 2, 2, 7], [mcap_message(1)])
    assert [time for time, _ in read(path)] == [1, 1, 2, 2, 7]
    loose([1, 3, 2])
    with pytest.raises(BagError, match=r"not in the order of time: expected an index of its chunks"):
        read(path)


WRONG_MCAP = [
    (mcap([CHUNKS[0]], repeated=2), "the index names the chunk at byte 124 inside another one"),
    (mcap([b"\0" * 900]), "a chunk has a record with opcode 0: expected schemas, channels, messages"),
    (
        mcap([struct.pack("<BQ", 5, 1 << 62)]),
        "a record in a chunk states 4611686018427387904 bytes: there are fewer",
    ),
    (mcap([CHUNKS[0]])[:-1], "does not end as an mcap file: it may be truncated"),
    (
        mcap([CHUNKS[0]])[:-36] + b"\xff" * 28 + mcap([])[-8:],
        "does not end as an mcap file|is outside of the file",
    ),
    (b"\x89MCAP0\r\n", "bytes at byte 8 are outside of the file"),
    (
        mcap([mcap_message(1, bytes(400_000))] * 3),
        "chunks that overlap in time have 1200093 bytes: expected at most 1 ",
    ),
]


@pytest.mark.parametrize(("data", "expected"), WRONG_MCAP, ids=range(len(WRONG_MCAP)))
def test_mcap_files_that_would_take_too_much(tmp_path, data, expected):
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(BagError, match=expected):
        read(path)


def test_chunks_that_do_not_overlap_are_held_one_at_a_time(tmp_path):
    path = tmp_path / "a.mcap"
    chunks = [mcap_message(second, bytes(400_000)) for second in range(9)]
    path.write_bytes(mcap(chunks, times=[(second, second) for second in range(9)]))
    file = McapFile(path, ChunkLimit(1))
    assert [time // SECOND for _, time, _ in file.read([1], None, None)] == list(range(9))
    file.close()


def test_every_cut_of_an_mcap_file_is_one_error(tmp_path):
    content = mcap(CHUNKS, "zstd")
    path = tmp_path / "a.mcap"
    for size in range(0, len(content), 13):
        path.write_bytes(content[:size])
        with pytest.raises(BagError):
            read(path)


# ---- SQLite ------------------------------------------------------------------------------------------

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n)"
DATA = "data BLOB NOT NULL);"
WRONG_SQLITE = [
    (
        {"after": f"DROP TABLE topics; CREATE VIEW topics AS {ENDLESS} SELECT i AS id, i AS name FROM n"},
        "'topics' is not a plain table: expected columns without defaults or expressions",
    ),
    (
        {
            "after": f"DROP TABLE message_definitions; CREATE VIEW message_definitions AS {ENDLESS} SELECT i FROM n"
        },
        "'message_definitions' is not a plain table",
    ),
    (
        {"after": "DROP TABLE messages"},
        "it has no table 'messages': expected a database that ros2 bag has written",
    ),
    (
        {
            "tables": TABLES.replace(DATA, "data BLOB AS (zeroblob(1000000000)));"),
            "messages": [],
            "after": "INSERT INTO messages(topic_id, timestamp) VALUES(1, 1)",
        },
        "'messages' is not a plain table",
    ),
    ({"after": "UPDATE messages SET timestamp = 'x'"}, "."),
    ({"messages": [(1, "text")]}, "a message is not an integer and a blob"),
    ({"rows": ROWS.replace("'/a'", "x'ff'")}, "a name or a definition is not text"),
]


@pytest.mark.parametrize(("changes", "expected"), WRONG_SQLITE, ids=range(len(WRONG_SQLITE)))
def test_databases_that_would_take_too_much(tmp_path, changes, expected):
    path = sqlite_bag(tmp_path / "a.db3", **changes)
    with pytest.raises(BagError, match=expected):
        read(path)


def test_a_table_whose_pages_are_named_again_and_again_ends(tmp_path):
    """A tree of pages in which each page names the next one some hundred times has more rows than can be counted."""
    path = sqlite_bag(tmp_path / "a.db3", messages=[(second, HELLO) for second in range(20_000)])
    with closing(sqlite3.connect(str(path))) as database:
        (size,) = database.execute("PRAGMA page_size").fetchone()
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    pages = bytearray(path.read_bytes())

    def children(page):
        """Return the places in which an interior page of a table names others."""
        begin = (page - 1) * size
        assert pages[begin] == 5
        (cells,) = struct.unpack_from(">H", pages, begin + 3)
        offsets = struct.unpack_from(f">{cells}H", pages, begin + 12)
        return [*(begin + offset for offset in offsets), begin + 8]

    # A copy of the root goes below itself, a few levels deep: each level multiplies the rows.
    levels = 6
    end = len(pages) // size
    original = bytes(pages[(root - 1) * size : root * size])
    for level in range(levels):
        page = end + level + 1
        pages += original
        if level:
            for place in children(page):
                struct.pack_into(">I", pages, place, page - 1)
    for place in children(root):
        struct.pack_into(">I", pages, place, end + levels)
    struct.pack_into(">I", pages, 28, len(pages) // size)
    path.write_bytes(bytes(pages))
    with pytest.raises(BagError, match="its tables have more rows than a file of its size can hold"):
        read(path)


def test_a_database_is_read_in_the_order_of_time_without_its_index(tmp_path):
    tables = TABLES.replace("CREATE INDEX timestamp_idx ON messages (timestamp ASC);", "")
    path = sqlite_bag(tmp_path / "a.db3", tables, messages=[(3, HELLO), (1, HELLO), (2, HELLO)])
    assert [time for time, _ in read(path)] == [1, 2, 3]
    file = SqliteFile(path, ChunkLimit(1))
    assert [time // SECOND for _, time, _ in file.read([1], 2 * SECOND, 3 * SECOND)] == [2]
    assert list(file.read([2], None, None)) == []
    file.close()


def test_a_reading_that_is_given_up_ends_after_its_file_was_closed(tmp_path, monkeypatch):
    unraisable = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    file = SqliteFile(sqlite_bag(tmp_path / "a.db3", messages=[(1, HELLO), (2, HELLO)]), ChunkLimit(1))
    messages = file.read([1], None, None)
    next(messages)
    file.close()
    messages.close()
    gc.collect()
    assert unraisable == []


def test_a_large_database_is_read_with_a_large_limit(tmp_path):
    path = sqlite_bag(tmp_path / "a.db3")
    os.truncate(path, 3 << 30)  # a sparse file: its last pages are holes
    file = SqliteFile(path, ChunkLimit(4096))
    assert [time for _, time, _ in file.read([1], None, None)] == [SECOND]
    file.close()


# ---- folders -----------------------------------------------------------------------------------------


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
        ("version: 5", "names no files, or no storage_identifier: expected sqlite3 or mcap"),
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
def test_metadata_that_is_wrong(tmp_path, text, expected):
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
def test_metadata_in_each_form_that_is_written(tmp_path, text):
    folder = folder_bag(tmp_path / "bag", "", "")
    sqlite_bag(folder / "a.db3")
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {text}\n")
    assert [time for time, _ in read(folder)] == [1]


def test_a_folder_with_several_files_is_one_bag(tmp_path):
    folder = folder_bag(tmp_path / "bag", "b.mcap, a.mcap", "mcap")
    for name, second in (("b", 1), ("a", 2)):
        (folder / f"{name}.mcap").write_bytes(mcap([mcap_message(second)]))
    with MergedBag([folder]) as bags:
        assert [record.time // SECOND for record in bags.records()] == [1, 2]
        assert [topic.messages for topic in bags.topics] == [2]
