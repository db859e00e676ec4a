"""Bags that a crash has cut: the messages before the cut, and the description of what is missing."""

import os
import re
import sqlite3
import struct
import sys
from contextlib import closing
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

rosbag1 = pytest.importorskip("rosbags.rosbag1")

from malicious_bags import ROWS, TABLES, TEXT, TOPIC, mcap, mcap_message, ros1_bag, zstd  # noqa: E402

from retalis import BagError, BagReader  # noqa: E402
from retalis.playback.bag_locations import MergedBag, find_bags, open_bag  # noqa: E402

SECOND = 10**9
MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
MESSAGE_COUNT = 40
TEXTS = [b"%d " % number * (number * 37 % 60) for number in range(1, MESSAGE_COUNT + 1)]


def cdr(text: bytes) -> bytes:
    """Return a message of ROS 2 with a string."""
    return b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"


def ros1_file(folder: Path, compression: str) -> bytes:
    """Return a bag with some messages in each chunk."""
    path = folder / "whole.bag"
    writer = rosbag1.Writer(path)
    if compression != "none":
        names = rosbag1 if hasattr(rosbag1, "CompressionFormat") else writer
        writer.set_compression(names.CompressionFormat[compression.upper()])
    writer.chunk_threshold = 1500
    with writer:
        topic = writer.add_connection("/a", "std_msgs/msg/String", msgdef=TEXT, md5sum=MD5)
        for number, text in enumerate(TEXTS, 1):
            writer.write(topic, number * SECOND, struct.pack("<I", len(text)) + text)
    content = path.read_bytes()
    path.unlink()
    return content


def mcap_records() -> List[Any]:
    """Return message records, in pairs in the reverse order of time."""
    return [mcap_message((number - 1 ^ 1) + 1, cdr(text)) for number, text in enumerate(TEXTS, 1)]


def mcap_file(compression: str) -> bytes:
    records = mcap_records()
    return bytes(
        mcap([b"".join(records[start : start + 9]) for start in range(0, MESSAGE_COUNT, 9)], compression)
    )


def loose_mcap_file() -> bytes:
    return bytes(mcap([], topic=TOPIC + b"".join(mcap_records())))


def sqlite_file(folder: Path, is_sorted: bool) -> bytes:
    """Return a database with pages of 512 bytes, so that messages have overflow pages and the tree has levels."""
    path = folder / "whole.db3"
    with closing(sqlite3.connect(str(path))) as database:
        database.execute("PRAGMA page_size = 512")
        database.executescript(TABLES)
        database.execute("INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/String', 'cdr', '', '')")
        database.execute(
            "INSERT INTO message_definitions VALUES(1, 'std_msgs/msg/String', 'ros2msg', ?, '')", (TEXT,)
        )
        for number, text in enumerate(TEXTS, 1):
            time = number if is_sorted else (number - 1 ^ 1) + 1
            database.execute(
                "INSERT INTO messages VALUES(?, 1, ?, ?)", (number, time * SECOND, cdr(text * 5))
            )
        database.commit()
    content = path.read_bytes()
    path.unlink()
    return content


class WholeFile(NamedTuple):
    """A complete file of a bag, its suffix, and its messages in their order in the file."""

    content: bytes
    suffix: str
    messages: List[Tuple[int, bytes]]


def read(path: Path) -> List[Tuple[int, bytes]]:
    with open_bag(path) as bag:
        return [(record.time, record.data) for record in bag.records()]


FORMATS: Dict[str, Tuple[str, Callable[[Path], bytes]]] = {
    "bag": (".bag", lambda folder: ros1_file(folder, "none")),
    "bag-bz2": (".bag", lambda folder: ros1_file(folder, "bz2")),
    "bag-lz4": (".bag.active", lambda folder: ros1_file(folder, "lz4")),
    "mcap": (".mcap", lambda folder: mcap_file("")),
    "mcap-lz4": (".mcap", lambda folder: mcap_file("lz4")),
    "mcap-zstd": (".mcap", lambda folder: mcap_file("zstd")),
    "mcap-loose": (".mcap", lambda folder: loose_mcap_file()),
    "mcap-file-zstd": (".mcap.zstd", lambda folder: zstd(mcap_file(""))),
    "db3": (".db3", lambda folder: sqlite_file(folder, True)),
    "db3-unsorted": (".db3", lambda folder: sqlite_file(folder, False)),
    "db3-file-zstd": (".db3.zstd", lambda folder: zstd(sqlite_file(folder, True))),
}


@pytest.fixture(scope="module", params=sorted(FORMATS))
def whole_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> WholeFile:
    folder = tmp_path_factory.mktemp("whole")
    suffix, create = FORMATS[request.param]
    path = folder / f"whole{suffix}"
    path.write_bytes(create(folder))
    messages = read(path)
    assert len(messages) == MESSAGE_COUNT
    if request.param.startswith("mcap") or "unsorted" in request.param:
        messages = [messages[index ^ 1] for index in range(MESSAGE_COUNT)]
    return WholeFile(path.read_bytes(), suffix, messages)


def count_messages_before_cut(file: WholeFile, size: int, folder: Path) -> int:
    """Check the messages and the description of a file that ends after ``size`` bytes; return their number."""
    path = folder / f"cut{file.suffix}"
    path.write_bytes(file.content[:size])
    try:
        bag = open_bag(path)
    except BagError as error:
        if f"{path} is not a complete ROS " not in str(error):
            raise
        return 0
    with bag:
        records = list(bag.records())
        (incomplete,) = bag.incomplete_files
    times = [record.time for record in records]
    assert times == sorted(times)
    assert {(record.time, record.data) for record in records} == set(file.messages[: len(records)])
    assert incomplete.path == str(path)
    assert incomplete.messages == bag.messages == len(records)
    assert incomplete.end == bag.end == max(times, default=0)
    if incomplete.position is not None and not file.suffix.endswith(".zstd"):
        unread_bytes = 0 if incomplete.is_data_complete else size - incomplete.position
        assert incomplete.unread_bytes == unread_bytes
    assert path.read_bytes() == file.content[:size]
    assert os.listdir(folder) == [path.name]
    return len(records)


@given(share=st.floats(0, 1, exclude_max=True))
@settings(max_examples=12, deadline=None)
def test_cut_file_has_messages_before_cut(
    whole_file: WholeFile, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    count_messages_before_cut(whole_file, int(share * len(whole_file.content)), folder)


@pytest.mark.nightly
def test_later_cut_has_more_messages(whole_file: WholeFile, tmp_path: Path) -> None:
    sizes = range(0, len(whole_file.content), 7)
    counts = [count_messages_before_cut(whole_file, size, tmp_path) for size in sizes]
    assert counts == sorted(counts)


def describe(path: Path) -> str:
    with open_bag(path) as bag:
        (file,) = bag.incomplete_files
    return str(file).replace(f"{path}", path.name)


def test_cut_message_of_bag_is_located(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    content = ros1_file(tmp_path, "none")
    # Before the text are lengths of 4 bytes each of text, data and header, and the header of 38 bytes.
    start = content.index(b"29 29") - 4 - 4 - 38 - 4
    path.write_bytes(content[: start + 60])
    assert re.fullmatch(
        "a.bag is incomplete: its index is missing: 28 messages were read, the last of time 28.000000000 s; "
        f"60 bytes from byte {start} on were not, at least [0-9]+ bytes are missing, "
        "the number of lost messages is unknown",
        describe(path),
    )


@pytest.mark.parametrize(
    ("compression", "old", "new", "reason"),
    [
        ("bz2", b"BZh9", b"BZhx", r"the chunk at byte 4109 cannot be read: OSError: .+"),
        (
            "none",
            b"compression=",
            b"compressiom=",
            "the chunk at byte 4109 cannot be read: its header, .+, has no field 'compression'",
        ),
        (
            "none",
            b"op=\x05",
            b"oq=\x05",
            "the record at byte 4109 cannot be read: its header, .+ has no field 'op'",
        ),
        ("none", b"op=\x05", b"op=\x09", "the record at byte 4109 is of no known type"),
        (
            "none",
            b"conn=\0",
            b"conm=\0",
            "the chunk at byte 4109 cannot be read: its header, .+ has no field 'conn'",
        ),
    ],
)
def test_damage_in_bag_without_index_has_reason(
    tmp_path: Path, compression: str, old: bytes, new: bytes, reason: str
) -> None:
    path = tmp_path / "a.bag"
    content = ros1_file(tmp_path, compression)
    (index_position,) = struct.unpack_from("<Q", content, content.index(b"index_pos=") + len("index_pos="))
    assert old in content[4109:index_position]
    path.write_bytes(content[:4109] + content[4109:index_position].replace(old, new, 1))
    assert re.fullmatch(
        f"a.bag is incomplete: its index is missing, and {reason}: 0 messages were read; "
        "[0-9]+ bytes from byte [0-9]+ on were not, the number of lost messages is unknown",
        describe(path),
    )


def test_bag_without_position_of_index_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.bag.active"
    content = bytearray(ros1_file(tmp_path, "none"))
    field = content.index(b"index_pos=") + len("index_pos=")
    (position,) = struct.unpack_from("<Q", content, field)
    content[field : field + 8] = bytes(8)
    path.write_bytes(content[:position])
    assert describe(path) == (
        "a.bag.active is incomplete: its index is missing: 40 messages were read, the last of time 40.000000000 s; "
        "messages that the recorder had not written are lost, their number is unknown"
    )
    path.write_bytes(content)
    assert describe(path).endswith("the last of time 40.000000000 s; no message in it is lost")


@pytest.mark.parametrize("name", ["bag", "mcap", "db3"])
def test_zeros_in_place_of_end_are_not_read(tmp_path: Path, name: str) -> None:
    suffix, create = FORMATS[name]
    path = tmp_path / f"a{suffix}"
    content = create(tmp_path)
    # A file system that loses its last blocks fills them with zeros.
    size = len(content) * 3 // 4 // 512 * 512
    path.write_bytes(content[:size])
    messages = read(path)
    assert 10 < len(messages) < MESSAGE_COUNT
    path.write_bytes(content[:size] + bytes(len(content) - size))
    # Zeros can be the end of the last message.
    assert set(messages) <= set(read(path))
    assert len(read(path)) <= len(messages) + 1


@pytest.mark.parametrize("name", ["bag", "mcap"])
def test_limit_of_chunks_holds_for_cut_file(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"a.{name}"
    text = bytes(1_100_000)
    if name == "bag":
        path.write_bytes(ros1_bag([[text]])[:-50])
    else:
        path.write_bytes(mcap([mcap_message(1, cdr(text))])[:-50])
    with pytest.raises(BagError, match="states 11[0-9]* bytes: expected at most 1 MB"):
        open_bag(path, max_chunk_megabytes=1)


def test_strict_reader_refuses_incomplete_bag(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_file(tmp_path, "none")[:-50])
    with pytest.raises(BagError, match="a.bag is incomplete: its index is cut or damaged at byte "):
        BagReader(path, strict=True)
    with pytest.raises(BagError, match="is incomplete"):
        MergedBag([path], strict=True)


def test_incomplete_bag_is_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_file(tmp_path, "none")[:-50])
    with MergedBag([path]) as bag:
        assert len(list(bag.records())) == len(list(bag.records())) == MESSAGE_COUNT
        (file,) = bag.incomplete_files
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [("WARNING", str(file))]


def test_folder_without_metadata_is_bag(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(mcap([mcap_message(2)], has_index=False))
    (folder / "run_1.mcap").write_bytes(mcap([mcap_message(1)], has_index=False))
    assert [time for time, _ in read(folder)] == [SECOND, 2 * SECOND]
    assert describe(folder) == (
        "run is incomplete: its metadata.yaml is missing: 2 messages were read, the last of time 2.000000000 s; "
        "messages that the recorder had not written are lost, their number is unknown"
    )
    assert [bag.name for bag in find_bags([str(tmp_path)])] == ["run"]
    assert [bag.name for bag in find_bags([str(folder)])] == ["run"]
    (folder / "metadata.yaml").touch()
    assert "its metadata.yaml is empty" in describe(folder)


@pytest.mark.parametrize(
    ("stated", "loss"),
    [("30", "9 messages are lost"), ("22", "1 message is lost"), ("21", "is unknown"), ("x", "is unknown")],
)
def test_metadata_states_number_of_lost_messages(tmp_path: Path, stated: str, loss: str) -> None:
    path = tmp_path / "a.mcap"
    content = loose_mcap_file()
    path.write_bytes(content[: content.index(b"22 22")])
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  relative_file_paths: [a.mcap]\n"
        f"  message_count: {stated}\n  topics_with_message_count:\n  - message_count: 7\n"
    )
    assert len(read(path)) == 21
    assert describe(tmp_path).endswith(f" {loss}")


def test_folder_with_other_files_is_not_bag(tmp_path: Path) -> None:
    for name in ("run_0.mcap", "other_0.mcap"):
        (tmp_path / name).write_bytes(mcap([mcap_message(2)]))
    assert [bag.name for bag in find_bags([str(tmp_path)])] == ["other_0", "run_0"]
    with pytest.raises(
        BagError, match="its files are not those of one recording: expected metadata.yaml, or"
    ):
        open_bag(tmp_path)


@pytest.mark.parametrize("other", ["run_00.mcap", "run_0.db3", "run_0.db3.zstd"])
def test_folder_with_two_files_of_one_number_is_not_bag(tmp_path: Path, other: str) -> None:
    """Neither of them is left out."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("run_0.mcap", other):
        (folder / name).write_bytes(mcap([mcap_message(2)]))
    with pytest.raises(BagError, match="its files are not those of one recording"):
        open_bag(folder)


def test_compressed_messages_need_no_metadata(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap([mcap_message(1, zstd(cdr(b"hello"))) + mcap_message(2, cdr(b"bye"))]))
    assert [data[8:-1] for _, data in read(path)] == [b"hello", b"bye"]


def test_write_ahead_log_makes_bag_incomplete(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(str(tmp_path / "live.db3"))) as database:
        database.execute("PRAGMA journal_mode = WAL")
        sqlite_bag_rows = f"{TABLES}{ROWS}"
        database.executescript(sqlite_bag_rows)
        database.execute("INSERT INTO messages VALUES(1, 1, ?, ?)", (SECOND, cdr(b"a")))
        database.commit()
        for suffix in ("", "-wal"):
            (tmp_path / f"a.db3{suffix}").write_bytes((tmp_path / f"live.db3{suffix}").read_bytes())
    assert describe(path) == (
        "a.db3 is incomplete: its recorder has not closed it (it has a write-ahead log, which is read): "
        "1 message was read, the last of time 1.000000000 s; "
        "messages that the recorder had not written are lost, their number is unknown"
    )


@pytest.mark.parametrize(("module", "compression"), [("lz4.frame", "lz4"), ("rosbags.rosbag2", "zstd")])
def test_missing_decompressor_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, compression: str
) -> None:
    path = tmp_path / "a.mcap"
    content = mcap_file(compression)
    monkeypatch.setitem(sys.modules, module, None)
    for end in (len(content), len(content) - 300):
        path.write_bytes(content[:end])
        with pytest.raises(BagError, match=f"compressed with {compression}, which needs the Python package"):
            read(path)
