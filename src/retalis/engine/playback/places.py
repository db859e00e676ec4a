"""Where bags are and where results go: files, folders with bags below them, and URLs as ``s3://``.

URLs are the work of the Python package ``fsspec`` and of what it needs for their kind (``s3fs``).
"""

import os
import shutil
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from uuid import uuid4

from .bags import BagError
from .decompression import copy_up_to, reason
from .ros2bags import METADATA, SUFFIXES

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
