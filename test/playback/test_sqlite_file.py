"""SQLite files of ROS 2 bags: write-ahead logs, limits, and malicious files."""

import gc
import hashlib
import os
import shutil
import sqlite3
import struct
import sys
from contextlib import closing
from pathlib import Path
from typing import Any, Dict, Generator, List, Tuple

import pytest

pytest.importorskip("rosbags.rosbag2")

from malicious_bags import HELLO, ROWS, TABLES, sqlite_bag  # noqa: E402

from retalis import BagError  # noqa: E402
from retalis.cli.command_line import main  # noqa: E402
from retalis.playback.bag_locations import MergedBag  # noqa: E402
from retalis.playback.decompression import ChunkLimit  # noqa: E402
from retalis.playback.sqlite_file import SqliteFile  # noqa: E402

SECOND = 10**9


def read(path: Any) -> List[Tuple[Any, ...]]:
    with MergedBag([path], max_chunk_megabytes=1) as bags:
        return [(record.time // SECOND, record.data[4:]) for record in bags.records()]


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
def test_malicious_database_is_an_error(tmp_path: Path, changes: Any, expected: str) -> None:
    path = sqlite_bag(tmp_path / "a.db3", **changes)
    with pytest.raises(BagError, match=expected):
        read(path)


def test_repeated_pages_of_table_are_an_error(tmp_path: Path) -> None:
    """A tree of pages in which each page refers hundreds of times to the next one has an unlimited number of rows."""
    path = sqlite_bag(tmp_path / "a.db3", messages=[(second, HELLO) for second in range(20_000)])
    with closing(sqlite3.connect(str(path))) as database:
        (size,) = database.execute("PRAGMA page_size").fetchone()
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    pages = bytearray(path.read_bytes())

    def children(page: Any) -> List[Any]:
        """Return the positions of the page numbers in an interior page of a table."""
        begin = (page - 1) * size
        assert pages[begin] == 5
        (cells,) = struct.unpack_from(">H", pages, begin + 3)
        offsets = struct.unpack_from(f">{cells}H", pages, begin + 12)
        return [*(begin + offset for offset in offsets), begin + 8]

    # Copies of the root are its own descendants, a few levels deep: each level multiplies the rows.
    levels = 6
    end = len(pages) // size
    original = bytes(pages[(root - 1) * size : root * size])
    for level in range(levels):
        page = end + level + 1
        pages += original
        if level:
            for position in children(page):
                struct.pack_into(">I", pages, position, page - 1)
    for position in children(root):
        struct.pack_into(">I", pages, position, end + levels)
    struct.pack_into(">I", pages, 28, len(pages) // size)
    path.write_bytes(bytes(pages))
    with pytest.raises(BagError, match="its tables have more rows than a file of its size can hold"):
        read(path)


def test_database_without_index_is_sorted_by_time(tmp_path: Path) -> None:
    tables = TABLES.replace("CREATE INDEX timestamp_idx ON messages (timestamp ASC);", "")
    path = sqlite_bag(tmp_path / "a.db3", tables, messages=[(3, HELLO), (1, HELLO), (2, HELLO)])
    assert [time for time, _ in read(path)] == [1, 2, 3]
    file = SqliteFile(path, ChunkLimit(1))
    assert [time // SECOND for _, time, _ in file.read([1], 2 * SECOND, 3 * SECOND)] == [2]
    assert list(file.read([2], None, None)) == []
    file.close()


def test_reading_can_end_after_file_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unraisable: List[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    file = SqliteFile(sqlite_bag(tmp_path / "a.db3", messages=[(1, HELLO), (2, HELLO)]), ChunkLimit(1))
    messages = file.read([1], None, None)
    assert isinstance(messages, Generator)
    next(messages)
    file.close()
    messages.close()
    gc.collect()
    assert unraisable == []


def test_large_database_is_read_with_large_limit(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path / "a.db3")
    os.truncate(path, 3 << 30)  # a sparse file: its last pages are holes
    file = SqliteFile(path, ChunkLimit(4096))
    assert [time for _, time, _ in file.read([1], None, None)] == [SECOND]
    file.close()


# ---- write-ahead log ---------------------------------------------------------------------------------


def interrupted_bag(folder: Path, stored: Any, logged: List[int]) -> Any:
    """Write the database of a killed recorder.

    Args:
        folder: the folder of the bag.
        stored: seconds of the messages in the database.
        logged: seconds of later messages in the write-ahead log.
    """
    folder.mkdir()
    path = folder / "w.db3"
    with closing(sqlite3.connect(str(folder / "recording.db3"))) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.executescript(TABLES + ROWS)
        insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)"
        database.executemany(insert, [(second * SECOND, HELLO) for second in stored])
        database.commit()
        if stored:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.executemany(insert, [(second * SECOND, HELLO) for second in logged])
        database.commit()
        shutil.copy(str(folder / "recording.db3"), str(path))
        shutil.copy(str(folder / "recording.db3-wal"), f"{path}-wal")
    (folder / "recording.db3").unlink()
    return path


def digests(folder: Path) -> Dict[Any, Any]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.mark.parametrize("stored", [[1, 2], []])
def test_write_ahead_log_is_read_without_writing(tmp_path: Path, stored: List[int]) -> None:
    path = interrupted_bag(tmp_path / "bag", stored, [3, 4, 5])
    before = digests(path.parent)
    assert sorted(before) == ["w.db3", "w.db3-wal"]
    assert [time for time, _ in read(path)] == [*stored, 3, 4, 5]
    assert digests(path.parent) == before


def test_log_beside_target_of_link_is_read(tmp_path: Path) -> None:
    link = tmp_path / "link.db3"
    link.symlink_to(interrupted_bag(tmp_path / "bag", [1], [2]))
    assert [time for time, _ in read(link)] == [1, 2]


def test_log_in_read_only_folder_is_read(tmp_path: Path) -> None:
    path = interrupted_bag(tmp_path / "bag", [1], [2])
    path.chmod(0o444)
    path.parent.chmod(0o555)
    try:
        assert [time for time, _ in read(path)] == [1, 2]
    finally:
        path.parent.chmod(0o755)


def test_unreadable_log_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = interrupted_bag(tmp_path / "bag", [1], [2])
    log = path.with_name("w.db3-wal")
    log.unlink()
    log.mkdir()
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "program" / "goalPredicates.txt").write_text("")
    assert main(["bag", str(path), "--program", str(tmp_path / "program")]) == 3
    error = capsys.readouterr().err
    assert "its write-ahead log w.db3-wal, which has the newest messages, cannot be read: " in error


def test_empty_database_keeps_its_log(tmp_path: Path) -> None:
    path = interrupted_bag(tmp_path / "bag", [1], [2])
    path.write_bytes(b"")
    before = digests(path.parent)
    with pytest.raises(BagError, match="it is empty: expected a database"):
        read(path)
    assert digests(path.parent) == before


def test_rollback_journal_is_ignored_with_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = sqlite_bag(tmp_path / "a.db3")
    journal = tmp_path / "a.db3-journal"
    journal.write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + bytes(504))
    before = digests(tmp_path)
    assert [time for time, _ in read(path)] == [1]
    (record,) = caplog.records
    assert record.getMessage() == (
        f"{path} is incomplete: its recorder has not ended a transaction (it has a rollback journal, which is "
        "ignored): 1 message was read, the last of time 1.000000000 s; messages that the recorder had not written "
        "are lost, their number is unknown"
    )
    assert digests(tmp_path) == before
