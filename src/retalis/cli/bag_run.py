"""A run of a program over bags, with printing of events and outputs, and recording of outputs into a bag."""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Callable, Dict, List, Optional

from ..engine.engine_settings import Settings
from ..events.program.topic_configuration import TopicType, topic_type
from ..explanation.explain import explain, record_origins
from ..foundation.cpython_and_pypy import limit_gc_pauses
from ..foundation.errors import UsageError, shortened
from ..playback.bag_locations import MergedBag
from ..playback.decompression import MAX_CHUNK_MEGABYTES
from ..playback.playback import Output, Playback, RunRecord, RunRecorder, output_record
from ..playback.rosbag1 import BagWriter
from ..prolog.syntax.event_text import to_text
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms import timestamps
from ..prolog.terms.types import Term, atom, functor
from .command_options import apply_folders, apply_limits
from .installed_types import installed_definitions
from .option_values import TIMES_RELATIVE, positive_integer
from .output import Printer
from .stderr_report import ProgressBar, StderrReporter, end_run_on_closed_pipe, show_progress

_OUTPUT_FUNCTOR = functor("output", 2)
_TIMED_OUTPUT_FUNCTOR = functor("output", 3)


RecordHandler = Callable[[RunRecord], None]


def add_chunk_limit_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that limits the decompressed size of chunks."""
    parser.add_argument(
        "--max-chunk-megabytes",
        type=positive_integer,
        default=MAX_CHUNK_MEGABYTES,
        metavar="N",
        help="maximum unpacked size of a chunk or a compressed message of a bag; for a compressed file, the larger "
        f"of this and 100 times its size ({MAX_CHUNK_MEGABYTES})",
    )


def print_record(record: RunRecord) -> None:
    """Print a record of a run as JSON."""
    print(json.dumps(record, ensure_ascii=False))


def play(
    options: argparse.Namespace,
    report: StderrReporter,
    write_record: RecordHandler = print_record,
    state: Optional[bytes] = None,
) -> Playback:
    """Play the bags of the options as one recording; return the program in its final state.

    Args:
        options: options of the command.
        report: receives errors.
        write_record: receives events and outputs if the options request JSON.
        state: snapshot of the program to continue from; None to start without state.
    """
    with ExitStack() as stack:
        # The bags are opened before the program is loaded, because rules may name fields of types that only a bag
        # defines.
        bags = stack.enter_context(open_bags(options))
        playback = create_playback(options, report, bags, state)
        # Recording costs time and memory per event, so it is switched on only for the explanations.
        if options.explain:
            record_origins(playback.engine)
        writer = _open_output(options, playback, stack)
        bar = stack.enter_context(show_progress("messages", progress_of(playback, bags)))
        printer = _RunPrinter(options, playback, bar, write_record, bags.start)
        # After the program is loaded: only the objects of the run are left to the collector.
        limit_gc_pauses()
        for output in playback.run(bags, printer.advance):
            printer.print_output(output)
            if writer is not None:
                writer.write(output)
        printer.finish()
    return playback


def open_bags(options: argparse.Namespace) -> MergedBag:
    """Open the bags of the options."""
    return MergedBag(options.bags, options.start, options.duration, options.max_chunk_megabytes)


def create_playback(
    options: argparse.Namespace,
    report: StderrReporter,
    bag: Optional[MergedBag] = None,
    state: Optional[bytes] = None,
) -> Playback:
    """Load the program of the options, with the message types of ``bag`` for its rules that name fields."""
    settings = apply_limits(apply_folders(Settings(), options), options)
    settings = settings._replace(max_gap=options.max_gap or None)
    if options.tf_cache:
        settings = settings._replace(tf_cache=options.tf_cache)
    limit = options.max_skew or None
    return Playback(
        options.program,
        report,
        _parse_topics(options.topic),
        settings,
        limit,
        bag,
        state,
        options.direct,
        installed_definitions(),
    )


def progress_of(playback: Playback, bags: MergedBag) -> Callable[[], float]:
    """Return a function that returns the elapsed share of the bags' time, from 0 to 1."""
    length = bags.end - bags.start
    return lambda: (playback.clock.now() - bags.start) / length if length > 0 else 1.0


def _parse_topics(texts: List[str]) -> List[TopicType]:
    topics = []
    for text in texts:
        name, _, type_name = text.partition("=")
        try:
            topics.append(topic_type(name, type_name))
        except UsageError as error:
            raise UsageError(
                f"--topic {shortened(text)}: expected TOPIC=package/Type: {error.message}"
            ) from None
    return topics


class _RunPrinter:
    """Printer of a run's events and outputs, with the progress bar."""

    def __init__(
        self,
        options: argparse.Namespace,
        playback: Playback,
        bar: Optional[ProgressBar],
        write_record: RecordHandler,
        start: int,
    ):
        self._options = options
        self._origin = start if options.times == TIMES_RELATIVE else None
        self._engine = playback.engine
        self._bar = bar
        self._write_record = write_record
        self._printer = Printer(options.json, False, None)
        self._recorder: Optional[RunRecorder] = None
        if options.events and options.json:
            self._recorder = RunRecorder(playback, end_run_on_closed_pipe(self._print_record))
        elif options.events:
            self._engine.on_event(end_run_on_closed_pipe(self._print_event))

    def advance(self, done: int) -> None:
        """Record that another message has been processed."""
        if self._recorder is not None:
            self._recorder.update_waits()
        if self._bar is not None:
            self._bar(done)

    def print_output(self, output: Output) -> None:
        """Print an output."""
        if self._options.quiet:
            return
        if self._options.json:
            self._print_record(output_record(output))
            return
        self._clear_bar()
        topic = atom(output.topic)
        # The program's clock is the bag's, so each run over a bag prints the same times.
        if self._options.times:
            instant: Term = timestamps.to_term(int(output.time))
            if self._origin is not None:
                instant = timestamps.to_seconds(output.time - self._origin)
            print(f"{to_text((_TIMED_OUTPUT_FUNCTOR, output.term, topic, instant))}.")
        else:
            print(f"{to_text((_OUTPUT_FUNCTOR, output.term, topic))}.")

    def finish(self) -> None:
        """Print the summary and the requested explanations."""
        if self._recorder is not None:
            self._recorder.record_final_state()
        for query in self._options.explain:
            term = read_term(query, self._engine.operators, "--explain").term
            self._clear_bar()
            self._printer.print_explanation(term, explain(self._engine, term, origin=self._origin))

    def _print_event(self, *event: object) -> None:
        self._clear_bar()
        self._printer.print_event(*event)  # type: ignore[arg-type]

    def _print_record(self, record: RunRecord) -> None:
        self._clear_bar()
        self._write_record(record)

    def _clear_bar(self) -> None:
        if self._bar is not None:
            self._bar.clear()


def _open_output(
    options: argparse.Namespace, playback: Playback, stack: ExitStack
) -> "Optional[_OutputWriter]":
    """Open the bag for outputs, if there is one."""
    if options.output is None:
        return None
    path = Path(options.output)
    # Compared as resolved paths: overwriting would truncate the recording before it is read.
    if any(path.resolve() == Path(bag).resolve() for bag in options.bags):
        raise UsageError(f"--output {path}: this is the bag that is read")
    if path.exists() and not options.overwrite:
        raise UsageError(f"{path} already exists; --overwrite replaces it")
    return _OutputWriter(stack.enter_context(BagWriter(path, options.overwrite)), playback.is_latched)


class _OutputWriter:
    """Writer of outputs into a bag, with one connection per topic."""

    def __init__(self, writer: BagWriter, is_latched: Callable[[str], bool]):
        self._writer = writer
        self._is_latched = is_latched
        self._connections: Dict[str, object] = {}

    def write(self, output: Output) -> None:
        if output.definition is None or output.data is None:
            # Not a message; the error was reported.
            return
        # Names in a bag are absolute.
        topic = output.topic if output.topic.startswith("/") else f"/{output.topic}"
        if topic not in self._connections:
            self._connections[topic] = self._writer.add(topic, output.definition, self._is_latched(topic))
        self._writer.write(self._connections[topic], output.time, output.data)
