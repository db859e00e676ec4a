"""``bag``: run a program over a bag, without ROS."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Callable, Dict, List

from ..engine import Settings
from ..engine.playback import BagReader, BagWriter, Output, Playback
from ..engine.runtime import relax
from ..events.program import TopicType, topic_type
from ..foundation import UsageError, shortened
from ..prolog.syntax import to_text
from ..prolog.terms import atom, functor
from .folders import add_folders, allow_folders
from .limits import add_limits, from_zero, limited
from .progress import progress
from .report import Report

OUTPUT = functor("output", 2)


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = add_command(
        "bag",
        help="run a program over a bag, without ROS",
        description="Feed a bag to a program and print what it publishes, as output(TERM,TOPIC) terms.",
    )
    parser.add_argument("bag", type=Path, help="a ROS 1 bag")
    parser.add_argument(
        "--program",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="folder with pub_sub.xml and goalPredicates.txt",
    )
    parser.add_argument("--output", type=Path, metavar="BAG", help="write what is published to a bag")
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="TOPIC=TYPE",
        help="a topic to turn into events, in addition to those in pub_sub.xml",
    )
    parser.add_argument(
        "--max-skew",
        type=from_zero(float),
        metavar="SECONDS",
        help="leave out messages whose stamp is further away from those before on their topic and frame; 0: none",
    )
    parser.add_argument(
        "--max-gap",
        type=from_zero(float),
        metavar="SECONDS",
        help="interpolate over no gap that is wider than that; 0: any",
    )
    parser.add_argument("--quiet", action="store_true", help="print no outputs")
    add_limits(parser)
    add_folders(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    report = Report().listen()
    with ExitStack() as stack:
        reader = stack.enter_context(BagReader(options.bag))
        settings = limited(allow_folders(Settings(), options), options)
        settings = settings._replace(max_gap=options.max_gap or None)
        limit = options.max_skew or None
        playback = Playback(options.program, report, _topics(options.topic), settings, limit)
        writer = None
        if options.output:
            writer = _OutputWriter(stack.enter_context(BagWriter(options.output)), playback.is_latched)
        advance = stack.enter_context(progress("messages", reader.messages))
        relax()
        for output in playback.run(reader, advance):
            if not options.quiet:
                print(f"{to_text((OUTPUT, output.term, atom(output.topic)))}.")
            if writer is not None:
                writer.write(output)
    return 1 if report.errors else 0


def _topics(texts: List[str]) -> List[TopicType]:
    topics = []
    for text in texts:
        name, _, kind = text.partition("=")
        try:
            topics.append(topic_type(name, kind))
        except UsageError as error:
            raise UsageError(
                f"--topic {shortened(text)}: expected TOPIC=package/Type: {error.message}"
            ) from None
    return topics


class _OutputWriter:
    """Writes outputs into a bag, a connection for each topic."""

    def __init__(self, writer: BagWriter, is_latched: Callable[[str], bool]):
        self._writer = writer
        self._is_latched = is_latched
        self._connections: Dict[str, object] = {}

    def write(self, output: Output) -> None:
        if output.definition is None or output.data is None:  # reported already
            return
        topic = output.topic if output.topic.startswith("/") else f"/{output.topic}"
        if topic not in self._connections:
            self._connections[topic] = self._writer.add(topic, output.definition, self._is_latched(topic))
        self._writer.write(self._connections[topic], output.time, output.data)
