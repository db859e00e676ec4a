"""Reading and writing of ROS 1 bags (rosbag format 2.0), message by message as raw bytes.

The package ``rosbags`` parses the index. Chunks and messages are read here, which is three times as fast and safe for
malformed files: sizes that a file states are compared with its real size, and a chunk is never read more often than a
factor of the file's size allows, however its index refers to it.

Messages of different chunks may alternate in time. Chunks are read in the order in which the messages, sorted by
time, need them. A chunk that is needed again later is kept in memory if the kept chunks fit into the limit of one
chunk; otherwise it is read again. Chunks that are compressed with bz2, which dominates the reading time, are
decompressed ahead by threads; `bz2` releases the GIL.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

import io
import logging
import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib import import_module
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from struct import Struct
from types import TracebackType
from typing import (
    Any,
    BinaryIO,
    Callable,
    ClassVar,
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
    Type,
    TypeVar,
    Union,
)

from ..foundation.errors import RetalisError
from ..foundation.interrupts import check_interrupt
from ..foundation.output_files import replace_file
from ..foundation.ros_name_checks import strip_slashes
from ..messages.type_definition import Definition, SerializationFormat
from ..prolog.terms.timestamps import SECOND
from .decompression import MAX_CHUNK_MEGABYTES, ChunkLimit, describe_error, unpack
from .incomplete_files import INCOMPLETE_STATUS, IncompleteFile
from .unindexed_bag import UnindexedBag, UnindexedConnection, find_index_problem

log = logging.getLogger("retalis")

MAX_CHUNKS_AHEAD = 3
"""Number of chunks that are decompressed before they are needed."""

_MAX_AHEAD_BYTES = 16 << 20
"""Larger chunks are not decompressed ahead."""

MAX_REPEATS = 8
"""Average number of times that a chunk may be read again because messages of several chunks alternate in time."""


class Chunk(NamedTuple):
    """Location of a chunk in a bag.

    Attributes:
        position: offset of its data.
        packed_size: size in the file in bytes.
        size: size after decompression in bytes, as its header states.
        compression: ``none``, ``bz2`` or ``lz4``.
    """

    position: int
    packed_size: int
    size: int
    compression: str


def read_chunks(
    file: BinaryIO, chunks_by_position: Mapping[int, Chunk], positions: Iterable[int], limit: ChunkLimit
) -> Generator[bytes, None, None]:
    """Yield the contents of chunks; consecutive requests for the same chunk yield it once.

    Args:
        file: the bag.
        chunks_by_position: locations of the chunks by their position.
        positions: positions of the chunks in the order of the messages that need them.
        limit: maximum size of a chunk.

    Raises:
        ValueError: if a chunk does not have the size that it states, or exceeds the limit, when it is next; or if
            chunks have to be read again too often.
        Exception: any other error that the bytes of a malformed bag lead to.
    """
    order = [position for position, _ in groupby(positions)]
    reader = _ChunkReader(file, chunks_by_position, limit, order)
    # One core remains for the engine. More threads do not help, because the messages are processed serially.
    thread_count = min(2, (os.cpu_count() or 1) - 1)
    if thread_count and any(map(reader.is_slow, order)):
        with ThreadPoolExecutor(thread_count, "chunks of a bag") as pool:
            yield from reader.read_ahead(pool.submit)
        return
    for index in range(len(order)):
        yield reader.start_reading(index, _call_at_once).result()


_Submit = Callable[..., "Future[bytes]"]
"""Function that executes another one, at once or in a thread."""


class _ChunkReader:
    """Reader of chunks in a known order."""

    def __init__(
        self,
        file: BinaryIO,
        chunks_by_position: Mapping[int, Chunk],
        limit: ChunkLimit,
        position_order: List[int],
    ):
        self._file = file
        self._chunks_by_position = chunks_by_position
        self._limit = limit
        self._position_order = position_order
        # A chunk whose last use has passed is freed at once.
        self._last_use = {position: index for index, position in enumerate(position_order)}
        self._cached: Dict[int, Tuple[int, Future[bytes]]] = {}
        """Size and content of the chunks that are needed again, by position."""
        self._cached_bytes = 0
        self._read_positions: Set[int] = set()
        self._rereadable_bytes = MAX_REPEATS * sum(
            chunks_by_position[position].size for position in self._last_use if position in chunks_by_position
        )

    def is_slow(self, position: int) -> bool:
        """Return whether a chunk takes long to decompress, and is small enough to be decompressed ahead."""
        chunk = self._chunks_by_position.get(position)
        return chunk is not None and chunk.compression == "bz2" and chunk.size <= _MAX_AHEAD_BYTES

    def read_ahead(self, submit: _Submit) -> Iterator[bytes]:
        """Yield the contents of all chunks, while the next ones are decompressed."""
        pending: Deque[Future[bytes]] = deque()
        for index, position in enumerate(self._position_order):
            check_interrupt()
            if self.is_slow(position):
                pending.append(self.start_reading(index, submit))
                if len(pending) > MAX_CHUNKS_AHEAD:
                    yield pending.popleft().result()
                continue
            # Chunks are yielded in order, so the pending ones come first.
            while pending:
                yield pending.popleft().result()
            yield self.start_reading(index, _call_at_once).result()
        while pending:
            yield pending.popleft().result()

    def start_reading(self, index: int, submit: _Submit) -> "Future[bytes]":
        """Return a future of the contents of a chunk, given by its index in the order, or of the error."""
        position = self._position_order[index]
        if position in self._cached:
            _, content = self._cached[position]
        else:
            try:
                chunk, packed = self._read_packed(position)
            # The error is raised when this chunk is next: the chunks before it are still read.
            except (OSError, ValueError) as error:
                return _call_at_once(_raise_error, error)
            # The file is read here and only decompressed elsewhere, since all threads share its position.
            content = submit(_unpack, chunk, packed, position)
            # Kept until its last use, within the limit for one chunk, so that memory does not depend on the index.
            if index < self._last_use[position] and self._cached_bytes + chunk.size <= self._limit.bytes:
                self._cached[position] = chunk.size, content
                self._cached_bytes += chunk.size
        if index == self._last_use[position] and position in self._cached:
            size, _ = self._cached.pop(position)
            self._cached_bytes -= size
        return content

    def _read_packed(self, position: int) -> Tuple[Chunk, bytes]:
        """Return a chunk and its content as it is in the file."""
        chunk = self._chunks_by_position.get(position)
        if chunk is None:
            raise ValueError(f"the index names a chunk at byte {position}: there is none")
        # Compared before anything is read: the stated size is what decompression may allocate.
        self._limit.check(chunk.size, f"the chunk at byte {position} states")
        if position in self._read_positions:
            self._rereadable_bytes -= chunk.size
            if self._rereadable_bytes < 0:
                raise ValueError(
                    "messages of large chunks alternate in time too often: expected chunks one after the other "
                    "(a larger --max-chunk-megabytes holds several)"
                )
        self._read_positions.add(position)
        self._file.seek(chunk.position)
        return chunk, self._file.read(chunk.packed_size)


def _call_at_once(function: Callable[..., bytes], *arguments: object) -> "Future[bytes]":
    """Call a function in this thread; return its result or error as a future."""
    future: Future[bytes] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:  # raised when the result is requested, as for a thread
        future.set_exception(error)
    return future


def _raise_error(error: Exception) -> bytes:
    raise error


def _unpack(chunk: Chunk, packed: bytes, position: int) -> bytes:
    try:
        return unpack(chunk.compression, packed, chunk.size)
    except Exception as error:  # any exception of the decompression library
        raise ValueError(f"the chunk at byte {position}: {describe_error(error)}") from error


_SIZE_STRUCT = Struct("<I")
_MAX_FIRST_LINE_BYTES = 64
"""Maximum length of the first line of a bag; a valid one has 13 bytes."""

_MESSAGE_FIELD, _CONNECTION_FIELD = (b"\x04\x00\x00\x00op=" + bytes([code]) for code in (2, 7))
"""Field of a record's header that states the type of the record."""

PathLike = Union[str, Path]


_MessageEntry = Tuple[int, int, int, "Topic"]
"""Location of a message: time, position of its chunk, offset in the chunk, and connection."""


class BagError(RetalisError):
    """A bag that cannot be read or written.

    >>> try:
    ...     BagReader(folder / "none.bag")
    ... except BagError as error:
    ...     print(str(error).endswith("there is no such file"))
    True
    """


class IncompleteBagError(BagError):
    """A bag, a part of whose messages cannot be read."""

    exit_status = INCOMPLETE_STATUS


class Topic(NamedTuple):
    """A connection of a bag: a topic of one publisher.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (topic,) = bag.topics
    >>> topic.name, topic.type, topic.messages
    ('/chatter', 'std_msgs/String', 1)

    Attributes:
        name: name of the topic.
        type: message type, ``pkg/Type``.
        definition: text of the type's definition, including nested types.
        md5sum: checksum of the type.
        messages: number of messages of this connection in the bag.
        latched: whether the publisher latched its last message.
        caller: name of the publishing node, if the bag contains it.
        format: serialization of the messages.
    """

    name: str
    type: str
    definition: str
    md5sum: str
    messages: int = 0
    latched: bool = False
    caller: str = ""
    format: SerializationFormat = SerializationFormat.ROS1


class UnreadableTopic(NamedTuple):
    """A topic of a bag whose messages cannot be read: its name, its type ``pkg/Type``, and the reason."""

    name: str
    type: str
    problem: str


class Record(NamedTuple):
    """A message of a bag: its topic, the time of its receipt in nanoseconds, and its bytes in the topic's format.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (record,) = bag.records()
    >>> record.topic.name, record.time, record.data[4:]
    ('/chatter', 1000000000, b'hello')
    """

    topic: Topic
    time: int
    data: bytes


class BagReader:
    """A ROS 1 bag opened for reading; a context manager.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     for topic, time, data in bag.records(["chatter"]):
    ...         print(topic.name, topic.type, time, data[4:])
    /chatter std_msgs/String 1000000000 b'hello'

    Args:
        path: path of the file.
        max_chunk_megabytes: maximum size of a chunk after decompression.
        strict: whether an incomplete bag is an error. By default, it is read up to the break, with a warning.

    Attributes:
        path: path of the file.
        topics: connections; a topic with several publishers has several connections.
        start, end: times of the first and the last message in nanoseconds; 0 for an empty bag.
        messages: number of messages.
        unreadable: topics that cannot be read, which ``topics`` does not contain.
        incomplete_files: what is missing if a crash has cut the bag; empty for a complete one.

    Raises:
        BagError: if the file is missing or is not a ROS 1 bag.
    """

    unreadable: Tuple[UnreadableTopic, ...] = ()
    incomplete_files: Tuple[IncompleteFile, ...] = ()

    def __init__(self, path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES, strict: bool = False):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        self._reader = _open_reader(self.path, self._limit)
        self._is_indexed = not isinstance(self._reader, UnindexedBag)
        create_topic = _create_topic if self._is_indexed else _create_unindexed_topic
        self._topics: Dict[int, Topic] = {
            connection.id: create_topic(connection) for connection in self._reader.connections
        }
        self.topics: Tuple[Topic, ...] = tuple(self._topics.values())
        self.messages: int = sum(topic.messages for topic in self.topics)
        self.start: int = self._reader.start_time if self.messages else 0
        self.end: int = self._reader.end_time - 1 if self.messages else 0
        if not self._is_indexed:
            self.incomplete_files = (self._reader.incomplete_file,)
            # Nothing else closes the file if the bag is refused.
            with ExitStack() as stack:
                stack.callback(self._reader.close)
                report_incomplete_files(self.incomplete_files, strict)
                stack.pop_all()

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
            topics: names of the topics, with or without leading ``/``; all by default.
            start: skip messages before this time, in nanoseconds.
            stop: skip messages at or after this time, in nanoseconds.

        Raises:
            BagError: if the bag is malformed.
        """
        connections = list(self._reader.connections)
        if topics is not None:
            wanted = {strip_slashes(name) for name in topics}
            connections = [
                connection for connection in connections if strip_slashes(connection.topic) in wanted
            ]
        if not connections:
            return
        try:
            if not self._is_indexed:
                for identifier, time, data in self._reader.read(
                    [connection.id for connection in connections], start, stop
                ):
                    yield Record(self._topics[identifier], time, data)
                return
            entries = self._find_entries(connections, start, stop)
            positions = [position for _, position, _, _ in entries]
            with closing(
                read_chunks(self._reader.bio, self._reader.chunks, positions, self._limit)
            ) as contents:
                yield from _read_messages(entries, contents)
        except Exception as error:  # malformed bags raise arbitrary exceptions
            raise BagError(f"{self.path}: the bag is broken: {describe_error(error)}") from error

    def _find_entries(
        self, connections: List[Any], start: Optional[int], stop: Optional[int]
    ) -> List[_MessageEntry]:
        """Return the locations of messages sorted by time, from the index that ``rosbags`` has read."""
        entries = [
            (entry.time, entry.chunk_pos, entry.offset, self._topics[connection.id])
            for connection in connections
            for entry in self._reader.indexes[connection.id]
            if (start is None or start <= entry.time) and (stop is None or entry.time < stop)
        ]
        # `sort` is stable, so that messages with equal times keep the order of their connections.
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


class NewBag:
    """A bag file that is being written; a context manager.

    The file is written beside its path, and renamed by `close`. If the block of the context manager raises an
    exception, it is discarded, and the path stays as it was.

    Args:
        overwrite: whether an existing file may be replaced.

    Raises:
        BagError: if the file exists already, or cannot be written.
    """

    _MAX_TIME: ClassVar[int]
    """Last time that a message can have, in nanoseconds; the first is 0."""

    def __init__(self, path: PathLike, overwrite: bool = False):
        self.path = Path(path)
        # A folder is never replaced.
        if self.path.exists() and not (overwrite and self.path.is_file()):
            raise BagError(f"{self.path} already exists")
        self._stack = ExitStack()
        self._is_open = True
        with self._discarding_on_error():
            self._start(self._stack.enter_context(replace_file(self.path)))

    def _start(self, path: Path) -> None:
        """Create the file."""
        raise NotImplementedError

    def _finish(self) -> None:
        """Write the index, and close the file."""
        raise NotImplementedError

    def _close_file(self) -> None:
        """Close the file, if it was created, without writing the index."""
        raise NotImplementedError

    @contextmanager
    def _discarding_on_error(self) -> Iterator[None]:
        """Discard the file after any exception; raise a `BagError` for one of the file system."""
        try:
            yield
        except BaseException as error:
            self._discard(error)
            if isinstance(error, OSError):
                raise BagError(f"{self.path} cannot be written: {describe_error(error)}") from error
            raise

    def _check_time(self, time: int) -> None:
        """Reject a time that a message cannot have.

        Raises:
            BagError: if it is such a time.
        """
        if not 0 <= time <= self._MAX_TIME:
            raise BagError(
                f"{self.path} cannot be written: expected a time from 0 to {self._MAX_TIME} ns, found {time} ns"
            )

    def _discard(self, error: BaseException) -> None:
        """Close and remove the file; the target stays as it was."""
        self._is_open = False
        # Closing writes the buffer, which may fail, and closes the file nevertheless.
        with suppress(OSError):
            self._close_file()
        # The context manager of the file raises the exception that it is given.
        with suppress(type(error)):
            self._stack.__exit__(type(error), error, error.__traceback__)

    def close(self) -> None:
        """Write the index, and give the file its name; further calls have no effect.

        >>> bag = BagWriter(folder / "silence.bag")
        >>> bag.close()

        Raises:
            BagError: if the file cannot be written.
        """
        if self._is_open:
            with self._discarding_on_error():
                self._finish()
                self._stack.close()
            self._is_open = False

    def __enter__(self: "NewBagType") -> "NewBagType":
        return self

    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        if error is None:
            self.close()
        else:
            self._discard(error)


NewBagType = TypeVar("NewBagType", bound=NewBag)


class BagWriter(NewBag):
    """A new ROS 1 bag; a context manager. The bag is complete when it is closed.

    >>> with BagWriter(folder / "new.bag") as bag:
    ...     text = bag.add("/chatter", Definitions().find("std_msgs/String"))
    ...     bag.write(text, 1_000_000_000, bytes([2, 0, 0, 0]) + b"hi")
    >>> with BagReader(folder / "new.bag") as bag:
    ...     print(bag.messages)
    1

    Args:
        path: path of the file. It is written beside and renamed by `close`; if the block of the context manager
            raises an exception, it is discarded.
        overwrite: whether an existing file may be replaced.

    Raises:
        BagError: if the file exists already, or cannot be written.
    """

    _MAX_TIME = (1 << 32) * SECOND - 1

    def __init__(self, path: PathLike, overwrite: bool = False):
        self._writer_class = import_rosbags("rosbag1").Writer
        self._writer: Any = None
        super().__init__(path, overwrite)

    def _start(self, path: Path) -> None:
        self._writer = self._writer_class(path)
        self._writer.open()

    def _finish(self) -> None:
        self._writer.close()

    def _close_file(self) -> None:
        if self._writer is not None and self._writer.bio is not None:
            self._writer.bio.close()

    def add(self, topic: str, definition: Definition, latched: bool = False, caller: str = "") -> object:
        """Add a connection; return the argument for `write` that identifies it."""
        return self._writer.add_connection(
            topic,
            # `rosbags` uses the names of ROS 2 for all types.
            definition.name.replace("/", "/msg/"),
            msgdef=definition.full_text,
            md5sum=definition.md5sum,
            callerid=caller or None,
            latching=int(latched),
        )

    def write(self, connection: object, time: int, data: bytes) -> None:
        """Write a message, with the time of its receipt in nanoseconds.

        Raises:
            BagError: if the file cannot be written, as on a full disk, or the time is before 1970 or after 2106.
        """
        with self._discarding_on_error():
            self._check_time(time)
            self._writer.write(connection, time, data)


ROSBAGS_HINT = (
    "pip install rosbags in a virtual environment, or, in a clone after ./install.py build: "
    'source "$(./install.py where)"'
)
"""Ways to install rosbags, for an error. No distribution packages it."""


def import_rosbags(module: str) -> Any:
    """Return a module of rosbags.

    Raises:
        BagError: if rosbags, or a package that it needs, is not installed.
    """
    try:
        return import_module(f"rosbags.{module}")
    except ImportError as error:
        package = error.name or "rosbags"
        hint = ROSBAGS_HINT if package.startswith("rosbags") else f"pip install {package.partition('.')[0]}"
        raise BagError(f"reading and writing bags needs the Python package {package}: {hint}") from None


def report_incomplete_files(files: Iterable[IncompleteFile], strict: bool) -> None:
    """Log incomplete files as warnings.

    Raises:
        BagError: if there are any, and ``strict`` is true.
    """
    for file in files:
        if strict:
            raise BagError(str(file))
        log.warning("%s", file)


def _read_messages(entries: List[_MessageEntry], contents: Iterator[bytes]) -> Iterator[Record]:
    """Yield messages from the contents of chunks.

    `rosbags` parses all fields of a header and compares index entries in Python, which takes twice as long, and three
    times with limits around it.
    """
    unpack_size = _SIZE_STRUCT.unpack_from
    current_position, chunk, unclaimed_in_chunk = -1, b"", 0
    # Bytes of each chunk that no message has claimed. The sizes of messages with their headers must add up to the
    # size of the chunk at most: otherwise index entries of 12 bytes each could repeat a message of megabytes.
    unclaimed: Dict[int, int] = {}
    for time, position, start, topic in entries:
        # Consecutive messages of a chunk need no lookup.
        if position != current_position:
            unclaimed[current_position] = unclaimed_in_chunk
            current_position, chunk = position, next(contents)
            unclaimed_in_chunk = unclaimed.get(position, len(chunk))
        offset = start
        (size,) = unpack_size(chunk, offset)
        body_offset = offset + 4 + size
        # The index may point to a connection record that precedes the message.
        while chunk.find(_MESSAGE_FIELD, offset, body_offset) < 0:
            if chunk.find(_CONNECTION_FIELD, offset, body_offset) < 0:
                raise ValueError(f"the index of the chunk at byte {position} does not point to a message")
            offset = body_offset + 4 + unpack_size(chunk, body_offset)[0]
            body_offset = offset + 4 + unpack_size(chunk, offset)[0]
        (size,) = unpack_size(chunk, body_offset)
        end = body_offset + 4 + size
        data = chunk[body_offset + 4 : end]
        if len(data) != size:
            raise ValueError(f"a message in the chunk at byte {position} is truncated")
        unclaimed_in_chunk -= end - start
        if unclaimed_in_chunk < 0:
            raise ValueError(f"the index names a message in the chunk at byte {position} more than once")
        yield Record(topic, time, data)


def _open_reader(path: Path, limit: ChunkLimit) -> Any:
    """Return the reader of ``rosbags`` for a file, whose index it has read, or a reader that needs no index."""
    rosbag1 = import_rosbags("rosbag1")
    if not path.is_file():
        raise BagError(f"{path}: there is no such file")
    try:
        index_problem = find_index_problem(path)
        if index_problem is not None:
            return UnindexedBag(path, limit, index_problem)
        reader = _define_index_reader(rosbag1)(path)
        reader.path = _BagPath(path)
        reader.open()
        reader.bio.lift_read_limit()
    except Exception as error:  # malformed bags raise arbitrary exceptions
        problem = describe_error(error)
        if "index looks damaged" in problem:  # the error of rosbags for an index with wrong values
            problem = "its index is damaged: repair it with 'rosbag reindex'"
        raise BagError(f"{path} is not a complete ROS 1 bag: {problem}") from error
    return reader


class _BagFile(io.BufferedReader):
    """A file that compares lengths from its content with its size.

    While the index is read, no more bytes are read than the file has. Otherwise an index whose entries refer to the
    same bytes repeatedly would take time and memory quadratic in its size.
    """

    def __init__(self, path: Path):
        super().__init__(io.FileIO(str(path)))
        self._size = os.fstat(self.fileno()).st_size
        self._remaining_bytes: float = self._size + io.DEFAULT_BUFFER_SIZE

    def lift_read_limit(self) -> None:
        """Remove the limit on the total number of bytes that are read."""
        self._remaining_bytes = float("inf")

    def read(self, size: Optional[int] = -1) -> bytes:
        """Read at most ``size`` bytes; memory is allocated only for bytes that the file has."""
        if size is None or size < 0 or size > io.DEFAULT_BUFFER_SIZE:
            remaining = max(0, self._size - self.tell())
            size = remaining if size is None or size < 0 else min(size, remaining)
        self._remaining_bytes -= size
        if self._remaining_bytes < 0:
            raise ValueError("its index refers to the same bytes repeatedly")
        return super().read(size)

    def readline(self, size: Optional[int] = -1) -> bytes:
        """Read the first line, which identifies the format; its length is limited."""
        return super().readline(_MAX_FIRST_LINE_BYTES)


class _BagPath:
    """Path whose `open` returns a `_BagFile` to ``rosbags``."""

    def __init__(self, path: Path):
        self._path = path

    def __str__(self) -> str:
        return str(self._path)

    __repr__ = __str__

    def open(self, mode: str) -> BinaryIO:
        """Open the file for reading; ``mode`` is ignored."""
        return _BagFile(self._path)


def _define_index_reader(rosbag1: Any) -> Any:
    """Return a reader class of ``rosbags`` that locates chunks, and rejects repeated connections and chunks."""
    from rosbags.rosbag1.reader import Header, RecordType  # noqa: PLC0415 - an optional package

    class IndexReader(rosbag1.Reader):  # type: ignore[misc]
        """Reader of the index of a bag."""

        def __init__(self, path: Path):
            super().__init__(path)
            self._connection_ids: Set[int] = set()
            self._chunk_ranges: List[Tuple[int, int]] = []

        def read_connection(self) -> Any:
            connection = super().read_connection()
            # A second definition could change the type of messages that were assigned to the first one.
            if connection.id in self._connection_ids:
                raise ValueError(f"connection {connection.id} is defined twice")
            self._connection_ids.add(connection.id)
            return connection

        def read_chunk(self) -> Chunk:
            position = self.bio.tell()
            header = Header.read(self.bio, RecordType.CHUNK)
            (packed_size,) = _SIZE_STRUCT.unpack(self.bio.read(_SIZE_STRUCT.size))
            data_offset = self.bio.tell()
            self.bio.seek(packed_size, os.SEEK_CUR)
            self._chunk_ranges.append((position, data_offset + packed_size))
            return Chunk(
                data_offset, packed_size, header.get_uint32("size"), header.get_string("compression")
            )

        def open(self) -> None:
            super().open()
            # Overlapping chunks would allow a small file to contain the same messages many times.
            # The index may list chunks in any order.
            self._chunk_ranges.sort()
            for (_, end), (position, _) in zip(self._chunk_ranges, self._chunk_ranges[1:]):
                if position < end:
                    raise ValueError(f"the chunk at byte {position} is inside another one")

    return IndexReader


def _create_topic(connection: Any) -> Topic:
    """Return a connection with the names of ROS 1; the definition depends on the ``rosbags`` version."""
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


def _create_unindexed_topic(connection: UnindexedConnection) -> Topic:
    """Return a connection of a bag that is read without its index."""
    return Topic(
        connection.topic,
        connection.type,
        connection.definition,
        connection.md5sum,
        connection.messages,
        connection.is_latched,
        connection.caller,
    )
