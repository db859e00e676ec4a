"""The files of ROS 2 bags: SQLite databases and mcap files.

They are read here, and not by ``rosbags``, so that a hostile file cannot take more memory or time than its size
allows: chunks are unpacked up to the size that they state, lengths are compared with the file's size, and a database
may have plain tables only, and takes a number of steps that its size bounds.

Mcap (https://mcap.dev/spec): a file is a header, records, a summary and a footer. A record is an opcode, its length
and its body. Messages are in chunks, which may be compressed, or beside them. The summary repeats schemas and
channels, and has an index entry with the time range of each chunk, by which the messages of all chunks are merged. A
file without a summary is read from its start.

ROS 2 bags (SQLite and mcap), read as if ROS 1 had recorded them; types as the ``rosbags`` package knows them.
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

from ..foundation.errors import MessageError, beginning, counted, shortened
from ..foundation.ros_names import plain_type, topic_fault
from ..messages.ros2_types import Ros2Type, ros2_type
from ..messages.type_registry import Installed
from .decompression import MAX_CHUNK_MEGABYTES, ChunkLimit, copy_up_to, reason, unpack, zstd_reader
from .rosbag1 import BagError, PathLike, Record, Topic

Message = Tuple[int, int, bytes]
"""A message: the number of its connection, its time in nanoseconds, its bytes."""


class Connection(NamedTuple):
    """A topic in a file.

    Attributes:
        id: its number in the file.
        topic: the topic's name.
        type: the message type, ``pkg/msg/Type``.
        encoding: the form of the definition: ``ros2msg``, ``ros2idl`` or nothing.
        definition: the text of the definition, if the file has it.
        format: the form of the messages, ``cdr``.
        messages: the number of messages.
    """

    id: int
    topic: str
    type: str
    encoding: str
    definition: str
    format: str
    messages: int


# ---- SQLite ------------------------------------------------------------------------------------------

_FREE_STEPS = 1_000_000
_STEPS_PER_BYTE = 10
"""Instructions of SQLite's virtual machine for a query: a row takes at least 10 bytes, and about 20 instructions."""

_STEPS_AT_A_TIME = 1000

_TOO_MANY_BYTES = "its rows have more bytes than the file: some name the same pages"

_LIMIT_LENGTH = 0
"""``SQLITE_LIMIT_LENGTH`` of ``sqlite3.h``: the largest text, blob or row."""

_MAX_LENGTH = (1 << 31) - 1
"""The largest value of a limit, which is an ``int`` of C."""


class SqliteFile:
    """A ``.db3`` file.

    Attributes:
        connections: its topics.
        start, end: the times of the first and the last message in nanoseconds, 0 if there are none.

    Raises:
        Exception: if it cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
        self._size = path.stat().st_size
        self._steps = 0
        with ExitStack() as stack:
            self._database = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
            )
            stack.callback(self._database.close)
            self._database.execute("PRAGMA trusted_schema = OFF")
            set_limit = getattr(self._database, "setlimit", None)  # from Python 3.11
            if set_limit is not None:
                set_limit(_LIMIT_LENGTH, min(limit.bytes + 1, self._size + 1, _MAX_LENGTH))
            self._database.set_progress_handler(self._count_steps, _STEPS_AT_A_TIME)
            self.connections = self._read_connections()
            self.start, self.end = self._read_times()
            self._stack = stack.pop_all()

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in the order of time, from a start and before a stop.

        Raises:
            Exception: if the file turns out to be broken.
        """
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join(map(str, ids))})"
        )
        arguments = []
        for sign, instant in ((">=", start), ("<", stop)):
            if instant is not None:
                query += f" AND timestamp {sign} ?"
                arguments.append(instant)
        for identifier, time, data in self._ask(f"{query} ORDER BY timestamp", *arguments):
            if time.__class__ is not int or data.__class__ is not bytes:
                raise ValueError("a message is not an integer and a blob")
            yield identifier, time, data

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _ask(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        unread = self._size
        for row in self._execute(query, *arguments):
            unread -= sum(len(value) for value in row if isinstance(value, (str, bytes)))
            if unread < 0:
                raise ValueError(_TOO_MANY_BYTES)
            yield row

    def _execute(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        self._steps = _FREE_STEPS + _STEPS_PER_BYTE * self._size
        try:
            # "yield from" would close the cursor of a reading that is given up, which raises once the file is closed.
            for row in self._database.execute(query, arguments):  # noqa: UP028
                yield row
        except sqlite3.OperationalError as error:
            if self._steps >= 0:
                raise
            raise ValueError("its tables have more rows than a file of its size can hold") from error

    def _count_steps(self) -> bool:
        self._steps -= _STEPS_AT_A_TIME
        return self._steps < 0  # the query ends as interrupted

    def _read_connections(self) -> List[Connection]:
        for table in ("topics", "messages"):
            if not self._has_table(table):
                raise ValueError(f"it has no table '{table}': expected a database that ros2 bag has written")
        definitions: Dict[str, Tuple[str, str]] = {}
        if self._has_table("message_definitions"):
            rows = self._ask(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            for name, encoding, text in rows:
                definitions.setdefault(_checked(name), (_checked(encoding), _checked(text)))
        counts = dict(self._ask("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        found = []
        for identifier, topic, name, form in self._ask(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            encoding, text = definitions.get(_checked(name), ("", ""))
            number = counts.get(identifier, 0)
            found.append(
                Connection(int(identifier), _checked(topic), name, encoding, text, _checked(form), number)
            )
        return found

    def _has_table(self, name: str) -> bool:
        """Return whether there is a plain table.

        A view or a generated column would run SQL of the file's, which can go on for ever or make gigabytes.
        """
        rows = list(self._ask("SELECT type, sql FROM sqlite_master WHERE name = ?", name))
        if not rows:
            return False
        kinds = [str(kind) for kind, sql in rows if str(sql)[:13].upper() == "CREATE TABLE "]
        columns = list(self._ask(f"PRAGMA table_xinfo({name})"))
        # Of each column: number, name, type, whether it is not null, default, key, and 0 for a plain one.
        if kinds != ["table"] or any(column[6] or column[4] is not None for column in columns):
            raise ValueError(
                f"'{name}' is not a plain table: expected columns without defaults or expressions"
            )
        return True

    def _read_times(self) -> Tuple[int, int]:
        ((first, last, size),) = self._ask(
            "SELECT min(timestamp), max(timestamp), total(length(data)) FROM messages"
        )
        if size > self._size:  # many rows with the same pages: sorted on disk, they would fill it
            raise ValueError(_TOO_MANY_BYTES)
        return (0, 0) if first is None else (int(first), int(last))


def _checked(text: object) -> str:
    if not isinstance(text, str):
        raise ValueError("a name or a definition is not text")
    return text


# ---- mcap --------------------------------------------------------------------------------------------

_MAGIC = b"\x89MCAP0\r\n"
_RECORD = Struct("<BQ")
_FOOTER = Struct("<BQQQI8s")
_LENGTH = Struct("<I")
_SIZE = Struct("<Q")
_ID = Struct("<H")
_IDS = Struct("<HH")
_MESSAGE = Struct("<HIQQ")
_CHUNK = Struct("<QQQI")
_INDEX = Struct("<QQQQ")
_STATISTICS = Struct("<QHIIIIQQ")
_COUNT = Struct("<HQ")

_HEADER, _END, _SCHEMA, _CHANNEL, _DATA, _CHUNK_RECORD, _CHUNK_INDEX, _TOTALS = 1, 2, 3, 4, 5, 6, 8, 11
"""Opcodes."""


class _McapChunk(NamedTuple):
    """A chunk that the index names: its times, its place and its length."""

    start: int
    end: int
    position: int
    length: int


class McapFile:
    """An ``.mcap`` file.

    Attributes:
        connections: its topics.
        start, end: the times of the first and the last message in nanoseconds, 0 if there are none.

    Raises:
        Exception: if it cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
        self._limit = limit
        self._size = path.stat().st_size
        self._schemas: Dict[int, Tuple[str, str, str]] = {0: ("", "", "")}
        self._channels: Dict[int, Tuple[int, str, str]] = {}
        self._counts: Dict[int, int] = {}
        self._chunks: List[_McapChunk] = []
        self._has_loose_messages = False
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
                form,
                self._counts.get(identifier, 0),
            )
            for identifier, (schema, topic, form) in self._channels.items()
        ]

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in the order of time, from a start and before a stop.

        Raises:
            Exception: if the file turns out to be broken, or too many chunks overlap in time.
        """
        first = 0 if start is None else start
        last = 1 << 64 if stop is None else stop
        wanted = set(ids)
        return (
            self._stream(wanted, first, last)
            if self._has_loose_messages
            else self._merge(wanted, first, last)
        )

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _open(self) -> None:
        if self._bytes(0, len(_MAGIC)) != _MAGIC:
            raise ValueError("it does not begin as an mcap file")
        opcode, length = self._record(len(_MAGIC), self._size)
        self._data_start = len(_MAGIC) + _RECORD.size + length
        if opcode != _HEADER or _text(self._bytes(len(_MAGIC) + _RECORD.size, length), 0)[0] != "ros2":
            raise ValueError("its header is not that of a ROS 2 bag")
        footer = self._size - _FOOTER.size
        opcode, length, summary, _, _, magic = _FOOTER.unpack(self._bytes(footer, _FOOTER.size))
        if (opcode, length, magic) != (_END, 20, _MAGIC):
            raise ValueError("it does not end as an mcap file: it may be truncated")
        self._data_end = summary or footer
        if not self._data_start <= self._data_end <= footer:
            raise ValueError(f"its summary at byte {summary} is outside of the file")
        if not (self._read_summary(footer) and len(self._schemas) > 1):
            self._scan()

    def _read_summary(self, footer: int) -> bool:
        """Read the summary; return whether it says how many messages there are, and when."""
        has_totals = False
        for opcode, position, length in self._records(self._data_end, footer):
            if opcode in (_SCHEMA, _CHANNEL):
                self._take_type(opcode, self._bytes(position, length))
            elif opcode == _CHUNK_INDEX:
                self._chunks.append(_McapChunk(*_INDEX.unpack_from(self._bytes(position, length))))
            elif opcode == _TOTALS:
                has_totals = True
                body = self._bytes(position, length)
                number, _, _, _, _, _, start, end = _STATISTICS.unpack_from(body)
                self.start, self.end = (start, end) if number else (0, 0)
                (size,) = _LENGTH.unpack_from(body, _STATISTICS.size)
                counts = body[_STATISTICS.size + _LENGTH.size :][:size]
                self._counts = dict(_COUNT.iter_unpack(counts))
        self._chunks.sort(key=lambda chunk: chunk.position)
        for before, chunk in zip(self._chunks, self._chunks[1:]):
            if chunk.position < before.position + before.length:
                raise ValueError(f"the index names the chunk at byte {chunk.position} inside another one")
        self._has_loose_messages = not self._chunks
        return has_totals

    def _scan(self) -> None:
        """Read everything before the summary, to find types, times and chunks."""
        self._chunks.clear()
        self._has_loose_messages = False
        counts: Counter[int] = Counter()
        first, last = 1 << 64, -1
        for opcode, position, length in self._records(self._data_start, self._data_end):
            if opcode in (_SCHEMA, _CHANNEL):
                self._take_type(opcode, self._bytes(position, length))
            elif opcode == _DATA:
                self._has_loose_messages = True
                channel, _, time, _ = _MESSAGE.unpack(self._bytes(position, min(length, _MESSAGE.size)))
                counts[channel] += 1
                first, last = min(first, time), max(last, time)
            elif opcode == _CHUNK_RECORD:
                chunk = _McapChunk(0, 0, position - _RECORD.size, length + _RECORD.size)
                data = self._unpack(chunk)
                begin, end = 1 << 64, -1
                for kind, place, stop in _records_in(data):
                    if kind in (_SCHEMA, _CHANNEL):
                        self._take_type(kind, data[place:stop])
                    elif kind == _DATA:
                        channel, _, time, _ = _MESSAGE.unpack_from(data, place)
                        counts[channel] += 1
                        begin, end = min(begin, time), max(end, time)
                if end >= 0:
                    self._chunks.append(chunk._replace(start=begin, end=end))
                    first, last = min(first, begin), max(last, end)
        self._counts = counts
        self.start, self.end = (first, last) if last >= 0 else (0, 0)

    def _take_type(self, opcode: int, body: bytes) -> None:
        if opcode == _SCHEMA:
            (identifier,) = _ID.unpack_from(body)
            name, at = _text(body, _ID.size)
            encoding, at = _text(body, at)
            self._schemas.setdefault(identifier, (name, encoding, _text(body, at)[0]))
        else:
            identifier, schema = _IDS.unpack_from(body)
            topic, at = _text(body, _IDS.size)
            self._channels.setdefault(identifier, (schema, topic, _text(body, at)[0]))

    def _merge(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages of all chunks by their time; only chunks that overlap in time are held."""
        held = 0
        heap: List[Tuple[int, int, Message, Iterator[Message], int]] = []

        def take(number: int, messages: Iterator[Message], size: int) -> int:
            message = next(messages, None)
            if message is None:
                return size
            heappush(heap, (message[1], number, message, messages, size))
            return 0

        chunks = sorted(chunk for chunk in self._chunks if chunk.end >= start and chunk.start < stop)
        for number, chunk in enumerate(chunks):
            while heap and heap[0][0] <= chunk.start:
                _, earlier, message, messages, size = heappop(heap)
                yield message
                held -= take(earlier, messages, size)
            data = self._unpack(chunk)
            size = len(data)
            held += size
            self._limit.check(held, "chunks that overlap in time have")
            held -= take(number, _messages_in(data, wanted, start, stop), size)
            del data  # the iterator has it for as long as it is needed
        while heap:
            _, earlier, message, messages, size = heappop(heap)
            yield message
            take(earlier, messages, size)

    def _stream(self, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
        """Yield the messages of a file without an index, which has to have them in the order of time."""
        before = -1
        for opcode, position, length in self._records(self._data_start, self._data_end):
            data = b""
            if opcode == _DATA:
                data = _RECORD.pack(opcode, length) + self._bytes(position, length)
            elif opcode == _CHUNK_RECORD:
                data = self._unpack(_McapChunk(0, 0, position - _RECORD.size, length + _RECORD.size))
            for message in _messages_in(data, wanted, start, stop):
                if message[1] < before:
                    raise ValueError(
                        "its messages are not in the order of time: expected an index of its chunks"
                    )
                before = message[1]
                yield message

    def _unpack(self, chunk: _McapChunk) -> bytes:
        where = f"the chunk at byte {chunk.position}"
        opcode, length = self._record(chunk.position, self._size)
        if opcode != _CHUNK_RECORD or length + _RECORD.size != chunk.length:
            raise ValueError(f"the index names {where}: there is none of {chunk.length} bytes")
        body = self._bytes(chunk.position + _RECORD.size, length)
        _, _, size, checksum = _CHUNK.unpack_from(body)
        compression, at = _text(body, _CHUNK.size)
        (packed_size,) = _SIZE.unpack_from(body, at)
        packed = body[at + _SIZE.size :][:packed_size]
        if len(packed) != packed_size:
            raise ValueError(f"{where} is truncated")
        self._limit.check(size, f"{where} states")
        try:
            data = unpack(compression, packed, size)
        except Exception as error:  # of the library that decompresses
            raise ValueError(f"{where}: {reason(error)}") from error
        if checksum and crc32(data) != checksum:
            raise ValueError(f"{where} is damaged: its checksum is wrong")
        return data

    def _records(self, position: int, end: int) -> Iterator[Tuple[int, int, int]]:
        """Yield opcode, place and length of the records between two places."""
        while position < end:
            opcode, length = self._record(position, end)
            position += _RECORD.size
            yield opcode, position, length
            position += length

    def _record(self, position: int, end: int) -> Tuple[int, int]:
        opcode, length = _RECORD.unpack(self._bytes(position, _RECORD.size))
        if length > end - position - _RECORD.size:
            raise ValueError(f"the record at byte {position} states {length} bytes: there are fewer")
        return opcode, length

    def _bytes(self, position: int, size: int) -> bytes:
        if position < 0 or position + size > self._size:
            raise ValueError(f"{size} bytes at byte {position} are outside of the file")
        self._file.seek(position)
        return self._file.read(size)


def _text(body: bytes, at: int) -> Tuple[str, int]:
    """Return a text and the place after it."""
    (size,) = _LENGTH.unpack_from(body, at)
    begin = at + _LENGTH.size
    if begin + size > len(body):
        raise ValueError(f"a text states {size} bytes: there are fewer")
    return body[begin : begin + size].decode(), begin + size


def _records_in(data: bytes) -> Iterator[Tuple[int, int, int]]:
    """Yield opcode, begin and end of the records in a chunk."""
    position, size = 0, len(data)
    while position < size:
        opcode, length = _RECORD.unpack_from(data, position)
        position += _RECORD.size
        end = position + length
        if end > size:
            raise ValueError(f"a record in a chunk states {length} bytes: there are fewer")
        if not _SCHEMA <= opcode <= _DATA:
            raise ValueError(
                f"a chunk has a record with opcode {opcode}: expected schemas, channels, messages"
            )
        yield opcode, position, end
        position = end


def _messages_in(data: bytes, wanted: Set[int], start: int, stop: int) -> Iterator[Message]:
    """Yield the messages in a chunk in the order of time."""
    times, places = array("Q"), array("Q")  # two numbers for a message of 31 bytes at least
    is_sorted, before = True, 0
    for opcode, place, _ in _records_in(data):
        if opcode == _DATA:
            channel, _, time, _ = _MESSAGE.unpack_from(data, place)
            if channel in wanted and start <= time < stop:
                times.append(time)
                places.append(place)
                is_sorted = is_sorted and time >= before
                before = time
    order = range(len(times)) if is_sorted else sorted(range(len(times)), key=times.__getitem__)
    for number in order:
        place = places[number]
        (channel,) = _ID.unpack_from(data, place)
        (length,) = _SIZE.unpack_from(data, place - _SIZE.size)
        yield channel, times[number], data[place + _MESSAGE.size : place + length]


Storage = Union[SqliteFile, McapFile]


log = logging.getLogger("retalis")

COMPRESSED = ".zstd"
"""The ending that ``ros2 bag record --compression-mode file`` adds to the name of a file."""

SUFFIXES = (".db3", ".mcap", f".db3{COMPRESSED}", f".mcap{COMPRESSED}")
"""Endings of the files of a ROS 2 bag."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

MAX_UNPACKED_RATIO = 100
"""Largest ratio of a compressed file's size unpacked to its own, if that is more than the limit of a chunk.

An unpacked file may also take at most half of the free disk space.
"""

MAX_METADATA_BYTES = 4_000_000

_HEADINGS = re.compile(r"^(?:={20,}|IDL:.*)$", re.MULTILINE)
"""Lines between the definitions of types in IDL, which are not IDL themselves."""


class _Way(NamedTuple):
    """A topic, and what makes ROS 1's bytes of its messages."""

    topic: Topic
    converted: Callable[[bytes], bytes]


class Ros2BagReader:
    """A bag of ROS 2 that is open for reading: a folder with ``metadata.yaml``, or one of its files.

    Types have ROS 1's names, and a header has the sequence number 0. Arguments, attributes and methods are those of
    `BagReader`.

    Raises:
        BagError: where it cannot be read.
    """

    def __init__(self, path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        self._stack = ExitStack()
        self._files, self._has_packed_messages = _open(self.path, self._limit, self._stack)
        self._sources = self._read_types()
        self.topics: Tuple[Topic, ...] = tuple(source.topic for source in self._sources.values())
        self.messages = sum(connection.messages for file in self._files for connection in file.connections)
        full = [file for file in self._files if any(connection.messages for connection in file.connections)]
        self.start = min((file.start for file in full), default=0)
        self.end = max((file.end for file in full), default=0)

    def _read_types(self) -> "Dict[Tuple[str, str], _Way]":
        """Return how to read each topic by its name and type; warn of those that cannot be read."""
        merged: Dict[Tuple[str, str], Connection] = {}
        for file in self._files:
            for connection in file.connections:
                key = connection.topic, connection.type
                known = merged.get(key)
                if known is not None:
                    messages = known.messages + connection.messages
                    connection = (known if known.definition else connection)._replace(messages=messages)
                merged[key] = connection
        types = _Types()
        sources: Dict[Tuple[str, str], _Way] = {}
        unreadable: Dict[Tuple[str, str], List[str]] = {}
        for key, connection in merged.items():
            try:
                sources[key] = types.source(connection)
            except MessageError as error:
                problem = str(error).partition("\n")[0]  # without the text of the line
                topics = unreadable.setdefault((plain_type(connection.type), problem), [])
                topics.append(_shown(connection.topic))
        for (kind, problem), topics in unreadable.items():
            names = f"topic{'s' if len(topics) > 1 else ''} {', '.join(sorted(topics))}"
            log.warning("%s: left out: %s (%s): %s", self.path, names, _shown(kind), problem)
        return sources

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in the order of their receipt; see `BagReader.records`.

        Messages that are not of their type are dropped, with a warning for the first one of a topic and their number.

        Raises:
            BagError: where the bag turns out to be broken.
        """
        dropped: Counter[str] = Counter()
        wanted = None if topics is None else {name.lstrip("/") for name in topics}
        try:
            for file in self._files:
                ways = {
                    connection.id: self._sources[connection.topic, connection.type]
                    for connection in file.connections
                    if (connection.topic, connection.type) in self._sources
                    and (wanted is None or connection.topic.lstrip("/") in wanted)
                }
                if not ways:
                    continue
                for identifier, time, data in file.read(ways, start, stop):
                    topic, converted = ways[identifier]
                    try:
                        raw = converted(
                            self._limit.unpack_message(data) if self._has_packed_messages else data
                        )
                    except MessageError as error:
                        name = _shown(topic.name)
                        if not dropped[name]:
                            log.warning("%s: a message on %s is dropped: %s", self.path, name, error)
                        dropped[name] += 1
                        continue
                    yield Record(topic, time, raw)
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{self.path}: the bag is broken: {reason(error)}") from error
        finally:
            for name, number in dropped.items():
                log.warning("%s: %s on %s dropped", self.path, counted(number, "message"), name)

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def __enter__(self) -> "Ros2BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class _Types:
    """The types of a bag's topics: by the definitions in the bag, by those of ROS 2, by what is installed."""

    def __init__(self) -> None:
        from rosbags import typesys  # noqa: PLC0415 - an optional package

        self._typesys: Any = typesys
        self._usual: Any = typesys.get_typestore(typesys.Stores.LATEST)
        self._installed = Installed()
        self._read: Dict[Tuple[str, str], Ros2Type] = {}

    def source(self, connection: Connection) -> _Way:
        """Return how to read a connection.

        Raises:
            MessageError: where its type is not defined, or the definition is wrong.
        """
        if connection.format != "cdr":
            raise MessageError(f"its messages are in '{beginning(connection.format)}': expected cdr")
        key = connection.type, connection.definition
        found = self._read.get(key)
        if found is None:
            text = self._definition(connection)
            found = self._read[key] = ros2_type(connection.type, text, self._find)
        definition = found.definition
        topic = Topic(
            connection.topic,
            definition.name,
            definition.full_text,
            definition.md5sum,
            connection.messages,
        )
        return _Way(topic, found.to_ros1)

    def _definition(self, connection: Connection) -> str:
        name, text = connection.type, connection.definition
        if not text:
            found = self._find(plain_type(name))
            if found is None:
                raise MessageError("the type is not defined in the bag or on this system")
            return found
        if connection.encoding.endswith("idl") or text.lstrip("=\r\n ").startswith("IDL:"):
            return self._of_idl(name, text)
        return text

    def _of_idl(self, name: str, text: str) -> str:
        store = self._typesys.get_typestore(self._typesys.Stores.EMPTY)
        try:
            usual = getattr(self._usual, "fielddefs", None) or self._usual.FIELDDEFS  # by its version
            store.register({**usual, **self._typesys.get_types_from_idl(_HEADINGS.sub("", text))})
            return str(store.generate_msgdef(name, ros_version=2)[0])
        except Exception as error:  # text of a bag can lead its parser to anything
            problem = shortened(" ".join(reason(error).split()))
            raise MessageError(f"its definition in IDL cannot be read: {problem}") from error

    def _find(self, kind: str) -> Optional[str]:
        name = "/msg/".join(kind.split("/"))
        if name in self._usual.types:
            return str(self._usual.generate_msgdef(name, ros_version=2)[0])
        installed = self._installed.text(kind)
        return None if installed is None else installed[0]


def _shown(name: str) -> str:
    """Return the name of a topic or type, quoted if ROS does not allow it."""
    return name if topic_fault(name) is None else shortened(name)


def _open(path: Path, limit: ChunkLimit, stack: ExitStack) -> Tuple[List[Storage], bool]:
    """Return the open files of a bag, which the stack closes, and whether each message is compressed."""
    try:
        import rosbags.typesys  # noqa: F401, PLC0415 - an optional package, which brings those that decompress
    except ImportError:
        raise BagError("reading bags needs the Python package rosbags (pip install rosbags)") from None
    with ExitStack() as opened:
        try:
            paths, has_packed_messages = _read_metadata(path / METADATA) if path.is_dir() else ([path], False)
            files: List[Storage] = []
            for file in paths:
                if file.suffix == COMPRESSED:
                    folder = opened.enter_context(TemporaryDirectory(prefix="retalis-"))
                    file = _unpack(file, Path(folder) / file.stem, limit)
                kind = McapFile if file.suffix == ".mcap" else SqliteFile
                files.append(kind(file, limit))
                opened.callback(files[-1].close)
        except BagError:
            raise
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{path} is not a complete ROS 2 bag: {reason(error)}") from error
        stack.push(opened.pop_all())
    return files, has_packed_messages


def _read_metadata(path: Path) -> Tuple[List[Path], bool]:
    """Return the files of a bag in their order, and whether each message is compressed.

    Raises:
        ValueError: for a text that does not say it.
    """
    size = path.stat().st_size
    if size > MAX_METADATA_BYTES:
        raise ValueError(f"{path.name} has {size} bytes: expected at most {MAX_METADATA_BYTES}")
    values = _metadata_values(path.read_text(encoding="utf-8"))
    names = [name.rpartition("/")[2] for name in values.get("relative_file_paths", [])]
    storage, mode, form = ("".join(values.get(name, [])) for name in _METADATA_SCALARS)
    ending = {"sqlite3": ".db3", "mcap": ".mcap"}.get(storage)
    if not names or ending is None:
        raise ValueError(f"{path.name} names no files, or no storage_identifier: expected sqlite3 or mcap")
    mode = mode.lower() or "none"
    if mode not in ("none", "file", "message") or (mode != "none" and form != COMPRESSED[1:]):
        raise ValueError(
            f"its compression by '{mode}' with '{form}' is unknown: expected zstd by file or message"
        )
    if len(set(names)) < len(names):
        raise ValueError("a file is named twice")
    files = [path.parent / name for name in names]
    for file in files:
        if file.suffix != (COMPRESSED if mode == "file" else ending):
            raise ValueError(f"the name '{file.name}' does not end as one of storage '{storage}'")
        if not file.is_file():
            raise ValueError(f"its file {file.name} is missing")
    return files, mode == "message"


_METADATA_SCALARS = ("storage_identifier", "compression_mode", "compression_format")
_METADATA_KEYS = (*_METADATA_SCALARS, "relative_file_paths")


def _metadata_values(text: str) -> Dict[str, List[str]]:
    """Return the values of the four keys that are needed, each as a list.

    A reader of all YAML takes 10 s for 5,000 brackets, and does not end for a mapping that is merged three times into
    each of forty others. This one reads the form in which ``ros2 bag`` and ``rosbags`` write: the keys on lines of
    their own, one level deep, and a list in brackets or with a dash before each of its values.
    """
    lines = text.splitlines()
    values: Dict[str, List[str]] = {}
    level = -1
    for number, line in enumerate(lines):
        content = line.lstrip(" ")
        depth = len(line) - len(content)
        key, colon, value = content.partition(":")
        if level < 0 and depth and colon:
            level = depth
        if depth != level or key not in _METADATA_KEYS or key in values or not colon:
            continue
        value = value.strip()
        rest = islice(lines, number + 1, None)
        if value.startswith("["):
            parts = [value]
            while "]" not in parts[-1]:
                parts.append(next(rest, "]"))
            values[key] = [_unquoted(part) for part in "".join(parts)[1:].partition("]")[0].split(",")]
        elif value:
            values[key] = [_unquoted(value)]
        else:
            items = takewhile(lambda item: item.startswith("- "), (item.strip() for item in rest))
            values[key] = [_unquoted(item[2:]) for item in items]
    return values


def _unquoted(value: str) -> str:
    value = value.strip()
    if value[:1] in ('"', "'") and value[-1:] == value[:1]:
        return value[1:-1]
    return "" if value in ("~", "null") else value


def _unpack(path: Path, target: Path, limit: ChunkLimit) -> Path:
    """Unpack a compressed file; return the new one.

    Raises:
        BagError: if it would take too much disk space.
    """
    allowed = min(
        max(limit.bytes, MAX_UNPACKED_RATIO * path.stat().st_size),
        shutil.disk_usage(target.parent).free // 2,
    )
    with path.open("rb") as packed, zstd_reader(packed) as source, target.open("wb") as file:
        if copy_up_to(source, file, allowed) > allowed:
            raise BagError(
                f"{path} is too large: unpacked it would have more than {counted(allowed, 'byte')} "
                "(--max-chunk-megabytes allows more)"
            )
    return target
