"""Command ``bag``: runs a program over recorded bags, without ROS.

`play` runs a program over the bags of the options as one recording. With ``--jobs`` or ``--scheduler`` each bag is a
separate run (`play_separately`), in processes of this machine or on a Dask cluster, with results in the bags' order.
Each bag is then a `BagTask`, which a worker plays from the program's initial state (`play_bag`). With ``--parts``,
the parts of a split recording form a chain: a part is ready when the former one has finished, and continues from its
snapshot. `_OutcomeReporter` holds finished results back until all earlier ones have been printed, so that the output
does not depend on the number of workers.
"""

import argparse
import logging
import os
import shutil
import sys
import threading
from contextlib import ExitStack, closing, contextmanager, nullcontext, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Dict,
    Generator,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ..engine.engine_settings import Settings
from ..engine.run_records import RunRecord, open_records
from ..events.program.topic_configuration import TopicType, topic_type
from ..explanation.event_and_output_explanations import explain, record_origins
from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import RetalisError, UsageError
from ..foundation.garbage_collection import limit_gc_pauses, restore_gc
from ..foundation.interrupts import check_interrupt, exit_by_exception, interruptible
from ..foundation.output_files import print_json
from ..messages.type_definition import Definition, SerializationFormat
from ..playback.bag_locations import (
    MergedBag,
    find_bags,
    group_recordings,
    is_url,
    local_copy,
    remove_incomplete_results,
    result_file,
)
from ..playback.incomplete_files import INCOMPLETE_STATUS, IncompleteFile
from ..playback.mcap_writer import McapWriter
from ..playback.playback import (
    Output,
    Playback,
    RunRecorder,
    make_incomplete_file_record,
    make_output_record,
)
from ..playback.rosbag1 import BagWriter
from ..playback.run_tables import TABLE_TYPES, RunTable
from ..playback.worker_pools import Unfinished, run_in_processes
from ..prolog.syntax.event_text import to_text
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms import timestamps
from ..prolog.terms.types import Term, atom, functor
from .bag_tasks import BagOutcome, BagTask, create_tasks
from .command_options import (
    OPEN_HELP,
    add_chunk_limit_option,
    add_direct,
    add_end_of_input,
    add_folders,
    add_limits,
    add_message_folders,
    apply_folders,
    apply_limits,
    connect_answers,
    message_folders,
)
from .dask_cluster import (
    ClusterError,
    ClusterListener,
    add_cluster_options,
    cluster_options,
    make_listener,
    run_on_cluster,
)
from .event_and_solution_printer import JSON_HELP, Printer, TimeOrigin, redirect_goal_output
from .many_bags_options import (
    BAG_FORMATS,
    FORMATS,
    add_many_bags_options,
    check_many_bags_options,
    requests_separate_runs,
)
from .option_values import (
    RELATIVE_TIMES_OPTION,
    TIMES_AS_STAMPS,
    TIMES_RELATIVE,
    non_negative,
    parse_delay,
)
from .optional_ros_imports import installed_definitions
from .progress_bar import ProgressBar, show_long_progress, show_progress
from .result_manifest import find_whole_results, record_result, remove_result
from .result_partitions import utc_day
from .stderr_reports import LimitedText, StderrReporter, detach_reporters

if TYPE_CHECKING:
    from ..testing.rule_coverage import CoveredPart

log = logging.getLogger("retalis")

MCAP_SUFFIX = ".mcap"
"""Suffix of bags of ROS 2 that are written."""

_OTHER_SUFFIXES = (".db3", *(f".{name}" for name in FORMATS if name not in BAG_FORMATS))
"""Suffixes of files that are no bags, or bags that cannot be written."""

DESCRIPTION = """\
Run a program over bags and print its outputs, as output(TERM,TOPIC) terms. Several bags are played as one,
in the order of receipt.

A ROS 2 bag is a folder with metadata.yaml, or its .db3, .mcap, .db3.zstd or .mcap.zstd file.

With --jobs or --scheduler each bag is a separate run, several at a time. A folder stands for all bags below it,
sorted by name; URLs such as s3://BUCKET/FOLDER are allowed. The output is in the order of the bags.

Exit status 3: incomplete bags.
"""
JSON_LINES_HELP = """\
  {"incomplete": FILE, "problem": TEXT, "messages": N, "end": T, ...}    first, for incomplete bags
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}    unless --quiet; T is the bag's time
  {"event": TERM, "start": T1, "end": T2}                  with --events, and the two below
  {"wait": TERM, "memories": [ID, ...], "start": T1, "end": T2}    a query that has waited
  {"memory": ID, "pattern": TERM, "size": N, "records": N, "taken": N, "start": T1, "end": T2}    at the end
  {"open": TERM, "start": T}                               with --open, a declared state that is open at the end
  {"open_window": WINDOW, "rule": HEAD, "name": NAME, "key": {VARIABLE: TERM, ...}, "elements": N,
   "start": T1, "end": T2 or null}
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
    add(
        "-o",
        "--output",
        metavar="BAG",
        help=f"write the outputs to a bag ({MCAP_SUFFIX}: of ROS 2)",
    )
    add("--overwrite", action="store_true", help="replace an existing bag")
    add("-v", "--events", action="store_true", help="print each event too, as event(TERM,[T1,T2])")
    add(
        "--times",
        action="store_const",
        const=TIMES_AS_STAMPS,
        help="print the bag's time with each output, as datime(...)",
    )
    add(
        RELATIVE_TIMES_OPTION,
        action="store_const",
        const=TIMES_RELATIVE,
        dest="times",
        help="print all times in seconds since the start of the run",
    )
    add(
        "--explain",
        metavar="TERM",
        action="append",
        default=[],
        help="print why an event happened or not, in lines with %%",
    )
    add("--json", action="store_true", help="print one JSON object per line instead of terms")
    add("-q", "--quiet", action="store_true", help="print no outputs")
    add_end_of_input(parser, OPEN_HELP)
    _add_coverage_options(parser)
    add_many_bags_options(parser)
    add_cluster_options(parser)
    add_folders(parser)
    add_limits(parser)
    parser.set_defaults(run=run)


def _add_coverage_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("coverage").add_argument
    add(
        "--coverage",
        action="store_true",
        help="print the parts of the program that no bag uses, to standard error",
    )
    add("--html", type=Path, metavar="FILE", help="write it as HTML page")
    add("--cobertura", type=Path, metavar="FILE", help="write it as Cobertura XML")


def add_source(parser: argparse.ArgumentParser, bags: str = "+", required: bool = True) -> None:
    """Add the options that select the program, the bags and their messages."""
    add = parser.add_argument
    add("bags", nargs=bags, metavar="BAG", help="a bag of ROS 1 or ROS 2")
    add(
        "-p",
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
        help="skip this many seconds after the first message (0)",
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
        help="a further topic whose messages become events",
    )
    add("--strict", action="store_true", help="refuse incomplete bags")
    group = parser.add_argument_group("messages")
    add = group.add_argument
    add_message_folders(add)
    add_direct(add)
    add(
        "--max-skew",
        type=non_negative(float),
        metavar="SECONDS",
        help="skip messages whose stamp differs by more from earlier stamps of their topic and frame "
        "(0: no limit)",
    )
    add(
        "--max-gap",
        type=non_negative(float),
        metavar="SECONDS",
        help="do not interpolate over longer gaps (0: no limit)",
    )
    add(
        "--watermark-delay",
        type=parse_delay,
        metavar="SECONDS",
        help="time that absent, windows, debounce, states and timeouts wait for messages received later than their "
        "stamps (default: auto, the recent lag of their topics, at most 1; 0: do not wait)",
    )
    add(
        "--tf-cache",
        type=non_negative(float),
        metavar="SECONDS",
        help="history of transforms for tf_lookup and similar goals (default: 10)",
    )
    add_chunk_limit_option(add)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if requests_separate_runs(options):
        return play_separately(options)
    reporter = StderrReporter().attach(show_events=True)
    played = play(options, reporter)
    if _records_coverage(options):
        _report_coverage(options, played.coverage)
    return exit_status_of(reporter.errors, played.incomplete_files)


def exit_status_of(error_count: int, incomplete_files: Sequence[IncompleteFile]) -> int:
    """Return the exit status of a run over bags: 3 if there are no errors, but incomplete files."""
    return 1 if error_count else INCOMPLETE_STATUS if incomplete_files else 0


def _records_coverage(options: argparse.Namespace) -> bool:
    return bool(options.coverage or options.html or options.cobertura)


def _report_coverage(options: argparse.Namespace, parts: "Sequence[CoveredPart]") -> None:
    """Print and write the coverage as the options request it.

    Raises:
        UsageError: if a file cannot be written.
    """
    # Imported only for this report, because other runs start faster without it.
    from ..testing.html_report import write_html_report  # noqa: PLC0415
    from ..testing.rule_coverage import format_coverage, write_cobertura_report  # noqa: PLC0415

    if options.coverage:
        for line in format_coverage(parts):
            print(line, file=sys.stderr)
    if options.cobertura is not None:
        write_cobertura_report(options.cobertura, parts)
    if options.html is not None:
        write_html_report(options.html, f"Coverage of {options.program}", (), parts)


_OUTPUT_FUNCTOR = functor("output", 2)
_TIMED_OUTPUT_FUNCTOR = functor("output", 3)
"""Functors of printed outputs: term, topic and optionally the time."""


class PlayedRun(NamedTuple):
    """A finished run.

    Attributes:
        playback: the program in its final state.
        coverage: its parts with their uses; empty if the options do not request them.
        incomplete_files: what is missing in the bags.
    """

    playback: Playback
    coverage: "Tuple[CoveredPart, ...]"
    incomplete_files: Tuple[IncompleteFile, ...]


def play(
    options: argparse.Namespace,
    reporter: StderrReporter,
    table: Optional[RunTable] = None,
    state: Optional[bytes] = None,
    is_last: bool = True,
    location: Optional[str] = None,
    bags: Optional[MergedBag] = None,
) -> PlayedRun:
    """Play the bags of the options as one recording.

    Args:
        options: options of the command.
        reporter: receives errors.
        table: receives events and outputs; None to print them.
        state: snapshot of the program to continue from; None to start without state.
        is_last: whether no bag follows that continues these.
        location: URL of the only bag, which the options name as a local copy; None if it is no copy.
        bags: the bags, if the caller has opened them.
    """
    with ExitStack() as stack:
        # The bags are opened before the program is loaded, because rules may name fields of types that only a bag
        # defines.
        if bags is None:
            bags = stack.enter_context(open_bags(options))
        # Each line of output is JSON, so what goals print, also while the program is loaded, goes to standard error.
        output_format = _select_output_format(options)
        with redirect_stdout(sys.stderr) if options.json else nullcontext():
            playback = create_playback(
                options, reporter, bags, state, _records_coverage(options), output_format
            )
        recorder = None
        if _records_coverage(options):
            from ..testing.rule_coverage import CoverageRecorder  # noqa: PLC0415 - see `_report_coverage`

            recorder = CoverageRecorder(playback.engine, is_restored=state is not None)
        if options.json:
            redirect_goal_output(playback.engine.program.logic)
        # Recording costs time and memory per event, so it is switched on only for the explanations.
        if options.explain:
            record_origins(playback.engine)
        bar = stack.enter_context(show_progress("messages", lambda: elapsed_fraction(playback, bags)))
        printer = _RunPrinter(options, playback, bar, table, bags.start)
        # After the program is loaded: only the objects of the run are left to the collector.
        limit_gc_pauses()
        flush_time = timestamps.from_seconds(options.flush)
        incomplete_files = bags.incomplete_files
        if location is not None:
            incomplete_files = tuple(
                file._replace(path=file.path.replace(options.bags[0], location)) for file in incomplete_files
            )
        writer = None
        if options.output is not None:
            writer = stack.enter_context(_open_output(options, playback, bags, incomplete_files))
        printer.print_incomplete_files(incomplete_files)
        if table is not None:
            table.begin(playback.published_types(), playback.definitions, bags.start, bags.end)
        for output in playback.run(bags, printer.advance, is_last, flush_time):
            check_interrupt()
            printer.print_output(output)
            if writer is not None:
                writer.write(output)
        printer.finish()
    return PlayedRun(playback, () if recorder is None else tuple(recorder.parts()), incomplete_files)


def open_bags(options: argparse.Namespace) -> MergedBag:
    """Open the bags of the options."""
    with interruptible():
        return MergedBag(
            options.bags,
            options.start,
            options.duration,
            options.max_chunk_megabytes,
            message_folders(options),
            options.strict,
        )


def create_playback(
    options: argparse.Namespace,
    reporter: StderrReporter,
    bags: Optional[MergedBag] = None,
    state: Optional[bytes] = None,
    counts_uses: bool = False,
    output_format: SerializationFormat = SerializationFormat.ROS1,
) -> Playback:
    """Load the program of the options.

    Args:
        options: options of the command.
        reporter: receives errors.
        bags: bags whose message types are known when the program is loaded, for rules that name fields; None if the
            types of the system suffice.
        state: snapshot of the program to continue from; None to start without state.
        counts_uses: whether the parts of the program count their uses.
        output_format: serialization of the published messages.
    """
    settings = apply_limits(apply_folders(Settings(), options), options)
    settings = settings._replace(
        max_gap=options.max_gap or None, watermark_delay=options.watermark_delay, counts_uses=counts_uses
    )
    if options.tf_cache:
        settings = settings._replace(tf_cache=options.tf_cache)
    definitions = installed_definitions(message_folders(options))
    return Playback(
        options.program,
        reporter,
        _parse_topics(options.topic),
        settings,
        max_skew=options.max_skew or None,
        bag=bags,
        state=state,
        direct=options.direct,
        definitions=definitions,
        prepare=connect_answers(options, definitions),
        output_format=output_format,
    )


def elapsed_fraction(playback: Playback, bags: MergedBag) -> float:
    """Return the fraction of the bags' time that has been played, from 0 to 1."""
    length = bags.end - bags.start
    return (playback.clock.now() - bags.start) / length if length > 0 else 1.0


def _parse_topics(texts: List[str]) -> List[TopicType]:
    topics = []
    for text in texts:
        name, _, type_name = text.partition("=")
        try:
            topics.append(topic_type(name, type_name))
        except UsageError as error:
            raise UsageError(
                f"--topic {quote_shortened(text)}: expected TOPIC=package/Type: {error.message}"
            ) from None
    return topics


class _RunPrinter:
    """Printer of a run's events and outputs, with the progress bar."""

    def __init__(
        self,
        options: argparse.Namespace,
        playback: Playback,
        bar: Optional[ProgressBar],
        table: Optional[RunTable],
        start: int,
    ):
        self._options = options
        # Time to which printed times are relative; None for absolute times.
        self._origin = TimeOrigin(start) if options.times == TIMES_RELATIVE else None
        self._engine = playback.engine
        self._bar = bar
        self._table = table
        self._printer = Printer(options.json, False, None, self._origin)
        self._recorder: Optional[RunRecorder] = None
        if options.events and options.json:
            self._recorder = RunRecorder(playback, self._print_record)
        elif options.events:
            self._engine.on_event(self._print_event)

    def advance(self, message_count: int) -> None:
        """Update records and progress bar after a message; ``message_count`` messages have been processed."""
        if self._recorder is not None:
            self._recorder.update_waits()
        if self._bar is not None:
            self._bar(message_count)

    def print_incomplete_files(self, files: Iterable[IncompleteFile]) -> None:
        """Print the incomplete files of the bags as JSON; they are logged as warnings when they are opened."""
        if self._options.json:
            for file in files:
                self._print_record(make_incomplete_file_record(file))

    def print_output(self, output: Output) -> None:
        """Print an output."""
        if self._options.quiet:
            return
        if self._options.json:
            self._print_record(make_output_record(output), output)
            return
        self._clear_bar()
        topic = atom(output.topic)
        # The program's clock is the bag's, so each run over a bag prints the same times.
        if self._options.times:
            instant: Term = timestamps.to_term(int(output.time))
            if self._origin is not None:
                instant = self._origin.relative_seconds(output.time)
            print(f"{to_text((_TIMED_OUTPUT_FUNCTOR, output.term, topic, instant))}.")
        else:
            print(f"{to_text((_OUTPUT_FUNCTOR, output.term, topic))}.")

    def finish(self) -> None:
        """Print the summary and the requested explanations."""
        if self._recorder is not None:
            self._recorder.record_final_state()
        if self._options.prints_open:
            self._clear_bar()
            self._printer.print_open(open_records(self._engine.program))
        for query in self._options.explain:
            term = read_term(query, self._engine.operators, "--explain").term
            self._clear_bar()
            start = None if self._origin is None else self._origin.start
            self._printer.print_explanation(term, explain(self._engine, term, origin=start))

    def _print_event(self, *event: object) -> None:
        self._clear_bar()
        self._printer.print_event(*event)  # type: ignore[arg-type]

    def _print_record(self, run_record: RunRecord, output: Optional[Output] = None) -> None:
        self._clear_bar()
        record = run_record if self._origin is None else self._origin.relative_record(run_record)
        if self._table is None:
            # Not flushed, because a run can have many records.
            print_json(record, flush=False)
        else:
            self._table.write(record, output)

    def _clear_bar(self) -> None:
        if self._bar is not None:
            self._bar.clear()


def _select_output_format(options: argparse.Namespace) -> SerializationFormat:
    is_ros2 = options.output is not None and options.output.endswith(MCAP_SUFFIX)
    return SerializationFormat.CDR if is_ros2 else SerializationFormat.ROS1


@contextmanager
def _open_output(
    options: argparse.Namespace,
    playback: Playback,
    bags: MergedBag,
    incomplete_files: Iterable[IncompleteFile],
) -> "Iterator[_OutputWriter]":
    """Open the bag for outputs.

    Raises:
        UsageError: if the bag is one of those that are read, or exists and may not be overwritten.
    """
    path = Path(options.output)
    # Compared as resolved paths: overwriting would truncate the recording before it is read.
    if any(path.resolve() == Path(bag).resolve() for bag in options.bags):
        raise UsageError(f"--output {path}: this is the bag that is read")
    if path.is_dir():
        raise UsageError(
            f"--output {path} is a folder: expected a file; with --jobs, each bag has one in a folder"
        )
    if path.suffix in _OTHER_SUFFIXES:
        raise UsageError(
            f"--output {path}: expected the name of a bag, {path.stem}.bag or {path.stem}{MCAP_SUFFIX}; "
            "with --jobs, --format writes other files"
        )
    if path.exists() and not options.overwrite:
        raise UsageError(f"{path} already exists; --overwrite replaces it")
    if _select_output_format(options) is SerializationFormat.CDR:
        records = list(map(make_incomplete_file_record, incomplete_files))
        with McapWriter(path, options.overwrite, records) as mcap:
            yield _OutputWriter(
                lambda topic, definition: mcap.add(topic, definition, playback.published_quality(topic)),
                mcap.write,
            )
        return
    if path.suffix != ".bag" and any(topic.format is SerializationFormat.CDR for topic in bags.topics):
        log.warning(
            "--output %s: this becomes a bag of ROS 1; a name that ends in %s makes it one of ROS 2",
            path,
            MCAP_SUFFIX,
        )
    with BagWriter(path, options.overwrite) as bag:
        yield _OutputWriter(
            lambda topic, definition: bag.add(topic, definition, playback.is_latched(topic)), bag.write
        )


class _OutputWriter:
    """Writer of outputs into a bag, with one connection per topic.

    Args:
        add: adds a topic of a type to the bag; returns the first argument of ``write``.
        write: writes a message, with its time.
    """

    def __init__(self, add: Callable[[str, Definition], object], write: Callable[[object, int, bytes], None]):
        self._add = add
        self._write = write
        self._connections: Dict[str, object] = {}

    def write(self, output: Output) -> None:
        if output.definition is None or output.data is None:
            # Not a message; the error was reported.
            return
        # Names in a bag are absolute.
        topic = output.topic if output.topic.startswith("/") else f"/{output.topic}"
        if topic not in self._connections:
            self._connections[topic] = self._add(topic, output.definition)
        self._write(self._connections[topic], output.time, output.data)


_PROCESS_LOCK = threading.Lock()
"""Lock of standard output and the reports, which exist once per process: a Dask worker may have several threads."""


def play_bag(task: BagTask, scratch: str) -> BagOutcome:
    """Play a bag and write its result and manifest; all errors are part of the returned outcome."""
    if task.manifest is None:
        return _play_bag(task, scratch)[0]
    outcome = BagOutcome(0, "")

    def play_recorded() -> Tuple[Optional[Dict[str, Any]], List[str]]:
        nonlocal outcome
        outcome, files = _play_bag(task, scratch)
        fields = outcome._replace(state=None, coverage=())._asdict()
        return fields if outcome.failure is None else None, files

    try:
        record_result(task.manifest, scratch, play_recorded)
    except RetalisError as error:
        outcome = outcome._replace(failure=str(error), state=None)
    return outcome


def _play_bag(task: BagTask, scratch: str) -> Tuple[BagOutcome, List[str]]:
    """Play a bag and write its result; return the outcome, and the event files that the program has loaded."""
    stderr, failure, state, day = LimitedText(), "", None, ""
    shown_paths: Dict[str, str] = {}
    coverage: Tuple[CoveredPart, ...] = ()
    files: List[str] = []
    is_incomplete = False
    with _PROCESS_LOCK, redirect_stderr(stderr):
        reporter = StderrReporter().attach(show_events=True)
        try:
            with local_copy(task.location, scratch) as bag:
                shown_paths[bag] = task.location
                options = argparse.Namespace(**task.options, bags=[bag], output=None, overwrite=True)
                with open_bags(options) as bags:
                    day = utc_day(bags.start) if task.target.tail else ""
                    target = task.target.locate(day)
                    with result_file(target, scratch) as result:
                        shown_paths[result] = target
                        played = _play_to_file(result, bags, options, task, reporter)
                coverage, is_incomplete = played.coverage, bool(played.incomplete_files)
                files = sorted(map(str, played.playback.engine.program.rules.files.loaded))
                state = played.playback.engine.snapshot() if task.has_next_part else None
        except RetalisError as error:
            failure = str(error)
        except Exception as error:
            # An internal error in one bag must not stop the others.
            failure = f"{type(error).__name__}: {error}"
        finally:
            detach_reporters()
            restore_gc()
    messages = stderr.getvalue()
    # Messages name the bag and the result as the user gave them, not temporary files.
    for path, shown_path in shown_paths.items():
        messages, failure = messages.replace(path, shown_path), failure.replace(path, shown_path)
    outcome = BagOutcome(reporter.errors, messages, failure or None, state, coverage, is_incomplete, day)
    return outcome, files


def _play_to_file(
    result: str, bags: MergedBag, options: argparse.Namespace, task: BagTask, reporter: StderrReporter
) -> PlayedRun:
    with ExitStack() as stack:
        if task.format in BAG_FORMATS:
            # The recording has the outputs, so they are not printed.
            options.output, options.quiet = result, True
        elif task.format is not None:
            options.json = True
        table = None
        if task.format in TABLE_TYPES:
            table = stack.enter_context(TABLE_TYPES[task.format](result, task.labels, options.events))
        # Printed output becomes the result of the formats that consist of lines, and is discarded otherwise.
        printed_output_path = result if task.format in (None, "jsonl") else os.devnull
        file = stack.enter_context(open(printed_output_path, "w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(file))
        return play(options, reporter, table, task.state, not task.has_next_part, task.location, bags)


_TaskOutcome = Union[BagOutcome, Unfinished]


def play_separately(options: argparse.Namespace) -> int:
    """Play each bag in a run of its own, and print or store the results in order; return the exit status."""
    check_many_bags_options(options)
    if options.resume and _records_coverage(options):
        raise UsageError("--resume: whole results have no coverage: expected only one of both options")
    with ExitStack() as stack:
        # Otherwise the workers would continue, and leave their incomplete results.
        stack.enter_context(exit_by_exception())
        scratch = stack.enter_context(TemporaryDirectory(prefix="retalis-"))
        bags = find_bags(options.bags)
        recordings = group_recordings(bags) if options.parts else [[bag] for bag in bags]
        tasks, ready = create_tasks(options, recordings, scratch)
        stack.callback(_remove_incomplete_files, tasks)
        reporter = _OutcomeReporter(tasks, to_print=options.output is None)
        skipped_count = _skip_whole_results(tasks, ready, reporter) if options.resume else 0

        def count() -> int:
            # Results that are skipped take no time, so that they would falsify the rate.
            return reporter.finished_count - skipped_count

        bar = stack.enter_context(
            show_long_progress("bags", lambda: count() / (len(tasks) - skipped_count or 1))
        )
        listener = make_listener(bar, lambda number: tasks[number].location, "played", count)
        outcomes = stack.enter_context(
            closing(_run_tasks(options, tasks, ready, scratch, listener, lambda: bar(count())))
        )
        try:
            for number, outcome in outcomes:
                bar.clear()
                if isinstance(outcome, BagOutcome) and outcome.state is not None:
                    # The next part runs before other bags, so that few snapshots exist at a time: they are large.
                    tasks[number + 1] = tasks[number + 1]._replace(state=outcome.state)
                    ready.appendleft(number + 1)
                    outcome = outcome._replace(state=None)
                # The snapshot that the task started from is not needed any more, unless its worker had died.
                tasks[number] = tasks[number]._replace(state=None)
                reporter.add_outcome(number, outcome)
                bar(count())
        except ClusterError as error:
            hint = "; --resume continues the run" if reporter.finished_count else ""
            listener.report(f"error: {error}{hint}")
            reporter.fail_unfinished()
        if _records_coverage(options):
            _report_coverage(options, reporter.coverage)
        return reporter.finish()


def _remove_failed_result(task: BagTask) -> None:
    """Remove the result that an earlier run had for a bag, which would pass for one of this run."""
    if task.manifest is not None:
        try:
            remove_result(task.manifest)
        except RetalisError as error:
            print(f"error: {error}", file=sys.stderr)


def _remove_incomplete_files(tasks: List[BagTask]) -> None:
    manifests = [task.manifest.location for task in tasks if task.manifest is not None]
    targets = {target for task in tasks for target in task.target.list_local_paths()}
    remove_incomplete_results([*targets, *manifests])


def _skip_whole_results(tasks: List[BagTask], ready: Deque[int], reporter: "_OutcomeReporter") -> int:
    """Report the outcomes of the results that are whole, and remove their tasks; return their number."""
    manifests = [task.manifest for task in tasks if task.manifest is not None]
    starts = list(ready)
    outcomes, line = find_whole_results(manifests, starts)
    print(line, file=sys.stderr)
    for number, fields in outcomes.items():
        # With --any-version, another version may have written the manifest.
        known_fields = {name: fields[name] for name in BagOutcome._fields if name in fields}
        reporter.add_outcome(number, BagOutcome(**{"errors": 0, "stderr_text": "", **known_fields}))
    ready.clear()
    ready.extend(number for number in starts if number not in outcomes)
    return len(outcomes)


def _run_tasks(
    options: argparse.Namespace,
    tasks: List[BagTask],
    ready: Deque[int],
    scratch: str,
    listener: ClusterListener,
    update_bar: Callable[[], object],
) -> Generator[Tuple[int, _TaskOutcome], None, None]:
    # A cluster is not needed if all results are whole.
    if options.scheduler and ready:
        return run_on_cluster(play_bag, tasks, cluster_options(options), listener, ready)
    return run_in_processes(
        play_bag, tasks, options.jobs or 1, scratch, listener.on_worker_death, ready, update_bar
    )


class _OutcomeReporter:
    """Reporter of the outcomes of bags, in the order of the bags.

    Attributes:
        finished_count: number of bags that have finished or failed.
        coverage: parts of the program with the sums of their uses over the bags that have been reported.
    """

    def __init__(self, tasks: List[BagTask], to_print: bool):
        self._tasks = tasks
        self._to_print = to_print
        self._outcomes: Dict[int, _TaskOutcome] = {}
        self._next_to_report = 0
        self._error_count = 0
        self._failed_count = 0
        self._incomplete_count = 0
        self._message_counts: Dict[str, int] = {}
        self.finished_count = 0
        self.coverage: List[CoveredPart] = []

    def add_outcome(self, number: int, outcome: _TaskOutcome) -> None:
        """Store the outcome of a bag; report all outcomes whose predecessors have been reported."""
        self.finished_count += 1
        self._outcomes[number] = outcome
        # All later parts of a recording fail with one of its parts, because they would lack its state.
        while self._tasks[number].has_next_part and _get_failure(self._outcomes[number]) is not None:
            number, location = number + 1, self._tasks[number].location
            self.finished_count += 1
            self._outcomes[number] = Unfinished(f"not played: it goes on from {location}, which failed")
        while self._next_to_report in self._outcomes:
            self._report(self._tasks[self._next_to_report], self._outcomes.pop(self._next_to_report))
            self._next_to_report += 1

    def fail_unfinished(self) -> None:
        """Report the outcomes that are held back, and count all bags without an outcome as failed."""
        for number in range(self._next_to_report, len(self._tasks)):
            if number in self._outcomes:
                self._report(self._tasks[number], self._outcomes.pop(number))
            else:
                self._failed_count += 1

    def _report(self, task: BagTask, outcome: _TaskOutcome) -> None:
        failure = _get_failure(outcome)
        if isinstance(outcome, BagOutcome):
            self._error_count += outcome.errors
            self._incomplete_count += outcome.is_incomplete
            if outcome.coverage:
                from ..testing.rule_coverage import merge_parts  # noqa: PLC0415 - see `_report_coverage`

                # Added up bag by bag, since thousands of lists would need much memory.
                self.coverage = merge_parts([self.coverage, outcome.coverage])
            self._report_messages(task, outcome.stderr_text)
        # A worker of a cluster may have written to a folder of its own machine with the same path.
        target = task.target.head
        if isinstance(outcome, BagOutcome):
            target = task.target.locate(outcome.day)
        if failure is None and not (self._to_print or is_url(target) or os.path.exists(target)):
            failure = f"{target} is not seen here: this machine and the workers need to share its folder"
        if failure is not None:
            self._failed_count += 1
            _remove_failed_result(task)
            place = "" if failure.startswith(task.location) else f"{task.location}: "
            print(f"error: {place}{failure}", file=sys.stderr)
        elif self._to_print:
            with open(target, encoding="utf-8") as file:
                shutil.copyfileobj(file, sys.stdout)
            os.unlink(target)

    def _report_messages(self, task: BagTask, messages: str) -> None:
        """Print the errors and warnings of a bag, unless another bag had the same ones."""
        if not messages:
            return
        if messages not in self._message_counts:
            print(f"{task.location}:\n{messages}", end="", file=sys.stderr)
        self._message_counts[messages] = self._message_counts.get(messages, 0) + 1

    def finish(self) -> int:
        """Print a summary; return the exit status."""
        repeated_count = sum(self._message_counts.values()) - len(self._message_counts)
        if repeated_count:
            print(
                f"{repeated_count} more bags had the same errors and warnings as one before", file=sys.stderr
            )
        if self._failed_count:
            print(f"{self._failed_count} of {len(self._tasks)} bags failed", file=sys.stderr)
        if self._incomplete_count:
            print(f"{self._incomplete_count} of {len(self._tasks)} bags are incomplete", file=sys.stderr)
        if self._failed_count or self._error_count:
            return 1
        return INCOMPLETE_STATUS if self._incomplete_count else 0


def _get_failure(outcome: _TaskOutcome) -> Optional[str]:
    return outcome.reason if isinstance(outcome, Unfinished) else outcome.failure
