"""The chunks of a bag, in the order in which its messages ask for them."""

import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import groupby
from typing import (
    BinaryIO,
    Callable,
    Deque,
    Dict,
    Generator,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Set,
    Tuple,
)

from .decompression import ChunkLimit, reason, unpack

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
