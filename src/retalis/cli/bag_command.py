"""Command ``bag``: runs a program over recorded bags, without ROS."""

import argparse
from pathlib import Path
from typing import Callable

from .bag_run import add_chunk_limit_option, play
from .command_options import add_direct, add_folders, add_limits
from .many_bags import add_many_bags_options, play_separately, requests_separate_runs
from .option_values import RELATIVE_TIMES_OPTION, TIMES_AS_STAMPS, TIMES_RELATIVE, non_negative
from .output import JSON_HELP
from .stderr_report import StderrReporter

DESCRIPTION = """\
Run a program over bags and print its outputs, as output(TERM,TOPIC) terms. ROS 1 bags may be compressed. A ROS 2
bag is a folder with metadata.yaml, or its .db3, .mcap, .db3.zstd or .mcap.zstd file. Several bags are played as one,
in the order of receipt. ROS 2 messages are read as ROS 1 messages of the same name.

With --jobs or --scheduler each bag is a separate run, and several run at the same time. A folder stands for all bags
below it, sorted by name; URLs such as s3://BUCKET/FOLDER are allowed. The output is the same as that of the bags one
after the other.
"""
JSON_LINES_HELP = """\
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}    unless --quiet; T is the bag's time
  {"event": TERM, "start": T1, "end": T2}                  with --events, and the two below
  {"wait": TERM, "memories": [ID, ...], "start": T1, "end": T2}    a query that has waited
  {"memory": ID, "pattern": TERM, "size": N, "records": N, "taken": N, "start": T1, "end": T2}    at the end
  {"explain": TERM, "happened": true or false, "because": [{"text": LINE, "below": [...]}, ...]}
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``bag``."""
    parser = add_command(
        "bag",
        help="run a program over bags, without ROS",
        description=DESCRIPTION,
        epilog=JSON_HELP + JSON_LINES_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_source(parser)
    add = parser.add_argument
    add("--output", metavar="BAG", help="write the published messages to a bag")
    add("--overwrite", action="store_true", help="replace this bag if it exists")
    add_many_bags_options(parser)
    add("--events", action="store_true", help="print each event too, as event(TERM,[T1,T2])")
    add(
        "--times",
        action="store_const",
        const=TIMES_AS_STAMPS,
        help="print outputs with the bag's time, as output(TERM,TOPIC,datime(...))",
    )
    add(
        RELATIVE_TIMES_OPTION,
        action="store_const",
        const=TIMES_RELATIVE,
        dest="times",
        help="print outputs and explanations with times in seconds since the start of the run",
    )
    add(
        "--explain",
        metavar="TERM",
        action="append",
        default=[],
        help="print at the end why an event like TERM happened or did not happen, in lines that start with %%",
    )
    add("--json", action="store_true", help="print one JSON object per line instead of terms")
    add("--quiet", action="store_true", help="print no outputs")
    add_limits(parser)
    add_folders(parser)
    parser.set_defaults(run=run)


def add_source(parser: argparse.ArgumentParser, bags: str = "+", required: bool = True) -> None:
    """Add the options that select the program, the bags and their messages."""
    add = parser.add_argument
    add("bags", nargs=bags, metavar="BAG", help="a bag of ROS 1 or ROS 2")
    add(
        "--program",
        type=Path,
        required=required,
        metavar="FOLDER",
        help="folder with pub_sub.xml and goalPredicates.txt",
    )
    add(
        "--start",
        type=non_negative(float),
        default=0.0,
        metavar="SECONDS",
        help="skip messages within this many seconds after the first message (0)",
    )
    add(
        "--duration",
        type=non_negative(float),
        metavar="SECONDS",
        help="stop after this many seconds (at the end)",
    )
    add(
        "--topic",
        action="append",
        default=[],
        metavar="TOPIC=TYPE",
        help="a topic whose messages become events, in addition to those of pub_sub.xml",
    )
    add_direct(parser)
    add(
        "--max-skew",
        type=non_negative(float),
        metavar="SECONDS",
        help="skip messages whose stamp differs by more than this from earlier stamps of their topic and frame "
        "(0: no limit)",
    )
    add(
        "--max-gap",
        type=non_negative(float),
        metavar="SECONDS",
        help="do not interpolate over longer gaps (0: no limit)",
    )
    add(
        "--tf-cache",
        type=non_negative(float),
        metavar="SECONDS",
        help="history of transforms for tf_lookup and similar goals (default: 10)",
    )
    add_chunk_limit_option(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if requests_separate_runs(options):
        return play_separately(options)
    report = StderrReporter().attach(show_events=True)
    play(options, report)
    return 1 if report.errors else 0
