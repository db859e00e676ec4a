"""Prolog system: the interface of a Prolog to Python.

`PrologSystem` adds clauses, runs directives and goals, compiles goals for Python, and prints terms.
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
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.displayed_text import MAX_SHOWN_CHARACTERS
from ...foundation.source_places import Place
from ..builtins.builtin_registry import ProgramMachine
from ..builtins.grammar_and_ssu_rules import (
    SINGLE_SIDED,
    is_error_clause_body,
    translate_rule,
    translate_single_sided,
)
from ..builtins.text_streams import UserStream
from ..compiler.clause_nodes import CALL
from ..database.clause_index import Clause, CountedClause
from ..database.compiled_goal import CompiledGoal
from ..database.goal_terms import check_body, functor_of, split_clause
from ..database.predicate import COMPILE_AFTER, Predicate
from ..machine.errors import PrologError, permission_error
from ..machine.resource_limits import NO_LIMITS, Budget, EntryExecutor, Limits
from ..syntax.operators import Operators
from ..syntax.term_writer import named_message_portray, write_term
from ..terms.term_traversal import copy
from ..terms.types import COLON, CompoundTerm, Functor, Term, Var, deref, functor
from .predicate_resolution import PredicateTable
from .undefined_procedure_hints import find_similar

if TYPE_CHECKING:
    from ..files.source_files import SourceFiles


_DIRECTIVE = functor(":-", 1)
_QUERY = functor("?-", 1)
_GRAMMAR_RULE = functor("-->", 2)
_FLAGS_LOCKED = "goals of services and the dashboard may not change flags: set the parameter ~allow_flags"


MAX_COUNTED_CLAUSES = 100_000
"""Maximum number of clauses that count their uses; further ones do not."""


class PrologSystem(PredicateTable):
    """Prolog system: clauses, predicates in Python, and goals.

    Args:
        operators: operator table of the program; by default the standard one.
        compile_after: calls of an unchanged predicate after which it is compiled.
        limits: resource limits of goals.
        executor: executor of the engine, see `Budget`; None without an engine.
        now: returns the current time in nanoseconds.
        files: opens files for goals; None if goals may open none.
        environment: environment variables of the process; None if the program may not read them.
        allow_flags: whether goals of clients, including those that they add to the program, may change flags.
        counts_uses: whether the clauses of files count their uses, see `CountedClause`.

    Attributes:
        output: called with text that the program prints.
        column: column at which the next text is printed.
        now: see above.
        error_output: called with text printed to ``user_error``, and with warnings.
        globals: global variables by name.
        state: data that built-ins store by name, such as counters and tables.
        swi_files: files that the program has loaded into SWI-Prolog, by name.
        foreign_modules: names or paths of the Python modules that the program has loaded.
        files: see above.
        environment: see above.
        ask: returns the next line that the user types, None at the end of input; None if there is no user.
        is_serving_client: whether the current work is done for a client and not for the program; see
            `serving_client`.
        counted_clauses: the clauses of files, if they count their uses, else None.
        new_goals: goals compiled since `precompiling_goals` began; None outside of it.
    """

    def __init__(
        self,
        operators: Optional[Operators] = None,
        compile_after: int = COMPILE_AFTER,
        limits: Limits = NO_LIMITS,
        executor: Optional[EntryExecutor] = None,
        now: Callable[[], int] = time_ns,
        files: "Optional[SourceFiles]" = None,
        environment: Optional[Mapping[str, str]] = None,
        allow_flags: bool = False,
        counts_uses: bool = False,
    ):
        super().__init__(
            ProgramMachine(self, Budget(limits, executor)),
            Operators.prolog() if operators is None else operators,
            compile_after,
            self._record_module,
            lambda text: self.message("warning", text),
        )
        self.now = now
        self.files = files
        self.environment = environment
        self._allow_flags = allow_flags
        self.counted_clauses: Optional[List[CountedClause]] = [] if counts_uses else None
        self.globals: Dict[str, Term] = {}
        self.column = 0
        self.output: Callable[[str], None]
        self.error_output: Callable[[str], None]
        self.print_to(_write_stdout, _write_stderr)
        self.ask: Optional[Callable[[], Optional[str]]] = None
        self.state: Dict[str, Any] = {}
        self.new_goals: Optional[List[CompiledGoal]] = None
        self.is_serving_client = False
        self.foreign_modules: Dict[str, None] = {}
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
        if self._allow_flags:
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
        predicate = self.database.writable(clause.predicate.functor)
        last_clause = predicate.clauses[-1]
        if not is_error_clause_body(last_clause.body):
            # The error clause was the last one before this rule.
            for earlier_clause in predicate.last_clauses(2):
                if is_error_clause_body(earlier_clause.body):
                    predicate.remove(earlier_clause)
            self._add_to_predicate(error_clause, None, False, asserted)
        return clause

    def _add_to_predicate(self, term: Term, place: Optional[Place], first: bool, asserted: bool) -> Clause:
        head, body = split_clause(copy(term))
        predicate = self.database.writable(functor_of(head), asserted)
        clause = (
            Clause(predicate, head, body, place)
            if asserted
            else self.create_clause(predicate, head, body, place)
        )
        predicate.add(clause, first)
        return clause

    def create_clause(self, predicate: Predicate, head: Term, body: Term, place: Optional[Place]) -> Clause:
        """Return a clause of a file, which is not added to its predicate yet."""
        counted_clauses = self.counted_clauses
        if counted_clauses is None or place is None or len(counted_clauses) >= MAX_COUNTED_CLAUSES:
            return Clause(predicate, head, body, place)
        clause = CountedClause(predicate, head, body, place)
        counted_clauses.append(clause)
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

    def continue_precompiling(self, goals: Optional[List[CompiledGoal]]) -> None:
        """Return to the goals that were compiled before a failed load; None outside of `precompiling_goals`."""
        self.new_goals = goals

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

    def discard_output(self) -> None:
        """Discard what goals print to ``user_output`` and ``user_error``. No goal may be running."""
        self.output = self.error_output = _discard

    def redirect(self, output: Callable[[str], None], column: int) -> None:
        """Set the current output, and the column of its next text."""
        self.output, self.column = output, column

    def start_line(self, column: int = 0) -> None:
        """Record the column of the next text, after another writer has ended the line."""
        self.column = column

    def read_lines_by(self, ask: Callable[[], Optional[str]]) -> None:
        """Let goals read lines of the user by a function; it returns None at the end of input."""
        self.ask = ask

    def write(self, text: str) -> None:
        """Write to the current output, and track its column."""
        newline = text.rfind("\n")
        self.column = self.column + len(text) if newline < 0 else len(text) - newline - 1
        self.output(text)

    def message(self, kind: str, text: str) -> None:
        """Print a message of a kind (error, warning, informational, ...), as ``print_message/2`` does."""
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

    def _record_module(self, name: str) -> None:
        """Record that the file that is being loaded declares a module; warn if another file declares the same one."""
        warning = "" if self.files is None else self.files.record_module(name)
        if warning:
            self.message("warning", warning)

    def find_similar(self, key: Functor) -> List[str]:
        """Return indicators of predicates with a similar name, for "did you mean" hints."""
        return find_similar(self, key)


def _write_stdout(text: str) -> None:
    sys.stdout.write(text)


def _discard(text: str) -> None:
    """Discard a text."""


def _write_stderr(text: str) -> None:
    sys.stderr.write(text)
