"""Command ``console``: an interactive Prolog top level over an engine.

The commands ``help``, ``apropos`` and ``make`` are not predicates. They are recognized here, unless the program
defines a predicate with the same name. Help texts are read from the page of predicates in the documentation, so that
there is one description of each. `LoadedFiles` implements reconsulting: a file that is loaded again replaces its
former clauses and rules.
"""

import argparse
import os
import sys
import time
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple, Union, cast

from ..engine.client_requests import decode_bindings, read_bindings
from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.runtime.problem_reports import Reports
from ..events.clock.clock import Clock
from ..events.rules.event_input_predicates import event_of
from ..foundation.displayed_text import printable
from ..foundation.errors import ProgramErrors, RetalisError, RuleError, SyntaxFault, UsageError
from ..foundation.garbage_collection import limit_gc_pauses
from ..foundation.interrupts import is_interrupted
from ..foundation.output_files import print_json
from ..prolog.builtins.tracer import Tracer
from ..prolog.syntax.term_reader import ReadTerm
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.types import COMMA, Atom, String, Term, Var, deref, functor
from . import node_console
from .command_options import add_answers, add_limits, apply_limits, connect_answers
from .help_search import all_entries, search
from .option_values import non_negative
from .optional_ros_imports import installed_definitions
from .stderr_reports import StderrReporter
from .toplevel_io import (
    QUIT_GOALS,
    PipedInput,
    TerminalInput,
    discard_unread_text,
    format_bindings,
    open_goal_text,
    read_clause,
)

PREDICATES_PAGE = "docs/reference/predicates.md"
MAX_HELP_LINES = 50
"""Limit for the lines of an answer."""
MAX_PAGE_ENTRIES = 3
"""Number of entries of other pages that describe a name, at most."""

CONSOLE_HELP = """\
GOAL.                 ask a goal; ";" asks for another solution, return for none
[FILE].               load a file or a program's folder; again, it replaces what it said before
make.                 load again all files that have changed
[user].               read clauses and rules that are typed, up to end_of_file.
event(E).             take an event that happens now; event(E,[T1,T2]) one with an interval
trace(GOAL).          show the ports that a goal passes; trace. and notrace. for all goals
help(NAME).           what a predicate does, as help(append) or help('append/3')
apropos(WORD).        the predicates with a word in their name or description
ctrl-C                end a goal
quit.                 end the console; so do exit., halt. and ctrl-D"""


class _PredicateRow(NamedTuple):
    """A row of the page of predicates: their indicators, a call with named arguments, and a description."""

    keys: List[str]
    call: str
    description: str


def help_lines(name: str, defined: Iterable[str]) -> List[str]:
    """Return the descriptions of the predicates with a name or an indicator.

    Args:
        name: name of predicates, or an indicator such as ``append/3``.
        defined: indicators of all predicates, including those of the program.
    """
    rows = [row for row in _read_rows() if any(_matches_name(name, key) for key in row.keys)]
    lines = [f"{row.call}\n    {row.description}" for row in rows]
    documented = {key for row in rows for key in row.keys}
    lines += [key for key in sorted(defined) if _matches_name(name, key) and key not in documented]
    if not rows:
        # Predicates and operators of retalis itself are described in other pages.
        word = name.partition("/")[0]
        entries = [entry for entry in search(word, all_entries()) if word in " ".join(entry.lines())]
        lines += ["\n".join(entry.lines()) for entry in entries[:MAX_PAGE_ENTRIES]]
    return lines[:MAX_HELP_LINES]


def apropos_lines(word: str, defined: Iterable[str]) -> List[str]:
    """Return a line for each predicate whose name or description contains a word; see `help_lines`."""
    lower_word = word.lower()
    documented: Set[str] = set()
    lines: List[str] = []
    for row in _read_rows():
        if lower_word in row.description.lower() or any(lower_word in key.lower() for key in row.keys):
            documented.update(row.keys)
            lines.append(f"{', '.join(row.keys)}: {row.description}")
    undocumented = [
        key
        for key in sorted(defined)
        if lower_word in key.lower() and key not in documented and key[0] != "$"
    ]
    lines += undocumented
    return (
        lines
        if len(lines) <= MAX_HELP_LINES
        else [*lines[:MAX_HELP_LINES], f"% and {len(lines) - MAX_HELP_LINES} more"]
    )


def _matches_name(name: str, key: str) -> bool:
    return name in (key, key.rpartition("/")[0])


def _read_rows() -> Iterator[_PredicateRow]:
    for line in _find_page().read_text(encoding="utf-8").split("\n"):
        # Rows of the tables begin with the indicator in code font. A vertical bar inside a cell is escaped, and
        # replaced by a zero byte while the row is split.
        if line.startswith("| ``"):
            cells = [cell.replace("\0", "|") for cell in line.replace("\\|", "\0").split(" | ")]
            keys = [key.strip() for key in cells[0].split("``")[1::2]]
            yield _PredicateRow(keys, cells[1].replace("``", "").strip(), cells[2].strip())


def _find_page() -> Path:
    """Return the page of predicates in the source tree or the installed package.

    Raises:
        UsageError: if it is in neither.
    """
    for root in Path(__file__).resolve().parents:
        for path in (root / PREDICATES_PAGE, root / "share" / "retalis" / PREDICATES_PAGE):
            if path.is_file():
                return path
    raise UsageError(f"{PREDICATES_PAGE} is neither in the source tree nor in an installed package")


_FileStates = Tuple[Tuple[str, int, int], ...]
"""Name, modification time in nanoseconds and size of each loaded file."""


class LoadedFiles:
    """The files and programs that were loaded into an engine, with reloading."""

    def __init__(self, engine: Engine):
        self._engine = engine
        self._file_states: Dict[Path, _FileStates] = {}

    def load(self, path: Path) -> List[str]:
        """Load a file, or the program in a folder, in place of its former version; return the changes.

        Raises:
            RetalisError: if the file has errors; the former version remains loaded.
        """
        is_reload = path in self._file_states
        try:
            if is_reload:
                return [f"{path} again", *(f"  {line}" for line in self._engine.reload(path))]
            self._engine.load_program(path)
            return []
        finally:
            # Also after an error, so that `make` tries again only after the file has changed.
            if is_reload or path.exists():
                self._file_states[path] = self._read_file_states(path)

    def find_changed(self) -> List[Path]:
        """Return the loaded files and folders with changed files."""
        return [path for path, states in self._file_states.items() if self._read_file_states(path) != states]

    def _read_file_states(self, path: Path) -> _FileStates:
        # A program may include further files, and a folder may get new ones: all of them count.
        deployment = self._engine.loaded_deployments().get(os.path.realpath(path))
        files = set() if deployment is None else {Path(file) for file in deployment.files}
        files |= set(path.iterdir()) if path.is_dir() else {path}
        return tuple(_read_file_state(file) for file in sorted(files))


def _read_file_state(path: Path) -> Tuple[str, int, int]:
    try:
        status = path.stat()
    except OSError:
        # The file was deleted.
        return str(path), 0, 0
    return str(path), status.st_mtime_ns, status.st_size


_QUERY_FUNCTORS = frozenset((functor("?-", 1), functor(":-", 1)))
_TRACE_FUNCTOR = functor("trace", 1)
_CONSULT_FUNCTOR = functor("consult", 1)
_HELP_FUNCTOR = functor("help", 1)
_APROPOS_FUNCTOR = functor("apropos", 1)

DEFAULT_SHOWN_SOLUTIONS = 10
"""Maximum number of solutions of a goal that are shown if the input is not a terminal."""

UNRESTRICTED = Settings(folders=None, write_folders=None)
"""Settings without restrictions of files: a typed goal may open the files that its user may open."""

DESCRIPTION = """\
Load files and answer goals. Files contain event rules, clauses and directives; a folder is a program with
goalPredicates.txt. A goal ends with a full stop; ";" prints another solution, return ends the goal. [FILE]. loads
a file, or replaces it if it was loaded before; make. loads all changed files again. [user]. reads typed clauses,
trace(GOAL). (or trace, GOAL.) prints the ports of a goal, help. lists the commands. Ctrl-C ends a goal, quit. or
ctrl-D ends the console. From a pipe, goals are read one after the other, and the first solutions of each are
printed.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``console``."""
    parser = add_command("console", help="ask goals, as at a Prolog top level", description=DESCRIPTION)
    add = parser.add_argument
    add(
        "files",
        nargs="*",
        type=Path,
        metavar="FILE",
        help="files of rules and clauses, or a program's folder",
    )
    add(
        "-g",
        "--goal",
        action="append",
        default=[],
        metavar="GOAL",
        help="ask this goal, then exit: with status 1 if it fails",
    )
    add(
        "--most",
        dest="max_solutions",
        type=non_negative(int),
        default=DEFAULT_SHOWN_SOLUTIONS,
        metavar="N",
        help=f"solutions shown for a goal read from a pipe ({DEFAULT_SHOWN_SOLUTIONS})",
    )
    add(
        "--json",
        action="store_true",
        help="print each solution of --goal as a JSON object of its variables, as query does",
    )
    add(
        "--node",
        metavar="/NAME",
        help="ask the node of this name, which runs, instead of an engine of its own",
    )
    add_answers(add)
    add_limits(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; the status is 1 if there was an error in goals from a pipe, or a goal of ``--goal`` failed."""
    if options.json and not options.goal:
        raise UsageError("console --json: expected a goal with --goal")
    if options.node is not None:
        return node_console.run(options)
    reporter = StderrReporter().attach(show_events=True)
    console = Console(reporter, apply_limits(UNRESTRICTED, options), options.max_solutions, options.json)
    connect_answers(options, installed_definitions())(console.engine)
    for path in options.files:
        console.load(path)
    # After the files are loaded: their clauses are exempted from later collections.
    limit_gc_pauses()
    if options.goal:
        for goal in options.goal:
            console.solve_goals(open_goal_text(goal))
    elif sys.stdin.isatty():
        console.solve_goals(TerminalInput(list_names=console.predicate_names))
        return 0
    else:
        console.solve_goals(PipedInput(sys.stdin))
    console.reports.sum_up()
    return 1 if reporter.errors or (options.goal and console.has_failed_goal) else 0


def _write_output(text: str) -> None:
    """Print the output of a goal without buffering, because the goal may run for long afterwards."""
    print(text, end="", flush=True)


def _write_error(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)


class Console:
    """A Prolog top level over an engine.

    Args:
        reporter: receives errors.
        settings: settings of the engine; by default `UNRESTRICTED`.
        max_solutions: maximum number of solutions of a goal if the input is not a terminal.
        as_json: whether to print solutions as JSON objects, and all other text to standard error.

    Attributes:
        has_failed_goal: whether a goal had no solution.
    """

    def __init__(
        self,
        reporter: StderrReporter,
        settings: Optional[Settings] = None,
        max_solutions: int = DEFAULT_SHOWN_SOLUTIONS,
        as_json: bool = False,
    ):
        self._as_json = as_json
        self.reports = Reports()
        self.engine = Engine(
            Clock(time.time_ns),
            UNRESTRICTED if settings is None else settings,
            self.reports,
            installed_definitions(),
        )
        self._loader = self.engine.program.loader
        # As in other top levels, singleton variables of loaded clauses are reported.
        self._loader.warn_of_singletons()
        self._files = LoadedFiles(self.engine)
        self.engine.on_output(self._print_output)
        self.logic = self.engine.program.logic
        self.logic.print_to(_write_error if as_json else _write_output, _write_error)
        self._reporter = reporter
        self._max_solutions = max_solutions
        self._is_tracing = False
        self.has_failed_goal = False
        self._input: Union[PipedInput, TerminalInput] = PipedInput(sys.stdin)

    def predicate_names(self) -> List[str]:
        """Return the names of all predicates, for completion."""
        return [key.name for key in self.logic.names()]

    def load(self, path: Path) -> bool:
        """Load a file, or the program in a folder, in place of its former version.

        Errors are reported.

        Returns:
            Whether it was loaded.
        """
        try:
            for line in self._files.load(_resolve_suffix(path)):
                self._print_text(f"% {printable(line)}")
        except ProgramErrors as errors:
            for error in errors.errors:
                self._reporter(error)
            return False
        except RetalisError as error:
            self._reporter(error)
            return False
        return True

    def solve_goals(self, source: Union[PipedInput, TerminalInput]) -> None:
        """Read and solve goals until the end of the input or ``halt``."""
        self._input = source
        if source.is_terminal:
            self.logic.read_lines_by(self._read_line)
        while True:
            try:
                clause = read_clause(source, self.logic, "?- ")
                if clause is None:
                    return
                if isinstance(clause, SyntaxFault):
                    self._reporter(clause)
                elif not self._solve_goal(clause):
                    return
            except KeyboardInterrupt:
                # At a terminal it ends the goal. With goals of a pipe or of --goal, it ends the command.
                if not source.is_terminal:
                    raise
                discard_unread_text(source)
                print("\n% interrupted", flush=True)

    def _read_line(self) -> Optional[str]:
        """Return a line of input for a goal that reads; None at the end."""
        self.logic.start_line()
        with self.logic.machine.budget.paused():
            return self._input.read_line("|: ")

    def _solve_goal(self, read_goal: ReadTerm) -> bool:
        """Solve a goal; return False if it ends the console."""
        goal = deref(read_goal.term)
        # `?- Goal.` and `:- Goal.` are accepted, as text is often pasted from a file.
        if goal.__class__ is tuple and goal[0] in _QUERY_FUNCTORS:
            goal = deref(goal[1])
        if goal.__class__ is Atom and goal.name in QUIT_GOALS and not self._is_user_defined(goal):
            return False
        # Alarms that became due while the user was typing precede the goal.
        self.engine.advance()
        # Commands and events are executed outside of `Engine.do`, as they call the engine themselves.
        if self._try_command(goal) or self._try_event(goal):
            return True
        is_traced = self._is_tracing
        if goal.__class__ is tuple and goal[0] is _TRACE_FUNCTOR:
            goal, is_traced = deref(goal[1]), True
        elif goal.__class__ is tuple and goal[0] is COMMA and _is_atom(goal[1], "trace"):
            goal, is_traced = deref(goal[2]), True
        self.engine.do(lambda: self._print_answers(goal, read_goal, is_traced), goal)
        return True

    def _try_command(self, goal: Term) -> bool:
        """Execute a goal that is a command of the console; return False if it is not one.

        The commands are help, apropos, make, lists of files, consult, trace and notrace.
        """
        if self._try_console_command(goal):
            return True
        if goal.__class__ is Atom and goal.name in ("trace", "notrace", "nodebug"):
            self._is_tracing = goal.name == "trace"
            self._print_truth(True)
            return True
        files: Optional[List[Term]] = None
        if goal.__class__ is tuple:
            files = list_items(goal)
            if files is None and goal[0] is _CONSULT_FUNCTOR:
                files = list_items(goal[1]) or [deref(goal[1])]
        # File names may be atoms or strings.
        names = [_get_text(name) for name in files] if files else []
        # A list with anything but names is a goal, not a list of files.
        if not names or None in names:
            return False
        loaded = [
            self._read_user_clauses() if name == "user" else self.load(Path(cast("str", name)))
            for name in names
        ]
        self._print_truth(all(loaded))
        return True

    def _try_console_command(self, goal: Term) -> bool:
        """Execute help, apropos or make, unless the program defines a predicate with this name."""
        if self._is_user_defined(goal):
            return False
        name = goal.name if goal.__class__ is Atom else ""
        if name == "make":
            self._print_truth(self._reload_changed_files())
            return True
        query = goal if goal.__class__ is tuple and goal[0] in (_HELP_FUNCTOR, _APROPOS_FUNCTOR) else None
        word = None if query is None else _get_text(query[1])
        if name == "help":
            lines = [CONSOLE_HELP]
        elif query is None or word is None:
            return False
        else:
            try:
                lines = (help_lines if query[0] is _HELP_FUNCTOR else apropos_lines)(
                    word, map(str, self.logic.names())
                )
            except UsageError as error:
                # The page of predicates was not copied with the package.
                self._reporter(error)
                return True
        self._print_text("\n".join(lines or [f"% nothing is known of {word}"]))
        return True

    def _reload_changed_files(self) -> bool:
        """Load all changed files again; return whether all were loaded."""
        loaded = [self.load(path) for path in self._files.find_changed()]
        return all(loaded)

    def _is_user_defined(self, goal: Term) -> bool:
        """Return whether the program defines the predicate of a goal."""
        key = goal[0] if goal.__class__ is tuple else getattr(goal, "functor", None)
        predicate = None if key is None else self.logic.database.predicates.get(key)
        return predicate is not None and predicate.kind == "user" and not predicate.is_library_predicate

    def _try_event(self, goal: Term) -> bool:
        """Process ``event(E)`` and ``event(E,[T1,T2])`` as events; return False for another goal."""
        try:
            event = event_of(goal) if goal.__class__ is tuple and goal[0].name == "event" else None
            if event is None:
                return False
            self.engine.event(event.term, *event.interval_terms())
            self._print_truth(True)
        except RetalisError as error:
            self._reporter(error)
        return True

    def _read_user_clauses(self) -> bool:
        """Read clauses up to the end of the input or ``end_of_file``, and add them."""
        while True:
            clause = read_clause(self._input, self.logic, "|: ")
            if clause is None or (
                not isinstance(clause, SyntaxFault) and _is_atom(clause.term, "end_of_file")
            ):
                return True
            if isinstance(clause, SyntaxFault):
                self._reporter(clause)
                continue
            try:
                if clause.singletons:
                    self._warn(f"singleton variables: {', '.join(clause.singletons)}", clause)
                self.engine.do(lambda: self._loader.load_terms([(clause.term, clause.place)]))  # noqa: B023
            except ProgramErrors as errors:
                for error in errors.errors:
                    self._reporter(error)
            except RetalisError as error:
                self._reporter(error)

    def _warn(self, text: str, clause: ReadTerm) -> None:
        print(f"warning: {RuleError(text, clause.place)}", file=sys.stderr)

    def _print_answers(self, goal: Term, read_goal: ReadTerm, is_traced: bool) -> None:
        logic = self.logic
        # The trace goes to stderr, so that the answers can be piped.
        tracer = Tracer(logic.machine, lambda line: print(line, file=sys.stderr))
        try:
            with tracer.on() if is_traced else nullcontext():
                print_solutions = self._print_json_solutions if self._as_json else self._print_solutions
                print_solutions(goal, read_goal.names)
        except RetalisError as error:
            # An interrupt ends the goal with an error, and is raised when this method has returned.
            if not is_interrupted():
                self._start_new_line()
                self._reporter(error if error.place else RuleError(error.message))
        finally:
            # Cleanup goals may write after the last answer. After an interrupt, the reader of a pipe may not read it.
            if not is_interrupted():
                self._start_new_line()
                sys.stdout.flush()

    def _print_solutions(self, goal: Term, names: Dict[str, Var]) -> None:
        choices = self.logic.machine.choices
        # A deterministic goal leaves only the choice point of the query itself. Its last solution ends with a full
        # stop, and the user is not asked.
        height = len(choices) + 1
        shown_count = 0
        with closing(self.logic.solutions(goal)) as solutions:
            for _ in solutions:
                self._start_new_line()
                text = format_bindings(names, self.logic.operators) or "true"
                print(text, end="", flush=True)
                shown_count += 1
                if len(choices) == height:
                    # No choice point is left, so there is no further solution.
                    print(".")
                    return
                if shown_count == self._max_solutions and not self._input.is_terminal:
                    print(" .\n% there may be more (see --most)")
                    return
                with self.logic.machine.budget.paused():
                    wants_more = self._input.wants_more()
                if not wants_more:
                    print(" .")
                    return
                print(" ;", flush=True)
                self.logic.start_line()
        self._start_new_line()
        if not shown_count:
            self.has_failed_goal = True
        print("false.")

    def _print_json_solutions(self, goal: Term, names: Dict[str, Var]) -> None:
        """Print each solution as a JSON object of the variables whose names do not begin with ``_``."""
        shown_names = {name: var for name, var in names.items() if not name.startswith("_")}
        choices = self.logic.machine.choices
        # See `_print_solutions`.
        height = len(choices) + 1
        shown_count = 0
        with closing(self.logic.solutions(goal)) as solutions:
            for _ in solutions:
                print_json(decode_bindings(read_bindings(self.engine, shown_names)))
                shown_count += 1
                if shown_count == self._max_solutions and len(choices) > height:
                    self._print_text("there may be more solutions (see --most)")
                    return
        self.has_failed_goal |= not shown_count

    def _start_new_line(self) -> None:
        """Start a new line if the goal has written an incomplete one."""
        if self.logic.column:
            self._print_text("")
            self.logic.start_line()

    def _print_output(self, term: Term, topic: str, name: Term) -> None:
        self._print_text(f"% {printable(topic)}: {self.engine.show(term)}")

    def _print_text(self, text: str) -> None:
        """Print a text that is not a solution."""
        print(text, file=sys.stderr if self._as_json else None, flush=True)

    def _print_truth(self, is_true: bool) -> None:
        """Print the result of a command or an event, as the solution of a goal without variables."""
        if not self._as_json:
            print("true." if is_true else "false.", flush=True)
        elif is_true:
            print_json({})
        self.has_failed_goal |= not is_true


def _is_atom(term: Term, name: str) -> bool:
    term = deref(term)
    return term.__class__ is Atom and term.name == name


def _get_text(term: Term) -> Optional[str]:
    term = deref(term)
    if term.__class__ is Atom:
        return str(term.name)
    return str(term.text) if term.__class__ is String else None


def _resolve_suffix(path: Path) -> Path:
    """Return a path, completed with a usual suffix if only that file exists."""
    if not path.exists():
        for suffix in (".pl", ".event", ".txt"):
            candidate = path.with_name(path.name + suffix)
            if candidate.exists():
                return candidate
    return path
