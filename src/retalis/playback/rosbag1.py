"""The chunks of a bag, in the order in which its messages ask for them.

ROS 1 bags, read and written message by message as raw bytes; the ``rosbags`` package does the work.
"""

import io
import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from struct import Struct
from typing import (
    Any,
    BinaryIO,
    Callable,
    Collection,
    Deque,
    Dict,
    Generator,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    Union,
)

from ..foundation.errors import RetalisError
from ..messages.type_definition import Definition
from .decompression import MAX_CHUNK_MEGABYTES, ChunkLimit, reason, unpack

AHEAD = 3
"""Chunks that are decompressed before they are asked for."""

_MAX_AHEAD_BYTES = 16 << 20
"""Size of a chunk up to which it is decompressed before it is asked for."""

MAX_REPEATS = 8
"""Average number of times that a chunk of a bag may be read again because messages of chunks alternate in time."""


class Chunk(NamedTuple):
    """The place of a chunk in a bag.

    Attributes:
        position: of its data.
        packed_size: the bytes that it has in the file.
        size: the bytes that it has unpacked, as its header states.
        compression: ``none``, ``bz2`` or ``lz4``.
    """

    position: int
    packed_size: int
    size: int
    compression: str


def chunks(
    file: BinaryIO, places: Mapping[int, Chunk], positions: Iterable[int], limit: ChunkLimit
) -> Generator[bytes, None, None]:
    """Yield the records of chunks, one after the other; a chunk that is asked for twice in a row comes once.

    Those that are compressed by bz2, which takes most of the time of reading, are decompressed by other threads
    meanwhile: that needs no lock of the interpreter's. A chunk that is asked for again later is held until then, if
    all that are held stay below the limit of one; if not, it is read again.

    Args:
        file: the bag.
        places: of the chunks, by their position.
        positions: of the chunks, as the messages need them.
        limit: the largest size of a chunk.

    Raises:
        ValueError: for a chunk that has not the size that it states, or a larger one than is allowed, when its turn
            comes; if chunks have to be read again too often.
        Exception: what else the bytes of a broken bag lead to.
    """
    order = [position for position, _ in groupby(positions)]
    reader = _ChunkReader(file, places, limit, order)
    others = min(2, (os.cpu_count() or 1) - 1)
    if others and any(map(reader.is_slow, order)):
        with ThreadPoolExecutor(others, "chunks of a bag") as pool:
            yield from reader.read_ahead(pool.submit)
        return
    for number in range(len(order)):
        yield reader.begin(number, _at_once).result()


_Submit = Callable[..., "Future[bytes]"]
"""Runs a function, now or in a thread."""


class _ChunkReader:
    """Reads chunks in an order that is known."""

    def __init__(self, file: BinaryIO, places: Mapping[int, Chunk], limit: ChunkLimit, order: List[int]):
        self._file = file
        self._places = places
        self._limit = limit
        self._order = order
        self._last_use = {position: number for number, position in enumerate(order)}
        self._held: Dict[int, Tuple[int, Future[bytes]]] = {}
        self._held_bytes = 0
        self._seen: Set[int] = set()
        self._repeatable = MAX_REPEATS * sum(places[one].size for one in self._last_use if one in places)

    def is_slow(self, position: int) -> bool:
        """Return whether a chunk is worth a thread, and small enough to be held before it is asked for."""
        chunk = self._places.get(position)
        return chunk is not None and chunk.compression == "bz2" and chunk.size <= _MAX_AHEAD_BYTES

    def read_ahead(self, submit: _Submit) -> Iterator[bytes]:
        """Yield the records of each chunk, while others are decompressed."""
        waiting: Deque[Future[bytes]] = deque()
        for number, position in enumerate(self._order):
            if self.is_slow(position):
                waiting.append(self.begin(number, submit))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
                continue
            while waiting:
                yield waiting.popleft().result()
            yield self.begin(number, _at_once).result()
        while waiting:
            yield waiting.popleft().result()

    def begin(self, number: int, submit: _Submit) -> "Future[bytes]":
        """Return the records of the chunk with this number in the order, or the error that it leads to."""
        position = self._order[number]
        if position in self._held:
            records = self._held[position][1]
        else:
            try:
                chunk, packed = self._packed(position)
            except (OSError, ValueError) as error:  # the chunks before this one are read all the same
                return _at_once(_raise, error)
            records = submit(_unpack, chunk, packed, position)
            if number < self._last_use[position] and self._held_bytes + chunk.size <= self._limit.bytes:
                self._held[position] = chunk.size, records
                self._held_bytes += chunk.size
        if number == self._last_use[position] and position in self._held:
            self._held_bytes -= self._held.pop(position)[0]
        return records

    def _packed(self, position: int) -> Tuple[Chunk, bytes]:
        chunk = self._places.get(position)
        if chunk is None:
            raise ValueError(f"the index names a chunk at byte {position}: there is none")
        self._limit.check(chunk.size, f"the chunk at byte {position} states")
        if position in self._seen:
            self._repeatable -= chunk.size
            if self._repeatable < 0:
                raise ValueError(
                    "messages of large chunks alternate in time too often: expected chunks one after the other "
                    "(a larger --max-chunk-megabytes holds several)"
                )
        self._seen.add(position)
        self._file.seek(chunk.position)
        return chunk, self._file.read(chunk.packed_size)


def _at_once(function: Callable[..., bytes], *arguments: object) -> "Future[bytes]":
    done: Future[bytes] = Future()
    try:
        done.set_result(function(*arguments))
    except Exception as error:  # it is raised where the result is asked for, as from a thread
        done.set_exception(error)
    return done


def _raise(error: Exception) -> bytes:
    raise error


def _unpack(chunk: Chunk, packed: bytes, position: int) -> bytes:
    try:
        return unpack(chunk.compression, packed, chunk.size)
    except Exception as error:  # of the library that decompresses
        raise ValueError(f"the chunk at byte {position}: {reason(error)}") from error


_SIZE = Struct("<I")
_MAX_FIRST_LINE_BYTES = 64
"""Bytes of the first line that are read; it has 13."""

_IS_MESSAGE, _IS_CONNECTION = (b"\x04\x00\x00\x00op=" + bytes([code]) for code in (2, 7))
"""The field of a record's header that says what it is."""

PathLike = Union[str, Path]


_MessageEntry = Tuple[int, int, int, "Topic"]
"""Where a message is: its time, its chunk, its place there, and its connection."""


class BagError(RetalisError):
    """A bag that cannot be read or written.

    >>> try:
    ...     BagReader(folder / "none.bag")
    ... except BagError as error:
    ...     print(str(error).endswith("there is no such file"))
    True
    """


class Topic(NamedTuple):
    """A connection of a bag: one publisher's topic.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (topic,) = bag.topics
    >>> topic.name, topic.type, topic.messages
    ('/chatter', 'std_msgs/String', 1)

    Attributes:
        name: the topic's name.
        type: the message type, ``pkg/Type``.
        definition: the text of the type's definition, with those of nested types.
        md5sum: the type's checksum.
        messages: how many messages the bag has of this connection.
        latched: whether the publisher latched its last message.
        caller: the publishing node, where the bag says so.
    """

    name: str
    type: str
    definition: str
    md5sum: str
    messages: int = 0
    latched: bool = False
    caller: str = ""


class Record(NamedTuple):
    """A message of a bag: its topic, the time of its receipt in nanoseconds, and its bytes.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (record,) = bag.records()
    >>> record.topic.name, record.time, record.data[4:]
    ('/chatter', 1000000000, b'hello')
    """

    topic: Topic
    time: int
    data: bytes


class BagReader:
    """A bag that is open for reading; a context manager.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     for topic, time, data in bag.records(["chatter"]):
    ...         print(topic.name, topic.type, time, data[4:])
    /chatter std_msgs/String 1000000000 b'hello'

    Args:
        path: the file.
        max_chunk_megabytes: the size of the largest chunk that is unpacked.

    Attributes:
        path: the file.
        topics: its connections; a topic with several publishers is there several times.
        start, end: the times of the first and the last message in nanoseconds; 0 for an empty bag.
        messages: the number of messages.

    Raises:
        BagError: where the file is missing, is not a ROS 1 bag, or is cut off (``rosbag reindex`` helps).
    """

    def __init__(self, path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        self._reader = _open(self.path)
        self._topics: Dict[int, Topic] = {
            connection.id: _topic(connection) for connection in self._reader.connections
        }
        self.topics: Tuple[Topic, ...] = tuple(self._topics.values())
        self.messages: int = sum(topic.messages for topic in self.topics)
        self.start: int = self._reader.start_time if self.messages else 0
        self.end: int = self._reader.end_time - 1 if self.messages else 0

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in the order of their receipt.

        >>> with BagReader(folder / "talk.bag") as bag:
        ...     print([time for topic, time, data in bag.records()])
        [1000000000]

        Args:
            topics: names of the topics wanted, with or without leading ``/``; all by default.
            start: leave out what came before this instant, in nanoseconds.
            stop: leave out what came then or later.

        Raises:
            BagError: where the bag turns out to be broken.
        """
        connections = list(self._reader.connections)
        if topics is not None:
            wanted = {name.lstrip("/") for name in topics}
            connections = [found for found in connections if found.topic.lstrip("/") in wanted]
        if not connections:
            return
        try:
            entries = self._entries(connections, start, stop)
            positions = [position for _, position, _, _ in entries]
            with closing(chunks(self._reader.bio, self._reader.chunks, positions, self._limit)) as coming:
                yield from _messages(entries, coming)
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{self.path}: the bag is broken: {reason(error)}") from error

    def _entries(
        self, connections: List[Any], start: Optional[int], stop: Optional[int]
    ) -> List[_MessageEntry]:
        """Return where the messages of connections are, in their order, by the index that ``rosbags`` has read."""
        entries = [
            (entry.time, entry.chunk_pos, entry.offset, self._topics[connection.id])
            for connection in connections
            for entry in self._reader.indexes[connection.id]
            if (start is None or start <= entry.time) and (stop is None or entry.time < stop)
        ]
        entries.sort(key=itemgetter(0))
        return entries

    def close(self) -> None:
        """Close the file.

        >>> bag = BagReader(folder / "talk.bag")
        >>> bag.close()
        """
        self._reader.close()

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class BagWriter:
    """A new bag; a context manager. The bag is complete when it is closed.

    >>> with BagWriter(folder / "new.bag") as bag:
    ...     text = bag.add("/chatter", Definitions().find("std_msgs/String"))
    ...     bag.write(text, 1_000_000_000, bytes([2, 0, 0, 0]) + b"hi")
    >>> with BagReader(folder / "new.bag") as bag:
    ...     print(bag.messages)
    1

    Args:
        path: the file.
        overwrite: whether a file that is there already may be replaced.

    Raises:
        BagError: where the file exists already or cannot be written.
    """

    def __init__(self, path: PathLike, overwrite: bool = False):
        self.path = Path(path)
        writer = _rosbag1().Writer
        if self.path.exists() and not (overwrite and self.path.is_file()):
            raise BagError(f"{self.path} already exists")
        try:
            if self.path.exists():
                self.path.unlink()
            self._writer = writer(self.path)
            self._writer.open()
        except OSError as error:
            raise BagError(f"{self.path} cannot be written: {reason(error)}") from error

    def add(self, topic: str, definition: Definition, latched: bool = False, caller: str = "") -> object:
        """Add a connection; return what `write` takes for it."""
        return self._writer.add_connection(
            topic,
            definition.name.replace("/", "/msg/"),
            msgdef=definition.full_text,
            md5sum=definition.md5sum,
            callerid=caller or None,
            latching=int(latched),
        )

    def write(self, connection: object, time: int, data: bytes) -> None:
        """Write a message with the time of its receipt in nanoseconds."""
        self._writer.write(connection, time, data)

    def close(self) -> None:
        """Write the index and close the file.

        >>> bag = BagWriter(folder / "silence.bag")
        >>> bag.close()
        """
        self._writer.close()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def _rosbag1() -> Any:
    try:
        from rosbags import rosbag1  # noqa: PLC0415 - an optional package
    except ImportError:
        raise BagError(
            "reading and writing bags needs the Python package rosbags (pip install rosbags)"
        ) from None
    return rosbag1


def _messages(entries: List[_MessageEntry], coming: Iterator[bytes]) -> Iterator[Record]:
    """Yield messages, from the chunks that come.

    The way of ``rosbags`` reads every field of their headers from a file object, in three times the time.
    """
    size_at = _SIZE.unpack_from
    current, chunk, unread = -1, b"", 0
    rests: Dict[int, int] = {}  # bytes of chunks that no message has taken yet
    for time, position, offset, topic in entries:
        if position != current:
            rests[current] = unread
            current, chunk = position, next(coming)
            unread = rests.get(position, len(chunk))
        (size,) = size_at(chunk, offset)
        at = offset + 4 + size
        while chunk.find(_IS_MESSAGE, offset, at) < 0:  # a connection's record that stands before its message
            if chunk.find(_IS_CONNECTION, offset, at) < 0:
                raise ValueError(f"the index of the chunk at byte {position} does not point to a message")
            offset = at + 4 + size_at(chunk, at)[0]
            at = offset + 4 + size_at(chunk, offset)[0]
        (size,) = size_at(chunk, at)
        data = chunk[at + 4 : at + 4 + size]
        if len(data) != size:
            raise ValueError(f"a message in the chunk at byte {position} is truncated")
        unread -= size
        if unread < 0:  # an index of 12 bytes for each copy of a message of megabytes
            raise ValueError(f"the index names a message in the chunk at byte {position} more than once")
        yield Record(topic, time, data)


def _open(path: Path) -> Any:
    rosbag1 = _rosbag1()
    if not path.is_file():
        raise BagError(f"{path}: there is no such file")
    try:
        reader = _index_reader(rosbag1)(path)
        reader.path = _BagPath(path)
        reader.open()
        reader.bio.end_opening()
    except Exception as error:  # broken bags raise whatever their bytes lead to
        why = reason(error)
        if "index looks damaged" in why:  # as rosbags says of a recording that was cut off
            why = "its index is missing or damaged: repair it with 'rosbag reindex'"
        raise BagError(f"{path} is not a complete ROS 1 bag: {why}") from error
    return reader


class _BagFile(io.BufferedReader):
    """A file in which lengths that come from itself are compared with its size.

    While the index is read, no more bytes are read than the file has: an index whose entries name the same bytes
    again and again would take time and memory that grow with the square of its size.
    """

    def __init__(self, path: Path):
        super().__init__(io.FileIO(str(path)))
        self._size = os.fstat(self.fileno()).st_size
        self._unread: float = self._size + io.DEFAULT_BUFFER_SIZE

    def end_opening(self) -> None:
        """Let all bytes be read as often as is needed."""
        self._unread = float("inf")

    def read(self, size: Optional[int] = -1) -> bytes:
        """Read what there is, at most a number of bytes, without memory for more."""
        if size is None or size < 0 or size > io.DEFAULT_BUFFER_SIZE:
            rest = max(0, self._size - self.tell())
            size = rest if size is None or size < 0 else min(size, rest)
        self._unread -= size
        if self._unread < 0:
            raise ValueError("its index names the same bytes again and again")
        return super().read(size)

    def readline(self, size: Optional[int] = -1) -> bytes:
        """Read the first line, which says that this is a bag."""
        return super().readline(_MAX_FIRST_LINE_BYTES)


class _BagPath:
    """The path of a bag, which `rosbags` opens."""

    def __init__(self, path: Path):
        self._path = path

    def open(self, mode: str) -> BinaryIO:
        """Open the file for reading."""
        return _BagFile(self._path)


def _index_reader(rosbag1: Any) -> Any:
    """Return a reader of ``rosbags`` that knows sizes of chunks, and refuses connections and chunks that repeat."""
    from rosbags.rosbag1.reader import Header, RecordType  # noqa: PLC0415 - an optional package

    class IndexReader(rosbag1.Reader):  # type: ignore[misc]
        """A reader of the index of a bag."""

        def __init__(self, path: Path):
            super().__init__(path)
            self._ids: Set[int] = set()
            self._records: List[Tuple[int, int]] = []

        def read_connection(self) -> Any:
            connection = super().read_connection()
            if connection.id in self._ids:
                raise ValueError(f"connection {connection.id} is there twice")
            self._ids.add(connection.id)
            return connection

        def read_chunk(self) -> Chunk:
            position = self.bio.tell()
            header = Header.read(self.bio, RecordType.CHUNK)
            (packed_size,) = _SIZE.unpack(self.bio.read(_SIZE.size))
            data = self.bio.tell()
            self.bio.seek(packed_size, os.SEEK_CUR)
            self._records.append((position, data + packed_size))
            return Chunk(data, packed_size, header.get_uint32("size"), header.get_string("compression"))

        def open(self) -> None:
            super().open()
            self._records.sort()
            for (_, end), (position, _) in zip(self._records, self._records[1:]):
                if position < end:
                    raise ValueError(f"the chunk at byte {position} is inside another one")

    return IndexReader


def _topic(connection: Any) -> Topic:
    """Return a connection in ROS's own terms; versions of ``rosbags`` differ in where the text is."""
    text = connection.msgdef
    return Topic(
        connection.topic,
        connection.msgtype.replace("/msg/", "/"),
        text if isinstance(text, str) else text.data,
        connection.digest,
        connection.msgcount,
        bool(connection.ext.latching),
        connection.ext.callerid or "",
    )
