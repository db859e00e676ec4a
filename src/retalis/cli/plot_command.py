"""Command ``plot``: draws the timeline of a run, with events, waiting queries, memories and outputs."""

import argparse
from pathlib import Path
from typing import Callable

from ..foundation.cpython_and_pypy import limit_gc_pauses
from ..foundation.errors import UsageError
from ..playback.playback import RunRecorder
from ..visualization.timeline import (
    PICTURE_FORMATS,
    Timeline,
    TimelineBuilder,
    draw_timeline,
    read_run,
    timeline_page,
)
from .bag_command import add_source
from .bag_run import create_playback, open_bags, progress_of
from .command_options import add_folders, add_limits
from .stderr_report import StderrReporter, show_progress

PAGE_SUFFIXES = ("html", "htm")

DESCRIPTION = """\
Run a program over bags, or read a run that "bag --events --json" has written, and draw its timeline: a row for each
event, for the waits of each query, for each memory and for each output. An .html file is a page with zoom, which
needs neither other files nor a network; .png, .svg and .pdf are drawn by matplotlib.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``plot``."""
    parser = add_command("plot", help="draw the timeline of a run", description=DESCRIPTION)
    add_source(parser, "*", required=False)
    add = parser.add_argument
    add(
        "--from",
        dest="run_file",
        type=Path,
        metavar="FILE",
        help='a run that "bag --events --json" has written',
    )
    add(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="where to draw it, as run.html or run.png",
    )
    add_limits(parser)
    add_folders(parser)
    parser.set_defaults(run=run, reject_usage=parser.error)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    path, suffix = options.output, options.output.suffix[1:].lower()
    if suffix not in (*PAGE_SUFFIXES, *PICTURE_FORMATS):
        endings = ", ".join(f".{ending}" for ending in (*PAGE_SUFFIXES, *PICTURE_FORMATS))
        raise UsageError(f"--output {path}: expected a name that ends in one of {endings}")
    report = StderrReporter().attach()
    if options.run_file is not None:
        if options.bags:
            options.reject_usage("give bags or --from, not both")
        timeline, title = _read_timeline(options.run_file), options.run_file.name
    else:
        if not options.bags or options.program is None:
            options.reject_usage("give bags with --program, or --from")
        # An error in the program does not prevent the drawing; it determines the exit status.
        timeline = _record_timeline(options, report).build()
        title = f"{options.program.resolve().name} over {', '.join(Path(bag).name for bag in options.bags)}"
    if suffix in PAGE_SUFFIXES:
        _write_page(path, timeline_page(timeline, title))
    else:
        draw_timeline(timeline, title, path)
    return 1 if report.errors else 0


def _read_timeline(path: Path) -> Timeline:
    try:
        with open(path, encoding="utf-8") as file:
            return read_run(file, str(path))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text: {error}") from error


def _record_timeline(options: argparse.Namespace, report: StderrReporter) -> TimelineBuilder:
    """Run the program over the bags, and record its timeline."""
    builder = TimelineBuilder()
    with open_bags(options) as bags:
        playback = create_playback(options, report)
        recorder = RunRecorder(playback, builder.add_record)
        with show_progress("messages", progress_of(playback, bags)) as bar:

            def advance(done: int) -> None:
                recorder.update_waits()
                if bar is not None:
                    bar(done)

            # After the program is loaded: only the objects of the run are left to the collector.
            limit_gc_pauses()
            for output in playback.run(bags, advance):
                recorder.record_output(output)
        recorder.record_final_state()
    return builder


def _write_page(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error
