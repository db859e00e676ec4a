"""Tasks of ``retalis bag`` for many bags: one for each bag, with the location of its result, and their outcomes."""

import argparse
import json
import os
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any, Deque, Dict, List, Mapping, NamedTuple, Optional, Tuple

from ..foundation.errors import UsageError
from ..playback.bag_locations import BagLocation, is_url, location_exists
from ..playback.rosbag1 import BagError
from ..playback.run_tables import TABLE_TYPES
from .many_bags_options import select_format, single_bag_options
from .result_manifest import MANIFEST_FOLDER, ResultManifest, compute_inputs
from .result_partitions import ResultTarget, find_robot, make_target

if TYPE_CHECKING:
    from ..testing.rule_coverage import CoveredPart


class BagTask(NamedTuple):
    """A bag to play.

    Attributes:
        location: path or URL of the bag.
        target: path or URL for the result, which may contain the day of the bag.
        format: format of the result, one of `FORMATS`; None for the printed output.
        options: the options of the command that apply to a single bag.
        has_next_part: whether it is a part of a recording with a further part.
        state: snapshot of the program after the previous part; None without one.
        manifest: manifest of the result; None for the printed output.
        labels: values of the columns that all rows of a table share, by name.
    """

    location: str
    target: ResultTarget
    format: Optional[str]
    options: Dict[str, Any]
    has_next_part: bool = False
    state: Optional[bytes] = None
    manifest: Optional[ResultManifest] = None
    labels: Mapping[str, Optional[str]] = {}


class BagOutcome(NamedTuple):
    """Outcome of a bag.

    Attributes:
        errors: number of errors during the run, which do not prevent a result.
        stderr_text: text of errors and warnings.
        failure: reason why there is no result; None if there is one.
        state: snapshot of the program for the next part; None without one.
        coverage: parts of the program with their uses; empty if the options do not request them.
        is_incomplete: whether the bag was read up to a break only.
        day: its day in the location of the result, as ``2026-11-30``; "" if that has none.
    """

    errors: int
    stderr_text: str
    failure: Optional[str] = None
    state: Optional[bytes] = None
    coverage: "Tuple[CoveredPart, ...]" = ()
    is_incomplete: bool = False
    day: str = ""


def create_tasks(
    options: argparse.Namespace, recordings: List[List[BagLocation]], scratch: str
) -> Tuple[List[BagTask], Deque[int]]:
    """Return all tasks in order, and the numbers of the tasks that can start: the first parts of recordings.

    Raises:
        UsageError: if two results would have the same name, a result exists already, or a robot is unknown.
        BagError: if a bag whose robot is unknown does not exist.
    """
    result_format = select_format(options)
    bag_options = _shared_bag_options(options)
    inputs: Dict[str, str] = {}
    if result_format is not None:
        other_options = (result_format, options.parts, options.robot, options.partition)
        inputs = compute_inputs(bag_options, other_options, options.output, options.any_version)
    bags_by_target: Dict[ResultTarget, str] = {}
    tasks: List[BagTask] = []
    ready: Deque[int] = deque()
    for bags in recordings:
        ready.append(len(tasks))
        for position, bag in enumerate(bags):
            robot = None if options.robot is None else _find_robot(options.robot, bag.location)
            task = BagTask(
                location=_shared_path(options, bag.location),
                # Printed output is collected in temporary files, so that it can be printed in the order of the bags.
                target=ResultTarget(os.path.join(scratch, str(len(tasks)))),
                format=result_format,
                options=bag_options,
                has_next_part=bag is not bags[-1],
                labels=_row_labels(options, bag, robot),
            )
            if result_format is not None:
                # If parts are added or deleted, the others continue from another state, or have another end.
                part_inputs = {**inputs, "position": f"{position} of {len(bags)}"}
                manifest = _create_manifest(task, options, bag, robot, part_inputs)
                _check_target(manifest, bag, bags_by_target, options.overwrite or options.resume)
                bags_by_target[manifest.target] = bag.location
                task = task._replace(target=manifest.target, manifest=manifest)
            tasks.append(task)
    return tasks, ready


def _find_robot(pattern: str, location: str) -> str:
    """Return the name of the robot of a bag; see `find_robot`."""
    try:
        return find_robot(pattern, location)
    except UsageError:
        # A misspelt folder or bucket is the cause, not the pattern.
        if not location_exists(location):
            raise BagError(f"{location}: there is no such file or folder") from None
        raise


def _shared_path(options: argparse.Namespace, path_or_url: str) -> str:
    """Return a path that is valid in all processes: those of a cluster may have other working directories."""
    return os.path.abspath(path_or_url) if options.scheduler and not is_url(path_or_url) else path_or_url


def _shared_bag_options(options: argparse.Namespace) -> Dict[str, Any]:
    """Return the options for a single bag, with paths that are valid in all processes."""
    absolute = os.path.abspath if options.scheduler else str
    bag_options = single_bag_options(options)
    bag_options["program"] = Path(absolute(options.program))
    bag_options["msg"] = [Path(absolute(folder)) for folder in options.msg]
    if options.answers is not None:
        bag_options["answers"] = Path(absolute(options.answers))
    bag_options["folder"] = [absolute(folder_name) for folder_name in options.folder]
    return bag_options


def _row_labels(
    options: argparse.Namespace, bag: BagLocation, robot: Optional[str]
) -> Dict[str, Optional[str]]:
    """Return the values of the columns that all rows of a bag's table share."""
    labels: Dict[str, Optional[str]] = {"bag": bag.location}
    # Data tools take a partition from the folder, and some refuse a column of the same name. The recordings can be in
    # such folders, too.
    if "robot" not in options.partition and "/robot=" not in f"/{bag.name}":
        labels["robot"] = robot
    return labels


def _create_manifest(
    task: BagTask, options: argparse.Namespace, bag: BagLocation, robot: Optional[str], inputs: Dict[str, str]
) -> ResultManifest:
    """Return the manifest of a task's result, with the location of the result."""
    folder, name = _shared_path(options, options.output.rstrip("/")), f"{bag.name}.{task.format}"
    target = make_target(folder, name, options.partition, robot)
    # The bags of two robots can have the same name. The day is not known yet.
    keys = [key for key in options.partition if key != "day"]
    place = make_target(f"{folder}/{MANIFEST_FOLDER}", f"{name}.json", keys, robot).head
    if task.format in TABLE_TYPES:
        inputs = {**inputs, "labels": json.dumps(task.labels)}
    return ResultManifest(place, task.location, target, inputs)


def _check_target(
    manifest: ResultManifest, bag: BagLocation, bags_by_target: Mapping[ResultTarget, str], overwrite: bool
) -> None:
    target = manifest.target
    name = target.locate("*")
    if target in bags_by_target:
        raise UsageError(
            f"{bags_by_target[target]} and {bag.location}: the result of both would be {name}; "
            "give the folder that both are below, or different ones to --output"
        )
    # Only the manifest names the day of an earlier result.
    if not overwrite and location_exists(manifest.location if target.tail else target.head):
        raise UsageError(f"{name} already exists; --overwrite replaces it, --resume keeps it if it is whole")
