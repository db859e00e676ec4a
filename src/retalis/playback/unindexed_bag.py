"""Reading of ROS 1 bags whose index is missing or cut, as a recorder leaves them that was killed (``.bag.active``).

A bag (format 2.0) has a header, chunks with messages and the connections that they refer to, and an index at the end,
whose position the recorder writes into the header last. Without it, the chunks are read once from the first one up to
the first record that is cut or damaged, to find topics, times and the break. Of a chunk that is cut, the messages
before the cut are read, as far as they can be decompressed; a compressed chunk that is damaged is not read. Then the
chunks are merged by time, as those of MCAP files: messages are sorted in a chunk and between chunks that overlap in
time, which are in memory together; the limit of a chunk bounds their size.

The files are not trusted: chunks are decompressed up to the size that they state, and lengths are compared with the
file's size.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

from array import array
from collections import Counter
from contextlib import ExitStack
from functools import partial
from operator import attrgetter
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import BinaryIO, Collection, Dict, FrozenSet, Iterator, List, NamedTuple, Optional, Set, Tuple

from ..foundation.interrupts import check_interrupt
from .decompression import ChunkLimit, ChunkLimitError, MissingPackageError, unpack, unpack_available
from .incomplete_files import IncompleteFile
from .message_merge import MAX_TIME, Message, list_chunk_sources, merge_by_time

_MAGIC = b"#ROSBAG V2.0\n"
_LENGTH_STRUCT = Struct("<I")
_POSITION_STRUCT = Struct("<Q")
_TIME_STRUCT = Struct("<II")

_MESSAGE_OPCODE, _HEADER_OPCODE, _INDEX_OPCODE, _CHUNK_OPCODE, _CHUNK_INFO_OPCODE, _CONNECTION_OPCODE = (
    bytes([code]) for code in (2, 3, 4, 5, 6, 7)
)
"""Types of records: the field ``op`` of their headers."""

_MAX_HEADER_BYTES = 1 << 20
"""Maximum size of the header of a record; that of a connection contains the name of its topic."""

_BREAK_ERRORS = (ValueError, KeyError, StructError)
"""Errors that bytes lead to which are no record."""


class UnindexedConnection(NamedTuple):
    """A connection of a bag: its fields as in the file, and the number of its messages."""

    id: int
    topic: str
    type: str
    md5sum: str
    definition: str
    caller: str
    is_latched: bool
    messages: int = 0


class IndexProblem(NamedTuple):
    """Problem of the index of a bag, and its position as the header states it; 0 if it states none."""

    text: str
    position: int


class _RecordLocation(NamedTuple):
    """Location of a record, and the fields of its header; the data may end after the file."""

    fields: Dict[bytes, bytes]
    data_position: int
    data_size: int

    @property
    def end(self) -> int:
        return self.data_position + self.data_size


class _UnindexedChunk(NamedTuple):
    """A chunk with messages.

    Attributes:
        start, end: times of the first and the last message in nanoseconds.
        record: its location, with at most the data that the file has.
        readable_bytes: size of the records before the break, after decompression.
        is_cut: whether the file ends within it.
        connections: ids of the connections that have messages in it.
    """

    start: int
    end: int
    record: _RecordLocation
    readable_bytes: int
    is_cut: bool
    connections: FrozenSet[int]


class _Break(NamedTuple):
    """The position up to which a bag is read.

    Attributes:
        position: offset in the file.
        is_data_complete: whether all chunks are before it.
        reason: description of the damage there; "" if the file only ends.
    """

    position: int
    is_data_complete: bool = False
    reason: str = ""


class _CutRecordError(ValueError):
    """A record whose header is not complete, because the file ends."""


class UnindexedBag:
    """A ROS 1 bag that is read without its index.

    Args:
        path: path of the file.
        limit: maximum size of a chunk, and of the chunks that are in memory together.
        problem: what is wrong with its index; see `find_index_problem`.

    Attributes:
        connections: connections of the messages.
        start_time: time of the first message in nanoseconds; 0 if there are none.
        end_time: time after the last message.
        incomplete_file: description of what is read.

    Raises:
        Exception: if the file has no header, or a chunk exceeds the limit.
    """

    def __init__(self, path: Path, limit: ChunkLimit, problem: IndexProblem):
        self._limit = limit
        self._connections: Dict[int, UnindexedConnection] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: List[_UnindexedChunk] = []
        self._size = path.stat().st_size
        with ExitStack() as stack:
            self._file = stack.enter_context(path.open("rb"))
            break_ = self._scan(problem.position)
            self._stack = stack.pop_all()
        self.connections = [
            connection._replace(messages=self._counts[connection.id])
            for connection in self._connections.values()
        ]
        self.start_time = min((chunk.start for chunk in self._chunks), default=0)
        last_time = max((chunk.end for chunk in self._chunks), default=0)
        self.end_time = last_time + 1
        self._chunks.sort(key=attrgetter("start", "end", "record.data_position"))
        self.incomplete_file = IncompleteFile(
            path=str(path),
            problem=f"{problem.text}, and {break_.reason}" if break_.reason else problem.text,
            messages=sum(self._counts.values()),
            end=last_time,
            position=break_.position,
            unread_bytes=0 if break_.is_data_complete else self._size - break_.position,
            missing_bytes=max(0, problem.position - self._size),
            is_data_complete=break_.is_data_complete,
        )

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in order of time, from ``start`` and before ``stop``.

        Raises:
            Exception: if too many chunks overlap in time.
        """
        first = 0 if start is None else start
        last = MAX_TIME + 1 if stop is None else stop
        wanted = set(ids)
        chunks = (
            (chunk.start, chunk)
            for chunk in self._chunks
            if chunk.end >= first and chunk.start < last and not chunk.connections.isdisjoint(wanted)
        )
        read = partial(_read_messages, wanted=wanted, start=first, stop=last)
        return merge_by_time(list_chunk_sources(chunks, self._unpack, read, self._limit))

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _scan(self, index_position: int) -> _Break:
        """Find chunks and connections; return the break."""
        position = _read_header(self._file, self._size).end
        while position < self._size and position != index_position:
            check_interrupt()
            try:
                record = _read_record(self._file, position, self._size)
                opcode = record.fields[b"op"]
                if opcode == _CHUNK_OPCODE:
                    break_in_chunk = self._add_chunk(record, position)
                    if break_in_chunk is not None:
                        return break_in_chunk
                elif opcode in (_CONNECTION_OPCODE, _CHUNK_INFO_OPCODE):
                    # An index that the recorder has begun, or completed without its position in the header.
                    return _Break(position, is_data_complete=True)
                elif record.end > self._size:
                    return _Break(position)
                elif opcode != _INDEX_OPCODE:
                    return _Break(position, reason=f"the record at byte {position} is of no known type")
            except ChunkLimitError:
                raise
            except _CutRecordError:
                return _Break(position)
            except _BREAK_ERRORS as error:
                return _Break(position, reason=_describe_damage(error, f"the record at byte {position}"))
            position = record.end
        return _Break(position, position == index_position)

    def _add_chunk(self, record: _RecordLocation, position: int) -> Optional[_Break]:
        """Find the messages of a chunk; return the break if it is in the chunk."""
        is_cut = record.end > self._size
        record = record._replace(data_size=min(record.data_size, self._size - record.data_position))
        chunk = _UnindexedChunk(MAX_TIME, -1, record, _read_size(record), is_cut, frozenset())
        subject = f"the chunk at byte {position}"
        reason = ""
        try:
            data = self._unpack(chunk)
        except (ChunkLimitError, MissingPackageError):
            raise
        except Exception as error:  # any exception of the decompression library
            return _Break(position, reason=_describe_damage(error, subject))
        readable_bytes = 0
        connections: Set[int] = set()
        try:
            for fields, body_start, end in _scan_chunk(data):
                if fields[b"op"] == _CONNECTION_OPCODE:
                    self._add_connection(fields, data[body_start:end])
                elif fields[b"op"] == _MESSAGE_OPCODE:
                    identifier, time = _read_message_fields(fields)
                    if identifier not in self._connections:
                        raise ValueError("a message in it has no connection")
                    connections.add(identifier)
                    self._counts[identifier] += 1
                    chunk = chunk._replace(start=min(chunk.start, time), end=max(chunk.end, time))
                readable_bytes = end
        except _BREAK_ERRORS as error:
            # The last record of a chunk that is cut is cut, too.
            reason = "" if is_cut else _describe_damage(error, subject)
            is_cut = True
        if connections:
            self._chunks.append(
                chunk._replace(readable_bytes=readable_bytes, connections=frozenset(connections))
            )
        if not is_cut and readable_bytes == len(data):
            return None
        # In a compressed chunk, the break has no offset in the file.
        is_packed = record.fields[b"compression"] != b"none"
        return _Break(position if is_packed else record.data_position + readable_bytes, reason=reason)

    def _unpack(self, chunk: _UnindexedChunk) -> bytes:
        """Return the records of a chunk before the break."""
        record = chunk.record
        size = _read_size(record)
        self._limit.check(
            max(size, record.data_size), f"the chunk with data at byte {record.data_position} states"
        )
        self._file.seek(record.data_position)
        packed = self._file.read(record.data_size)
        compression = record.fields[b"compression"].decode()
        data = (unpack_available if chunk.is_cut else unpack)(compression, packed, size)
        return data[: chunk.readable_bytes]

    def _add_connection(self, fields: Dict[bytes, bytes], data: bytes) -> None:
        """Store a connection; of definitions with the same id, the first one is used."""
        (identifier,) = _LENGTH_STRUCT.unpack(fields[b"conn"])
        if identifier not in self._connections:
            texts = {name: value.decode() for name, value in _parse_fields(data).items()}
            self._connections[identifier] = UnindexedConnection(
                identifier,
                fields[b"topic"].decode(),
                texts[b"type"],
                texts[b"md5sum"],
                texts[b"message_definition"],
                texts.get(b"callerid", ""),
                texts.get(b"latching", "0") == "1",
            )


def find_index_problem(path: Path) -> Optional[IndexProblem]:
    """Return the problem of an index that is missing or cut; None if it is complete.

    Raises:
        Exception: if the file has no header of a ROS 1 bag.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header = _read_header(file, size)
        (start,) = _POSITION_STRUCT.unpack(header.fields[b"index_pos"])
        if not 0 < start < size:
            return IndexProblem("its index is missing", start)
        counts = (header.fields[name] for name in (b"conn_count", b"chunk_count"))
        position = start
        try:
            for _ in range(sum(_LENGTH_STRUCT.unpack(count)[0] for count in counts)):
                record = _read_record(file, position, size)
                if record.end > size or record.fields[b"op"] not in (_CONNECTION_OPCODE, _CHUNK_INFO_OPCODE):
                    raise ValueError("the record is cut, or of another type")
                position = record.end
        except _BREAK_ERRORS:
            return IndexProblem(f"its index is cut or damaged at byte {position}", start)
    return None


def _read_header(file: BinaryIO, size: int) -> _RecordLocation:
    """Return the first record of a bag.

    Raises:
        ValueError: if the file does not have it.
    """
    file.seek(0)
    if file.read(len(_MAGIC)) != _MAGIC:
        raise ValueError(f"it does not begin with '{_MAGIC.decode().strip()}'")
    try:
        record = _read_record(file, len(_MAGIC), size)
        if record.fields[b"op"] == _HEADER_OPCODE and record.end <= size:
            return record
    except _BREAK_ERRORS:
        pass
    raise ValueError("its header is cut or damaged")


def _read_record(file: BinaryIO, position: int, size: int) -> _RecordLocation:
    """Return the record at a position.

    Raises:
        ValueError, struct.error: if there is none, or its header is damaged.
        _CutRecordError: if the file ends before its data.
    """
    if position + _LENGTH_STRUCT.size > size:
        raise _CutRecordError
    file.seek(position)
    (header_size,) = _LENGTH_STRUCT.unpack(file.read(_LENGTH_STRUCT.size))
    data_position = position + 2 * _LENGTH_STRUCT.size + header_size
    if not 0 < header_size <= _MAX_HEADER_BYTES:
        raise ValueError(f"its header states {header_size} bytes")
    if data_position > size:
        raise _CutRecordError
    fields = _parse_fields(file.read(header_size))
    (data_size,) = _LENGTH_STRUCT.unpack(file.read(_LENGTH_STRUCT.size))
    return _RecordLocation(fields, data_position, data_size)


def _describe_damage(error: Exception, subject: str) -> str:
    """Return the description of an error that the bytes of a record or chunk led to."""
    if isinstance(error, KeyError):
        reason = f"its header, or that of a record in it, has no field '{error.args[0].decode()}'"
    elif isinstance(error, StructError):
        reason = "a number in it is cut"
    elif isinstance(error, ValueError):
        reason = str(error)
    else:
        reason = f"{type(error).__name__}: {error}"
    return f"{subject} cannot be read: {reason}"


def _parse_fields(header: bytes) -> Dict[bytes, bytes]:
    """Return the fields of a header: a length, a name, ``=`` and a value each."""
    fields: Dict[bytes, bytes] = {}
    position, size = 0, len(header)
    while position < size:
        (length,) = _LENGTH_STRUCT.unpack_from(header, position)
        position += _LENGTH_STRUCT.size
        name, separator, value = header[position : position + length].partition(b"=")
        position += length
        if position > size or not separator:
            raise ValueError("a field of a header is cut or has no value")
        fields[name] = value
    return fields


def _read_size(record: _RecordLocation) -> int:
    """Return the size of a chunk after decompression, as it states."""
    (size,) = _LENGTH_STRUCT.unpack(record.fields[b"size"])
    return int(size)


def _read_message_fields(fields: Dict[bytes, bytes]) -> Tuple[int, int]:
    """Return the connection and the time of a message in nanoseconds."""
    (identifier,) = _LENGTH_STRUCT.unpack(fields[b"conn"])
    seconds, nanoseconds = _TIME_STRUCT.unpack(fields[b"time"])
    return identifier, seconds * 10**9 + nanoseconds


def _scan_chunk(data: bytes) -> Iterator[Tuple[Dict[bytes, bytes], int, int]]:
    """Yield the fields of the records in a chunk, and start and end of their data.

    Raises:
        ValueError, struct.error: at the first record that is cut or damaged.
    """
    position, size = 0, len(data)
    while position < size:
        (header_size,) = _LENGTH_STRUCT.unpack_from(data, position)
        header_start = position + _LENGTH_STRUCT.size
        header_end = header_start + header_size
        (data_size,) = _LENGTH_STRUCT.unpack_from(data, header_end)
        body_start = header_end + _LENGTH_STRUCT.size
        position = body_start + data_size
        if position > size or not header_size:
            raise ValueError("a record in a chunk is cut")
        yield _parse_fields(data[header_start:header_end]), body_start, position


def _read_messages(data: bytes, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
    """Yield the messages in a chunk in order of time."""
    # Arrays instead of lists of tuples: 28 bytes per message, while the smallest message record has 46.
    identifiers, times, body_starts, ends = array("I"), array("Q"), array("Q"), array("Q")
    for fields, body_start, end in _scan_chunk(data):
        if fields[b"op"] == _MESSAGE_OPCODE:
            identifier, time = _read_message_fields(fields)
            if identifier in wanted and start <= time < stop:
                identifiers.append(identifier)
                times.append(time)
                body_starts.append(body_start)
                ends.append(end)
    # Stable: messages with equal times keep the order of the file.
    for index in sorted(range(len(times)), key=times.__getitem__):
        yield identifiers[index], times[index], data[body_starts[index] : ends[index]]
