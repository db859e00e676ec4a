"""Several bags as one, and a part of that: what came when, in the order of receipt.

Where bags are and where results go: files, folders with bags below them, and URLs as ``s3://``.

URLs are the work of the Python package ``fsspec`` and of what it needs for their kind (``s3fs``).
"""

import os
import shutil
from contextlib import ExitStack, contextmanager
from heapq import merge
from operator import attrgetter
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)
from uuid import uuid4

from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import SECOND
from .decompression import MAX_CHUNK_MEGABYTES, copy_up_to, reason
from .rosbag1 import BagError, BagReader, PathLike, Record, Topic
from .rosbag2 import METADATA, SUFFIXES, Ros2BagReader

OneBag = Union[BagReader, Ros2BagReader]

Bag = Union[OneBag, "MergedBag"]
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


class MergedBag:
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

    def __enter__(self) -> "MergedBag":
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


_KINDS = (".bag", *SUFFIXES)
_PART = ".part"
"""What a result ends in, and begins with a dot, until it is complete."""


class FoundBag(NamedTuple):
    """A bag that is there to be played.

    Attributes:
        place: its path, or its URL.
        name: what its result is called: its name without the ending, below the folder that was given.
    """

    place: str
    name: str


def is_url(place: str) -> bool:
    """Tell whether a place is a URL, and not a path."""
    kind, mark, _ = place.partition("://")
    return bool(kind and mark) and "/" not in kind


def find_bags(places: Sequence[str]) -> List[FoundBag]:
    """Return the bags that places name: bags in the order given, those below a folder in the order of their names.

    Raises:
        BagError: where there is none below a folder, or a URL cannot be looked at. A path that is not there is
            found out when it is played.
    """
    found: List[FoundBag] = []
    for place in places:
        inside = _names_below(place)
        if inside is None:
            found.append(FoundBag(place, _without_kind(PurePosixPath(place.rstrip("/")).name)))
            continue
        bags = _bags_of(inside)
        if not bags:
            raise BagError(
                f"{place} has no bags below it: no {METADATA}, nothing that ends in {', '.join(_KINDS)}"
            )
        found += [FoundBag(f"{place.rstrip('/')}/{name}", _without_kind(name)) for name in bags]
    return found


def in_parts(bags: Iterable[FoundBag]) -> List[List[FoundBag]]:
    """Return bags as recordings: what ``rosbag record --split`` has written in parts as one, each other bag as one.

    Parts are called ``NAME_0.bag``, ``NAME_1.bag``, or ``NAME_DATE_0.bag`` with the date at which each begins; they
    are of one folder, and none is missing between them. A recording stands where its first part stood.
    """
    named: Dict[Tuple[str, str], List[Tuple[str, int, int, FoundBag]]] = {}
    for place, bag in enumerate(bags):
        base, date, number = _part_of(bag.name)
        key = (os.path.dirname(bag.place), base if number >= 0 else bag.place)
        named.setdefault(key, []).append((date, number, place, bag))
    found: List[Tuple[int, List[FoundBag]]] = []
    for parts in named.values():
        before = None
        for _, number, place, bag in sorted(parts):
            if before is None or number != before + 1:
                found.append((place, [bag]))
            else:
                found[-1][1].append(bag)
            before = number
    return [recording for _, recording in sorted(found)]


def _part_of(name: str) -> Tuple[str, str, int]:
    """Return what a part's recording is called, the part's date, and its number; -1 where it has none."""
    base, mark, number = PurePosixPath(name).name.rpartition("_")
    if not (mark and number.isdecimal() and len(number) < 10):
        return name, "", -1
    rest, _, date = base.rpartition("_")
    if len(date) == len("2014-10-19-19-50-06") and date.replace("-", "").isdecimal() and date.count("-") == 5:
        return rest, date, int(number)
    return base, "", int(number)


def is_folder_of_bags(place: str) -> bool:
    """Tell whether a path is a folder that is no bag itself."""
    return os.path.isdir(place) and not os.path.exists(os.path.join(place, METADATA))


def is_there(place: str) -> bool:
    """Tell whether a place has something already."""
    if not is_url(place):
        return os.path.lexists(place)
    files, path = _filesystem(place)
    return bool(_asked(place, files.exists, path))


@contextmanager
def fetched(place: str, scratch: str) -> Iterator[str]:
    """Give the path of a bag; that of a URL is fetched for as long as it is used.

    Args:
        place: a path or a URL.
        scratch: a folder to fetch it into.

    Raises:
        BagError: where it cannot be fetched.
    """
    if not is_url(place):
        yield place
        return
    files, path = _filesystem(place)
    with TemporaryDirectory(dir=scratch) as folder:
        local = str(Path(folder) / PurePosixPath(path).name)
        _asked(place, _fetch, files, path, local)
        yield local


def _fetch(files: Any, path: str, local: str) -> None:
    """Copy a file or a folder, each file up to the size that is stated for it, and half of the free disk space."""
    names = files.find(path) if files.isdir(path) else [path]
    for name in names:
        inside = PurePosixPath(name).relative_to(path)
        if ".." in inside.parts:
            raise ValueError(f"'{name}' is outside of the folder")
        target = Path(local) / inside
        target.parent.mkdir(parents=True, exist_ok=True)
        stated, free = files.size(name), shutil.disk_usage(target.parent).free // 2
        allowed = free if stated is None else min(stated, free)
        with files.open(name, "rb") as source, target.open("wb") as file:
            if copy_up_to(source, file, allowed) > allowed:
                raise ValueError(
                    f"'{name}' has more than {allowed} bytes, as stated or as half of the disk has"
                )


@contextmanager
def result_file(target: str, scratch: str) -> Iterator[str]:
    """Give a path to write to: when all has gone well, what is there becomes the target, all at once.

    Args:
        target: a path or a URL; folders are made as needed.
        scratch: a folder to write in where the target is a URL.

    Raises:
        BagError: where it cannot be written.
    """
    if is_url(target):
        files, path = _filesystem(target)
        with TemporaryDirectory(dir=scratch) as folder:
            local = str(Path(folder) / PurePosixPath(path).name)
            yield local
            _asked(target, files.makedirs, str(PurePosixPath(path).parent), exist_ok=True)
            _asked(target, files.put_file, local, path)
        return
    folder, name = os.path.split(target)
    part = os.path.join(folder, f".{name}.{uuid4().hex}{_PART}")
    _written(target, os.makedirs, folder or ".", exist_ok=True)
    try:
        yield part
        _written(target, os.replace, part, target)
    finally:
        if os.path.exists(part):
            os.unlink(part)


def remove_parts(targets: Iterable[str]) -> None:
    """Remove what workers that have died left of their results."""
    names = {os.path.split(target) for target in targets if not is_url(target)}
    for folder in {folder for folder, _ in names}:
        for path in Path(folder).glob(f".*{_PART}"):
            if (folder, path.name[1 : -len(_PART)].rpartition(".")[0]) in names:
                path.unlink()


def _written(target: str, do: Callable[..., object], *arguments: str, **options: bool) -> None:
    try:
        do(*arguments, **options)
    except OSError as error:
        raise BagError(f"{target} cannot be written: {reason(error)}") from error


def _without_kind(name: str) -> str:
    kind = max((kind for kind in _KINDS if name.endswith(kind)), key=len, default="")
    return name[: len(name) - len(kind)]


def _names_below(place: str) -> Optional[List[str]]:
    """Return the names of all files below a folder, relative to it; None where it is none, or is a bag itself."""
    if not is_url(place):
        if not is_folder_of_bags(place):
            return None
        return [path.relative_to(place).as_posix() for path in Path(place).rglob("*")]
    files, path = _filesystem(place)
    if not _asked(place, files.isdir, path) or _asked(place, files.exists, f"{path.rstrip('/')}/{METADATA}"):
        return None
    return [PurePosixPath(one).relative_to(path).as_posix() for one in _asked(place, files.find, path)]


def _bags_of(names: Iterable[str]) -> List[str]:
    """Return which of the names below a folder are bags, in their order; what begins with a dot is left out."""
    paths = [path for path in map(PurePosixPath, names) if not any(part[0] == "." for part in path.parts)]
    folders = {path.parent for path in paths if path.name == METADATA}
    files = {path for path in paths if path.name.endswith(_KINDS) and path.parent not in folders}
    return [path.as_posix() for path in sorted(folders | files, key=lambda path: path.parts)]


def _filesystem(url: str) -> Tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 - an optional package
    except ImportError:
        raise BagError(
            f"{url}: URLs need the Python package fsspec (pip install fsspec, and s3fs for s3://)"
        ) from None
    files, path = _asked(url, url_to_fs, url)
    return files, str(path)


def _asked(url: str, ask: Any, *arguments: Any, **options: Any) -> Any:
    """Return what a file system answers; it is another package's, which raises whatever it likes."""
    try:
        return ask(*arguments, **options)
    except Exception as error:
        raise BagError(f"{url}: {reason(error)}") from error
