"""Reading of MCAP files (https://mcap.dev/spec).

A file consists of a header, records, a summary, and a footer. A record is an opcode, a length, and a body. Messages
are in chunks, which may be compressed, or directly in the file. The summary repeats schemas and channels, and has an
index entry with the time range of each chunk. A file without a summary is scanned from its start.

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
from typing import Callable, Collection, Dict, FrozenSet, Iterator, List, NamedTuple, Optional, Set, Tuple

from ..foundation.errors import format_count
from ..foundation.interrupts import check_interrupt
from .decompression import ChunkLimit, describe_error, unpack
from .ros2_storage import MAX_TIME, Connection, Message, merge_by_time

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
) = 1, 2, 3, 4, 5, 6, 8, 11
"""Opcodes of records."""


_TRUNCATED_MESSAGE = "it does not end as an mcap file: it is truncated: repair it with 'mcap recover'"

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
    """

    start: int
    end: int
    position: int
    length: int
    channels: FrozenSet[int] = frozenset()

    def may_have(self, channels: Set[int]) -> bool:
        """Return whether the chunk may have messages of one of the channels."""
        return not self.channels or not self.channels.isdisjoint(channels)


class McapFile:
    """An ``.mcap`` file.

    Attributes:
        connections: topics of the file.
        start, end: times of the first and the last message in nanoseconds; 0 if there are none.

    Raises:
        Exception: if the file cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
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
        footer = self._size - _FOOTER_STRUCT.size
        # A recorder that was killed does not write a footer.
        if footer < len(_MAGIC):
            raise ValueError(_TRUNCATED_MESSAGE)
        opcode, length, summary, _, _, magic = _FOOTER_STRUCT.unpack(
            self._read_bytes(footer, _FOOTER_STRUCT.size)
        )
        if (opcode, length, magic) != (_FOOTER_OPCODE, 20, _MAGIC):
            raise ValueError(_TRUNCATED_MESSAGE)
        opcode, length = self._read_record_header(len(_MAGIC), footer)
        # The profile in the header is not needed: each channel states the format of its messages.
        if opcode != _HEADER_OPCODE:
            raise ValueError(f"its first record has the opcode {opcode}: expected a header, {_HEADER_OPCODE}")
        self._data_start = len(_MAGIC) + _RECORD_STRUCT.size + length
        self._data_end = summary or footer
        if not self._data_start <= self._data_end <= footer:
            raise ValueError(f"its summary at byte {summary} is outside of the file")
        # Some writers omit statistics or schemas in the summary. Schema 0 means "no schema" and is always present.
        # Without chunks, the summary does not say whether the messages are in order.
        if not (self._read_summary(footer) and len(self._schemas) > 1 and self._chunks):
            self._scan()

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
        previous_time = 0
        counts: Counter[int] = Counter()
        first, last = MAX_TIME, -1
        for opcode, position, length in self._scan_records(self._data_start, self._data_end):
            if opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
                self._add_schema_or_channel(opcode, self._read_bytes(position, length))
            elif opcode == _MESSAGE_OPCODE:
                self._has_loose_messages = True
                channel, _, time, _ = _MESSAGE_STRUCT.unpack(
                    self._read_bytes(position, min(length, _MESSAGE_STRUCT.size))
                )
                counts[channel] += 1
                first, last = min(first, time), max(last, time)
                self._is_in_order = self._is_in_order and time >= previous_time
                previous_time = time
            elif opcode == _CHUNK_OPCODE:
                chunk = _McapChunk(0, 0, position - _RECORD_STRUCT.size, length + _RECORD_STRUCT.size)
                data = self._unpack_chunk(chunk)
                begin, end = MAX_TIME, -1
                for inner_opcode, body_start, body_end in _scan_chunk_records(data):
                    if inner_opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
                        self._add_schema_or_channel(inner_opcode, data[body_start:body_end])
                    elif inner_opcode == _MESSAGE_OPCODE:
                        channel, _, time, _ = _MESSAGE_STRUCT.unpack_from(data, body_start)
                        counts[channel] += 1
                        begin, end = min(begin, time), max(end, time)
                if end >= 0:
                    self._chunks.append(chunk._replace(start=begin, end=end))
                    first, last = min(first, begin), max(last, end)
        self._counts = counts
        self.start, self.end = (first, last) if last >= 0 else (0, 0)

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
        bytes_in_memory = 0

        def read(chunk: _McapChunk) -> Iterator[Message]:
            nonlocal bytes_in_memory
            check_interrupt()
            data = self._unpack_chunk(chunk)
            bytes_in_memory += len(data)
            self._limit.check(bytes_in_memory, "chunks that overlap in time have")
            yield from _read_messages(data, wanted, start, stop)
            bytes_in_memory -= len(data)

        chunks = [
            chunk
            for chunk in self._chunks
            if chunk.end >= start and chunk.start < stop and chunk.may_have(wanted)
        ]
        chunks.sort(key=attrgetter("start", "end", "position"))
        return [(chunk.start, partial(read, chunk)) for chunk in chunks]

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
        location = f"the chunk at byte {chunk.position}"
        opcode, length = self._read_record_header(chunk.position, self._size)
        if opcode != _CHUNK_OPCODE or length + _RECORD_STRUCT.size != chunk.length:
            raise ValueError(f"the index names {location}: there is none of {chunk.length} bytes")
        # The data is read separately, because copies of large chunks take as long as their decompression.
        position = chunk.position + _RECORD_STRUCT.size
        header = self._read_bytes(position, min(length, _MAX_CHUNK_HEADER_BYTES))
        _, _, size, checksum = _CHUNK_STRUCT.unpack_from(header)
        compression, offset = _read_text(header, _CHUNK_STRUCT.size)
        (packed_size,) = _SIZE_STRUCT.unpack_from(header, offset)
        offset += _SIZE_STRUCT.size
        if packed_size > length - offset:
            raise ValueError(f"{location} is truncated")
        packed = self._read_bytes(position + offset, packed_size)
        self._limit.check(size, f"{location} states")
        try:
            data = unpack(compression, packed, size)
        except Exception as error:  # any exception of the decompression library
            raise ValueError(f"{location}: {describe_error(error)}") from error
        # A checksum of 0 means that the writer has not computed one.
        if checksum and crc32(data) != checksum:
            raise ValueError(f"{location} is damaged: its checksum is wrong")
        return data

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
