"""Several bags as one, and a part of that: what came when, in the order of receipt."""

from contextlib import ExitStack
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Collection, Dict, Iterator, List, Optional, Sequence, Tuple, Union

from ...foundation import UsageError
from ...prolog.terms import SECOND
from .bags import BagError, BagReader, PathLike, Record, Topic
from .decompression import MAX_CHUNK_MEGABYTES
from .ros2bags import SUFFIXES, Ros2BagReader

OneBag = Union[BagReader, Ros2BagReader]

Bag = Union[OneBag, "BagSeries"]
"""Whatever a program can be run over."""


def open_bag(path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES) -> OneBag:
    """Open a bag of ROS 1 (a file) or of ROS 2 (a folder, or a file that ends as one of `SUFFIXES`).

    Args:
        path: the bag.
        max_chunk_megabytes: the size of the largest chunk or compressed message that is unpacked. A compressed file
            may have a hundred times its own size unpacked, if that is more.

    Raises:
        BagError: where it cannot be read.
    """
    path = Path(path)
    is_of_ros2 = path.is_dir() or (path.is_file() and path.name.endswith(SUFFIXES))
    return (Ros2BagReader if is_of_ros2 else BagReader)(path, max_chunk_megabytes)


class BagSeries:
    """One or more bags, whose messages come in the order of their receipt; a context manager.

    >>> with BagSeries([folder / "talk.bag"], duration=5) as bags:
    ...     print([(record.topic.name, record.time) for record in bags.records()])
    [('/chatter', 1000000000)]

    Args:
        paths: bags of ROS 1 or of ROS 2.
        start: how many seconds after the first message of all to begin.
        duration: how many seconds to go on; by default up to the end.
        max_chunk_megabytes: as for `open_bag`.

    Attributes:
        path: what to call them in messages.
        topics: the connections of all.
        start, end: the times between which messages are given, in nanoseconds; 0 where there are none.

    Raises:
        BagError: where a bag cannot be read.
        UsageError: where one is given twice, or none of them has a message after ``start``.
    """

    def __init__(
        self,
        paths: Sequence[PathLike],
        start: float = 0.0,
        duration: Optional[float] = None,
        max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES,
    ):
        _refuse_twice(paths)
        with ExitStack() as stack:
            self._bags: List[OneBag] = []
            for path in paths:
                self._bags.append(open_bag(path, max_chunk_megabytes))
                stack.callback(self._bags[-1].close)
            self._part(start, duration)
            self._stack = stack.pop_all()
        self.path = ", ".join(str(bag.path) for bag in self._bags)
        self.topics: Tuple[Topic, ...] = tuple(topic for bag in self._bags for topic in bag.topics)

    def _part(self, start: float, duration: Optional[float]) -> None:
        there = [bag for bag in self._bags if bag.messages]
        first = min((bag.start for bag in there), default=0)
        last = max((bag.end for bag in there), default=0)
        self.start = first + round(start * SECOND)
        self._stop = None if duration is None else self.start + round(duration * SECOND)
        self.end = last if self._stop is None else min(last, self._stop)
        if start and self.start > last:
            seconds = (last - first) / SECOND
            raise UsageError(
                f"there is nothing {start:g} s after the first message: the last is at {seconds:g} s"
            )

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages of all bags, a part at most; see `BagReader.records`.

        Raises:
            BagError: where a bag turns out to be broken.
        """
        start = self.start if start is None else max(start, self.start)
        ends = [one for one in (stop, self._stop) if one is not None]
        streams = [bag.records(topics, start, min(ends, default=None)) for bag in self._bags]
        return streams[0] if len(streams) == 1 else iter(merge(*streams, key=attrgetter("time")))

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    def __enter__(self) -> "BagSeries":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def _refuse_twice(paths: Sequence[PathLike]) -> None:
    """Refuse a bag that is given twice: its messages would come twice."""
    seen: Dict[Path, PathLike] = {}
    for path in paths:
        real = Path(path).resolve()
        if real in seen:
            raise UsageError(f"{path} is given twice")
        seen[real] = path
    if not seen:
        raise BagError("there is no bag")
