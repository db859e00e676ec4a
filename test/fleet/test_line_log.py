"""Logs of lines: what a writer has appended is read once, also after either process was killed."""

from pathlib import Path
from typing import List

import pytest

from retalis.fleet.line_log import START, LogReader, LogWriter, Position
from retalis.foundation.errors import UsageError


def read_texts(reader: LogReader, position: Position = START) -> List[str]:
    """Return all lines from a position on."""
    texts = []
    while True:
        lines, next_position = reader.read(position)
        texts += [line.text for line in lines]
        if next_position == position:
            return texts
        position = next_position


def test_lines_of_all_files_are_read_in_order(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path, max_file_bytes=20)
    expected = [f"line {number}" for number in range(20)]
    for line in expected:
        writer.append([line])
    writer.close()
    assert len(list(tmp_path.iterdir())) == 7
    assert read_texts(LogReader(tmp_path)) == expected
    assert read_texts(LogReader(tmp_path, max_bytes=10)) == expected


def test_reader_continues_at_each_position(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path, max_file_bytes=20)
    for number in range(10):
        writer.append([f"line {number}"])
    writer.close()
    reader = LogReader(tmp_path)
    lines, _ = reader.read(START)
    assert [line.position for line in lines] == [Position(1, 0), Position(1, 7), Position(1, 14)]
    for line in lines:
        assert read_texts(reader, line.position)[0] == line.text


def test_incomplete_line_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text("one\ntw", encoding="utf-8")
    reader = LogReader(path)
    lines, position = reader.read(START)
    assert [line.text for line in lines] == ["one"]
    path.write_text("one\ntwo\n", encoding="utf-8")
    assert read_texts(reader, position) == ["two"]


def test_writer_removes_incomplete_line(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path)
    writer.append(["one"])
    writer.close()
    (path,) = tmp_path.iterdir()
    with open(path, "a", encoding="utf-8") as file:
        file.write("a part of a li")
    writer = LogWriter(tmp_path)
    writer.append(["two"])
    writer.close()
    assert read_texts(LogReader(tmp_path)) == ["one", "two"]


def test_second_writer_is_refused(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path)
    with pytest.raises(UsageError, match="another process writes this log"):
        LogWriter(tmp_path)
    writer.append(["one"])
    writer.close()
    LogWriter(tmp_path).close()
    assert read_texts(LogReader(tmp_path)) == ["one"]


def test_deleted_files_are_reported(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path, max_bytes=20, max_file_bytes=10)
    for number in range(10):
        writer.append([f"line number {number}"])
    writer.close()
    assert writer.deleted_count == 9
    lines, _ = LogReader(tmp_path).read(Position(1, 14))
    assert [line.error for line in lines[:1]] == ["9 files of the log deleted before the end was read"]
    assert read_texts(LogReader(tmp_path)) == ["line number 9"]


def test_invalid_text_is_a_line_with_error(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_bytes(b"\xff\nfine\n")
    lines, _ = LogReader(path).read(START)
    assert [(line.text, line.error) for line in lines] == [
        ("\\xff", "no UTF-8: invalid start byte"),
        ("fine", ""),
    ]


def test_too_long_line_is_reported_and_skipped(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text("a" * 30 + "\nfine\n", encoding="utf-8")
    reader = LogReader(path, max_bytes=20)
    lines, position = reader.read(START)
    assert [line.error for line in lines] == ["the line is longer than 20 bytes: 'aaaaaaaaaaaaaaaaaaaa'"]
    assert read_texts(reader, position) == ["a" * 10, "fine"]


def test_file_that_became_shorter_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text("one\n", encoding="utf-8")
    with pytest.raises(UsageError, match="it has 4 bytes: expected at least 8, which have been read before"):
        LogReader(path).read(Position(1, 8))
