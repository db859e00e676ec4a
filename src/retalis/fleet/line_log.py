"""A log of lines in a folder: numbered files that one process appends to, and that readers follow by position.

A line is in the log when it ends with a newline and is on the disk. A reader stores its `Position` together with what
it has made of the lines before, and continues there after a crash. A writer that was killed may leave a part of a
line at the end of the last file: no reader has used it, and the next writer removes it.
"""

import os
from pathlib import Path
from typing import BinaryIO, Iterable, List, NamedTuple, Optional, Tuple

from ..foundation.displayed_text import format_count, quote_shortened
from ..foundation.errors import UsageError

SUFFIX = ".jsonl"

MAX_FILE_BYTES = 64_000_000
"""Size at which a writer begins the next file."""

READ_BYTES = 4_000_000
"""Maximum number of bytes that are read at once; no line may be longer."""


class Position(NamedTuple):
    """A position in a log.

    >>> str(Position(2, 70)), Position.parse("2:70")
    ('2:70', Position(number=2, offset=70))

    Attributes:
        number: number of the file.
        offset: offset in the file in bytes.
    """

    number: int
    offset: int

    def __str__(self) -> str:
        return f"{self.number}:{self.offset}"

    @classmethod
    def parse(cls, text: str) -> "Position":
        """Return the position of its text."""
        number, _, offset = text.partition(":")
        return cls(int(number), int(offset))


START = Position(0, 0)


class LogLine(NamedTuple):
    """A line of a log, and its position.

    Attributes:
        position: position of its first byte.
        text: the line without the newline, if it is one.
        error: why it is no line; "" if it is one.
    """

    position: Position
    text: str
    error: str = ""


def log_files(folder: Path) -> List[Tuple[int, Path]]:
    """Return the files of a log with their numbers, in order."""
    return sorted((int(path.stem), path) for path in folder.glob(f"*{SUFFIX}") if path.stem.isdecimal())


class LogWriter:
    """The writer of a log; there must be one per log.

    Args:
        folder: folder of the log; it is created.
        max_bytes: maximum size of all files together in bytes; the oldest files are deleted. None for no limit.
        max_file_bytes: size at which the next file begins.

    Attributes:
        deleted_count: number of files that were deleted.

    Raises:
        UsageError: if another process writes the log.
        OSError: if the log cannot be opened.
    """

    def __init__(self, folder: Path, max_bytes: Optional[int] = None, max_file_bytes: int = MAX_FILE_BYTES):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._max_bytes, self._max_file_bytes = folder, max_bytes, max_file_bytes
        self.deleted_count = 0
        files = log_files(folder)
        self._number = files[-1][0] if files else 1
        self._file = self._open()
        self._remove_partial_line()

    def append(self, lines: Iterable[str]) -> None:
        """Append lines, and return when they are on the disk.

        Raises:
            OSError: if they cannot be written; the writer must not be used again.
        """
        self._file.write(b"".join(line.encode() + b"\n" for line in lines))
        self._file.flush()
        os.fsync(self._file.fileno())
        if self._file.tell() >= self._max_file_bytes:
            self._file.close()
            self._number += 1
            self._file = self._open()
            self._delete_old()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _open(self) -> BinaryIO:
        import fcntl  # noqa: PLC0415 (not on Windows)

        file = open(self._folder / f"{self._number:09}{SUFFIX}", "ab")  # noqa: SIM115 - closed by `close`
        try:
            # A reader never returns to a file that another writer has left, so it would miss the lines of this one.
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.close()
            raise UsageError(f"{self._folder}: another process writes this log: expected one") from error
        # The name of a new file is on the disk before a line of it is.
        descriptor = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        return file

    def _remove_partial_line(self) -> None:
        size = end = self._file.tell()
        with open(self._file.name, "rb") as file:
            while end > 0:
                start = max(0, end - READ_BYTES)
                file.seek(start)
                newline = file.read(end - start).rfind(b"\n")
                if newline >= 0:
                    end = start + newline + 1
                    break
                end = start
        if end < size:
            self._file.truncate(end)
            self._file.seek(end)

    def _delete_old(self) -> None:
        if self._max_bytes is None:
            return
        files = log_files(self._folder)[:-1]
        total_bytes = sum(path.stat().st_size for _, path in files)
        for _, path in files:
            if total_bytes <= self._max_bytes:
                break
            total_bytes -= path.stat().st_size
            path.unlink()
            self.deleted_count += 1


class LogReader:
    """A reader of a log, or of one file that grows.

    Args:
        path: folder of a log, or a file.
        max_bytes: maximum number of bytes that are read at once.
    """

    def __init__(self, path: Path, max_bytes: int = READ_BYTES):
        self._path, self._max_bytes = path, max_bytes

    def read(self, position: Position) -> Tuple[List[LogLine], Position]:
        """Return complete lines from a position on, and the position after them.

        If there are none, the position is returned, or the beginning of the next file. Lines that were deleted before
        they were read are reported as a `LogLine` with an error.

        Raises:
            UsageError: if the position is beyond the end of a file.
        """
        files = [(1, self._path)] if self._path.is_file() else log_files(self._path)
        files = [(number, path) for number, path in files if number >= position.number]
        if not files:
            return [], position
        number, path = files[0]
        lines: List[LogLine] = []
        if number != position.number:
            if position != START:
                gap = format_count(number - position.number, "file")
                lines = [LogLine(position, "", f"{gap} of the log deleted before the end was read")]
            position = Position(number, 0)
        read_lines, position = self._read_file(path, position)
        lines += read_lines
        # The next file exists, so this one does not grow any more. It is read again, as it may have grown meanwhile.
        if not lines and len(files) > 1:
            lines, position = self._read_file(path, position)
            if not lines:
                position = Position(files[1][0], 0)
        return lines, position

    def _read_file(self, path: Path, position: Position) -> Tuple[List[LogLine], Position]:
        number, offset = position
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            if size < offset:
                raise UsageError(
                    f"{path}: it has {size} bytes: expected at least {offset}, which have been read before"
                )
            file.seek(offset)
            data = file.read(self._max_bytes)
        end = data.rfind(b"\n") + 1
        if end == 0:
            if len(data) < self._max_bytes:
                return [], position
            start = quote_shortened(data[:100].decode("ascii", "replace"))
            error = f"the line is longer than {self._max_bytes} bytes: {start}"
            return [LogLine(position, "", error)], Position(number, offset + len(data))
        lines = []
        for line in data[: end - 1].split(b"\n"):
            lines.append(_decode_line(line, Position(number, offset)))
            offset += len(line) + 1
        return lines, Position(number, offset)


def _decode_line(line: bytes, position: Position) -> LogLine:
    try:
        return LogLine(position, line.decode())
    except UnicodeDecodeError as error:
        return LogLine(position, line.decode("utf-8", "backslashreplace"), f"no UTF-8: {error.reason}")
