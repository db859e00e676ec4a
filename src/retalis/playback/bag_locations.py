"""Locations of bags and results, and several bags merged into one.

Programs are run over files, over folders with bags below them, and over URLs such as ``s3://``. `find_bags` lists the
bags of such locations, `group_recordings` groups the files of a split recording, and `MergedBag` presents several
bags as one, whose messages are merged in the order of receipt.

URLs require the Python package ``fsspec`` and a file system implementation for their scheme (``s3fs``).
"""

import os
import shutil
from contextlib import ExitStack, contextmanager
from heapq import merge
from operator import attrgetter
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import (
    TYPE_CHECKING,
    Any,
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

from ..foundation.displayed_text import format_number
from ..foundation.errors import UsageError
from ..foundation.output_files import replace_file, target_name_of
from ..prolog.terms.timestamps import SECOND
from .decompression import MAX_CHUNK_MEGABYTES, copy_up_to, describe_error
from .rosbag1 import BagError, BagReader, PathLike, Record, Topic, UnreadableTopic
from .rosbag2 import METADATA, SUFFIXES, Ros2BagReader, is_ros2_bag

if TYPE_CHECKING:
    from .incomplete_files import IncompleteFile

SingleBag = Union[BagReader, Ros2BagReader]

Bag = Union[SingleBag, "MergedBag"]
"""Any bag that a program can be run over."""


def open_bag(
    path: PathLike,
    max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES,
    message_folders: Sequence[str] = (),
    strict: bool = False,
) -> SingleBag:
    """Open a bag of ROS 1 (a file) or of ROS 2 (a folder, or a file whose name ends with one of `SUFFIXES`).

    Args:
        path: path of the bag.
        max_chunk_megabytes: maximum size of a chunk or compressed message after decompression. A compressed file may
            have a hundred times its own size after decompression if that is more.
        message_folders: folders with the types that a bag of ROS 2 does not define; see `InstalledTypes`.
        strict: whether an incomplete bag is an error.

    Raises:
        BagError: if the bag cannot be read.
    """
    path = Path(path)
    if path.is_dir() or (path.is_file() and path.name.endswith(SUFFIXES)):
        return Ros2BagReader(path, max_chunk_megabytes, message_folders, strict)
    return BagReader(path, max_chunk_megabytes, strict)


class MergedBag:
    """One or more bags whose messages are merged in the order of receipt; a context manager.

    >>> with MergedBag([folder / "talk.bag"], duration=5) as bags:
    ...     print([(record.topic.name, record.time) for record in bags.records()])
    [('/chatter', 1000000000)]

    Args:
        paths: bags of ROS 1 or of ROS 2.
        start: seconds to skip after the first message of all bags.
        duration: seconds to read from there; up to the end by default.
        max_chunk_megabytes, message_folders, strict: as for `open_bag`.

    Attributes:
        path: description of the bags for messages.
        topics: connections of all bags.
        unreadable: topics of all bags that cannot be read.
        incomplete_files: what is missing in the bags that a crash has cut.
        start, end: times of the first and the last message that are read, in nanoseconds; 0 for empty bags.

    Raises:
        BagError: if a bag cannot be read.
        UsageError: if a bag is given twice, or no bag has a message after ``start``.
    """

    def __init__(
        self,
        paths: Sequence[PathLike],
        start: float = 0.0,
        duration: Optional[float] = None,
        max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES,
        message_folders: Sequence[str] = (),
        strict: bool = False,
    ):
        _reject_duplicates(paths)
        # The bags that are open already are closed if a later one cannot be opened.
        with ExitStack() as stack:
            self._bags: List[SingleBag] = []
            for path in paths:
                self._bags.append(open_bag(path, max_chunk_megabytes, message_folders, strict))
                stack.callback(self._bags[-1].close)
            self._select_interval(start, duration)
            self._stack = stack.pop_all()
        self.path = ", ".join(str(bag.path) for bag in self._bags)
        self.topics: Tuple[Topic, ...] = tuple(topic for bag in self._bags for topic in bag.topics)
        self.unreadable: Tuple[UnreadableTopic, ...] = tuple(
            topic for bag in self._bags for topic in bag.unreadable
        )
        self.incomplete_files: Tuple[IncompleteFile, ...] = tuple(
            file for bag in self._bags for file in bag.incomplete_files
        )

    def _select_interval(self, start: float, duration: Optional[float]) -> None:
        """Set the times between which messages are read."""
        non_empty_bags = [bag for bag in self._bags if bag.messages]
        first = min((bag.start for bag in non_empty_bags), default=0)
        last = max((bag.end for bag in non_empty_bags), default=0)
        self.start = first + round(start * SECOND)
        self._stop = None if duration is None else self.start + round(duration * SECOND)
        self.end = last if self._stop is None else min(last, self._stop)
        if start and self.start > last:
            seconds = (last - first) / SECOND
            raise UsageError(
                f"there is nothing {format_number(start)} s after the first message: "
                f"the last is at {format_number(seconds)} s"
            )

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages of all bags in the order of receipt; see `BagReader.records`.

        Raises:
            BagError: if a bag is malformed.
        """
        start = self.start if start is None else max(start, self.start)
        ends = [end for end in (stop, self._stop) if end is not None]
        # Each bag is filtered by itself, by its index if it has one, before the streams are merged.
        streams = [bag.records(topics, start, min(ends, default=None)) for bag in self._bags]
        return streams[0] if len(streams) == 1 else iter(merge(*streams, key=attrgetter("time")))

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    def __enter__(self) -> "MergedBag":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def _reject_duplicates(paths: Sequence[PathLike]) -> None:
    """Raise an error if a bag is given twice, because its messages would be processed twice."""
    seen: Dict[Path, PathLike] = {}
    for path in paths:
        # Symbolic links and relative paths must not hide that two paths are one bag.
        resolved = Path(path).resolve()
        if resolved in seen:
            raise UsageError(f"{path} is given twice")
        seen[resolved] = path
    if not seen:
        raise BagError("no bag is given: expected at least one")


BAG_SUFFIXES = (".bag", ".bag.active", *SUFFIXES)
"""Suffixes of the files of bags. A recorder of ROS 1 that was killed leaves a file ``.bag.active``."""


class BagLocation(NamedTuple):
    """A bag that was found.

    Attributes:
        location: path or URL.
        name: name of its result: the name of the bag without its suffix, relative to the folder that was searched.
    """

    location: str
    name: str


def is_url(location: str) -> bool:
    """Return whether a location is a URL rather than a path."""
    scheme, separator, _ = location.partition("://")
    return bool(scheme and separator) and "/" not in scheme


def find_bags(locations: Sequence[str]) -> List[BagLocation]:
    """Return the bags at the given locations, in the given order, and sorted by name below a folder.

    Raises:
        BagError: if there is no bag below a folder, or a URL cannot be accessed. A missing path is reported when it
            is played.
    """
    bags: List[BagLocation] = []
    for location in locations:
        names_below = _list_names_below(location)
        if names_below is None:
            bags.append(BagLocation(location, _strip_suffix(PurePosixPath(location.rstrip("/")).name)))
            continue
        names = _select_bag_names(names_below)
        if not names:
            raise BagError(
                f"{location} has no bags below it: no {METADATA}, nothing that ends in {', '.join(BAG_SUFFIXES)}"
            )
        bags += [BagLocation(f"{location.rstrip('/')}/{name}", _strip_suffix(name)) for name in names]
    return bags


def group_recordings(bags: Iterable[BagLocation]) -> List[List[BagLocation]]:
    """Group the files of split recordings; every other bag forms a group of its own.

    ``rosbag record --split`` names the files ``NAME_0.bag``, ``NAME_1.bag``, or ``NAME_DATE_0.bag`` with the date at
    which each begins. A group consists of files of one folder with consecutive numbers. It is listed at the position
    of its first file.
    """
    parts_by_name: Dict[Tuple[str, str], List[Tuple[str, int, int, BagLocation]]] = {}
    for position, bag in enumerate(bags):
        base, date, number = _parse_part_name(bag.name)
        key = (os.path.dirname(bag.location), base if number >= 0 else bag.location)
        parts_by_name.setdefault(key, []).append((date, number, position, bag))
    groups: List[Tuple[int, List[BagLocation]]] = []
    for parts in parts_by_name.values():
        previous = None
        # Sorted by date first: several recordings of one name may lie in the folder, each with a part 0.
        for _, number, position, bag in sorted(parts):
            if previous is None or number != previous + 1:
                groups.append((position, [bag]))
            else:
                groups[-1][1].append(bag)
            previous = number
    return [recording for _, recording in sorted(groups)]


def _parse_part_name(name: str) -> Tuple[str, str, int]:
    """Return the name of the recording, the date and the number of a part; number -1 for other names."""
    base, separator, number = PurePosixPath(name).name.rpartition("_")
    if not (separator and number.isdecimal() and len(number) < 10):
        return name, "", -1
    recording_name, _, date = base.rpartition("_")
    # The name of a recording may contain underscores and digits itself, so the form of the date is checked exactly.
    if len(date) == len("2014-10-19-19-50-06") and date.replace("-", "").isdecimal() and date.count("-") == 5:
        return recording_name, date, int(number)
    return base, "", int(number)


def is_folder_of_bags(location: str) -> bool:
    """Return whether a path is a folder that is not a ROS 2 bag itself."""
    return os.path.isdir(location) and not is_ros2_bag(
        os.path.basename(os.path.realpath(location)), os.listdir(location)
    )


def location_exists(location: str) -> bool:
    """Return whether a location exists."""
    if not is_url(location):
        return os.path.lexists(location)
    filesystem, path = _open_filesystem(location)
    return bool(_call_filesystem(location, filesystem.exists, path))


_BUCKET_PROTOCOLS = frozenset(("s3", "s3a", "gs", "gcs"))
"""Schemes of the file systems of Amazon and Google, and of those that are compatible."""

_VERSION_KEYS = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created")
"""Names that the file systems of fsspec use for what changes with a file."""

CONTENT_KEYS = _VERSION_KEYS[:3]
"""Those that a copy of a file has, too."""


def list_file_versions(location: str, keys: Sequence[str] = _VERSION_KEYS) -> List[List[str]]:
    """Return name, size, and time of modification or ETag of each file of a bag or result; empty if there is none.

    Args:
        location: path or URL.
        keys: entries of a file's description that are returned of a file at a URL, as far as there are any.

    Raises:
        BagError: if a URL cannot be accessed.
    """
    if is_url(location):
        filesystem, path = _open_filesystem(location)
        # Processes of a cluster live long, and a file system remembers what it has listed.
        _call_filesystem(location, filesystem.invalidate_cache)
        if not _call_filesystem(location, filesystem.exists, path):
            return []
        files = _call_filesystem(location, filesystem.find, path, detail=True)
        return [
            [name, str(info.get("size")), str([info[key] for key in keys if key in info])]
            for name, info in sorted(files.items())
        ]
    local_path = Path(location)
    # The newest messages of a database can be in its log.
    names = (location, f"{location}-wal", f"{location}-journal")
    paths = sorted(local_path.rglob("*")) if local_path.is_dir() else map(Path, names)
    versions = []
    for file in paths:
        try:
            status = file.stat()
        except OSError:
            continue
        if file.is_file():
            versions.append([file.name, str(status.st_size), str(status.st_mtime_ns)])
    return versions


def read_location(location: str) -> Optional[str]:
    """Return the text of a file; None if it does not exist or cannot be read.

    Raises:
        BagError: if a URL cannot be accessed.
    """
    if not is_url(location):
        try:
            return Path(location).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return None
    filesystem, path = _open_filesystem(location)
    if not _call_filesystem(location, filesystem.exists, path):
        return None
    return str(_call_filesystem(location, filesystem.cat_file, path), "utf-8", "replace")


def remove_location(location: str) -> None:
    """Remove a file if it exists.

    Raises:
        BagError: if it cannot be removed.
    """
    if is_url(location):
        filesystem, path = _open_filesystem(location)
        if _call_filesystem(location, filesystem.exists, path):
            _call_filesystem(location, filesystem.rm_file, path)
        return
    try:
        os.unlink(location)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise BagError(f"{location} cannot be removed: {describe_error(error)}") from error


@contextmanager
def local_copy(location: str, scratch: str) -> Iterator[str]:
    """Provide the local path of a bag; a bag at a URL is downloaded and deleted afterwards.

    Raises:
        BagError: if the download fails.
    """
    if not is_url(location):
        yield location
        return
    filesystem, path = _open_filesystem(location)
    with TemporaryDirectory(dir=scratch) as folder:
        local = str(Path(folder) / PurePosixPath(path).name)
        _call_filesystem(location, _download, filesystem, path, local)
        # The newest messages of a database can be in its write-ahead log.
        if path.endswith(".db3") and _call_filesystem(location, filesystem.exists, f"{path}-wal"):
            _call_filesystem(location, _download, filesystem, f"{path}-wal", f"{local}-wal")
        yield local


def _download(filesystem: Any, path: str, local: str) -> None:
    """Copy a file or a folder; each file up to its stated size and up to half of the free disk space."""
    names = filesystem.find(path) if filesystem.isdir(path) else [path]
    for name in names:
        relative_path = PurePosixPath(name).relative_to(path)
        # The names come from a server, so they must not lead out of the target folder.
        if ".." in relative_path.parts:
            raise ValueError(f"'{name}' is outside of the folder")
        target = Path(local) / relative_path
        target.parent.mkdir(parents=True, exist_ok=True)
        # A server may send more than it states, and a full disk would stop other programs of the robot.
        stated_size, available_bytes = filesystem.size(name), shutil.disk_usage(target.parent).free // 2
        max_bytes = available_bytes if stated_size is None else min(stated_size, available_bytes)
        with filesystem.open(name, "rb") as source, target.open("wb") as file:
            if copy_up_to(source.read, file, max_bytes) > max_bytes:
                raise ValueError(
                    f"'{name}' has more than {max_bytes} bytes, as stated or as half of the disk has"
                )


@contextmanager
def result_file(target: str, scratch: str) -> Iterator[str]:
    """Provide a path to write a result to, which is moved to the target atomically if no exception is raised.

    Args:
        target: path or URL; missing folders are created.
        scratch: folder for the file before it is uploaded to a URL.

    Raises:
        BagError: if the target cannot be written.
    """
    if is_url(target):
        filesystem, path = _open_filesystem(target)
        with TemporaryDirectory(dir=scratch) as folder:
            local = str(Path(folder) / PurePosixPath(path).name)
            yield local
            if not _has_buckets(filesystem):
                _call_filesystem(target, filesystem.makedirs, str(PurePosixPath(path).parent), exist_ok=True)
            _call_filesystem(target, filesystem.put_file, local, path)
        return
    folder = os.path.dirname(target)
    try:
        os.makedirs(folder or ".", exist_ok=True)
        # DuckDB reads hidden files, too. The writers of bags need the suffix.
        with replace_file(target, has_suffix=target.endswith(BAG_SUFFIXES)) as incomplete_path:
            yield str(incomplete_path)
    except OSError as error:
        raise BagError(f"{target} cannot be written: {describe_error(error)}") from error


def remove_incomplete_results(targets: Iterable[str]) -> None:
    """Remove incomplete results of worker processes that were killed."""
    result_names = {os.path.split(target) for target in targets if not is_url(target)}
    for folder in {folder for folder, _ in result_names}:
        for path in Path(folder).glob(".*"):
            # Other runs may be writing other results to the same folder.
            if (folder, target_name_of(path)) in result_names:
                path.unlink()


def _strip_suffix(name: str) -> str:
    suffix = max((suffix for suffix in BAG_SUFFIXES if name.endswith(suffix)), key=len, default="")
    return name[: len(name) - len(suffix)]


def _list_names_below(location: str) -> Optional[List[str]]:
    """Return the names of all files below a folder, relative to it; None for files and bags."""
    if not is_url(location):
        if not is_folder_of_bags(location):
            return None
        return [path.relative_to(location).as_posix() for path in Path(location).rglob("*")]
    filesystem, path = _open_filesystem(location)
    if not _call_filesystem(location, filesystem.isdir, path):
        return None
    names = [
        PurePosixPath(name).relative_to(path).as_posix()
        for name in _call_filesystem(location, filesystem.find, path)
    ]
    own_names = [name for name in names if "/" not in name]
    return None if is_ros2_bag(PurePosixPath(path).name, own_names) else names


def _select_bag_names(names: Iterable[str]) -> List[str]:
    """Return the names that are bags, sorted; hidden files and folders are skipped."""
    paths = [path for path in map(PurePosixPath, names) if not any(part[0] == "." for part in path.parts)]
    names_by_folder: Dict[PurePosixPath, List[str]] = {}
    for path in paths:
        names_by_folder.setdefault(path.parent, []).append(path.name)
    # The files in a ROS 2 bag are parts of it, not bags of their own.
    folders = {folder for folder, names in names_by_folder.items() if is_ros2_bag(folder.name, names)}
    files = {path for path in paths if path.name.endswith(BAG_SUFFIXES) and path.parent not in folders}
    # The same recording, completed by another program.
    files -= {path.with_name(f"{path.name}.active") for path in files}
    return [path.as_posix() for path in sorted(folders | files, key=lambda path: path.parts)]


def _open_filesystem(url: str) -> Tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 - an optional package
    except ImportError:
        raise BagError(
            f"{url}: URLs need the Python package fsspec (pip install fsspec, and s3fs for s3://)"
        ) from None
    filesystem, path = _call_filesystem(url, url_to_fs, url)
    return filesystem, str(path)


def _has_buckets(filesystem: Any) -> bool:
    """Return whether a file system has buckets in place of folders.

    Their implementations would create a bucket whose name is misspelled; keys need no folders.
    """
    protocols = filesystem.protocol
    return bool(_BUCKET_PROTOCOLS & {*((protocols,) if isinstance(protocols, str) else protocols)})


def _call_filesystem(url: str, function: Any, *arguments: Any, **options: Any) -> Any:
    """Call a function of a file system, and convert any exception: its implementation is not part of this package."""
    try:
        return function(*arguments, **options)
    except Exception as error:
        raise BagError(f"{url}: {describe_error(error)}") from error
