"""Prolog system: the interface of a Prolog to Python.

`PrologSystem` adds clauses, runs directives and goals, compiles goals for Python, and prints terms. The module also
contains two services of a running system:

* `Tracer` runs goals in the box model of Byrd: it interprets clauses and reports each port (call, exit, redo, fail,
  exception) that a goal passes.
* `machine_state`, `restore_machine` and `repair_after_interrupt` return a machine to an earlier state after an
  interrupt at any point.
"""

import sys
from contextlib import contextmanager
from time import time_ns
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Generator,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.errors import MAX_SHOWN_CHARACTERS, Place, printable
from ..builtins.builtin_registry import control
from ..builtins.grammar_and_ssu_rules import (
    SINGLE_SIDED,
    is_error_clause_body,
    translate_rule,
    translate_single_sided,
)
from ..builtins.text_streams import end_captures
from ..compiler.clause_nodes import CALL
from ..database.clause_index import Clause
from ..database.compiled_goal import CompiledGoal
from ..database.goal_interpreter import check_body, functor_of, split_clause
from ..database.predicate import COMPILE_AFTER, Predicate
from ..machine.errors import PrologError, permission_error
from ..machine.machine import Code, Guard, Machine
from ..machine.resource_limits import Budget, BudgetState, Limits
from ..syntax.operators import Operators
from ..syntax.term_writer import named_message_portray, write_term
from ..terms.term_traversal import copy
from ..terms.types import (
    COLON,
    COMMA,
    Atom,
    CompoundTerm,
    Frame,
    Functor,
    Term,
    Values,
    Var,
    deref,
    functor,
)
from ..terms.unification import undo, unify
from .predicate_resolution import PredicateTable
from .undefined_procedures import UndefinedProcedures, find_similar

if TYPE_CHECKING:
    from ...events.program.file_and_library_names import SourceFiles

_UNREPORTED_GOALS = frozenset(functor(name, 0) for name in ("true", "!", "fail", "false", "otherwise"))
"""Goals without ports in a trace."""

_CONTROL_CONSTRUCTS = frozenset(
    functor(name, arity)
    for name, arity in ((";", 2), ("|", 2), ("->", 2), ("*->", 2), ("\\+", 1), ("call", 1))
)
"""Constructs without ports in a trace; the goals in them have ports."""


class _TracedCall:
    """Traced call: its goal, its depth, and whether it has exited with choice points, so that it can be retried."""

    __slots__ = ("goal", "depth", "has_exited")

    def __init__(self, goal: Term, depth: int):
        self.goal = goal
        self.depth = depth
        self.has_exited = False


class Tracer:
    """Tracer that interprets goals and reports each port that they pass.

    Clauses of the program are interpreted while it is on. A predicate of the system is a single call, but the goals
    that it calls are traced.

    Args:
        logic: the predicates.
        write_line: called with a line for each port.
    """

    def __init__(self, logic: PredicateTable, write_line: Callable[[str], None]):
        self._logic = logic
        self._write_line = write_line
        self._control = logic.control
        self._choices = logic.machine.choices
        self._trail = logic.machine.trail
        self._depth = 0
        self._guard_code = Guard("trace", self._on_unwind)
        self._guard_code.run = self._on_failure
        self._exit_code = Code("trace exit", self._on_exit)
        self._redo_code = Code("trace redo", self._on_redo)
        self._next_clause_code = Code("trace clause", self._next_clause)

    @contextmanager
    def on(self) -> Iterator[None]:
        """Return a context in which goals are traced."""
        self.start()
        try:
            yield
        finally:
            self.stop()

    def start(self) -> None:
        """Start tracing."""
        # An instance attribute hides the method, so that calls need no test whether tracing is on.
        control = self._control
        self._untraced_solve = control.solve
        control.solve = self._logic.database.solve = self.solve  # type: ignore[method-assign]

    def stop(self) -> None:
        """Stop tracing."""
        control = self._control
        if control.solve == self.solve:
            del control.solve
            self._logic.database.solve = control.solve

    def solve(self, goal: Term, height: int, continuation: Frame) -> Optional[Frame]:
        """Return the frame that runs a goal with reports of its ports; see `Control.solve`."""
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] is COMMA:
            continuation = (self._control.code, goal[2], height, continuation)
            goal = deref(goal[1])
        if goal.__class__ is tuple and goal[0] is COLON:
            return self.solve(self._logic.database.modules.resolve_qualified_goal(goal), height, continuation)
        key = _functor_of(goal)
        if key is None or key in _UNREPORTED_GOALS or key in _CONTROL_CONSTRUCTS:
            return self._untraced_solve(goal, height, continuation)
        return self._call(goal, key, continuation)

    def _call(self, goal: Term, key: Functor, continuation: Frame) -> Optional[Frame]:
        self._depth += 1
        call = _TracedCall(goal, self._depth)
        self._report_port("Call", call)
        # The guard lies below the choice points of the call: backtracking reaches it when the call has failed, and an
        # exception unwinds it.
        base = len(self._choices)
        self._choices.append((self._guard_code, call, len(self._trail)))
        exit_frame = (self._exit_code, call, base, continuation)
        predicate = self._logic.lookup(key) or self._logic.database.predicate(key)
        if predicate.kind == "user" and not predicate.is_library_predicate:
            arguments = goal[1:] if goal.__class__ is tuple else ()
            clauses = list(predicate.active_clauses())
            return self._next_clause((self._next_clause_code, arguments, clauses, 0, exit_frame, call, None))
        return self._untraced_solve(goal, base + 1, exit_frame)

    def _next_clause(self, entry: Frame) -> Optional[Frame]:
        """Try the remaining clauses of a call."""
        _, arguments, clauses, start, exit_frame, call, _ = entry
        self._depth = call.depth
        trail = self._trail
        mark = len(trail)
        height = len(self._choices)
        for index in range(start, len(clauses)):
            clause = clauses[index]
            new_vars: Dict[Var, Term] = {}
            head = copy(clause.head, new_vars)
            head_args = head[1:] if head.__class__ is tuple else ()
            if all(unify(argument, head_arg, trail) for argument, head_arg in zip(arguments, head_args)):
                if index + 1 < len(clauses):
                    self._choices.append(
                        (self._next_clause_code, arguments, clauses, index + 1, exit_frame, call, mark)
                    )
                return self._control.solve(copy(clause.body, new_vars), height, exit_frame)
            undo(trail, mark)
        return None

    def _on_exit(self, frame: Frame) -> Frame:
        continuation: Frame
        _, call, base, continuation = frame
        self._report_port("Exit", call)
        self._depth = call.depth - 1
        if len(self._choices) == base + 1:
            self._choices.pop()
        else:
            # On top of the call's choice points: backtracking into the call passes its redo port first.
            call.has_exited = True
            self._choices.append((self._redo_code, call, len(self._trail)))
        return continuation

    def _on_redo(self, entry: Frame) -> None:
        call = entry[1]
        call.has_exited = False
        self._depth = call.depth
        self._report_port("Redo", call)

    def _on_failure(self, entry: Frame) -> None:
        self._report_port("Fail", entry[1])
        self._depth = entry[1].depth - 1

    def _on_unwind(self, entry: Frame) -> None:
        call = entry[1]
        if not call.has_exited:
            self._report_port("Exception", call)
        self._depth = call.depth - 1

    def _report_port(self, port: str, call: _TracedCall) -> None:
        text = write_term(
            call.goal, self._logic.operators, quoted=True, numbervars=True, spacing=True, priority=999
        )
        self._write_line(f"{port:>9}: ({call.depth}) {text}")


def _functor_of(goal: Term) -> Optional[Functor]:
    """Return the functor of a goal, or None for a term that is no goal."""
    if goal.__class__ is tuple:
        key: Functor = goal[0]
        return key
    return goal.functor if goal.__class__ is Atom else None


@control("trace/1")
def trace(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal and write a line to the error output for each port that it passes."""
    logic = machine.logic
    tracer = Tracer(logic, lambda line: logic.error_output(f"{line}\n"))
    tracer.start()
    # Tracing must stop when the goal fails, exits or raises, and start again when it is retried: the guard and the
    # codes below do that at the corresponding points of the choice point stack.
    height = len(machine.choices)
    machine.choices.append((_TRACE_GUARD, tracer, len(machine.trail)))
    return tracer.solve(args[0], height + 1, (_EXIT_TRACE, machine, tracer, height, continuation))


def _exit_trace(frame: Frame) -> Frame:
    """Stop tracing when the traced goal exits; backtracking into it starts tracing again."""
    machine: Machine
    tracer: Tracer
    continuation: Frame
    _, machine, tracer, height, continuation = frame
    tracer.stop()
    if len(machine.choices) == height + 1:
        machine.choices.pop()
    else:
        machine.choices.append((_RESUME_TRACE, tracer, len(machine.trail)))
    return continuation


_TRACE_GUARD = Guard("trace", lambda entry: entry[1].stop())
_EXIT_TRACE = Code("trace", _exit_trace)
_RESUME_TRACE = Code("trace", lambda entry: entry[1].start())


class MachineState(NamedTuple):
    """Position of a machine, to which `restore_machine` returns it.

    Attributes:
        height: height of the choice point stack.
        mark: length of the trail.
        budget: state of the budget.
    """

    height: int
    mark: int
    budget: BudgetState


def machine_state(machine: Machine) -> MachineState:
    """Return the current position of a machine."""
    return MachineState(len(machine.choices), len(machine.trail), machine.budget.snapshot())


def restore_machine(machine: Machine, state: Optional[MachineState]) -> None:
    """Return a machine to an earlier position, or to its idle one if it is None, and unwind the guards above it."""
    height, mark = machine.idle_lengths if state is None else state[:2]
    budget, choices = machine.budget, machine.choices
    while len(choices) > height:
        entry = choices[-1]
        # The entry is deleted after its guard has run: an interrupt in between repeats the guard and does not lose
        # it.
        if entry[0].__class__ is Guard:
            entry[0].unwind(entry)
        del choices[-1:]
    undo(machine.trail, mark)
    budget.restore(None if state is None else state.budget)


def repair_after_interrupt(logic: Any) -> None:
    """Restore the invariants of data that outlives a goal after an interrupt; no goal may be running."""
    end_captures(logic)
    logic.new_goals = None
    logic.database.modules.reset_loading()
    # An interrupted trace leaves its method on the instance; see `Tracer.start`.
    vars(logic.control).pop("solve", None)
    logic.database.solve = logic.control.solve
    for predicate in list(logic.database.predicates.values()):
        predicate.repair()
    for value in list(logic.state.values()):
        if hasattr(value, "repair"):
            value.repair()


_DIRECTIVE = functor(":-", 1)
_QUERY = functor("?-", 1)
_GRAMMAR_RULE = functor("-->", 2)
_FLAGS_LOCKED = "goals of services and the dashboard may not change flags: set the parameter ~allow_flags"


class UserStream:
    """Stream ``user_output`` or ``user_error``, which escapes control characters that terminals and logs interpret.

    Args:
        budget: limits the output of an entry.
        write: prints a text.
    """

    def __init__(self, budget: Budget, write: Callable[[str], None]):
        self._budget = budget
        self._write = write

    def __call__(self, text: str) -> None:
        """Write a text.

        Raises:
            LimitError: if the text exceeds the limit of output; none of it is written.
        """
        # Counted before it is processed, so that a text that is too long costs nothing. Escapes and multibyte
        # characters are added once they are known.
        self._budget.count_output(len(text))
        escaped = printable(text)
        added_bytes = len(escaped.encode()) - len(text)
        if added_bytes:
            self._budget.count_output(added_bytes)
        self._write(escaped)


class PrologSystem(PredicateTable):
    """Prolog system: clauses, predicates in Python, and goals.

    Args:
        operators: operator table of the program; by default the standard one.
        compile_after: calls of an unchanged predicate after which it is compiled.

    Attributes:
        output: called with text that the program prints.
        column: column at which the next text is printed.
        now: returns the current time in nanoseconds.
        error_output: called with text printed to ``user_error``, and with warnings.
        globals: global variables by name.
        state: data that built-ins store by name, such as counters and tables.
        swi_files: files that the program has loaded into SWI-Prolog, by name.
        foreign_modules: names or paths of the Python modules that the program has loaded.
        files: opens files for goals; None if goals may open none.
        undefined_procedures: handles calls of undefined procedures.
        ask: returns the next line that the user types, None at the end of input; None if there is no user.
        environment: environment variables of the process; None if the program may not read them.
        is_serving_client: whether the current work is done for a client and not for the program; see
            `serving_client`.
        allow_flags: whether goals of clients, including those that they add to the program, may change flags.
        new_goals: goals compiled since `precompiling_goals` began; None outside of it.
    """

    def __init__(self, operators: Optional[Operators] = None, compile_after: int = COMPILE_AFTER):
        super().__init__(operators, compile_after)
        self.database.call_undefined = self._call_undefined
        self.undefined_procedures = UndefinedProcedures(self)
        self.globals: Dict[str, Term] = {}
        self.column = 0
        self.output: Callable[[str], None]
        self.error_output: Callable[[str], None]
        self.print_to(_write_stdout, _write_stderr)
        self.message = self._to_error_output
        self.database.modules.on_import_conflict = lambda text: self.message("warning", text)
        self.files: Optional[SourceFiles] = None
        self.ask: Optional[Callable[[], Optional[str]]] = None
        self.state: Dict[str, Any] = {}
        self.now: Callable[[], int] = time_ns
        self.new_goals: Optional[List[CompiledGoal]] = None
        self.is_serving_client = False
        self.allow_flags = False
        self.foreign_modules: Dict[str, None] = {}
        self.environment: Optional[Mapping[str, str]] = None
        self.swi_files: Dict[str, Tuple[Any, ...]] = {}

    # Limits

    @property
    def limits(self) -> Limits:
        """Resource limits of goals."""
        return self.machine.budget.limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        self.machine.budget.set_limits(limits)

    # Clients

    @contextmanager
    def serving_client(self) -> Iterator[None]:
        """Return a context in which work is done for clients: services and the dashboard."""
        was_serving_client, self.is_serving_client = self.is_serving_client, True
        try:
            yield
        finally:
            self.is_serving_client = was_serving_client

    def require_flags(self, flag: Term) -> None:
        """Require that the running goal may change a flag.

        Raises:
            PrologError: a permission error if the goal comes from a client.
        """
        if self.allow_flags:
            return
        # A compiled goal records its origin: a client may have added it to the program, which runs it later.
        goal = self.machine.budget.goal
        if goal.is_from_client if isinstance(goal, CompiledGoal) else self.is_serving_client:
            raise permission_error("modify", "flag", flag, _FLAGS_LOCKED)

    # Clauses

    def add_clause(
        self, term: Term, place: Optional[Place] = None, first: bool = False, asserted: bool = False
    ) -> Clause:
        """Add a copy of a clause; grammar rules and single-sided unification rules are translated.

        Args:
            term: the clause.
            place: source position, or None.
            first: whether it is added before the existing clauses.
            asserted: whether a goal adds it, and not a file.

        Raises:
            PrologError: if the term is not a clause, or the predicate belongs to the system.
        """
        term = self._resolve_in_module(deref(term), asserted)
        if term.__class__ is tuple and term[0] is SINGLE_SIDED:
            return self._add_single_sided(term, place, first, asserted)
        return self._add_to_predicate(term, place, first, asserted)

    def _add_single_sided(
        self, rule: CompoundTerm, place: Optional[Place], first: bool, asserted: bool
    ) -> Clause:
        """Add a single-sided unification rule.

        Such a predicate raises an error if no rule matches: its last clause raises it, and is moved behind each new
        rule.
        """
        term, error_clause = translate_single_sided(rule)
        clause = self._add_to_predicate(term, place, first, asserted)
        predicate = self.database.writable(clause.predicate.functor, "modify")
        last_clause = predicate.clauses[-1]
        if not is_error_clause_body(last_clause.body):
            for earlier_clause in list(predicate.active_clauses())[-2:]:
                if is_error_clause_body(earlier_clause.body):
                    predicate.remove(earlier_clause)
            self._add_to_predicate(error_clause, None, False, asserted)
        return clause

    def _add_to_predicate(self, term: Term, place: Optional[Place], first: bool, asserted: bool) -> Clause:
        head, body = split_clause(copy(term))
        predicate = self.database.writable(functor_of(head), "modify", asserted)
        clause = Clause(predicate, head, body, place)
        predicate.add(clause, first)
        return clause

    def _resolve_in_module(self, term: Term, asserted: bool) -> Term:
        """Return a clause with names resolved in the module that it names, or in the one that is being loaded."""
        modules = self.database.modules
        module = None if asserted else modules.loading_module
        while term.__class__ is tuple and term[0] is COLON:
            named_module = modules.find_module(term[1])
            module, term = (module if named_module is None else named_module), deref(term[2])
        if term.__class__ is tuple and term[0] is _GRAMMAR_RULE:
            term = translate_rule(term)
        if module is not None and term.__class__ is not Var:
            return modules.resolve_clause(
                module, term, resolve_name=modules.assertion_target if asserted else None
            )
        if modules.modules and term.__class__ is tuple and term[0].arity == 2 and term[0].name == ":-":
            return modules.resolve_head_module(term)
        return term

    def resolve_file_goal(self, goal: Term) -> Term:
        """Return a goal of the file that is being loaded, with names resolved in its module."""
        modules = self.database.modules
        return goal if modules.loading_module is None else modules.resolve_body(modules.loading_module, goal)

    def load(
        self,
        terms: Sequence[Tuple[Term, Optional[Place]]],
        report_problem: Callable[[str, Optional[Place]], None],
    ) -> None:
        """Add clauses and run directives in order; ``initialization/1`` goals run at the end.

        Args:
            terms: clauses and directives with their source positions.
            report_problem: called with message and position of each directive that fails or raises, and of each
                invalid clause.
        """
        initializations: List[Tuple[Term, Optional[Place]]] = []
        for term, place in terms:
            term = deref(term)
            if term.__class__ is tuple and (term[0] is _DIRECTIVE or term[0] is _QUERY):
                goal = deref(term[1])
                if goal.__class__ is tuple and goal[0].name == "initialization":
                    initializations.append((goal[1], place))
                else:
                    self.run_directive(goal, place, report_problem)
                continue
            try:
                self.add_clause(term, place)
            except PrologError as error:
                report_problem(error.message, place)
        for goal, place in initializations:
            self.run_directive(goal, place, report_problem)

    def run_directive(
        self, goal: Term, place: Optional[Place], report_problem: Callable[[str, Optional[Place]], None]
    ) -> bool:
        """Run a directive, and call ``report_problem`` if it fails or raises.

        Returns:
            Whether it succeeded.
        """
        try:
            if self.once(self.resolve_file_goal(goal)):
                return True
            report_problem(f"Goal (directive) failed: {self.show(goal)}", place)
        except PrologError as error:
            report_problem(error.message, place)
        return False

    # Goals

    def compile_goal(
        self,
        goal: Term,
        inputs: Sequence[Var] = (),
        outputs: Sequence[Term] = (),
        place: Optional[Place] = None,
        name: str = "goal",
        is_from_client: Optional[bool] = None,
    ) -> CompiledGoal:
        """Compile a goal for Python code.

        Args:
            goal: the goal as a term.
            inputs: variables that get values, by position.
            outputs: variables (or terms) whose values are returned, by position.
            place: source position, for tracebacks.
            name: name of the caller, for tracebacks.
            is_from_client: whether the goal comes from a client; by default that of the system (`is_serving_client`).

        Raises:
            PrologError: if the term is not a goal.
        """
        goal = deref(goal)
        if goal.__class__ is not Var:
            goal = check_body(goal)
        if is_from_client is None:
            is_from_client = self.is_serving_client
        compiled = CompiledGoal(self.database, goal, inputs, outputs, place, name, is_from_client)
        if self.new_goals is not None:
            self.new_goals.append(compiled)
        return compiled

    @contextmanager
    def precompiling_goals(self, terms: Callable[[], Iterable[Term]]) -> Iterator[None]:
        """Return a context at whose end the goals compiled in it are ready, so that the first events do not wait.

        Args:
            terms: called at the end; returns the terms whose predicates will be called.
        """
        outer_goals = self.new_goals
        goals = self.new_goals = []
        try:
            yield
        finally:
            self.new_goals = outer_goals
        self.database.compile_reachable(terms())
        for goal in goals:
            goal.precompile()

    def once(self, goal: Term, reported_goal: Optional[Term] = None) -> bool:
        """Run a goal for its first solution, whose bindings remain.

        Args:
            goal: the goal.
            reported_goal: the term that reports show in place of the goal.

        Returns:
            Whether there is a solution.

        Raises:
            PrologError: if the goal raises it.
        """
        budget = self.machine.budget
        # Each goal is charged as a step: nested short goals would otherwise end before any of them checks the limits.
        budget.count_last_steps(1)
        if budget.needs_check:
            budget.check_entry()
        outer_goal = budget.goal
        if outer_goal is None:
            budget.goal = goal if reported_goal is None else reported_goal
        try:
            return self.machine.run((self.control.code, (CALL, goal), 0, self.machine.done))
        finally:
            budget.goal = outer_goal

    def solutions(self, goal: Term) -> Generator[None, None, None]:
        """Run a goal and yield at each solution with its bindings in place; closing the generator ends the goal."""
        return self.machine.solutions((self.control.code, (CALL, goal), 0, self.machine.done), goal)

    def print_to(self, write: Callable[[str], None], write_error: Callable[[str], None]) -> None:
        """Set the functions that print ``user_output`` and ``user_error``. No goal may be running."""
        budget = self.machine.budget
        self.output, self.error_output = UserStream(budget, write), UserStream(budget, write_error)

    def write(self, text: str) -> None:
        """Write to the current output, and track its column."""
        newline = text.rfind("\n")
        self.column = self.column + len(text) if newline < 0 else len(text) - newline - 1
        self.output(text)

    def _to_error_output(self, message_kind: str, text: str) -> None:
        self.error_output(text)

    def show(
        self,
        term: Term,
        quoted: bool = True,
        names: Optional[Mapping[Var, str]] = None,
        is_constructed: bool = False,
        longest: Optional[int] = None,
        spacing: bool = False,
    ) -> str:
        """Return a term as text that reads back with the program's operators.

        Args:
            term: any term.
            quoted: whether atoms and strings are quoted if necessary.
            names: names of variables.
            is_constructed: whether the term is constructed and not matched; see `ReadFlags`.
            longest: length in characters after which the text ends with ``...``.
            spacing: whether there are spaces after commas and around the infix operators of rules and conditions.
        """
        options = {
            "quoted": quoted,
            "numbervars": True,
            "variable_names": names,
            "longest": longest,
            "spacing": spacing,
            "wide": spacing,
        }
        named_variables = [var for var, name in (names or {}).items() if name != "_"]
        portray = (
            named_message_portray(term, self.operators, named_variables, is_constructed, **options)
            if quoted
            else None
        )
        return write_term(term, self.operators, portray=portray, **options)

    def brief(
        self, term: Term, names: Optional[Mapping[Var, str]] = None, is_constructed: bool = False
    ) -> str:
        """Return the text of a term, shortened for reports."""
        return self.show(term, names=names, is_constructed=is_constructed, longest=MAX_SHOWN_CHARACTERS)

    # Internals

    def _call_undefined(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Run a call of an undefined predicate: through the plain name, the library, or the existence error."""
        key = predicate.functor
        if predicate.dynamic:
            return None
        plain_key = self.database.modules.plain_functor(key)
        plain_predicate = None if plain_key is None else self.lookup(plain_key)
        if plain_predicate is not None:
            return plain_predicate.run((plain_predicate, *frame[1:]))
        library_file = self._library.get((key.name, key.arity))
        if library_file is not None:
            self._load_library(library_file)
            return self.database.predicate(key).run(frame)
        return self.undefined_procedures.handle_call(predicate, frame)

    def find_similar(self, key: Functor) -> List[str]:
        """Return indicators of predicates with a similar name, for "did you mean" hints."""
        return find_similar(self, key)


def _write_stdout(text: str) -> None:
    sys.stdout.write(text)


def _write_stderr(text: str) -> None:
    sys.stderr.write(text)
