"""Options of ``retalis bag`` for many bags: separate runs, result files, and options that exclude each other."""

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Dict, Optional

from ..foundation.errors import UsageError
from ..playback.bag_locations import is_folder_of_bags, is_url
from ..playback.run_tables import TABLE_TYPES
from .option_values import TIMES_RELATIVE, positive_integer
from .result_partitions import parse_partition, parse_robot

BAG_FORMATS = ("bag", "mcap")
"""Formats of results that contain published messages: bags of ROS 1 and of ROS 2."""

FORMATS = (*BAG_FORMATS, *TABLE_TYPES, "jsonl")
"""Formats of the results of separate runs, and the suffixes of their files."""

_REQUIRED_PACKAGES = {"mcap": "mcap", "parquet": "pyarrow"}
"""Optional Python packages by the format that needs them."""

_MANY_BAGS_OPTIONS = (
    "bags",
    "output",
    "overwrite",
    "jobs",
    "parts",
    "format",
    "partition",
    "robot",
    "scheduler",
    "worker_timeout",
    "any_version",
    "resume",
)
_PARSER_ENTRIES = ("command", "run", "root_parser")
"""Entries of the parsed options that a `BagTask` does not need."""


def add_many_bags_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for many bags."""
    group = parser.add_argument_group(
        "many bags",
        "A bag that cannot be played is reported; the others are played. A bag whose worker dies is played again.",
    )
    add = group.add_argument
    add(
        "--jobs",
        type=positive_integer,
        metavar="N",
        help="play N bags at a time, in local processes",
    )
    add(
        "--parts",
        action="store_true",
        help="play the parts of a split recording, NAME_0.bag, NAME_1.bag ..., as one run",
    )
    add(
        "--resume",
        action="store_true",
        help="keep results that are whole, of the same program, options and bag",
    )
    add(
        "--format",
        choices=FORMATS,
        help="format of the results, one file per bag in the folder or URL --output (bag; with --json: jsonl)",
    )
    add(
        "--partition",
        type=parse_partition,
        default=(),
        metavar="KEYS",
        help="place results in folders of day, robot or day,robot, as day=2026-11-30/robot=r07",
    )
    add(
        "--robot",
        type=parse_robot,
        metavar="PATTERN",
        help="name of the robot, or the end of the bags' paths with it, as {robot}/*/*.bag",
    )


def single_bag_options(options: argparse.Namespace) -> Dict[str, Any]:
    """Return the options that apply to a single bag."""
    omitted = (*_MANY_BAGS_OPTIONS, *_PARSER_ENTRIES)
    return {name: value for name, value in vars(options).items() if name not in omitted}


def requests_separate_runs(options: argparse.Namespace) -> bool:
    """Return whether the options request a separate run for each bag.

    Raises:
        UsageError: if they do not, but another option or a bag requires it.
    """
    if options.jobs or options.scheduler:
        return True
    for name in ("format", "parts", "partition", "resume", "robot"):
        if getattr(options, name):
            raise UsageError(f"--{name} needs --jobs or --scheduler")
    for location in options.bags:
        if is_url(location):
            raise UsageError(f"{location}: --jobs plays bags of URLs, each by itself")
        if is_folder_of_bags(location):
            raise UsageError(
                f"{location} is not a ROS 2 bag: it has no metadata.yaml: name its .db3 or .mcap file, "
                "or use --jobs to play all bags below a folder"
            )
    if options.output and is_url(options.output):
        raise UsageError(f"--output {options.output}: --jobs writes results to URLs, one for each bag")
    return False


def check_many_bags_options(options: argparse.Namespace) -> None:
    """Reject incompatible options.

    Raises:
        UsageError: if there are any.
    """
    result_format = select_format(options)
    # Otherwise each bag would fail, and lose its earlier result.
    if not options.program.is_dir():
        raise UsageError(f"--program {options.program}: there is no such folder")
    package = _REQUIRED_PACKAGES.get(result_format or "")
    # The workers of a cluster have packages of their own.
    if package is not None and not options.scheduler and find_spec(package) is None:
        raise UsageError(
            f"--format {result_format} needs the Python package {package} (pip install {package})"
        )
    if options.jobs and options.scheduler:
        raise UsageError(
            "--jobs and --scheduler: give only one option: a cluster determines the number of its workers"
        )
    # The results of other machines have to be written to a folder or URL that both sides can read.
    if options.scheduler and not options.output:
        raise UsageError("--scheduler needs --output: a folder that the workers see, or a URL")
    if options.write_folder:
        raise UsageError(
            "--write-folder: bags that are played at the same time would write over each other's files"
        )
    if result_format in BAG_FORMATS and options.events:
        raise UsageError("--events: a bag contains only published messages; use --format jsonl or parquet")
    if options.times == TIMES_RELATIVE and result_format in TABLE_TYPES:
        raise UsageError(f"--times=relative: --format {result_format} has times in UTC")
    if "robot" in options.partition and options.robot is None:
        raise UsageError("--partition robot needs --robot")
    if options.robot is not None and "robot" not in options.partition and result_format not in TABLE_TYPES:
        raise UsageError("--robot needs --format parquet or csv, or --partition robot")
    _check_printed_lines(options, result_format)
    _check_output(options)


def _check_output(options: argparse.Namespace) -> None:
    """Reject options that need an output folder, and a folder whose results would be played.

    Raises:
        UsageError: if there are any.
    """
    for name in ("format", "partition", "resume", "robot"):
        if getattr(options, name) and not options.output:
            raise UsageError(f"--{name} needs --output")
    if options.output and not is_url(options.output):
        target = Path(options.output).resolve()
        for location in options.bags:
            if is_folder_of_bags(location) and Path(location).resolve() in (target, *target.parents):
                raise UsageError(
                    f"--output {options.output} is below {location}: results would be played the next time"
                )


def _check_printed_lines(options: argparse.Namespace, result_format: Optional[str]) -> None:
    """Reject options that print lines at the end, if the format of the results cannot contain them.

    Raises:
        UsageError: if there are any.
    """
    if result_format in (*BAG_FORMATS, *TABLE_TYPES):
        for name, value, content in (
            ("explain", options.explain, "explanations"),
            ("open", options.prints_open, "open states and windows"),
        ):
            if value:
                raise UsageError(
                    f"--{name}: --format {result_format} cannot contain {content}: use --format jsonl"
                )


def select_format(options: argparse.Namespace) -> Optional[str]:
    """Return the format of the results; None if they are printed."""
    if not options.output:
        return None
    return str(options.format or ("jsonl" if options.json else "bag"))
