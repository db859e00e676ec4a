"""Reading of MCAP files (https://mcap.dev/spec).

A file consists of a header, records, a summary, and a footer. A record is an opcode, a length, and a body. Messages
are in chunks, which may be compressed, or directly in the file. The summary repeats schemas and channels, and has an
index entry with the time range of each chunk. A file without a summary is scanned from its start. A file without a
footer, whose recorder was killed or that was cut, is scanned up to the first record that is cut or damaged. Of a
chunk that is cut, the messages before the cut are read.

Chunks are merged by time, and only chunks that overlap in time are in memory. A chunk is not read if its index entry
has none of the requested channels. Messages outside of chunks have no
index: if the scan has found them in order of time, they are read one after the other. Otherwise the positions of the
requested ones are sorted by time, which takes 32 bytes of memory a message; the limit of a chunk bounds it.

The files are not trusted: chunks are decompressed up to the size that they state, and lengths are compared with the
file's size.
"""

from array import array
from binascii import crc32
from collections import Counter
from contextlib import ExitStack
from functools import partial
from operator import attrgetter
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import Callable, Collection, Dict, FrozenSet, Iterator, List, NamedTuple, Optional, Set, Tuple

from ..foundation.displayed_text import format_count
from ..foundation.interrupts import check_interrupt
from .decompression import (
    ChunkLimit,
    ChunkLimitError,
    MissingPackageError,
    describe_error,
    unpack,
    unpack_available,
)
from .incomplete_files import IncompleteFile
from .message_merge import MAX_TIME, Message, list_chunk_sources, merge_by_time
from .ros2_connections import Connection

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_STRUCT = Struct("<BQ")
_FOOTER_STRUCT = Struct("<BQQQI8s")
_LENGTH_STRUCT = Struct("<I")
_SIZE_STRUCT = Struct("<Q")
_ID_STRUCT = Struct("<H")
_IDS_STRUCT = Struct("<HH")
_MESSAGE_STRUCT = Struct("<HIQQ")
_CHUNK_STRUCT = Struct("<QQQI")
_INDEX_STRUCT = Struct("<QQQQ")
_STATISTICS_STRUCT = Struct("<QHIIIIQQ")
_COUNT_STRUCT = Struct("<HQ")
"""Channel, and the number of its messages or the position of its index."""

(
    _HEADER_OPCODE,
    _FOOTER_OPCODE,
    _SCHEMA_OPCODE,
    _CHANNEL_OPCODE,
    _MESSAGE_OPCODE,
    _CHUNK_OPCODE,
    _CHUNK_INDEX_OPCODE,
    _STATISTICS_OPCODE,
    _DATA_END_OPCODE,
) = 1, 2, 3, 4, 5, 6, 8, 11, 15
"""Opcodes of records."""


_MAX_CHUNK_HEADER_BYTES = 256
"""Number of bytes that are read of a chunk for the fields before its data; without a long name they have 44."""

_BYTES_PER_POSITION = 32
"""Memory for the time, position, length and rank of a message whose position is sorted."""


class _McapChunk(NamedTuple):
    """Index entry of a chunk.

    Attributes:
        start, end: times of the first and the last message in nanoseconds.
        position: offset of the record.
        length: length of the record, including its header.
        channels: ids of the channels that have messages in the chunk; empty if the file does not state them.
        readable_bytes: size after decompression of the complete records in a chunk that is cut; None if it is not.
    """

    start: int
    end: int
    position: int
    length: int
    channels: FrozenSet[int] = frozenset()
    readable_bytes: Optional[int] = None

    def may_have(self, channels: Set[int]) -> bool:
        """Return whether the chunk may have messages of one of the channels."""
        return not self.channels or not self.channels.isdisjoint(channels)


class _Totals:
    """Counts of messages by channel, and the times of the first and the last one.

    Attributes:
        last_loose_time: time of the last message outside of chunks in the order of the file.
    """

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()
        self.first, self.last = MAX_TIME, 0
        self.last_loose_time = 0

    def add(self, channel: int, time: int) -> None:
        """Count a message."""
        self.counts[channel] += 1
        self.first, self.last = min(self.first, time), max(self.last, time)

    def merge(self, other: "_Totals") -> None:
        """Add the counts of a chunk."""
        self.counts.update(other.counts)
        self.first, self.last = min(self.first, other.first), max(self.last, other.last)


class McapFile:
    """An ``.mcap`` file.

    Attributes:
        connections: topics of the file.
        start, end: times of the first and the last message in nanoseconds; 0 if there are none.
        incomplete_file: description of what is missing, without the path; None if the file is complete.

    Raises:
        Exception: if the file cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
        self.incomplete_file: Optional[IncompleteFile] = None
        self._limit = limit
        self._size = path.stat().st_size
        self._schemas: Dict[int, Tuple[str, str, str]] = {0: ("", "", "")}
        """Type, encoding and text of each schema, by its id."""
        self._channels: Dict[int, Tuple[int, str, str]] = {}
        """Id of the schema, topic and serialization format of each channel, by its id."""
        self._counts: Dict[int, int] = {}
        """Number of messages of each channel, by its id."""
        self._chunks: List[_McapChunk] = []
        self._has_loose_messages = False
        """True if there are messages outside of chunks."""
        self._is_in_order = True
        """True if the messages outside of chunks are in order of time."""
        self.start = self.end = 0
        with ExitStack() as stack:
            self._file = stack.enter_context(path.open("rb"))
            self._open()
            self._stack = stack.pop_all()
        self.connections = [
            Connection(
                identifier,
                topic,
                *self._schemas.get(schema, ("", "", "")),
                message_format,
                self._counts.get(identifier, 0),
            )
            for identifier, (schema, topic, message_format) in self._channels.items()
        ]

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in order of time, from ``start`` and before ``stop``.

        Raises:
            Exception: if the file is malformed, or too many chunks overlap in time.
        """
        first = 0 if start is None else start
        last = MAX_TIME + 1 if stop is None else stop
        wanted = set(ids)
        sources = self._list_chunk_sources(wanted, first, last)
        if self._has_loose_messages:
            read = self._read_in_order if self._is_in_order else self._read_sorted
            sources.insert(0, (0, partial(read, wanted, first, last)))
        return merge_by_time(sources)

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _open(self) -> None:
        """Read the header and the footer, and the summary or all records."""
        if self._read_bytes(0, min(self._size, len(_MAGIC))) != _MAGIC:
            raise ValueError("it does not begin as an mcap file")
        try:
            opcode, length = self._read_record_header(len(_MAGIC), self._size)
        except ValueError:
            raise ValueError("its header is cut or damaged") from None
        # The profile in the header is not needed: each channel states the format of its messages.
        if opcode != _HEADER_OPCODE:
            raise ValueError(f"its first record has the opcode {opcode}: expected a header, {_HEADER_OPCODE}")
        self._data_start = len(_MAGIC) + _RECORD_STRUCT.size + length
        footer = self._size - _FOOTER_STRUCT.size
        summary = self._read_footer(footer)
        if summary is None:
            self._recover()
            return
        self._data_end = summary or footer
        if not self._data_start <= self._data_end <= footer:
            raise ValueError(f"its summary at byte {summary} is outside of the file")
        # Some writers omit statistics or schemas in the summary. Schema 0 means "no schema" and is always present.
        # Without chunks, the summary does not say whether the messages are in order.
        if not (self._read_summary(footer) and len(self._schemas) > 1 and self._chunks):
            self._scan()

    def _read_footer(self, position: int) -> Optional[int]:
        """Return the position of the summary, 0 if there is none; None if the file has no footer."""
        # A recorder that was killed does not write a footer.
        if position < self._data_start:
            return None
        opcode, length, summary, _, _, magic = _FOOTER_STRUCT.unpack(
            self._read_bytes(position, _FOOTER_STRUCT.size)
        )
        return int(summary) if (opcode, length, magic) == (_FOOTER_OPCODE, 20, _MAGIC) else None

    def _read_summary(self, footer: int) -> bool:
        """Read the summary; return whether it contains the number of messages and their time range."""
        has_totals = False
        for opcode, position, length in self._scan_records(self._data_end, footer):
            if opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
                self._add_schema_or_channel(opcode, self._read_bytes(position, length))
            elif opcode == _CHUNK_INDEX_OPCODE:
                body = self._read_bytes(position, length)
                start, end, chunk_position, chunk_length = _INDEX_STRUCT.unpack_from(body)
                self._chunks.append(
                    _McapChunk(start, end, chunk_position, chunk_length, _read_indexed_channels(body))
                )
            elif opcode == _STATISTICS_OPCODE:
                body = self._read_bytes(position, length)
                message_count, _, _, _, _, _, start, end = _STATISTICS_STRUCT.unpack_from(body)
                self.start, self.end = (start, end) if message_count else (0, 0)
                (size,) = _LENGTH_STRUCT.unpack_from(body, _STATISTICS_STRUCT.size)
                counts = body[_STATISTICS_STRUCT.size + _LENGTH_STRUCT.size :][:size]
                self._counts = dict(_COUNT_STRUCT.iter_unpack(counts))
                # The number of messages of each channel is optional.
                has_totals = bool(self._counts) or not message_count
        # Overlapping index entries would let a small file contain the same chunk many times.
        self._chunks.sort(key=lambda chunk: chunk.position)
        for previous, chunk in zip(self._chunks, self._chunks[1:]):
            if chunk.position < previous.position + previous.length:
                raise ValueError(f"the index names the chunk at byte {chunk.position} inside another one")
        return has_totals

    def _scan(self) -> None:
        """Read all records before the summary, to find types, times, and chunks."""
        self._chunks.clear()
        totals = _Totals()
        for opcode, position, length in self._scan_records(self._data_start, self._data_end):
            self._add_record(opcode, position, length, totals)
        self._set_totals(totals)

    def _recover(self) -> None:
        """Read the records of a file without a footer, up to the first one that is cut or damaged."""
        totals = _Totals()
        position, is_data_complete = self._data_start, False
        while position < self._size and not is_data_complete:
            check_interrupt()
            try:
                opcode, length = self._read_record_header(position, self._size)
                # A file system fills the end of a file with zeros if the computer fails.
                if not opcode:
                    break
                is_data_complete = opcode in (_DATA_END_OPCODE, _FOOTER_OPCODE)
                if not is_data_complete:
                    self._add_record(opcode, position + _RECORD_STRUCT.size, length, totals)
                    position += _RECORD_STRUCT.size + length
            except ChunkLimitError:
                raise
            except (ValueError, StructError):
                position = self._add_cut_chunk(position, totals)
                break
        self._data_end = position
        self._set_totals(totals)
        self.incomplete_file = IncompleteFile(
            path="",
            problem="it has no footer",
            messages=sum(totals.counts.values()),
            end=self.end,
            position=position,
            unread_bytes=0 if is_data_complete else self._size - position,
            is_data_complete=is_data_complete,
        )

    def _add_cut_chunk(self, position: int, totals: "_Totals") -> int:
        """Add the messages before the break if it is in a chunk; return its position."""
        opcode, length = 0, 0
        if position + _RECORD_STRUCT.size <= self._size:
            opcode, length = _RECORD_STRUCT.unpack(self._read_bytes(position, _RECORD_STRUCT.size))
        record_length = length + _RECORD_STRUCT.size
        if opcode != _CHUNK_OPCODE:
            return position
        chunk = _McapChunk(0, 0, position, record_length, readable_bytes=0)
        try:
            compression, _, checksum, data_position, _ = self._read_chunk_header(chunk)
            # A chunk that is not cut is damaged: if a checksum or a compression could detect that, nothing is read.
            if position + record_length <= self._size and (checksum or compression):
                return position
            data = self._unpack_cut_chunk(chunk)
        except ChunkLimitError:
            raise
        except (ValueError, StructError):
            return position
        readable_bytes = self._add_chunk(chunk, data, totals)
        return position if compression else data_position + readable_bytes

    def _add_record(self, opcode: int, position: int, length: int, totals: "_Totals") -> None:
        """Store a schema, a channel or a chunk, and count messages; other records are skipped."""
        if opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
            self._add_schema_or_channel(opcode, self._read_bytes(position, length))
        elif opcode == _MESSAGE_OPCODE:
            channel, _, time, _ = _MESSAGE_STRUCT.unpack(
                self._read_bytes(position, min(length, _MESSAGE_STRUCT.size))
            )
            self._has_loose_messages = True
            self._is_in_order = self._is_in_order and time >= totals.last_loose_time
            totals.last_loose_time = time
            totals.add(channel, time)
        elif opcode == _CHUNK_OPCODE:
            chunk = _McapChunk(0, 0, position - _RECORD_STRUCT.size, length + _RECORD_STRUCT.size)
            self._add_chunk(chunk, self._unpack_chunk(chunk), totals)

    def _add_chunk(self, chunk: _McapChunk, data: bytes, totals: "_Totals") -> int:
        """Store a chunk and count its messages; return the size of its complete records.

        Args:
            chunk: the chunk, without the times of its messages.
            data: its content; a chunk whose ``readable_bytes`` are not None may end with an incomplete record.
            totals: counts and times of all messages.
        """
        chunk_totals = _Totals()
        readable_bytes = 0
        try:
            for opcode, start, end in _scan_chunk_records(data):
                if opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
                    self._add_schema_or_channel(opcode, data[start:end])
                elif opcode == _MESSAGE_OPCODE:
                    channel, _, time, _ = _MESSAGE_STRUCT.unpack_from(data, start)
                    chunk_totals.add(channel, time)
                readable_bytes = end
        except (ValueError, StructError):
            if chunk.readable_bytes is None:
                raise
        if chunk.readable_bytes is not None:
            chunk = chunk._replace(readable_bytes=readable_bytes)
        if chunk_totals.counts:
            self._chunks.append(chunk._replace(start=chunk_totals.first, end=chunk_totals.last))
            totals.merge(chunk_totals)
        return readable_bytes

    def _set_totals(self, totals: "_Totals") -> None:
        self._counts = totals.counts
        self.start, self.end = (totals.first, totals.last) if totals.counts else (0, 0)

    def _add_schema_or_channel(self, opcode: int, body: bytes) -> None:
        """Store a record with a schema or a channel."""
        if opcode == _SCHEMA_OPCODE:
            (identifier,) = _ID_STRUCT.unpack_from(body)
            name, offset = _read_text(body, _ID_STRUCT.size)
            encoding, offset = _read_text(body, offset)
            text, _ = _read_text(body, offset)
            # Repeated definitions are ignored: the summary contains those of the data section again.
            self._schemas.setdefault(identifier, (name, encoding, text))
        else:
            identifier, schema = _IDS_STRUCT.unpack_from(body)
            topic, offset = _read_text(body, _IDS_STRUCT.size)
            message_format, _ = _read_text(body, offset)
            self._channels.setdefault(identifier, (schema, topic, message_format))

    def _list_chunk_sources(
        self, wanted: Set[int], start: int, stop: int
    ) -> List[Tuple[int, Callable[[], Iterator[Message]]]]:
        """Return the chunks with messages from ``start`` and before ``stop``, for `merge_by_time`."""
        chunks = [
            chunk
            for chunk in self._chunks
            if chunk.end >= start and chunk.start < stop and chunk.may_have(wanted)
        ]
        chunks.sort(key=attrgetter("start", "end", "position"))
        read = partial(_read_messages, wanted=wanted, start=start, stop=stop)
        return list_chunk_sources(
            ((chunk.start, chunk) for chunk in chunks), self._unpack_chunk, read, self._limit
        )

    def _read_in_order(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages outside of chunks in the order of the file."""
        for channel, time, position, length in self._scan_loose_messages(wanted, start, stop):
            yield channel, time, self._read_bytes(position, length)

    def _read_sorted(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages outside of chunks in order of time, from an index of their positions."""
        from numpy import argsort, frombuffer, uint64  # noqa: PLC0415 - slow, and most files have chunks

        count = sum(self._counts.get(channel, 0) for channel in wanted)
        self._limit.check(
            _BYTES_PER_POSITION * count, f"the index of {format_count(count, 'unsorted message')} takes"
        )
        channels, times, positions, lengths = array("H"), array("Q"), array("Q"), array("Q")
        for channel, time, position, length in self._scan_loose_messages(wanted, start, stop):
            channels.append(channel)
            times.append(time)
            positions.append(position)
            lengths.append(length)
        # A stable sort keeps the order of the file for messages with equal times.
        for index in argsort(frombuffer(times, uint64), kind="stable") if times else ():
            yield channels[index], times[index], self._read_bytes(positions[index], lengths[index])

    def _scan_loose_messages(
        self, wanted: Set[int], start: int, stop: int
    ) -> Iterator[Tuple[int, int, int, int]]:
        """Yield channel and time of messages outside of chunks, and position and length of their data."""
        for opcode, position, length in self._scan_records(self._data_start, self._data_end):
            if opcode == _MESSAGE_OPCODE:
                channel, _, time, _ = _MESSAGE_STRUCT.unpack(
                    self._read_bytes(position, min(length, _MESSAGE_STRUCT.size))
                )
                if channel in wanted and start <= time < stop:
                    yield channel, time, position + _MESSAGE_STRUCT.size, length - _MESSAGE_STRUCT.size

    def _unpack_chunk(self, chunk: _McapChunk) -> bytes:
        """Return the records in a chunk, decompressed."""
        if chunk.readable_bytes is not None:
            return self._unpack_cut_chunk(chunk)[: chunk.readable_bytes]
        location = f"the chunk at byte {chunk.position}"
        opcode, length = self._read_record_header(chunk.position, self._size)
        if opcode != _CHUNK_OPCODE or length + _RECORD_STRUCT.size != chunk.length:
            raise ValueError(f"the index names {location}: there is none of {chunk.length} bytes")
        compression, size, checksum, position, packed_size = self._read_chunk_header(chunk)
        if position + packed_size > chunk.position + chunk.length:
            raise ValueError(f"{location} is truncated")
        try:
            data = unpack(compression, self._read_bytes(position, packed_size), size)
        except MissingPackageError:
            raise
        except Exception as error:  # any exception of the decompression library
            raise ValueError(f"{location}: {describe_error(error)}") from error
        # A checksum of 0 means that the writer has not computed one.
        if checksum and crc32(data) != checksum:
            raise ValueError(f"{location} is damaged: its checksum is wrong")
        return data

    def _unpack_cut_chunk(self, chunk: _McapChunk) -> bytes:
        """Return the start of the records in a chunk, as far as the file has it."""
        compression, size, _, position, packed_size = self._read_chunk_header(chunk)
        packed_size = min(packed_size, self._size - position)
        self._limit.check(packed_size, f"the chunk at byte {chunk.position} has")
        return unpack_available(compression, self._read_bytes(position, packed_size), size)

    def _read_chunk_header(self, chunk: _McapChunk) -> Tuple[str, int, int, int, int]:
        """Return compression, stated size and checksum of a chunk, and position and size of its data.

        The data is read separately, because copies of large chunks take as long as their decompression.
        """
        position = chunk.position + _RECORD_STRUCT.size
        header = self._read_bytes(
            position,
            min(chunk.length - _RECORD_STRUCT.size, _MAX_CHUNK_HEADER_BYTES, self._size - position),
        )
        _, _, size, checksum = _CHUNK_STRUCT.unpack_from(header)
        compression, offset = _read_text(header, _CHUNK_STRUCT.size)
        (packed_size,) = _SIZE_STRUCT.unpack_from(header, offset)
        self._limit.check(size, f"the chunk at byte {chunk.position} states")
        return compression, size, checksum, position + offset + _SIZE_STRUCT.size, packed_size

    def _scan_records(self, position: int, end: int) -> Iterator[Tuple[int, int, int]]:
        """Yield opcode, offset, and length of the records between two offsets."""
        while position < end:
            check_interrupt()
            opcode, length = self._read_record_header(position, end)
            position += _RECORD_STRUCT.size
            yield opcode, position, length
            position += length

    def _read_record_header(self, position: int, end: int) -> Tuple[int, int]:
        opcode, length = _RECORD_STRUCT.unpack(self._read_bytes(position, _RECORD_STRUCT.size))
        if length > end - position - _RECORD_STRUCT.size:
            raise ValueError(f"the record at byte {position} states {length} bytes: there are fewer")
        return opcode, length

    def _read_bytes(self, position: int, size: int) -> bytes:
        if position < 0 or position + size > self._size:
            raise ValueError(f"{size} bytes at byte {position} are outside of the file")
        self._file.seek(position)
        return self._file.read(size)


def _read_text(body: bytes, offset: int) -> Tuple[str, int]:
    """Return the string at an offset, and the offset after it."""
    (size,) = _LENGTH_STRUCT.unpack_from(body, offset)
    start = offset + _LENGTH_STRUCT.size
    if start + size > len(body):
        raise ValueError(f"a string states {size} bytes: there are fewer")
    return body[start : start + size].decode(), start + size


def _read_indexed_channels(body: bytes) -> FrozenSet[int]:
    """Return the channels of a chunk from its index entry; an empty set if they are missing or damaged."""
    (size,) = _LENGTH_STRUCT.unpack_from(body, _INDEX_STRUCT.size)
    offsets = body[_INDEX_STRUCT.size + _LENGTH_STRUCT.size :][:size]
    if len(offsets) != size or size % _COUNT_STRUCT.size:
        return frozenset()
    return frozenset(channel for channel, _ in _COUNT_STRUCT.iter_unpack(offsets))


def _scan_chunk_records(data: bytes) -> Iterator[Tuple[int, int, int]]:
    """Yield opcode, start, and end of the records in a chunk."""
    position, size = 0, len(data)
    while position < size:
        opcode, length = _RECORD_STRUCT.unpack_from(data, position)
        position += _RECORD_STRUCT.size
        end = position + length
        if end > size:
            raise ValueError(f"a record in a chunk states {length} bytes: there are fewer")
        # The specification allows only these in a chunk; a nested chunk could expand again.
        if not _SCHEMA_OPCODE <= opcode <= _MESSAGE_OPCODE:
            raise ValueError(
                f"a chunk has a record with opcode {opcode}: expected schemas, channels, messages"
            )
        yield opcode, position, end
        position = end


def _read_messages(data: bytes, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
    """Yield the messages in a chunk in order of time."""
    # Arrays instead of lists of tuples: 16 bytes per message, while the smallest message record has 31.
    times, offsets = array("Q"), array("Q")
    is_sorted, previous_time = True, 0
    for opcode, offset, _ in _scan_chunk_records(data):
        if opcode == _MESSAGE_OPCODE:
            channel, _, time, _ = _MESSAGE_STRUCT.unpack_from(data, offset)
            if channel in wanted and start <= time < stop:
                times.append(time)
                offsets.append(offset)
                is_sorted = is_sorted and time >= previous_time
                previous_time = time
    order = range(len(times)) if is_sorted else sorted(range(len(times)), key=times.__getitem__)
    for index in order:
        offset = offsets[index]
        (channel,) = _ID_STRUCT.unpack_from(data, offset)
        (length,) = _SIZE_STRUCT.unpack_from(data, offset - _SIZE_STRUCT.size)
        yield channel, times[index], data[offset + _MESSAGE_STRUCT.size : offset + length]
