"""Search for the first damaged row of a table in an SQLite file that is cut, or whose last pages are zero.

SQLite reads missing bytes of the last page as zeros, so a message can have zeros in place of its end. This module
walks through the pages of a table in the order of its rows, and counts the rows whose pages are all in the file.

Format: https://www.sqlite.org/fileformat.html, "B-tree Pages" and "Cell Payload Overflow Pages"
"""

from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import BinaryIO, Iterator, Tuple

from ..foundation.interrupts import check_interrupt

_FILE_HEADER_BYTES = 100
_FILE_HEADER_STRUCT = Struct(">16xH2xB3xII60xI")
"""Size of a page, unused bytes of each page, change counter, number of pages, and the counter when it was written."""

_PAGE_HEADER_STRUCT = Struct(">B2xH3x")
"""Type of a page, and number of its cells."""

_POINTER_STRUCT = Struct(">I")
_OFFSET_STRUCT = Struct(">H")

_INTERIOR_PAGE, _LEAF_PAGE = 5, 13
"""Types of the pages of tables."""

_BLOCK_BYTES = 1 << 16

_DAMAGE_ERRORS = (ValueError, IndexError, StructError)
"""Errors that the bytes of a damaged page lead to."""


def read_stated_size(path: Path) -> int:
    """Return the size of a database in bytes as its header states it; 0 if it does not state it."""
    with path.open("rb") as file:
        header = file.read(_FILE_HEADER_BYTES)
    if len(header) < _FILE_HEADER_BYTES or not header.startswith(b"SQLite format 3\0"):
        return 0
    page_size, _, change_counter, page_count, valid_for = _FILE_HEADER_STRUCT.unpack_from(header)
    # The value 1 means 65536.
    return (65536 if page_size == 1 else page_size) * page_count if change_counter == valid_for else 0


def count_complete_rows(path: Path, root_page: int) -> Tuple[int, bool]:
    """Return the number of rows of a table before the first one that is damaged, and whether none is damaged.

    Args:
        path: the database, which has no write-ahead log.
        root_page: number of the first page of the table.

    Raises:
        ValueError, struct.error: if the file has no header of a database.
    """
    count = 0
    with path.open("rb") as file:
        table = _TablePages(file, path.stat().st_size)
        try:
            for payload_is_complete in table.check_rows(root_page):
                if not payload_is_complete:
                    return count, False
                count += 1
        except _DAMAGE_ERRORS:
            return count, False
    return count, True


class _TablePages:
    """The pages of a database that are complete."""

    def __init__(self, file: BinaryIO, size: int):
        self._file = file
        page_size, unused_bytes, _, _, _ = _FILE_HEADER_STRUCT.unpack_from(file.read(_FILE_HEADER_BYTES))
        self._page_size = 65536 if page_size == 1 else page_size
        if self._page_size < 512:
            raise ValueError("the size of a page is invalid")
        self._usable_size = self._page_size - unused_bytes
        # A file system fills the end of a file with zeros if the computer fails: these pages are missing.
        self._page_count = min(size // self._page_size, -(-_find_zero_end(file, size) // self._page_size))
        # Each page belongs to one row or node: more reads would follow a cycle.
        self._remaining_reads = self._page_count

    def check_rows(self, page_number: int, depth: int = 0) -> Iterator[bool]:
        """Yield for each row below a page whether it has all its pages.

        Raises:
            ValueError, IndexError, struct.error: if a page of the tree is missing or damaged.
        """
        check_interrupt()
        page = self._read_page(page_number, self._page_size)
        start = _FILE_HEADER_BYTES if page_number == 1 else 0
        page_type, cell_count = _PAGE_HEADER_STRUCT.unpack_from(page, start)
        is_leaf = page_type == _LEAF_PAGE
        # A tree of 2**32 pages has a depth of less than 20.
        if not (is_leaf or page_type == _INTERIOR_PAGE) or depth > 20:
            raise ValueError("a page is not one of a table")
        array_start = start + (8 if is_leaf else 12)
        for index in range(cell_count):
            (offset,) = _OFFSET_STRUCT.unpack_from(page, array_start + 2 * index)
            if is_leaf:
                yield self._has_payload(page, offset)
            else:
                yield from self.check_rows(_POINTER_STRUCT.unpack_from(page, offset)[0], depth + 1)
        if not is_leaf:
            yield from self.check_rows(_POINTER_STRUCT.unpack_from(page, start + 8)[0], depth + 1)

    def _has_payload(self, page: bytes, offset: int) -> bool:
        """Return whether a row has all its overflow pages."""
        payload_size, offset = _read_varint(page, offset)
        _, offset = _read_varint(page, offset)
        usable = self._usable_size
        if payload_size <= usable - 35:
            return payload_size > 0
        minimum = (usable - 12) * 32 // 255 - 23
        local_size = minimum + (payload_size - minimum) % (usable - 4)
        if local_size > usable - 35:
            local_size = minimum
        remaining = payload_size - local_size
        (page_number,) = _POINTER_STRUCT.unpack_from(page, offset + local_size)
        while remaining > 0:
            (page_number,) = _POINTER_STRUCT.unpack(self._read_page(page_number, _POINTER_STRUCT.size))
            remaining -= usable - 4
        return True

    def _read_page(self, number: int, size: int) -> bytes:
        """Return the first bytes of a page.

        Raises:
            ValueError: if it is missing.
        """
        self._remaining_reads -= 1
        if not 0 < number <= self._page_count or self._remaining_reads < 0:
            raise ValueError(f"page {number} is missing")
        self._file.seek((number - 1) * self._page_size)
        return self._file.read(size)


def _find_zero_end(file: BinaryIO, size: int) -> int:
    """Return the position after the last byte that is not zero."""
    end = size
    while end > 0:
        start = max(0, end - _BLOCK_BYTES)
        file.seek(start)
        content = file.read(end - start).rstrip(b"\0")
        if content:
            return start + len(content)
        end = start
    return 0


def _read_varint(data: bytes, offset: int) -> Tuple[int, int]:
    """Return the integer of at most 9 bytes at an offset, and the offset after it."""
    value = 0
    for index in range(offset, offset + 8):
        value = value << 7 | data[index] & 0x7F
        if data[index] < 0x80:
            return value, index + 1
    return value << 8 | data[offset + 8], offset + 9
