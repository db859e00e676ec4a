"""The façade of the logic room: a machine, its predicates, flags and operators."""

import sys
from contextlib import contextmanager
from time import time_ns
from typing import (
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

from ...foundation import SHOWN, Place, printable
from .. import builtins  # noqa: F401  (they register themselves)
from ..compiler import CALL
from ..database import COMPILE_AFTER, Clause, CompiledGoal, Predicate, check_body, functor_of, split_clause
from ..machine import Budget, Frame, Limits, PrologError, permission_error
from ..syntax import Operators, by_name, write_term
from ..terms import COLON, CompoundTerm, Functor, Term, Var, copy, deref, functor
from . import ports  # noqa: F401  (it registers trace/1)
from .predicates import Predicates
from .unknown import similar, undefined

_DIRECTIVE = functor(":-", 1)
_QUERY = functor("?-", 1)
_ARROW = functor("-->", 2)
_FLAGS_LOCKED = "goals of services and the dashboard may not change flags: set the parameter ~allow_flags"


class UserStream:
    """``user_output`` or ``user_error``: what people and logs get, with escapes for what these would act on.

    Args:
        budget: limits what an entry may write.
        write: prints a text.
    """

    def __init__(self, budget: Budget, write: Callable[[str], None]):
        self._budget = budget
        self._write = write

    def __call__(self, text: str) -> None:
        """Write a text.

        Raises:
            LimitError: past the limit of output; nothing of the text is written then.
        """
        self._budget.count_output(len(text))  # before anything is made of a text that is too long
        shown = printable(text)
        more = len(shown.encode()) - len(text)
        if more:
            self._budget.count_output(more)
        self._write(shown)


class Logic(Predicates):
    """A Prolog: clauses, predicates in Python, goals.

    Args:
        operators: the operator table of the program; Prolog's by default.
        compile_after: calls of an unchanged predicate after which it is compiled.

    Attributes:
        output: called with text that the program prints.
        column: where that stands in its line.
        now: gives the present in nanoseconds.
        error_output: called with text printed to ``user_error``, and with warnings.
        swi_files: what the program has had SWI-Prolog load, by their names.
        foreign_modules: the Python modules that the program has asked for, names or paths.
        files: opens the files that goals may open; None where there are none.
        ask: gives the next line that the user types, None at the end; None where nobody is there.
        environment: the variables of the process's environment; None where the program may not know them.
        from_outside: whether the work at hand is done for others than the program, see `for_others`.
        allow_flags: whether such work, and goals that it has added to the program, may change flags.
        new_goals: what has been compiled since `preparing` began; None outside of that.
    """

    def __init__(self, operators: Optional[Operators] = None, compile_after: int = COMPILE_AFTER):
        super().__init__(operators, compile_after)
        self.database.undefined = self._undefined
        self.globals: Dict[str, Term] = {}
        self.column = 0
        self.output: Callable[[str], None]
        self.error_output: Callable[[str], None]
        self.print_to(_print, _print_error)
        self.message = self._to_error_output
        self.database.modules.on_clash = lambda text: self.message("warning", text)
        self.files: Optional[builtins.StreamFiles] = None
        self.ask: Optional[Callable[[], Optional[str]]] = None
        self.state: Dict[str, Any] = {}
        self.now: Callable[[], int] = time_ns
        self.new_goals: Optional[List[CompiledGoal]] = None
        self.from_outside = False
        self.allow_flags = False
        self.foreign_modules: Dict[str, None] = {}
        self.environment: Optional[Mapping[str, str]] = None
        self.swi_files: Dict[str, Tuple[Any, ...]] = {}

    # Limits

    @property
    def limits(self) -> Limits:
        """What a goal may use."""
        return self.machine.budget.limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        self.machine.budget.allow(limits)

    # Others than the program

    @contextmanager
    def for_others(self) -> Iterator[None]:
        """Work meanwhile for others than the program: services and the dashboard."""
        before, self.from_outside = self.from_outside, True
        try:
            yield
        finally:
            self.from_outside = before

    def require_flags(self, flag: Term) -> None:
        """Require that the goal at work may change a flag.

        Raises:
            PrologError: a permission error where others than the program have given the goal.
        """
        if self.allow_flags:
            return
        goal = self.machine.budget.goal
        if goal.from_outside if isinstance(goal, CompiledGoal) else self.from_outside:
            raise permission_error("modify", "flag", flag, _FLAGS_LOCKED)

    # Clauses

    def add_clause(
        self, term: Term, place: Optional[Place] = None, first: bool = False, asserted: bool = False
    ) -> Clause:
        """Add a clause (its variables are copied); DCG rules and single-sided rules are translated.

        Args:
            term: the clause.
            place: where it was read.
            first: whether it comes before the others.
            asserted: whether a goal adds it, not a file.

        Raises:
            PrologError: where the term is not a clause, or belongs to a predicate of the system.
        """
        term = self._of_module(deref(term), asserted)
        if term.__class__ is tuple and term[0] is builtins.SINGLE_SIDED:
            return self._add_single_sided(term, place, first, asserted)
        return self._add(term, place, first, asserted)

    def _add_single_sided(
        self, rule: CompoundTerm, place: Optional[Place], first: bool, asserted: bool
    ) -> Clause:
        """Add a rule; the clause behind all rules of its predicate stays the last one."""
        term, behind = builtins.translate_single_sided(rule)
        clause = self._add(term, place, first, asserted)
        predicate = self.database.writable(clause.predicate.functor, "modify")
        last = predicate.clauses[-1]
        if not builtins.is_behind(last.body):
            for other in list(predicate.live())[-2:]:
                if builtins.is_behind(other.body):
                    predicate.remove(other)
            self._add(behind, None, False, asserted)
        return clause

    def _add(self, term: Term, place: Optional[Place], first: bool, asserted: bool) -> Clause:
        head, body = split_clause(copy(term))
        predicate = self.database.writable(functor_of(head), "modify", asserted)
        clause = Clause(predicate, head, body, place)
        predicate.add(clause, first)
        return clause

    def _of_module(self, term: Term, asserted: bool) -> Term:
        """Return a clause as it is added: of the module that it names, or whose file is being loaded."""
        modules = self.database.modules
        module = None if asserted else modules.loading
        while term.__class__ is tuple and term[0] is COLON:
            named = modules.named(term[1])
            module, term = (module if named is None else named), deref(term[2])
        if term.__class__ is tuple and term[0] is _ARROW:
            term = builtins.translate_rule(term)
        if module is not None and term.__class__ is not Var:
            return modules.clause(module, term, name=modules.stored if asserted else None)
        if modules.table and term.__class__ is tuple and term[0].arity == 2 and term[0].name == ":-":
            return modules.of_another(term)
        return term

    def of_file(self, goal: Term) -> Term:
        """Return a goal of the file that is being loaded as it means the same everywhere; see `Modules.body`."""
        modules = self.database.modules
        return goal if modules.loading is None else modules.body(modules.loading, goal)

    def load(
        self, terms: Sequence[Tuple[Term, Optional[Place]]], problem: Callable[[str, Optional[Place]], None]
    ) -> None:
        """Add clauses and run directives in order; ``initialization/1`` goals run at the end.

        Args:
            terms: clauses and directives with their places.
            problem: called for directives that fail or raise, and clauses that cannot be added.
        """
        late: List[Tuple[Term, Optional[Place]]] = []
        for term, place in terms:
            term = deref(term)
            if term.__class__ is tuple and (term[0] is _DIRECTIVE or term[0] is _QUERY):
                goal = deref(term[1])
                if goal.__class__ is tuple and goal[0].name == "initialization":
                    late.append((goal[1], place))
                else:
                    self.run_directive(goal, place, problem)
                continue
            try:
                self.add_clause(term, place)
            except PrologError as error:
                problem(error.message, place)
        for goal, place in late:
            self.run_directive(goal, place, problem)

    def run_directive(
        self, goal: Term, place: Optional[Place], problem: Callable[[str, Optional[Place]], None]
    ) -> bool:
        """Run a directive; tell ``problem`` where it fails or raises. Return whether it succeeded."""
        try:
            if self.once(self.of_file(goal)):
                return True
            problem(f"Goal (directive) failed: {self.show(goal)}", place)
        except PrologError as error:
            problem(error.message, place)
        return False

    # Goals

    def compile_goal(
        self,
        goal: Term,
        inputs: Sequence[Var] = (),
        outputs: Sequence[Term] = (),
        place: Optional[Place] = None,
        name: str = "goal",
        from_outside: Optional[bool] = None,
    ) -> CompiledGoal:
        """Compile a goal for Python code.

        Args:
            goal: its term.
            inputs: variables that get values, by position.
            outputs: variables (or terms) whose values are wanted.
            place: where it was read, for tracebacks.
            name: who asks, for tracebacks.
            from_outside: whether others than the program have given it; by default, whether it is compiled for them.

        Raises:
            PrologError: where the term can be no goal.
        """
        goal = deref(goal)
        if goal.__class__ is not Var:
            goal = check_body(goal)
        if from_outside is None:
            from_outside = self.from_outside
        compiled = CompiledGoal(self.database, goal, inputs, outputs, place, name, from_outside)
        if self.new_goals is not None:
            self.new_goals.append(compiled)
        return compiled

    @contextmanager
    def preparing(self, terms: Callable[[], Iterable[Term]]) -> Iterator[None]:
        """Have what is compiled meanwhile be ready at the end, so that the first events need not wait for it.

        Args:
            terms: returns, at the end, the terms whose predicates will be called.
        """
        outer = self.new_goals
        new = self.new_goals = []
        try:
            yield
        finally:
            self.new_goals = outer
        self.database.compile_named(terms())
        for goal in new:
            goal.prepare()

    def once(self, goal: Term, asked_for: Optional[Term] = None) -> bool:
        """Run a goal for its first solution, whose bindings stay. Return whether there is one.

        Args:
            goal: the goal.
            asked_for: what reports show in its place.

        Raises:
            PrologError: what the goal threw.
        """
        budget = self.machine.budget
        budget.ended(1)  # many short ones may lie in each other, and none of them comes to look at the limits
        if budget.closed:
            budget.admit()
        asked = budget.goal
        if asked is None:
            budget.goal = goal if asked_for is None else asked_for
        try:
            return self.machine.run((self.control.code, (CALL, goal), 0, self.machine.done))
        finally:
            budget.goal = asked

    def solutions(self, goal: Term) -> Generator[None, None, None]:
        """Run a goal; yield at each solution, with its bindings in place. Closing drops what is left."""
        return self.machine.solutions((self.control.code, (CALL, goal), 0, self.machine.done), goal)

    def print_to(self, write: Callable[[str], None], write_error: Callable[[str], None]) -> None:
        """Set what prints the texts of ``user_output`` and ``user_error``; no goal runs."""
        budget = self.machine.budget
        self.output, self.error_output = UserStream(budget, write), UserStream(budget, write_error)

    def write(self, text: str) -> None:
        """Write to the current output."""
        newline = text.rfind("\n")
        self.column = self.column + len(text) if newline < 0 else len(text) - newline - 1
        self.output(text)

    def _to_error_output(self, kind: str, text: str) -> None:
        self.error_output(text)

    def show(
        self,
        term: Term,
        quoted: bool = True,
        names: Optional[Mapping[Var, str]] = None,
        made: bool = False,
        longest: Optional[int] = None,
    ) -> str:
        """Return a term as text that reads back with the program's operators.

        Args:
            term: any term.
            quoted: whether atoms and strings are quoted where they have to be.
            names: of variables.
            made: whether the term is made and not matched, see `ReadFlags`.
            longest: characters after which the text ends with ``...``.
        """
        options = {"quoted": quoted, "numbervars": True, "variable_names": names, "longest": longest}
        named = [var for var, name in (names or {}).items() if name != "_"]
        portray = by_name(term, self.operators, named, made, **options) if quoted else None
        return write_term(term, self.operators, portray=portray, **options)

    def brief(self, term: Term, names: Optional[Mapping[Var, str]] = None, made: bool = False) -> str:
        """Return the beginning of a term's text, as reports show it."""
        return self.show(term, names=names, made=made, longest=SHOWN)

    # Internals

    def _undefined(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Load the part of the library that defines a predicate, or raise its existence error."""
        key = predicate.functor
        if predicate.dynamic:
            return None
        plain = self.database.modules.plain_of(key)
        found = None if plain is None else self.lookup(plain)
        if found is not None:
            return found.run((found, *frame[1:]))
        part = self._library.get((key.name, key.arity))
        if part is not None:
            self._load_library(part)
            return self.database.predicate(key).run(frame)
        return undefined(self, predicate, frame)

    def similar(self, key: Functor) -> List[str]:
        """Return the predicates that may have been meant by the name of one that is not there."""
        return similar(self, key)


def _print(text: str) -> None:
    sys.stdout.write(text)


def _print_error(text: str) -> None:
    sys.stderr.write(text)
