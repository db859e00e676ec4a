"""Folders of results: the robot of a bag by its path, and partitions by day and robot.

Option ``--robot`` is the end of the bags' paths with the robot's name in it, as ``{robot}/*/*.bag``. Option
``--partition`` places results in folders that data tools read as columns, as ``day=2026-11-30/robot=r07`` of Hive.
The day is known only when the bag is read, so that the worker completes the name of the result (`ResultTarget`).
"""

import argparse
import os
from datetime import datetime, timedelta, timezone
from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple
from urllib.parse import quote

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import UsageError
from ..playback.bag_locations import is_url

PARTITION_KEYS = ("day", "robot")
"""Keys of option ``--partition``."""

_ROBOT_MARK = "{robot}"
_PATTERN_CHARACTERS = frozenset("/*{}")
"""Characters of patterns, which the name of a robot lacks."""

_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


class ResultTarget(NamedTuple):
    """The location of a result, which may contain the day of its bag.

    Attributes:
        head: path or URL, or its part before the day.
        tail: its part after the day; "" without a day.
    """

    head: str
    tail: str = ""

    def locate(self, day: str) -> str:
        """Return the path or URL of the result of a bag of a day; the day is ignored if the location has none."""
        return f"{self.head}{day}{self.tail}" if self.tail else self.head

    def list_local_paths(self) -> Iterator[str]:
        """Yield the local paths that the result can have in existing folders."""
        if is_url(self.head):
            return
        if not self.tail:
            yield self.head
            return
        folder, prefix = os.path.split(self.head)
        if os.path.isdir(folder):
            for name in os.listdir(folder):
                if name.startswith(prefix):
                    yield f"{folder}/{name}{self.tail}"


def make_target(output: str, name: str, partition: Sequence[str], robot: Optional[str]) -> ResultTarget:
    """Return the location of a result.

    Args:
        output: folder or URL of all results.
        name: name of the result below its partition.
        partition: keys of option ``--partition``.
        robot: name of the robot; None if the partition has no robot.
    """
    folders = ""
    for key in partition:
        # The mark of the day is no character of a quoted name.
        value = "{" if key == "day" else quote(robot or "", safe="", errors="surrogateescape")
        folders += f"{key}={value}/"
    head, _, tail = folders.partition("{")
    return (
        ResultTarget(f"{output}/{head}", f"{tail}{name}")
        if tail
        else ResultTarget(f"{output}/{folders}{name}")
    )


def utc_day(instant: int) -> str:
    """Return the day of an instant in nanoseconds, as ``2026-11-30``; that of an empty bag is ``1970-01-01``."""
    try:
        return str((_EPOCH + timedelta(microseconds=instant // 1000)).date())
    except OverflowError:
        return str(datetime.max.date())


def parse_partition(text: str) -> Tuple[str, ...]:
    """Return the keys of option ``--partition``.

    Raises:
        argparse.ArgumentTypeError: if one is unknown or repeated.
    """
    keys = tuple(text.split(","))
    if len(set(keys)) < len(keys) or not set(keys) <= set(PARTITION_KEYS):
        raise argparse.ArgumentTypeError(
            f"expected {' or '.join(PARTITION_KEYS)}, or both with a comma, found {quote_shortened(text)}"
        )
    return keys


def parse_robot(text: str) -> str:
    """Return the pattern of option ``--robot``.

    Raises:
        argparse.ArgumentTypeError: if it is empty, names the robot twice, or is a pattern without a robot.
    """
    count = text.count(_ROBOT_MARK)
    if not text or count > 1 or (count == 0 and not _PATTERN_CHARACTERS.isdisjoint(text)):
        raise argparse.ArgumentTypeError(
            f"expected a name, or the end of a path with one {_ROBOT_MARK}, found {quote_shortened(text)}"
        )
    return text


def find_robot(pattern: str, location: str) -> str:
    """Return the name of the robot of a bag.

    Args:
        pattern: the name of the robot; or the last components of the paths of bags, in which ``{robot}`` and ``*``
            stand for the shortest text that fits.
        location: path or URL of the bag.

    Raises:
        UsageError: if the path does not fit.
    """
    if _ROBOT_MARK not in pattern:
        return pattern
    components = pattern.strip("/").split("/")
    path = location if is_url(location) else os.path.abspath(location)
    names = [name for name in path.split("/") if name][-len(components) :]
    robot = ""
    if len(names) == len(components):
        for component, name in zip(components, names):
            texts = _match_component(component, name)
            if texts is None:
                robot = ""
                break
            robot = texts or robot
    if not robot:
        raise UsageError(
            f"{location}: its robot is not known: expected a path that ends as --robot {quote_shortened(pattern)}"
        )
    return robot


def _match_component(pattern: str, name: str) -> Optional[str]:
    """Return the text of ``{robot}`` in a component of a path, "" if it has none; None if the name does not fit."""
    before, mark, after = pattern.partition(_ROBOT_MARK)
    literals = [*before.split("*"), *after.split("*")] if mark else pattern.split("*")
    if len(literals) == 1:
        return "" if name == pattern else None
    if not name.startswith(literals[0]):
        return None
    wildcards: List[str] = []
    position = len(literals[0])
    for literal in literals[1:-1]:
        start = name.find(literal, position)
        if start < 0:
            return None
        wildcards.append(name[position:start])
        position = start + len(literal)
    end = len(name) - len(literals[-1])
    if end < position or not name.endswith(literals[-1]):
        return None
    wildcards.append(name[position:end])
    if not mark:
        return ""
    # A robot without a name does not fit.
    return wildcards[before.count("*")] or None
