"""Reading of ROS 2 bags (SQLite and MCAP files), with messages converted to ROS 1 serialization.

`Ros2BagReader` has the interface of `rosbag1.BagReader`. `SqliteFile` and `McapFile` read one file each; types come
from the definitions in the bag, from ROS 2 (with the package ``rosbags``), or from the installed messages.

The files are parsed here instead of with ``rosbags``, so that a malformed file cannot consume more memory or time
than its size justifies: chunks are decompressed up to the size that they state, lengths are compared with the file's
size, and a database may only have plain tables and is limited to a number of virtual machine instructions.

MCAP (https://mcap.dev/spec): a file consists of a header, records, a summary, and a footer. A record is an opcode, a
length, and a body. Messages are in chunks, which may be compressed, or directly in the file. The summary repeats
schemas and channels, and has an index entry with the time range of each chunk. Chunks are merged by time with a heap,
into which a chunk enters when its time range begins. A file without a summary is scanned from its start.
"""

import logging
import re
import shutil
import sqlite3
from array import array
from binascii import crc32
from collections import Counter
from contextlib import ExitStack
from heapq import heappop, heappush
from itertools import islice, takewhile
from pathlib import Path
from struct import Struct
from tempfile import TemporaryDirectory
from typing import Any, Callable, Collection, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple, Union

from ..foundation.errors import MessageError, format_count, place_at_offset, quote_shortened, shorten
from ..foundation.ros_names import ros1_type_name, topic_fault
from ..messages.ros2_to_ros1 import Ros2Type, parse_ros2_type
from ..messages.type_registry import InstalledTypes
from .decompression import MAX_CHUNK_MEGABYTES, ChunkLimit, copy_up_to, describe_error, unpack, zstd_reader
from .rosbag1 import BagError, PathLike, Record, Topic

Message = Tuple[int, int, bytes]
"""A message: number of its connection, time in nanoseconds, and bytes."""


class Connection(NamedTuple):
    """A topic of a file.

    Attributes:
        id: its number in the file.
        topic: name of the topic.
        type: message type, ``pkg/msg/Type``.
        encoding: format of the definition: ``ros2msg``, ``ros2idl``, or empty.
        definition: text of the definition, if the file contains it.
        format: serialization format of the messages, ``cdr``.
        messages: number of messages.
    """

    id: int
    topic: str
    type: str
    encoding: str
    definition: str
    format: str
    messages: int


# ---- SQLite ------------------------------------------------------------------------------------------

_BASE_QUERY_STEPS = 1_000_000
_STEPS_PER_BYTE = 10
"""Limit for the virtual machine instructions of a query: a row has at least 10 bytes, and takes about 20 of them."""

_STEPS_PER_CALLBACK = 1000

_TOO_MANY_BYTES_MESSAGE = "its rows have more bytes than the file: some name the same pages"

_LIMIT_LENGTH = 0
"""``SQLITE_LIMIT_LENGTH`` of ``sqlite3.h``: maximum size of a string, blob or row."""

_MAX_LENGTH = (1 << 31) - 1
"""Maximum value of a limit, which is a C ``int``."""


class SqliteFile:
    """A ``.db3`` file.

    Attributes:
        connections: topics of the file.
        start, end: times of the first and the last message in nanoseconds; 0 if there are none.

    Raises:
        Exception: if the file cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
        self._size = path.stat().st_size
        self._steps = 0
        with ExitStack() as stack:
            # `immutable` skips locks and journals, so that bags on read-only media can be read.
            self._database = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
            )
            stack.callback(self._database.close)
            # A schema from an untrusted file must not call functions with side effects.
            self._database.execute("PRAGMA trusted_schema = OFF")
            # Older versions of Python cannot limit single values; the number of rows and steps is limited in any
            # case.
            set_limit = getattr(self._database, "setlimit", None)  # from Python 3.11
            if set_limit is not None:
                set_limit(_LIMIT_LENGTH, min(limit.bytes + 1, self._size + 1, _MAX_LENGTH))
            self._database.set_progress_handler(self._count_steps, _STEPS_PER_CALLBACK)
            self.connections = self._read_connections()
            self.start, self.end = self._read_times()
            self._stack = stack.pop_all()

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in order of time, from ``start`` and before ``stop``.

        Raises:
            Exception: if the file is malformed.
        """
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join(map(str, ids))})"
        )
        arguments = []
        for operator, bound in ((">=", start), ("<", stop)):
            if bound is not None:
                query += f" AND timestamp {operator} ?"
                arguments.append(bound)
        for identifier, time, data in self._query_limited(f"{query} ORDER BY timestamp", *arguments):
            # SQLite does not enforce the types of columns.
            if time.__class__ is not int or data.__class__ is not bytes:
                raise ValueError("a message is not an integer and a blob")
            yield identifier, time, data

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _query_limited(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        """Yield the rows of a query, which may not have more bytes than the file."""
        # Rows of a malformed database can share pages, so that a small file returns gigabytes.
        remaining = self._size
        for row in self._execute(query, *arguments):
            remaining -= sum(len(value) for value in row if isinstance(value, (str, bytes)))
            if remaining < 0:
                raise ValueError(_TOO_MANY_BYTES_MESSAGE)
            yield row

    def _execute(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        """Yield the rows of a query; raise `ValueError` if it takes more steps than the size of the file allows."""
        # The budget is per query. A crafted schema could otherwise make a query run forever.
        self._steps = _BASE_QUERY_STEPS + _STEPS_PER_BYTE * self._size
        try:
            # `yield from` would close the cursor of an abandoned iterator, which raises after the file was closed.
            for row in self._database.execute(query, arguments):  # noqa: UP028
                yield row
        except sqlite3.OperationalError as error:
            if self._steps >= 0:
                raise
            raise ValueError("its tables have more rows than a file of its size can hold") from error

    def _count_steps(self) -> bool:
        self._steps -= _STEPS_PER_CALLBACK
        return self._steps < 0  # True interrupts the query

    def _read_connections(self) -> List[Connection]:
        """Return the topics, with the definitions and the number of their messages."""
        for table in ("topics", "messages"):
            if not self._has_table(table):
                raise ValueError(f"it has no table '{table}': expected a database that ros2 bag has written")
        definitions: Dict[str, Tuple[str, str]] = {}
        if self._has_table("message_definitions"):
            rows = self._query_limited(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            for name, encoding, text in rows:
                definitions.setdefault(_require_text(name), (_require_text(encoding), _require_text(text)))
        counts = dict(self._query_limited("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        connections = []
        for identifier, topic, name, message_format in self._query_limited(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            encoding, text = definitions.get(_require_text(name), ("", ""))
            message_count = counts.get(identifier, 0)
            connections.append(
                Connection(
                    int(identifier),
                    _require_text(topic),
                    name,
                    encoding,
                    text,
                    _require_text(message_format),
                    message_count,
                )
            )
        return connections

    def _has_table(self, name: str) -> bool:
        """Return whether there is a table; raise `ValueError` if it is not a plain one.

        A view or a generated column would execute SQL from the file, which may run forever or produce gigabytes.
        """
        rows = list(self._query_limited("SELECT type, sql FROM sqlite_master WHERE name = ?", name))
        if not rows:
            return False
        types = [str(object_type) for object_type, sql in rows if str(sql)[:13].upper() == "CREATE TABLE "]
        columns = list(self._query_limited(f"PRAGMA table_xinfo({name})"))
        # Columns: number, name, type, not null, default, primary key, and 0 for columns that are not generated.
        if types != ["table"] or any(column[6] or column[4] is not None for column in columns):
            raise ValueError(
                f"'{name}' is not a plain table: expected columns without defaults or expressions"
            )
        return True

    def _read_times(self) -> Tuple[int, int]:
        ((first, last, size),) = self._query_limited(
            "SELECT min(timestamp), max(timestamp), total(length(data)) FROM messages"
        )
        # Rows that share pages would fill the disk when SQLite sorts them.
        if size > self._size:
            raise ValueError(_TOO_MANY_BYTES_MESSAGE)
        return (0, 0) if first is None else (int(first), int(last))


def _require_text(text: object) -> str:
    if not isinstance(text, str):
        raise ValueError("a name or a definition is not text")
    return text


# ---- mcap --------------------------------------------------------------------------------------------

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


_AFTER_ALL_TIMES = 1 << 64
"""Time after all times of messages, which have 64 bits."""


class _McapChunk(NamedTuple):
    """Index entry of a chunk: time range, offset, and length including the record's header."""

    start: int
    end: int
    position: int
    length: int


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
        """True if messages may be outside of chunks."""
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
        last = _AFTER_ALL_TIMES if stop is None else stop
        wanted = set(ids)
        return (
            self._read_sequentially(wanted, first, last)
            if self._has_loose_messages
            else self._merge_chunks(wanted, first, last)
        )

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _open(self) -> None:
        """Read the header and the footer, and the summary or all records."""
        if self._read_bytes(0, len(_MAGIC)) != _MAGIC:
            raise ValueError("it does not begin as an mcap file")
        opcode, length = self._read_record_header(len(_MAGIC), self._size)
        self._data_start = len(_MAGIC) + _RECORD_STRUCT.size + length
        if (
            opcode != _HEADER_OPCODE
            or _read_text(self._read_bytes(len(_MAGIC) + _RECORD_STRUCT.size, length), 0)[0] != "ros2"
        ):
            raise ValueError("its header is not that of a ROS 2 bag")
        footer = self._size - _FOOTER_STRUCT.size
        opcode, length, summary, _, _, magic = _FOOTER_STRUCT.unpack(
            self._read_bytes(footer, _FOOTER_STRUCT.size)
        )
        # A recorder that was killed does not write a footer.
        if (opcode, length, magic) != (_FOOTER_OPCODE, 20, _MAGIC):
            raise ValueError("it does not end as an mcap file: it may be truncated")
        self._data_end = summary or footer
        if not self._data_start <= self._data_end <= footer:
            raise ValueError(f"its summary at byte {summary} is outside of the file")
        # Some writers omit statistics or schemas in the summary. Schema 0 means "no schema" and is always present.
        if not (self._read_summary(footer) and len(self._schemas) > 1):
            self._scan()

    def _read_summary(self, footer: int) -> bool:
        """Read the summary; return whether it contains the number of messages and their time range."""
        has_totals = False
        for opcode, position, length in self._scan_records(self._data_end, footer):
            if opcode in (_SCHEMA_OPCODE, _CHANNEL_OPCODE):
                self._add_schema_or_channel(opcode, self._read_bytes(position, length))
            elif opcode == _CHUNK_INDEX_OPCODE:
                self._chunks.append(
                    _McapChunk(*_INDEX_STRUCT.unpack_from(self._read_bytes(position, length)))
                )
            elif opcode == _STATISTICS_OPCODE:
                has_totals = True
                body = self._read_bytes(position, length)
                message_count, _, _, _, _, _, start, end = _STATISTICS_STRUCT.unpack_from(body)
                self.start, self.end = (start, end) if message_count else (0, 0)
                (size,) = _LENGTH_STRUCT.unpack_from(body, _STATISTICS_STRUCT.size)
                counts = body[_STATISTICS_STRUCT.size + _LENGTH_STRUCT.size :][:size]
                self._counts = dict(_COUNT_STRUCT.iter_unpack(counts))
        # Overlapping index entries would let a small file contain the same chunk many times.
        self._chunks.sort(key=lambda chunk: chunk.position)
        for previous, chunk in zip(self._chunks, self._chunks[1:]):
            if chunk.position < previous.position + previous.length:
                raise ValueError(f"the index names the chunk at byte {chunk.position} inside another one")
        self._has_loose_messages = not self._chunks
        return has_totals

    def _scan(self) -> None:
        """Read all records before the summary, to find types, times, and chunks."""
        self._chunks.clear()
        self._has_loose_messages = False
        counts: Counter[int] = Counter()
        first, last = _AFTER_ALL_TIMES, -1
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
            elif opcode == _CHUNK_OPCODE:
                chunk = _McapChunk(0, 0, position - _RECORD_STRUCT.size, length + _RECORD_STRUCT.size)
                data = self._unpack_chunk(chunk)
                begin, end = _AFTER_ALL_TIMES, -1
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

    def _merge_chunks(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages of all chunks by time; only chunks that overlap in time are in memory."""
        bytes_in_memory = 0
        heap: List[Tuple[int, int, Message, Iterator[Message], int]] = []

        def push_next(index: int, messages: Iterator[Message], size: int) -> int:
            """Put the next message of a chunk into the heap; at its end, return its size, which is free then."""
            message = next(messages, None)
            if message is None:
                return size
            _, time, _ = message
            heappush(heap, (time, index, message, messages, size))
            return 0

        # By start time, because a heap of the chunks that have started is sufficient to merge them.
        chunks = sorted(chunk for chunk in self._chunks if chunk.end >= start and chunk.start < stop)
        for index, chunk in enumerate(chunks):
            # Messages before this chunk's start are final. Chunks that end by then free their memory.
            while heap and heap[0][0] <= chunk.start:
                _, earlier_index, message, messages, size = heappop(heap)
                yield message
                bytes_in_memory -= push_next(earlier_index, messages, size)
            data = self._unpack_chunk(chunk)
            size = len(data)
            bytes_in_memory += size
            self._limit.check(bytes_in_memory, "chunks that overlap in time have")
            bytes_in_memory -= push_next(index, _read_messages(data, wanted, start, stop), size)
            del data  # the iterator holds it for as long as it is needed
        while heap:
            _, earlier_index, message, messages, size = heappop(heap)
            yield message
            push_next(earlier_index, messages, size)

    def _read_sequentially(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages of a file without an index, which must be in order of time."""
        previous_time = -1
        for opcode, position, length in self._scan_records(self._data_start, self._data_end):
            data = b""
            if opcode == _MESSAGE_OPCODE:
                data = _RECORD_STRUCT.pack(opcode, length) + self._read_bytes(position, length)
            elif opcode == _CHUNK_OPCODE:
                data = self._unpack_chunk(
                    _McapChunk(0, 0, position - _RECORD_STRUCT.size, length + _RECORD_STRUCT.size)
                )
            for message in _read_messages(data, wanted, start, stop):
                _, time, _ = message
                if time < previous_time:
                    raise ValueError(
                        "its messages are not in the order of time: expected an index of its chunks"
                    )
                previous_time = time
                yield message

    def _unpack_chunk(self, chunk: _McapChunk) -> bytes:
        """Return the records in a chunk, decompressed."""
        location = f"the chunk at byte {chunk.position}"
        opcode, length = self._read_record_header(chunk.position, self._size)
        if opcode != _CHUNK_OPCODE or length + _RECORD_STRUCT.size != chunk.length:
            raise ValueError(f"the index names {location}: there is none of {chunk.length} bytes")
        body = self._read_bytes(chunk.position + _RECORD_STRUCT.size, length)
        _, _, size, checksum = _CHUNK_STRUCT.unpack_from(body)
        compression, offset = _read_text(body, _CHUNK_STRUCT.size)
        (packed_size,) = _SIZE_STRUCT.unpack_from(body, offset)
        packed = body[offset + _SIZE_STRUCT.size :][:packed_size]
        if len(packed) != packed_size:
            raise ValueError(f"{location} is truncated")
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


Storage = Union[SqliteFile, McapFile]


log = logging.getLogger("retalis")

_COMPRESSED_SUFFIX = ".zstd"
"""Suffix that ``ros2 bag record --compression-mode file`` adds to file names."""

SUFFIXES = (".db3", ".mcap", f".db3{_COMPRESSED_SUFFIX}", f".mcap{_COMPRESSED_SUFFIX}")
"""Suffixes of the files of a ROS 2 bag."""

METADATA = "metadata.yaml"
"""File that identifies a folder as a ROS 2 bag."""

MAX_UNPACKED_RATIO = 100
"""Maximum ratio of a file's size after decompression to its compressed size, unless the chunk limit is larger.

A decompressed file may also take at most half of the free disk space.
"""

MAX_METADATA_BYTES = 4_000_000

_IDL_HEADING = re.compile(r"^(?:={20,}|IDL:.*)$", re.MULTILINE)
"""Lines between IDL definitions that are not part of IDL."""

_IDL_PROBLEM = re.compile(r"\n(?P<offset>[0-9]{1,9})\n(?s:.*?)(?:\n\{(?P<expected>.*)\})?\Z")
"""End of an error of the IDL parser of rosbags."""


class _ConvertedTopic(NamedTuple):
    """A topic, and the conversion of its messages to ROS 1."""

    topic: Topic
    convert: Callable[[bytes], bytes]


class Ros2BagReader:
    """A ROS 2 bag opened for reading: a folder with ``metadata.yaml``, or one of its files.

    Types have the names of ROS 1, and headers have the sequence number 0. Arguments, attributes, and methods are
    those of `BagReader`.

    Raises:
        BagError: if the bag cannot be read.
    """

    def __init__(self, path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        self._stack = ExitStack()
        self._files, self._has_packed_messages = _open_files(self.path, self._limit, self._stack)
        self._converted_topics = self._read_types()
        self.topics: Tuple[Topic, ...] = tuple(source.topic for source in self._converted_topics.values())
        self.messages = sum(connection.messages for file in self._files for connection in file.connections)
        non_empty_files = [
            file for file in self._files if any(connection.messages for connection in file.connections)
        ]
        self.start = min((file.start for file in non_empty_files), default=0)
        self.end = max((file.end for file in non_empty_files), default=0)

    def _read_types(self) -> "Dict[Tuple[str, str], _ConvertedTopic]":
        """Return the readable topics by name and type; log a warning for the others."""
        merged: Dict[Tuple[str, str], Connection] = {}
        for file in self._files:
            for connection in file.connections:
                key = connection.topic, connection.type
                previous = merged.get(key)
                if previous is not None:
                    messages = previous.messages + connection.messages
                    connection = (previous if previous.definition else connection)._replace(messages=messages)
                merged[key] = connection
        types = _Types()
        sources: Dict[Tuple[str, str], _ConvertedTopic] = {}
        unreadable: Dict[Tuple[str, str], List[str]] = {}
        for key, connection in merged.items():
            try:
                sources[key] = types.convert_topic(connection)
            except MessageError as error:
                problem = str(error).partition("\n")[0]  # without the source line
                topics = unreadable.setdefault((ros1_type_name(connection.type), problem), [])
                topics.append(_quote_if_invalid(connection.topic))
        for (type_name, problem), topics in unreadable.items():
            names = f"topic{'s' if len(topics) > 1 else ''} {', '.join(sorted(topics))}"
            log.warning("%s: left out: %s (%s): %s", self.path, names, _quote_if_invalid(type_name), problem)
        return sources

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in order of receipt; see `BagReader.records`.

        Messages that do not fit their type are dropped, with a warning for the first one of a topic and their number.

        Raises:
            BagError: if the bag is malformed.
        """
        dropped: Counter[str] = Counter()
        wanted = None if topics is None else {name.lstrip("/") for name in topics}
        try:
            for file in self._files:
                sources = {
                    connection.id: self._converted_topics[connection.topic, connection.type]
                    for connection in file.connections
                    if (connection.topic, connection.type) in self._converted_topics
                    and (wanted is None or connection.topic.lstrip("/") in wanted)
                }
                if not sources:
                    continue
                for identifier, time, data in file.read(sources, start, stop):
                    topic, convert = sources[identifier]
                    try:
                        raw = convert(self._limit.unpack_message(data) if self._has_packed_messages else data)
                    except MessageError as error:
                        name = _quote_if_invalid(topic.name)
                        if not dropped[name]:
                            log.warning("%s: a message on %s is dropped: %s", self.path, name, error)
                        dropped[name] += 1
                        continue
                    yield Record(topic, time, raw)
        except Exception as error:  # malformed bags raise arbitrary exceptions
            raise BagError(f"{self.path}: the bag is broken: {describe_error(error)}") from error
        finally:
            for name, count in dropped.items():
                log.warning("%s: %s on %s dropped", self.path, format_count(count, "message"), name)

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    def __enter__(self) -> "Ros2BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class _Types:
    """Resolver of the types of a bag: definitions in the bag first, then those of ROS 2, then installed ones."""

    def __init__(self) -> None:
        from rosbags import typesys  # noqa: PLC0415 - an optional package

        self._typesys: Any = typesys
        # Types of ROS 2 that bags without definitions refer to.
        self._ros2_store: Any = typesys.get_typestore(typesys.Stores.LATEST)
        self._installed = InstalledTypes()
        self._by_definition: Dict[Tuple[str, str], Ros2Type] = {}

    def convert_topic(self, connection: Connection) -> _ConvertedTopic:
        """Return the topic of a connection and the conversion of its messages.

        Raises:
            MessageError: if its type is not defined, or the definition is invalid.
        """
        if connection.format != "cdr":
            raise MessageError(f"its messages are in '{shorten(connection.format)}': expected cdr")
        key = connection.type, connection.definition
        message_type = self._by_definition.get(key)
        if message_type is None:
            text = self._find_definition(connection)
            message_type = self._by_definition[key] = parse_ros2_type(connection.type, text, self._find_text)
        definition = message_type.definition
        topic = Topic(
            connection.topic,
            definition.name,
            definition.full_text,
            definition.md5sum,
            connection.messages,
        )
        return _ConvertedTopic(topic, message_type.to_ros1)

    def _find_definition(self, connection: Connection) -> str:
        """Return the text of the type of a connection, in the syntax of ``.msg`` files."""
        name, text = connection.type, connection.definition
        if not text:
            definition = self._find_text(ros1_type_name(name))
            if definition is None:
                raise MessageError("the type is not defined in the bag or on this system")
            return definition
        if connection.encoding.endswith("idl") or text.lstrip("=\r\n ").startswith("IDL:"):
            return self._convert_idl(name, text)
        return text

    def _convert_idl(self, name: str, text: str) -> str:
        """Return a definition in IDL in the syntax of ``.msg`` files."""
        store = self._typesys.get_typestore(self._typesys.Stores.EMPTY)
        # Lines are emptied and not removed, so that line numbers stay the same.
        text = _IDL_HEADING.sub("", text)
        try:
            # The attribute depends on the version of rosbags.
            field_definitions = getattr(self._ros2_store, "fielddefs", None) or self._ros2_store.FIELDDEFS
            store.register({**field_definitions, **self._typesys.get_types_from_idl(text)})
            return str(store.generate_msgdef(name, ros_version=2)[0])
        except Exception as error:  # the IDL parser raises arbitrary exceptions for malformed text
            raise _make_idl_error(name, text, error) from error

    def _find_text(self, type_name: str) -> Optional[str]:
        name = "/msg/".join(type_name.split("/"))
        if name in self._ros2_store.types:
            return str(self._ros2_store.generate_msgdef(name, ros_version=2)[0])
        installed = self._installed.find(type_name)
        return None if installed is None else installed.text


def _make_idl_error(name: str, text: str, error: Exception) -> MessageError:
    """Return the error for a definition in IDL that rosbags cannot parse.

    Its errors contain the complete text; in version 0.11 the offset of the first part that it cannot parse and the
    expected tokens follow.
    """
    problem = str(error).partition(repr(text))[2] or describe_error(error)
    match = _IDL_PROBLEM.match(problem)
    if match is None:
        reason = quote_shortened(" ".join(problem.split())) if problem.strip() else "it is not IDL"
        return MessageError(f"its definition in IDL cannot be parsed: {reason}")
    expected = " or ".join(sorted(re.findall(r"'[^']*'|/[^/]*/", match["expected"] or ""))) or "IDL"
    return MessageError(
        f"its definition in IDL cannot be parsed: expected {shorten(expected)}",
        place_at_offset(ros1_type_name(name), text, min(int(match["offset"]), len(text))),
    )


def _quote_if_invalid(name: str) -> str:
    """Return the name of a topic or type; it is quoted if ROS does not allow it."""
    return name if topic_fault(name) is None else quote_shortened(name)


def _open_files(path: Path, limit: ChunkLimit, stack: ExitStack) -> Tuple[List[Storage], bool]:
    """Return the open files of a bag, which ``stack`` closes, and whether its messages are compressed."""
    try:
        import rosbags.typesys  # noqa: F401, PLC0415 - an optional package, which brings those that decompress
    except ImportError:
        raise BagError("reading bags needs the Python package rosbags (pip install rosbags)") from None
    with ExitStack() as open_files:
        try:
            paths, has_packed_messages = _read_metadata(path / METADATA) if path.is_dir() else ([path], False)
            files: List[Storage] = []
            for file in paths:
                if file.suffix == _COMPRESSED_SUFFIX:
                    folder = open_files.enter_context(TemporaryDirectory(prefix="retalis-"))
                    file = _unpack_file(file, Path(folder) / file.stem, limit)
                reader_class = McapFile if file.suffix == ".mcap" else SqliteFile
                files.append(reader_class(file, limit))
                open_files.callback(files[-1].close)
        except BagError:
            raise
        except Exception as error:  # malformed bags raise arbitrary exceptions
            raise BagError(f"{path} is not a complete ROS 2 bag: {describe_error(error)}") from error
        # Handed over only after all files were opened: an error above closes those that are open already.
        stack.push(open_files.pop_all())
    return files, has_packed_messages


def _read_metadata(path: Path) -> Tuple[List[Path], bool]:
    """Return the files of a bag in their order, and whether messages are compressed individually.

    Raises:
        ValueError: if the metadata is invalid.
    """
    size = path.stat().st_size
    if size > MAX_METADATA_BYTES:
        raise ValueError(f"{path.name} has {size} bytes: expected at most {MAX_METADATA_BYTES}")
    values = _parse_metadata(path.read_text(encoding="utf-8"))
    # Only the file name is used: some versions of ROS 2 wrote paths, and a path must not lead out of the bag.
    names = [name.rpartition("/")[2] for name in values.get("relative_file_paths", [])]
    storage, mode, compression_format = ("".join(values.get(name, [])) for name in _METADATA_SCALARS)
    suffix = {"sqlite3": ".db3", "mcap": ".mcap"}.get(storage)
    if not names or suffix is None:
        raise ValueError(f"{path.name} names no files, or no storage_identifier: expected sqlite3 or mcap")
    mode = mode.lower() or "none"
    # Other modes would yield compressed bytes as messages.
    if mode not in ("none", "file", "message") or (
        mode != "none" and compression_format != _COMPRESSED_SUFFIX[1:]
    ):
        raise ValueError(
            f"its compression by '{mode}' with '{compression_format}' is unknown: expected zstd by file or message"
        )
    if len(set(names)) < len(names):
        raise ValueError("a file is named twice")
    files = [path.parent / name for name in names]
    for file in files:
        if file.suffix != (_COMPRESSED_SUFFIX if mode == "file" else suffix):
            raise ValueError(f"the name '{file.name}' does not have the suffix of storage '{storage}'")
        if not file.is_file():
            raise ValueError(f"its file {file.name} is missing")
    return files, mode == "message"


_METADATA_SCALARS = ("storage_identifier", "compression_mode", "compression_format")
_METADATA_KEYS = (*_METADATA_SCALARS, "relative_file_paths")


def _parse_metadata(text: str) -> Dict[str, List[str]]:
    """Return the values of the four keys in `_METADATA_KEYS`, each as a list.

    A complete YAML parser takes 10 s for 5,000 brackets, and does not terminate for a mapping that is merged three
    times into each of forty others. This one parses the form that ``ros2 bag`` and ``rosbags`` write: the keys on
    separate lines, one level deep, and a list in brackets or with a dash before each value.
    """
    lines = text.splitlines()
    values: Dict[str, List[str]] = {}
    key_depth = -1
    for number, line in enumerate(lines):
        content = line.lstrip(" ")
        depth = len(line) - len(content)
        key, colon, value = content.partition(":")
        if key_depth < 0 and depth and colon:
            key_depth = depth
        if depth != key_depth or key not in _METADATA_KEYS or key in values or not colon:
            continue
        value = value.strip()
        following = islice(lines, number + 1, None)
        if value.startswith("["):
            parts = [value]
            while "]" not in parts[-1]:
                parts.append(next(following, "]"))
            values[key] = [_unquote(part) for part in "".join(parts)[1:].partition("]")[0].split(",")]
        elif value:
            values[key] = [_unquote(value)]
        else:
            items = takewhile(lambda item: item.startswith("- "), (item.strip() for item in following))
            values[key] = [_unquote(item[2:]) for item in items]
    return values


def _unquote(value: str) -> str:
    value = value.strip()
    if value[:1] in ('"', "'") and value[-1:] == value[:1]:
        return value[1:-1]
    return "" if value in ("~", "null") else value


def _unpack_file(path: Path, target: Path, limit: ChunkLimit) -> Path:
    """Decompress a file; return the path of the new file.

    Raises:
        BagError: if it would take too much disk space.
    """
    max_bytes = min(
        max(limit.bytes, MAX_UNPACKED_RATIO * path.stat().st_size),
        shutil.disk_usage(target.parent).free // 2,
    )
    with path.open("rb") as packed, zstd_reader(packed) as source, target.open("wb") as file:
        if copy_up_to(source, file, max_bytes) > max_bytes:
            raise BagError(
                f"{path} is too large: unpacked it would have more than {format_count(max_bytes, 'byte')} "
                "(--max-chunk-megabytes allows more)"
            )
    return target
