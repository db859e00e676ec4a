"""``events``: run a program over a stream of events."""

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Callable, Iterable, List, Optional, Sequence, Union

from ..engine import Engine, Settings, parts_of
from ..engine.explaining import explain, record_origins
from ..engine.runtime import Reports, StreamClock, limit_gc_pauses
from ..events.program import goal_of, read_goals, read_text
from ..events.rules import event_of
from ..foundation import ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
from ..prolog.machine import Frame, Machine
from ..prolog.syntax import Operators, ReadTerm, read_term
from ..prolog.terms import Term, deref, rebuild, timestamps, variables
from .folders import add_folders, allow_folders
from .limits import add_limits, limited
from .numbers import RELATIVE, RELATIVE_TIMES
from .printing import JSON, Printer
from .report import Report, to_reader
from .stream import Read, ReadLine, is_left_unread, read_stream

DESCRIPTION = """\
Call the goals, load the rules, feed the stream, and print each event in the order in which it happened, as
event(TERM,[T1,T2]). The stream is Prolog terms: event(TERM,[T1,T2])., event(TERM)., or any goal. The clock is the
stream's: event stamps and the goal sleep(Seconds) move it, and alarms follow it. Errors go to standard
error with their place; the exit status is 1 if there was one.
"""
LINES = """\
  {"event": TERM, "start": T1, "end": T2}           an event
  {"memory_event": TERM, "start": T1, "end": T2}    with --memory-events
  {"output": TERM, "topic": TOPIC, "id": ID, "time": T}    with --outputs, into that file
  {"query": GOAL, "solutions": [GOAL, ...]}         for each goal of --queries
  {"explain": TERM, "happened": true or false, "because": [{"text": LINE, "below": [...]}, ...]}
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = add_command(
        "events",
        help="run a program over a stream of events",
        description=DESCRIPTION,
        epilog=JSON + LINES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--rules", type=Path, action="append", default=[], metavar="FILE", help="event rules and clauses")
    add(
        "--goals",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="goals called first, one per line",
    )
    add("--stream", metavar="FILE", help="events and goals; - is standard input, read as it arrives")
    add("--outputs", metavar="FILE", help="write what subscribers get, as output(TERM,TOPIC,ID); - prints it")
    add("--queries", type=Path, metavar="FILE", help="goals whose solutions are printed at the end")
    add("--memory-events", action="store_true", help="print memory events too, as memory_event(TERM,[T1,T2])")
    add(
        "--explain",
        metavar="TERM",
        action="append",
        default=[],
        help="print at the end, in lines that start with %%, why such an event happened or what was missing; a term "
        "with variables, or event(TERM,[T1,T2])",
    )
    add(
        RELATIVE_TIMES,
        action="store_const",
        const=RELATIVE,
        dest="times",
        help="print explanations with times in seconds since the first event",
    )
    add("--clock", metavar="TERM", help="pin the clock to an instant: datime(2001,1,1,0,0,0,0) or seconds")
    add("--json", action="store_true", help="print one JSON object per line instead of terms")
    add_folders(parser)
    add_limits(parser)
    parser.set_defaults(run=run, wrong=parser.error)


def run(options: argparse.Namespace) -> int:
    """Run the command; the status is 1 if there was an error."""
    if not (options.rules or options.goals or options.stream or options.queries or options.explain):
        options.wrong("nothing to do: give --rules, --goals, --stream, --queries or --explain")
    report = Report().listen()
    with ExitStack() as stack:
        printer = Printer(options.json, options.memory_events, _opened(options.outputs, stack))
        session = Session(options, report, printer)
        session.load()
        limit_gc_pauses()
        session.feed()
        session.ask()
        session.reports.sum_up()
    sys.stdout.flush()
    if options.stream is None and is_left_unread():
        print("warning: standard input was not read; --stream - takes events from it", file=sys.stderr)
    return 1 if report.errors else 0


def _opened(name: Optional[str], stack: ExitStack) -> Optional[IO[str]]:
    if name is None:
        return None
    if name == "-":
        return sys.stdout
    try:
        return stack.enter_context(open(name, "w", encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot write {name}: {error.strerror}") from error


class Session:
    """One run: the engine and what it was asked to do."""

    def __init__(self, options: argparse.Namespace, report: Report, printer: Printer):
        self._options = options
        self._report = report
        self._printer = printer
        self._clock = StreamClock(0)
        self.reports = Reports()
        self.engine = Engine(self._clock, limited(allow_folders(Settings(), options), options), self.reports)
        self.engine.on_event(to_reader(printer.event))
        self.engine.on_output(to_reader(self._output))
        self._first: Optional[int] = None
        if options.times == RELATIVE:
            self.engine.on_event(self._note_first)
        parts_of(self.engine).logic.define_control("sleep", 1, self._sleep)
        if options.explain:
            record_origins(self.engine)
        if options.clock:
            stamp = read_term(options.clock, Operators.prolog(), "--clock").term
            try:
                self._clock.pin(timestamps.from_term(stamp))
            except UsageError as error:
                raise UsageError(f"--clock {options.clock}: {error.message}") from error

    def _output(self, term: Term, topic: str, name: Term) -> None:
        self._printer.output(term, topic, name, self._clock.now())

    def load(self) -> None:
        """Call the goals and load the rules; of a file with an error nothing is active, all else goes on."""
        for path in self._options.goals:
            self._try(self._load, self.engine.call_goals, path)
        for path in self._options.rules:
            self._try(self._load, self.engine.load_rules, path)

    def _load(self, take: Callable[[str, str, Path], None], path: Path) -> None:
        take(read_text(path), str(path), path.parent)

    def feed(self) -> None:
        """Feed the stream."""
        name = self._options.stream
        if name is None:
            return
        operators = self.engine.operators
        if name == "-":
            self._feed(read_stream(sys.stdin, operators, "standard input"))
            return
        with ExitStack() as stack:
            try:
                file = stack.enter_context(open(name, encoding="utf-8"))
            except OSError as error:
                raise UsageError(f"cannot read {name}: {error.strerror}") from error
            self._feed(read_stream(file, operators, name))

    def _feed(self, stream: Iterable[Read]) -> None:
        try:
            for item in stream:
                if isinstance(item, SyntaxFault):
                    self._report(item)
                else:
                    self._try(self._step, item)
        except UnicodeDecodeError as error:
            raise UsageError(f"the stream is not UTF-8 text: {error}") from error

    def _step(self, item: Union[ReadLine, ReadTerm]) -> None:
        try:
            self._do(goal_of(item.term))
        except RetalisError as error:
            raise (error if error.place else RuleError(error.message, item.place)) from error

    def _do(self, goal: Term) -> None:
        made = event_of(goal)
        if made is None:
            if not self.engine.call(goal):
                raise RuleError("this goal fails")
            return
        if made.end is not None:
            self._clock.move_to(made.end)
        self.engine.event_at(made.term, made.start, made.end)

    def ask(self) -> None:
        """Print the solutions of the queries, and the explanation."""
        if self._options.queries is not None:
            path = self._options.queries
            for goal in read_goals(read_text(path), self.engine.operators, str(path)):
                if isinstance(goal, SyntaxFault):
                    self._report(goal)
                else:
                    self._try(self._query, goal)
        for asked in self._options.explain:
            self._try(self._explain, asked)

    def _note_first(self, term: Term, start: int, end: int) -> None:
        self._first = int(start) if self._first is None else min(self._first, int(start))

    def _explain(self, asked: str) -> None:
        term = read_term(asked, self.engine.operators, "--explain").term
        self._printer.explanation(term, explain(self.engine, term, origin=self._first))

    def _query(self, goal: ReadTerm) -> None:
        found: List[Term] = []
        term = goal_of(goal.term)
        try:
            for answer in self.engine.query(term):
                values = dict(zip(variables(term), answer.values()))
                found.append(rebuild(term, values.__getitem__))
        except RetalisError as error:
            raise RuleError(error.message, goal.place) from error
        finally:
            self._printer.solutions(term, found)

    def _sleep(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Frame:
        """Let the stream's time pass: the goal ``sleep(Seconds)``."""
        seconds = deref(arguments[0])
        if not isinstance(seconds, (int, float)) or not 0 <= seconds < float("inf"):
            raise UsageError("sleep/1 needs a number of seconds, not a negative one")
        self._clock.move_by(timestamps.from_seconds(seconds))
        self.engine.advance()
        return after

    def _try(self, work: Callable[..., object], *arguments: object) -> None:
        """Do a piece of work and report what goes wrong."""
        try:
            work(*arguments)
        except ProgramErrors as errors:
            for error in errors.errors:
                self._report(error)
        except RetalisError as error:
            self._report(error)
