"""``bag``: run a program over bags, without ROS."""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Callable, Dict, List, Optional

from ..engine import Settings
from ..engine.explaining import explain, record_origins
from ..engine.playback import BagSeries, BagWriter, Line, Output, Playback, RunLook, output_line
from ..engine.runtime import relax
from ..events.program import TopicType, topic_type
from ..foundation import UsageError, shortened
from ..prolog.syntax import read_term, to_text
from ..prolog.terms import atom, functor, timestamps
from .folders import add_folders, allow_folders
from .limits import add_limits, limited
from .numbers import from_zero
from .printing import JSON, Printer
from .progress import Bar, progress
from .report import Report, to_reader

OUTPUT = functor("output", 2)
TIMED_OUTPUT = functor("output", 3)

DESCRIPTION = """\
Feed bags to a program and print what it publishes, as output(TERM,TOPIC) terms. Bags are of ROS 1, compressed or
not, or of ROS 2: a folder with metadata.yaml, or its .db3 or .mcap file. Several bags are played as one, in the
order in which their messages came. ROS 2 messages are read as those of ROS 1 with the same names.
"""
LINES = """\
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}    unless --quiet; T is the bag's time
  {"event": TERM, "start": T1, "end": T2}                  with --events, and the two below
  {"wait": TERM, "memories": [ID, ...], "start": T1, "end": T2}    a query that has waited
  {"memory": ID, "pattern": TERM, "size": N, "records": N, "taken": N, "start": T1, "end": T2}    at the end
  {"explain": TERM, "happened": true or false, "because": [{"text": LINE, "below": [...]}, ...]}
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = add_command(
        "bag",
        help="run a program over bags, without ROS",
        description=DESCRIPTION,
        epilog=JSON + LINES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_source(parser)
    add = parser.add_argument
    add("--output", type=Path, metavar="BAG", help="write what is published to a bag")
    add("--overwrite", action="store_true", help="replace that bag if it is there")
    add("--events", action="store_true", help="print each event too, as event(TERM,[T1,T2])")
    add(
        "--times",
        action="store_true",
        help="print outputs with the bag's time, as output(TERM,TOPIC,datime(...))",
    )
    add(
        "--explain",
        metavar="TERM",
        action="append",
        default=[],
        help="print at the end why such an event happened or what was missing, in lines that start with %%",
    )
    add("--json", action="store_true", help="print one JSON object per line instead of terms")
    add("--quiet", action="store_true", help="print no outputs")
    add_limits(parser)
    add_folders(parser)
    parser.set_defaults(run=run)


def add_source(parser: argparse.ArgumentParser, bags: str = "+", required: bool = True) -> None:
    """Add the options that say which program takes which messages."""
    add = parser.add_argument
    add("bags", nargs=bags, type=Path, metavar="BAG", help="a bag of ROS 1 or ROS 2")
    add(
        "--program",
        type=Path,
        required=required,
        metavar="FOLDER",
        help="folder with pub_sub.xml and goalPredicates.txt",
    )
    add(
        "--start",
        type=from_zero(float),
        default=0.0,
        metavar="SECONDS",
        help="leave out what came earlier than so long after the first message (0)",
    )
    add("--duration", type=from_zero(float), metavar="SECONDS", help="end after so long (to the end)")
    add(
        "--topic",
        action="append",
        default=[],
        metavar="TOPIC=TYPE",
        help="a topic to turn into events, in addition to those in pub_sub.xml",
    )
    add(
        "--max-skew",
        type=from_zero(float),
        metavar="SECONDS",
        help="leave out messages whose stamp is further away from those before on their topic and frame "
        "(0: take all)",
    )
    add(
        "--max-gap",
        type=from_zero(float),
        metavar="SECONDS",
        help="interpolate over no gap that is wider than that (0: any gap)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    report = Report().listen(events=True)
    with ExitStack() as stack:
        bags = stack.enter_context(BagSeries(options.bags, options.start, options.duration))
        playback = playback_of(options, report, bags)
        if options.explain:
            record_origins(playback.engine)
        writer = _writer(options, playback, stack)
        bar = stack.enter_context(progress("messages", share_of(playback, bags)))
        show = _Shower(options, playback, bar)
        relax()
        for output in playback.run(bags, show.advance):
            show.output(output)
            if writer is not None:
                writer.write(output)
        show.finish()
    return 1 if report.errors else 0


def playback_of(options: argparse.Namespace, report: Report, bag: Optional[BagSeries] = None) -> Playback:
    """Return the program that the options name, loaded; it may name slots of the types of a bag."""
    settings = limited(allow_folders(Settings(), options), options)
    settings = settings._replace(max_gap=options.max_gap or None)
    limit = options.max_skew or None
    return Playback(options.program, report, _topics(options.topic), settings, limit, bag)


def share_of(playback: Playback, bags: BagSeries) -> Callable[[], float]:
    """Return what tells how much of the bags' time has passed, from 0 to 1."""
    length = bags.end - bags.start
    return lambda: (playback.clock.now() - bags.start) / length if length > 0 else 1.0


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


class _Shower:
    """Prints what happens in a run, and moves the bar."""

    def __init__(self, options: argparse.Namespace, playback: Playback, bar: Optional[Bar]):
        self._options = options
        self._engine = playback.engine
        self._bar = bar
        self._printer = Printer(options.json, False, None)
        self._look: Optional[RunLook] = None
        if options.events and options.json:
            self._look = RunLook(playback, to_reader(self._line))
        elif options.events:
            self._engine.on_event(to_reader(self._event))

    def advance(self, done: int) -> None:
        """Take note that another message has been taken."""
        if self._look is not None:
            self._look.look()
        if self._bar is not None:
            self._bar(done)

    def output(self, output: Output) -> None:
        """Print an output."""
        if self._options.quiet:
            return
        if self._options.json:
            self._line(output_line(output))
            return
        self._clear()
        topic = atom(output.topic)
        if self._options.times:
            instant = timestamps.to_term(timestamps.WholeSeconds(output.time))
            print(f"{to_text((TIMED_OUTPUT, output.term, topic, instant))}.")
        else:
            print(f"{to_text((OUTPUT, output.term, topic))}.")

    def finish(self) -> None:
        """Print what is known at the end."""
        if self._look is not None:
            self._look.finish()
        for asked in self._options.explain:
            term = read_term(asked, self._engine.operators, "--explain").term
            self._clear()
            self._printer.explanation(term, explain(self._engine, term))

    def _event(self, *event: object) -> None:
        self._clear()
        self._printer.event(*event)  # type: ignore[arg-type]

    def _line(self, line: Line) -> None:
        self._clear()
        print(json.dumps(line, ensure_ascii=False))

    def _clear(self) -> None:
        if self._bar is not None:
            self._bar.clear()


def _writer(options: argparse.Namespace, playback: Playback, stack: ExitStack) -> "Optional[_OutputWriter]":
    """Open the bag that is written, if one is."""
    path = options.output
    if path is None:
        return None
    if any(path.resolve() == bag.resolve() for bag in options.bags):
        raise UsageError(f"--output {path}: this is the bag that is read")
    if path.exists() and not options.overwrite:
        raise UsageError(f"{path} already exists; --overwrite replaces it")
    return _OutputWriter(stack.enter_context(BagWriter(path, options.overwrite)), playback.is_latched)


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
