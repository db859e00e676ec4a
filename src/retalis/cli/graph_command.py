"""Command ``graph``: draws the data flow of a program from topics through events and rules to outputs."""

import argparse
import sys
from pathlib import Path
from typing import Callable, List, Optional

from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.event_input import InputTopics
from ..events.program.topic_configuration import GOALS, TOPICS, Topics, read_topics
from ..foundation.errors import ProgramErrors, UsageError
from ..messages.type_definition import functor_name
from ..visualization.program_graph import PICTURE_SUFFIXES, GraphTopic, dot_text, draw_graph, program_graph
from .command_options import add_limits, apply_limits
from .installed_types import installed_definitions
from .stderr_report import StderrReporter

TEXT_SUFFIXES = ("dot", "gv")
"""Suffixes of files in the text format of Graphviz."""

DESCRIPTION = """\
Load a program and draw its graph: topics, events, rules, queries, memories, transforms, subscriptions, and the data
flow between them. The suffix of the file determines the format: .svg, .png and .pdf are drawn by Graphviz; .dot, or
no file, is the input text of Graphviz, which is not required for it.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``graph``."""
    parser = add_command("graph", help="draw a program", description=DESCRIPTION)
    add = parser.add_argument
    add(
        "folder",
        nargs="?",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="the program's folder, with goalPredicates.txt; the current one by default",
    )
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="where to draw it, as program.svg; without it the text is printed",
    )
    add_limits(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    report = StderrReporter().attach()
    # Before the program is loaded: a wrong suffix is reported at once.
    suffix = _get_output_format(options.output)
    folder = options.folder
    if not (folder / GOALS).is_file():
        raise UsageError(f"{folder.resolve()} is not a program: it has no file {GOALS}")
    engine = Engine(settings=apply_limits(Settings(), options), definitions=installed_definitions())
    input_topics = engine.input_topics
    # Goals may subscribe to topics during loading. They are recorded for the graph, and nothing is subscribed.
    input_topics.set_subscriber(lambda request: None)
    try:
        engine.load_program(folder)
    except ProgramErrors as errors:
        for error in errors.errors:
            report(error)
    # A program with errors is drawn as far as it was loaded.
    text = dot_text(program_graph(engine, _collect_topics(folder, input_topics)), folder.resolve().name)
    if options.output is None:
        sys.stdout.write(text)
    elif suffix in TEXT_SUFFIXES:
        _write_file(options.output, text)
    else:
        draw_graph(text, options.output)
    return 1 if report.errors else 0


def _get_output_format(path: Optional[Path]) -> str:
    """Return the output format by the suffix of a file; ``dot`` without a file."""
    suffix = "dot" if path is None else path.suffix[1:].lower()
    if suffix not in (*PICTURE_SUFFIXES, *TEXT_SUFFIXES):
        endings = ", ".join(f".{ending}" for ending in (*PICTURE_SUFFIXES, *TEXT_SUFFIXES))
        raise UsageError(f"--output {path}: expected a name that ends in one of {endings}")
    return suffix


def _collect_topics(folder: Path, input_topics: InputTopics) -> List[GraphTopic]:
    topics = input_topics.merge_with(read_topics(folder / TOPICS) if (folder / TOPICS).exists() else Topics())
    return [
        GraphTopic(name, topics.event_of(name) or functor_name(type_name))
        for name, type_name in topics.subscribed
    ]


def _write_file(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error
