"""Connections and messages of the files of ROS 2 bags, and their merge by time.

`sqlite_file` and `mcap_file` read one file each; `rosbag2` combines the files of a bag. `merge_by_time` merges
sources (files of a bag, chunks of a file) with a heap of the sources that overlap at the current time, so that memory
does not depend on the length of the bag.
"""

from heapq import heappop, heappush
from typing import Any, Callable, Iterable, Iterator, List, NamedTuple, Tuple, TypeVar

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


MAX_TIME = (1 << 64) - 1
"""Maximum time of a message, in nanoseconds."""

_Timed = TypeVar("_Timed", bound=Tuple[Any, int, bytes])
"""A tuple whose second item is a time: `Message` or `rosbag1.Record`."""


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
