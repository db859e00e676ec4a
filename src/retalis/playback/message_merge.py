"""Merge by time of the messages of several sources: files of a bag, or chunks of a file.

`merge_by_time` merges sources with a heap of the sources that overlap at the current time, so that memory does not
depend on the length of the bag. `list_chunk_sources` makes sources of the chunks of a file, and limits the number of
bytes of the chunks that overlap.
"""

from functools import partial
from heapq import heappop, heappush
from typing import Any, Callable, Iterable, Iterator, List, Tuple, TypeVar

from ..foundation.interrupts import check_interrupt
from .decompression import ChunkLimit

Message = Tuple[int, int, bytes]
"""A message: number of its connection, time in nanoseconds, and bytes."""

MAX_TIME = (1 << 64) - 1
"""Maximum time of a message, in nanoseconds."""

_Timed = TypeVar("_Timed", bound=Tuple[Any, int, bytes])
"""A tuple whose second item is a time: `Message` or `rosbag1.Record`."""

_AnyChunk = TypeVar("_AnyChunk")


def merge_by_time(sources: Iterable[Tuple[int, Callable[[], Iterator[_Timed]]]]) -> Iterator[_Timed]:
    """Yield the messages of sources in order of time; messages with equal times in the order of the sources.

    A source is read from its first time on, so only sources that overlap in time are in memory at once.

    Args:
        sources: the time of the first message of each source, and the function that begins to read its messages in
            order of time; sorted by that time.
    """
    # Time and source of the next message of a source, this message, and the messages after it.
    heap: List[Tuple[int, int, _Timed, Iterator[_Timed]]] = []
    for number, (start, read) in enumerate(sources):
        # Messages up to the start of this source are final. Sources that end by then free their memory.
        yield from _pop_until(heap, start)
        messages = read()
        message = next(messages, None)
        if message is not None:
            heappush(heap, (message[1], number, message, messages))
    yield from _pop_until(heap, MAX_TIME)


def _pop_until(heap: List[Tuple[int, int, _Timed, Iterator[_Timed]]], limit: int) -> Iterator[_Timed]:
    """Yield the messages up to a time, and leave the next message of each source in the heap."""
    while heap and heap[0][0] <= limit:
        _, number, message, messages = heappop(heap)
        yield message
        # The heap is only needed where sources alternate: a source continues up to the next message of another one.
        bound = heap[0][0] if heap and heap[0][0] < limit else limit
        for message in messages:
            if message[1] >= bound:
                heappush(heap, (message[1], number, message, messages))
                break
            yield message


def list_chunk_sources(
    chunks: Iterable[Tuple[int, _AnyChunk]],
    unpack: Callable[[_AnyChunk], bytes],
    read: Callable[[bytes], Iterator[Message]],
    limit: ChunkLimit,
) -> List[Tuple[int, Callable[[], Iterator[Message]]]]:
    """Return the chunks of a file as sources for `merge_by_time`.

    Args:
        chunks: the time of the first message of each chunk, and the chunk; sorted by that time.
        unpack: returns the content of a chunk.
        read: yields the messages of such a content in order of time.
        limit: maximum number of bytes of the contents that are in memory at once.
    """
    bytes_in_memory = 0

    def read_chunk(chunk: _AnyChunk) -> Iterator[Message]:
        nonlocal bytes_in_memory
        check_interrupt()
        data = unpack(chunk)
        bytes_in_memory += len(data)
        limit.check(bytes_in_memory, "chunks that overlap in time have")
        yield from read(data)
        bytes_in_memory -= len(data)

    return [(start, partial(read_chunk, chunk)) for start, chunk in chunks]
