"""Command ``events``: runs a program over a stream of events and goals from a file or a pipe.

The stream is Prolog text. A line that contains exactly one event is parsed by the fast `EventReader`; all other text,
such as terms over several lines, comments and errors, by the full Prolog parser. Terms are processed as soon as their
line is complete, so that a pipe can be read live.
"""

import argparse
import os
import re
import stat
import sys
from array import array
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Callable, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Set, Union

from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.program_check import find_absent_events
from ..engine.run_records import open_records
from ..engine.runtime.problem_reports import Reports
from ..events.clock.clock import StreamClock
from ..events.program.goal_file import goal_of, read_goals
from ..events.program.topic_configuration import read_text
from ..events.rules.event_input_predicates import event_of
from ..explanation.event_and_output_explanations import explain, record_origins
from ..foundation.errors import ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
from ..foundation.garbage_collection import collect_if_grown, limit_gc_pauses
from ..foundation.interrupts import check_interrupt, interruptible
from ..foundation.output_files import open_output
from ..foundation.source_places import Place, place_at_column
from ..prolog.machine.machine import Machine
from ..prolog.syntax.event_text import EventReader
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import ReadTerm, read_program, read_term
from ..prolog.terms import timestamps
from ..prolog.terms.term_traversal import rebuild, variables
from ..prolog.terms.types import Frame, Functor, Term, deref
from .command_options import (
    OPEN_HELP,
    add_end_of_input,
    add_folders,
    add_limits,
    apply_folders,
    apply_limits,
    connect_answers,
)
from .event_and_solution_printer import JSON_HELP, Printer, TimeOrigin, redirect_goal_output
from .option_values import RELATIVE_TIMES_OPTION, TIMES_RELATIVE
from .optional_ros_imports import installed_definitions
from .stderr_reports import StderrReporter


class EventLine(NamedTuple):
    """An event that has a line of the stream to itself, and the place of the line."""

    term: Term
    place: Place


StreamItem = Union[ReadTerm, EventLine, SyntaxFault]

_AMBIGUOUS_TEXT = re.compile(r"[\"`]|\b(?:inf|nan|True|False)\b")
"""Matches text that `EventReader` and the full parser may read differently: strings, back quotes, special numbers."""


def read_stream(file: IO[str], operators: Operators, source: str) -> Iterator[StreamItem]:
    """Yield each term of a stream when its last line has been read, and a `SyntaxFault` for each error.

    Raises:
        UsageError: if a line cannot be read.
    """
    unparsed_text = ""
    start_line = 1
    reader = EventReader(operators)
    for line_number, text in enumerate(_read_lines(file, source), 1):
        if not unparsed_text and text.startswith("event("):
            place = place_at_column(source, line_number, 1, text.rstrip("\n"))
            event = _parse_event_line(reader, text.rstrip(), place)
            if event is not None:
                yield event
                start_line = line_number + 1
                continue
        # Lines are collected until the parser finds no unfinished term at their end. Comments and quoted atoms may
        # contain full stops, so a full stop alone does not end a term.
        unparsed_text += text
        # Only a full stop can complete a term: without one, the lines read so far need not be parsed again.
        if "." not in text:
            continue
        terms = list(read_program(unparsed_text, operators, source, first_line=start_line))
        if not terms or not _is_unfinished(terms, unparsed_text, line_number):
            yield from terms
            unparsed_text, start_line = "", line_number + 1
    yield from read_program(unparsed_text, operators, source, first_line=start_line)


def _read_lines(file: IO[str], source: str) -> Iterator[str]:
    """Yield the lines of a file; an error of the operating system names the file."""
    try:
        while True:
            with interruptible():
                line = file.readline()
            if not line:
                return
            yield line
    except OSError as error:
        raise UsageError(f"cannot read {source}: {error.strerror}") from error


def _parse_event_line(reader: EventReader, text: str, place: Place) -> Optional[EventLine]:
    """Return the event of a line that contains only an event, or None.

    This is the usual case, and much faster than the full parser. Text that the two parsers read differently is left
    to the full parser.
    """
    if not text.endswith(").") or _AMBIGUOUS_TEXT.search(text):
        return None
    try:
        return EventLine(reader.read(text[:-1]), place)
    except SyntaxFault:
        # The line has several terms, or an error, which the full parser reports.
        return None


def _is_unfinished(terms: Sequence[StreamItem], text: str, line_number: int) -> bool:
    """Return whether the last term may continue in the next line."""
    for term in terms:
        if isinstance(term, SyntaxFault) and term.message.startswith("this comment is never closed"):
            return True
    # An error in an earlier line, or before a full stop at the end, cannot be corrected by further lines.
    last_term = terms[-1]
    if not isinstance(last_term, SyntaxFault) or last_term.place is None or text.rstrip().endswith("."):
        return False
    return last_term.place.line >= line_number


def has_unread_input(descriptor: int = 0) -> bool:
    """Return whether a pipe or file has unread data, without blocking."""
    try:
        import fcntl  # noqa: PLC0415 (not on Windows)
        import termios  # noqa: PLC0415
    except ImportError:
        return False
    try:
        mode = os.fstat(descriptor)
        # Only files and pipes are checked: text that is typed at a terminal is not meant for this command.
        if stat.S_ISREG(mode.st_mode):
            return mode.st_size > os.lseek(descriptor, 0, os.SEEK_CUR)
        if not stat.S_ISFIFO(mode.st_mode):
            return False
        unread_bytes = array("i", [0])
        fcntl.ioctl(descriptor, termios.FIONREAD, unread_bytes)
    except OSError:
        # The descriptor is closed.
        return False
    return unread_bytes[0] > 0


MAX_USUAL_DELAY_SECONDS = 10
"""Seconds by which an event may end before an earlier one without a warning, as events of sensors often do."""

DESCRIPTION = """\
Run rules over a stream, and print each event in the order in which it happened, as event(TERM,[T1,T2]).

The goals are called before the rules are loaded. The stream is Prolog terms: event(TERM,[T1,T2])., event(TERM)., or
any goal. The clock is the stream's: event stamps and the goal sleep(Seconds) move it, and alarms follow it. Errors go
to standard error with their place; the exit status is 1 if there was one.
"""
JSON_LINES_HELP = """\
  {"event": TERM, "start": T1, "end": T2}           an event
  {"memory_event": TERM, "start": T1, "end": T2}    with --memory-events
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}    with --outputs, into that file
  {"query": GOAL, "solutions": [GOAL, ...]}         for each goal of --queries
  {"open": TERM, "start": T}                        with --open, a declared state that is open at the end
  {"open_window": WINDOW, "rule": HEAD, "name": NAME, "key": {VARIABLE: TERM, ...}, "elements": N,
   "start": T1, "end": T2 or null}
  {"explain": TERM, "happened": true or false, "because": [{"text": LINE, "below": [...]}, ...]}
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``events``."""
    parser = add_command(
        "events",
        help="run a program over a stream of events",
        description=DESCRIPTION,
        epilog=JSON_HELP + JSON_LINES_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "-r",
        "--rules",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="event rules and clauses",
    )
    add(
        "-g",
        "--goals",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="goals called first, one per line",
    )
    add("-s", "--stream", metavar="FILE", help="events and goals; - is standard input, read live")
    add(
        "-o",
        "--outputs",
        metavar="FILE",
        help="write outputs, as output(TERM,TOPIC,ID); - prints them",
    )
    add("--queries", type=Path, metavar="FILE", help="goals whose solutions are printed at the end")
    add("--memory-events", action="store_true", help="print memory events too, as memory_event(TERM,[T1,T2])")
    add(
        "--explain",
        metavar="TERM",
        action="append",
        default=[],
        help="print why an event, or event(TERM,[T1,T2]), happened or not, in lines with %%",
    )
    add(
        RELATIVE_TIMES_OPTION,
        action="store_const",
        const=TIMES_RELATIVE,
        dest="times",
        help="print all times in seconds since the first event",
    )
    add("--clock", metavar="TERM", help="pin the clock: datime(2001,1,1,0,0,0,0) or seconds")
    add("--json", action="store_true", help="print one JSON object per line instead of terms")
    add_end_of_input(parser, OPEN_HELP)
    add_folders(parser)
    add_limits(parser)
    parser.set_defaults(run=run, reject_usage=parser.error)


def run(options: argparse.Namespace) -> int:
    """Run the command; the status is 1 if there was an error."""
    if not (options.rules or options.goals or options.stream or options.queries or options.explain):
        options.reject_usage("nothing to do: give --rules, --goals, --stream, --queries or --explain")
    reporter = StderrReporter().attach()
    with ExitStack() as stack:
        origin = TimeOrigin() if options.times == TIMES_RELATIVE else None
        output = _open_output(options.outputs, stack)
        printer = Printer(options.json, options.memory_events, output, origin)
        session = Session(options, reporter, printer, origin)
        session.load()
        limit_gc_pauses()
        session.process_stream()
        session.report_absent_events()
        session.print_results()
        session.reports.sum_up()
    sys.stdout.flush()
    if options.stream is None and has_unread_input():
        print("warning: standard input was not read; --stream - takes events from it", file=sys.stderr)
    return 1 if reporter.errors else 0


def _open_output(name: Optional[str], stack: ExitStack) -> Optional[IO[str]]:
    if name is None:
        return None
    if name == "-":
        return sys.stdout
    return stack.enter_context(open_output(name, keep_on_interrupt=True))


class Session:
    """A run of the command: the engine, the stream's clock, and the requested output.

    Attributes:
        engine: engine of the program.
        reports: counts of the engine's problems.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        reporter: StderrReporter,
        printer: Printer,
        origin: Optional[TimeOrigin],
    ):
        self._options = options
        self._reporter = reporter
        self._printer = printer
        self._clock = StreamClock(0, follows_events=True)
        self.reports = Reports()
        definitions = installed_definitions()
        self.engine = Engine(
            self._clock,
            # The clock follows the stamps, so an event with an earlier stamp does not lag: it is out of order.
            apply_limits(apply_folders(Settings(watermark_delay=0), options), options),
            self.reports,
            definitions,
        )
        connect_answers(options, definitions)(self.engine)
        if options.json:
            redirect_goal_output(self.engine.program.logic)
        # Registered before goals are called, because goals may cause events.
        self.engine.on_event(self._print_event)
        self._occurred: Set[Functor] = set()
        self.engine.on_output(self._print_output)
        self._origin = origin
        self._newest_end = -timestamps.MAX_TIMESTAMP
        self.engine.program.logic.define_control("sleep", 1, self._sleep)
        # Before any event: the causes of earlier events cannot be recovered.
        if options.explain:
            record_origins(self.engine)
        if options.clock:
            clock_term = read_term(options.clock, Operators.prolog(), "--clock").term
            try:
                self._clock.pin(timestamps.from_term(clock_term))
            except UsageError as error:
                raise UsageError(f"--clock {options.clock}: {error.message}") from error

    def _print_event(self, term: Term, start: int, end: int) -> None:
        self._occurred.add(term[0] if term.__class__ is tuple else term.functor)  # type: ignore[union-attr]
        self._printer.print_event(term, start, end)

    def report_absent_events(self) -> None:
        """Report awaited events that the stream does not have, if it has one with a similar name."""
        if self._options.stream is None or self._reporter.errors:
            return
        for error in find_absent_events(self.engine, self._occurred):
            self.reports.warning(error)

    def _print_output(self, term: Term, topic: str, name: Term) -> None:
        self._printer.print_output(term, topic, name, self._clock.now())

    def load(self) -> None:
        """Call the goals and load the rules; a file with an error is skipped, and the others are loaded.

        Raises:
            UsageError: if a file cannot be read.
        """
        for load, paths in (
            (self.engine.call_goals, self._options.goals),
            (self.engine.load_rules, self._options.rules),
        ):
            for path in paths:
                # A wrong path ends the command: a run without the file would print misleading events.
                text = read_text(path)
                self._call_reporting_errors(load, text, str(path), path.parent)

    def process_stream(self) -> None:
        """Process the stream."""
        name = self._options.stream
        if name is None:
            return
        operators = self.engine.operators
        if name == "-":
            self._process_terms(read_stream(sys.stdin, operators, "standard input"))
        else:
            try:
                file = open(name, encoding="utf-8")  # noqa: SIM115 - closed below
            except OSError as error:
                raise UsageError(f"cannot read {name}: {error.strerror}") from error
            with file:
                self._process_terms(read_stream(file, operators, name))
        self._end_stream()

    def _end_stream(self) -> None:
        if self._options.flush:
            end = self._clock.reached() + timestamps.from_seconds(self._options.flush)
            self._clock.fire_alarms(end, self.engine.advance)
            self._clock.move_to(end)
            self.engine.advance()
        self.engine.end_input()

    def _process_terms(self, stream: Iterable[StreamItem]) -> None:
        try:
            for item in stream:
                check_interrupt()
                collect_if_grown()
                if isinstance(item, SyntaxFault):
                    self._reporter(item)
                else:
                    self._call_reporting_errors(self._process_term, item)
        except UnicodeDecodeError as error:
            raise UsageError(f"the stream is not UTF-8 text: {error}") from error

    def _process_term(self, item: Union[EventLine, ReadTerm]) -> None:
        try:
            self._execute(goal_of(item.term), item.place)
        except RetalisError as error:
            raise (error if error.place else RuleError(error.message, item.place)) from error

    def _execute(self, goal: Term, place: Optional[Place]) -> None:
        event = event_of(goal)
        if event is None:
            # A goal of the stream is a command, so its failure is an error.
            if not self.engine.call(goal):
                raise RuleError("this goal fails")
            return
        if event.end is not None:
            if event.end < self._newest_end - MAX_USUAL_DELAY_SECONDS * timestamps.SECOND:
                self.reports.warning(
                    RuleError(
                        "the stream goes back in time here: rules match events by their stamps, and windows do not "
                        "measure events that are too late; sort the stream by end, unless this is intended",
                        place,
                    ),
                    kind="stream that goes back",
                    once=True,
                )
            self._newest_end = max(self._newest_end, event.end)
            if self._options.answers is not None and self._clock.reached():
                # Answers of services that are due before are events, too. Without answers, the engine fires the
                # alarms, because it first checks whether the stamp of the event may be wrong.
                self._clock.fire_alarms(event.end, self.engine.advance)
        ahead_count = self.engine.far_ahead_count
        self.engine.event(event.term, *event.interval_terms())
        # The events that follow a wrong stamp do not go back.
        if self.engine.far_ahead_count != ahead_count:
            self._newest_end = self._clock.reached()

    def print_results(self) -> None:
        """Print the solutions of the queries, and the explanations."""
        if self._options.queries is not None:
            path = self._options.queries
            for goal in read_goals(read_text(path), self.engine.operators, str(path)):
                check_interrupt()
                if isinstance(goal, SyntaxFault):
                    self._reporter(goal)
                else:
                    self._call_reporting_errors(self._print_solutions, goal)
        if self._options.prints_open:
            self._printer.print_open(open_records(self.engine.program))
        for term in self._options.explain:
            self._call_reporting_errors(self._print_explanation, term)

    def _print_explanation(self, text: str) -> None:
        term = read_term(text, self.engine.operators, "--explain").term
        start = None if self._origin is None else self._origin.start
        self._printer.print_explanation(term, explain(self.engine, term, origin=start))

    def _print_solutions(self, goal: ReadTerm) -> None:
        instances: List[Term] = []
        term = goal_of(goal.term)
        try:
            for answer in self.engine.query(term):
                # Each solution is printed as an instance of the goal, which can be read back as a term.
                values = dict(zip(variables(term), answer.values()))
                instances.append(rebuild(term, values.__getitem__))
        except RetalisError as error:
            raise RuleError(error.message, goal.place) from error
        finally:
            self._printer.print_solutions(term, instances)

    def _sleep(self, machine: Machine, arguments: Sequence[Term], frame: Frame) -> Frame:
        """Advance the stream's clock: the goal ``sleep(Seconds)``."""
        seconds = deref(arguments[0])
        if not isinstance(seconds, (int, float)) or not 0 <= seconds < float("inf"):
            raise UsageError("sleep/1: expected a number of seconds of 0 or more")
        self._clock.move_by(timestamps.from_seconds(seconds))
        self.engine.advance()
        return frame

    def _call_reporting_errors(self, function: Callable[..., object], *arguments: object) -> None:
        try:
            function(*arguments)
        except ProgramErrors as errors:
            for error in errors.errors:
                self._reporter(error)
        except RetalisError as error:
            self._reporter(error)
