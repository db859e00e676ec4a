"""Commands ``graph`` and ``plot``, which draw a program as a graph and a run as a timeline."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Dict, List, Optional, Sequence, Tuple

from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.ros_param_predicate import no_parameters
from ..engine.run_records import open_records
from ..events.program.topic_configuration import GOALS, TOPICS, Topics, read_topics
from ..foundation.errors import ProgramErrors, UsageError
from ..foundation.garbage_collection import limit_gc_pauses
from ..foundation.interrupts import interruptible
from ..foundation.output_files import open_output, print_json
from ..playback.playback import RunRecorder
from ..prolog.terms import timestamps
from ..visualization.program_graph import (
    PICTURE_SUFFIXES,
    Graph,
    GraphTopic,
    dot_text,
    draw_graph,
    program_graph,
)
from ..visualization.timeline import (
    PICTURE_FORMATS,
    Timeline,
    TimelineBuilder,
    draw_timeline,
    read_run,
    timeline_page,
)
from .bag_command import add_source, create_playback, elapsed_fraction, exit_status_of, open_bags
from .command_options import add_end_of_input, add_folders, add_limits, apply_limits
from .optional_ros_imports import installed_definitions
from .progress_bar import show_progress
from .stderr_reports import StderrReporter

if TYPE_CHECKING:
    from ..playback.incomplete_files import IncompleteFile

MAX_BAGS_IN_TITLE = 5
"""Maximum number of bags that the title of a timeline names."""

TEXT_SUFFIXES = ("dot", "gv")
"""Suffixes of files in the text format of Graphviz."""

_GRAPH_DESCRIPTION = """\
Load a program and draw its graph: topics, events, rules, queries, memories, transforms, facts, subscriptions, and the
data flow between them. The suffix of the file determines the format: .svg, .png and .pdf are drawn by Graphviz; .dot,
or no file, is the input text of Graphviz, which is not required for it.
"""


def add_graph_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``graph``."""
    parser = add_command("graph", help="draw a program", description=_GRAPH_DESCRIPTION)
    add = parser.add_argument
    add(
        "folder",
        nargs="?",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="the program's folder, with goalPredicates.txt; the current one by default",
    )
    add = parser.add_mutually_exclusive_group().add_argument
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="where to draw it, as program.svg; without it the text is printed",
    )
    add("--json", action="store_true", help="print the nodes and edges as one JSON object")
    add_limits(parser)
    parser.set_defaults(run=draw_program)


def draw_program(options: argparse.Namespace) -> int:
    """Run command ``graph``; return its exit status."""
    reporter = StderrReporter().attach()
    # Before the program is loaded: a wrong suffix is reported at once.
    suffix = _get_output_format(options.output)
    folder = options.folder
    if not (folder / GOALS).is_file():
        raise UsageError(f"{folder.resolve()} is not a program: it has no file {GOALS}")
    engine = Engine(settings=apply_limits(Settings(), options), definitions=installed_definitions())
    # Goals may subscribe to topics during loading. They are recorded for the graph, and nothing is subscribed.
    engine.on_topic_request(lambda request: None)
    engine.on_service_call(lambda call: None)
    engine.on_parameter_read(no_parameters)
    try:
        engine.load_program(folder)
    except ProgramErrors as errors:
        for error in errors.errors:
            reporter(error)
    # A program with errors is drawn as far as it was loaded.
    graph = program_graph(engine, _collect_topics(folder, engine))
    text = dot_text(graph, folder.resolve().name)
    if options.json:
        print_json(_graph_to_json(graph))
    elif options.output is None:
        sys.stdout.write(text)
    elif suffix in TEXT_SUFFIXES:
        _write_file(options.output, text)
    else:
        draw_graph(text, options.output)
    return 1 if reporter.errors else 0


def _graph_to_json(graph: Graph) -> Dict[str, object]:
    return {
        "nodes": [node._asdict() for node in graph.nodes],
        "edges": [edge._asdict() for edge in graph.edges],
        "omitted": graph.omitted_count,
    }


def _get_output_format(path: Optional[Path]) -> str:
    """Return the output format by the suffix of a file; ``dot`` without a file.

    Raises:
        UsageError: if there is no format with this suffix.
    """
    suffix = "dot" if path is None else path.suffix[1:].lower()
    if suffix not in (*PICTURE_SUFFIXES, *TEXT_SUFFIXES):
        raise _unsupported_suffix(path, (*PICTURE_SUFFIXES, *TEXT_SUFFIXES))
    return suffix


def _collect_topics(folder: Path, engine: Engine) -> List[GraphTopic]:
    """Return the subscribed topics of pub_sub.xml and of the program's goals, with the names of their events."""
    topics = engine.with_requested_topics(
        read_topics(folder / TOPICS) if (folder / TOPICS).exists() else Topics()
    )
    return [GraphTopic(topic.topic, topics.functor_name_of(topic)) for topic in topics.subscribed]


PAGE_SUFFIXES = ("html", "htm")
"""Suffixes of files that become a page with a timeline."""

_PLOT_DESCRIPTION = """\
Run a program over bags, or read a run that "bag --events --json" has written, and draw its timeline: a row for each
event, for the waits of each query, for each memory, for each output, and with --open for what is open at the end. An
.html file is a page with zoom, which needs neither other files nor a network; .png, .svg and .pdf are drawn by
matplotlib.
"""


def add_plot_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``plot``."""
    parser = add_command("plot", help="draw the timeline of a run", description=_PLOT_DESCRIPTION)
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
    add_end_of_input(
        parser, "draw the declared states that are open at the end, and the windows that have not ended"
    )
    add_limits(parser)
    add_folders(parser)
    parser.set_defaults(run=draw_run, reject_usage=parser.error)


def draw_run(options: argparse.Namespace) -> int:
    """Run command ``plot``; return its exit status."""
    path, suffix = options.output, options.output.suffix[1:].lower()
    if suffix not in (*PAGE_SUFFIXES, *PICTURE_FORMATS):
        raise _unsupported_suffix(path, (*PAGE_SUFFIXES, *PICTURE_FORMATS))
    reporter = StderrReporter().attach()
    incomplete_files: Sequence[IncompleteFile] = ()
    if options.run_file is not None:
        if options.bags:
            options.reject_usage("give bags or --from, not both")
        with interruptible():
            timeline = _read_timeline(options.run_file)
        title = options.run_file.name
    else:
        if not options.bags or options.program is None:
            options.reject_usage("give bags with --program, or --from")
        # An error in the program does not prevent the drawing; it determines the exit status.
        timeline, incomplete_files = _record_timeline(options, reporter)
        bag_names = [Path(bag).name for bag in options.bags]
        more = f" and {len(bag_names) - MAX_BAGS_IN_TITLE} more" if len(bag_names) > MAX_BAGS_IN_TITLE else ""
        title = f"{options.program.resolve().name} over {', '.join(bag_names[:MAX_BAGS_IN_TITLE])}{more}"
        if incomplete_files:
            title += " (incomplete)"
    with interruptible():
        if suffix in PAGE_SUFFIXES:
            _write_file(path, timeline_page(timeline, title))
        else:
            draw_timeline(timeline, title, path)
    return exit_status_of(reporter.errors, incomplete_files)


def _read_timeline(path: Path) -> Timeline:
    try:
        with open(path, encoding="utf-8") as file:
            return read_run(file, str(path))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text: {error}") from error


def _record_timeline(
    options: argparse.Namespace, reporter: StderrReporter
) -> "Tuple[Timeline, Sequence[IncompleteFile]]":
    """Run the program over the bags; return the timeline of the run, and the incomplete files of the bags."""
    builder = TimelineBuilder()
    with open_bags(options) as bags:
        playback = create_playback(options, reporter, bags)
        recorder = RunRecorder(playback, builder.add_record)
        with show_progress("messages", lambda: elapsed_fraction(playback, bags)) as bar:

            def advance(message_count: int) -> None:
                recorder.update_waits()
                if bar is not None:
                    bar(message_count)

            # After the program is loaded: only the objects of the run are left to the collector.
            limit_gc_pauses()
            for output in playback.run(bags, advance, flush_time=timestamps.from_seconds(options.flush)):
                recorder.record_output(output)
        recorder.record_final_state()
        if options.prints_open:
            for record in open_records(playback.engine.program):
                builder.add_record(record)
    return builder.build(), bags.incomplete_files


def _unsupported_suffix(path: Optional[Path], suffixes: Sequence[str]) -> UsageError:
    names = ", ".join(f".{suffix}" for suffix in suffixes)
    return UsageError(f"--output {path}: expected a name that ends in one of {names}")


def _write_file(path: Path, text: str) -> None:
    with open_output(path) as file:
        file.write(text)
