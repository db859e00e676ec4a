"""The façade of the logic room: a machine, its predicates, flags and operators."""

import sys
from contextlib import contextmanager
from time import time_ns
from typing import Any, Callable, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

from ..errors import Place, beginning
from ..syntax import Operators, write_term
from ..terms import TRUE, Atom, Functor, Term, Var, copy, deref, functor
from . import builtins
from .clause import Clause
from .codes import LAST, Code, Frame
from .control import Control, check_body, control_predicates
from .database import Database
from .faults import PrologError, instantiation_error, type_error
from .functional import functional
from .goal import Goal
from .limits import Limits
from .machine import Machine
from .predicate import COMPILE_AFTER, Predicate
from .unknown import similar, undefined

_NECK = functor(":-", 2)
_DIRECTIVE = functor(":-", 1)
_QUERY = functor("?-", 1)
_ARROW = functor("-->", 2)

_END = object()


class Logic:
    """A Prolog: clauses, predicates in Python, goals.

    Args:
        operators: the operator table of the program; Prolog's by default.
        compile_after: calls of an unchanged predicate after which it is compiled.

    Attributes:
        machine: runs frames.
        database: predicates by functor.
        operators: operator table, changed by ``op/3``.
        flags: Prolog flags by name, as terms.
        output: called with text that the program prints.
        column: where that stands in its line.
        now: gives the present in nanoseconds.
        message: called with kind (error, warning, informational, ...) and text of ``print_message/2``.
        error_output: called with text printed to ``user_error``, and with warnings.
        new_goals: what has been compiled since `preparing` began; None outside of that.
    """

    def __init__(self, operators: Optional[Operators] = None, compile_after: int = COMPILE_AFTER):
        self.machine = Machine()
        self.machine.logic = self
        self.operators = Operators.prolog() if operators is None else operators
        self.database = Database(self.machine, compile_after)
        self.database.undefined = self._undefined
        self.control = Control(self.database)
        self.flags: Dict[str, Term] = builtins.default_flags()
        self.globals: Dict[str, Term] = {}
        self.column = 0
        self.output: Callable[[str], None] = _print
        self.error_output: Callable[[str], None] = _print_error
        self.message: Callable[[str, str], None] = self._to_error_output
        self.state: Dict[str, Any] = {}
        self.now: Callable[[], int] = time_ns
        for (name, arity), function in control_predicates(self.control).items():
            self.define_control(name, arity, function).locked = True
        ways = {
            "deterministic": self.define,
            "function": self.define_function,
            "nondeterministic": self.define_nondeterministic,
            "control": self.define_control,
        }
        for (name, arity), entry in builtins.ENTRIES.items():
            define: Any = ways[entry.kind]
            define(name, arity, entry.function).locked = entry.locked
        self._library = builtins.library_index()
        self.new_goals: Optional[List[Goal]] = None

    # Limits

    @property
    def limits(self) -> Limits:
        """What a goal may use."""
        return self.machine.budget.limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        self.machine.budget.allow(limits)

    # Predicates in Python

    def define(self, name: str, arity: int, function: Callable[..., bool]) -> Predicate:
        """Define a deterministic predicate: ``function(machine, *args)`` says whether it succeeds.

        Arguments may be bound variables or lazy (`deref` them); results are unified by ``machine.unify``.
        Bindings of a call that fails are undone.
        """
        machine = self.machine

        def run(frame: Frame) -> Optional[Frame]:
            return frame[-1] if function(machine, *frame[1:-1]) else None

        return self.database.define(functor(name, arity), function, run, "builtin")

    def define_function(
        self,
        name: str,
        arity: int,
        function: Callable[..., Any],
        outputs: Tuple[int, ...] = (),
        shows: Tuple[Optional[Callable[[Any], Term]], ...] = (),
    ) -> Predicate:
        """Define a deterministic predicate by a function of its input arguments; see `Functional`.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: takes the inputs; returns the outputs, or None where it fails.
            outputs: positions of the output arguments, whose values are returned as a tuple; without them
                the last argument is the only output, and its value is what is returned.
            shows: for each output what makes its term, where the function returns something else.
        """
        form = functional(function, arity, outputs, shows)
        predicate = self.define(name, arity, form.predicate())
        predicate.functional = form
        return predicate

    def define_nondeterministic(
        self,
        name: str,
        arity: int,
        function: Callable[..., Any],
        known: Optional[Callable[..., Any]] = None,
    ) -> Predicate:
        """Define a predicate by a generator ``function(machine, *args)`` that yields at each solution.

        It unifies before each yield; the bindings are undone before it goes on. What it binds for a
        solution that does not work out it has to undo itself: `Machine.unify_all` does. Yielding `LAST`
        says that there are no more solutions. A function that is not a generator may return a bool instead of
        one, as a deterministic predicate does, where the arguments leave at most one solution: that costs a
        fraction of a generator.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: the generator.
            known: for a predicate that is a function of its other arguments where the first is known: gives
                the last one, or None where it fails. Then ``function`` is called for a variable only.
        """
        machine = self.machine
        choices, trail = machine.choices, machine.trail
        key = functor(name, arity)

        def resume(entry: Frame) -> Optional[Frame]:
            _, solutions, after, _ = entry
            mark = len(trail)
            value = next(solutions, _END)
            if value is _END:
                return None
            if value is not LAST:
                choices.append((retry, solutions, after, mark))
            return after

        retry = Code(str(key), resume)
        retry.functor = key

        def call(machine: Machine, args: Tuple[Term, ...], after: Frame) -> Optional[Frame]:
            found = function(machine, *args)
            if found is True:
                return after
            return resume((retry, iter(found), after, 0)) if found else None

        def run(frame: Frame) -> Optional[Frame]:
            return call(machine, frame[1:-1], frame[-1])

        if known is None:
            return self.database.define(key, call, run, "control")
        alone = self.define_function(f"${name}", arity, known)

        def run_known(frame: Frame) -> Optional[Frame]:
            return run(frame) if deref(frame[1]).__class__ is Var else alone.run((alone, *frame[1:]))

        predicate = self.database.define(key, None, run_known, "control")
        predicate.known = alone.functor
        return predicate

    def define_control(
        self,
        name: str,
        arity: int,
        function: Callable[..., Optional[Frame]],
        at_once: bool = False,
        gate: Optional[Callable[[Functor, Tuple[int, ...]], Any]] = None,
    ) -> Predicate:
        """Define a predicate that decides what runs next: ``function(machine, args, next)`` returns a frame.

        One that most often does all ``at_once`` and returns ``next`` is called in line by compiled clauses.

        Args:
            name: of the predicate.
            arity: of the predicate.
            function: does a call.
            at_once: whether it most often does all at once.
            gate: for a predicate that often has nothing to do: takes the functor of a first argument and positions
                in that; returns an object whose ``passes``, called with the other arguments and those at
                the positions, is false where a call would do nothing, so that compiled clauses make none. Then
                ``function`` is called with whether the first argument has surely no variables as well.
        """
        machine = self.machine

        def run(frame: Frame) -> Optional[Frame]:
            return function(machine, frame[1:-1], frame[-1])

        predicate = self.database.define(functor(name, arity), function if at_once else None, run, "control")
        predicate.gate = gate
        return predicate

    # Clauses

    def add_clause(self, term: Term, place: Optional[Place] = None, first: bool = False) -> Clause:
        """Add a clause (its variables are copied); DCG rules are translated.

        Raises:
            PrologError: where the term is not a clause, or belongs to a predicate of the system.
        """
        term = deref(term)
        if term.__class__ is tuple and term[0] is _ARROW:
            term = builtins.translate_rule(term)
        head, body = split_clause(copy(term))
        key = head.functor if head.__class__ is Atom else head[0]
        predicate = self.database.writable(key, "modify")
        clause = Clause(predicate, head, body, place)
        predicate.add(clause, first)
        return clause

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
            if self.once(goal):
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
    ) -> Goal:
        """Compile a goal for Python code.

        Args:
            goal: its term.
            inputs: variables that get values, by position.
            outputs: variables (or terms) whose values are wanted.
            place: where it was read, for tracebacks.
            name: who asks, for tracebacks.

        Raises:
            PrologError: where the term can be no goal.
        """
        goal = deref(goal)
        if goal.__class__ is not Var:
            goal = check_body(goal)
        compiled = Goal(self.database, goal, inputs, outputs, place, name)
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
            return self.machine.run((self.control.code, (_CALL, goal), 0, self.machine.done))
        finally:
            budget.goal = asked

    def solutions(self, goal: Term) -> Iterator[None]:
        """Run a goal; yield at each solution, with its bindings in place. Closing drops what is left."""
        return self.machine.solutions((self.control.code, (_CALL, goal), 0, self.machine.done), goal)

    def write(self, text: str) -> None:
        """Write to the current output."""
        newline = text.rfind("\n")
        self.column = self.column + len(text) if newline < 0 else len(text) - newline - 1
        self.output(text)

    def _to_error_output(self, kind: str, text: str) -> None:
        self.error_output(text)

    def show(self, term: Term, quoted: bool = True, names: Optional[Mapping[Var, str]] = None) -> str:
        """Return a term as text that reads back with the program's operators; names are those of variables."""
        return write_term(term, self.operators, quoted=quoted, numbervars=True, variable_names=names)

    def brief(self, term: Term, names: Optional[Mapping[Var, str]] = None) -> str:
        """Return the beginning of a term's text, as reports show it."""
        return beginning(self.show(term, names=names))

    # Internals

    def _undefined(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Load the part of the library that defines a predicate, or raise its existence error."""
        key = predicate.functor
        if predicate.dynamic:
            return None
        part = self._library.get((key.name, key.arity))
        if part is not None:
            builtins.load_library(self, part)
            return self.database.predicate(key).run(frame)
        return undefined(self, predicate, frame)

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor if it is defined, loading the library where it defines it."""
        predicate = self.database.predicates.get(key)
        if (predicate is None or predicate.kind == "undefined") and (key.name, key.arity) in self._library:
            builtins.load_library(self, self._library[key.name, key.arity])
            predicate = self.database.predicates.get(key)
        return predicate if predicate is not None and predicate.defined else None

    def defines(self, key: Functor) -> bool:
        """Tell whether there is such a predicate."""
        predicate = self.database.predicates.get(key)
        return (predicate is not None and predicate.defined) or (key.name, key.arity) in self._library

    def is_of_system(self, key: Functor) -> bool:
        """Tell whether a predicate is the system's, not one that a program has put in its place."""
        predicate = self.database.predicates.get(key)
        if predicate is not None and predicate.defined:
            return bool(predicate.library)
        return (key.name, key.arity) in self._library

    def similar(self, key: Functor) -> List[str]:
        """Return the predicates that may have been meant by the name of one that is not there."""
        return similar(self, key)

    def names(self) -> Iterator[Functor]:
        """Yield the functors of all defined predicates."""
        for key, predicate in list(self.database.predicates.items()):
            if predicate.defined:
                yield key
        for name, arity in self._library:
            yield functor(name, arity)


_CALL = functor("call", 1)


def split_clause(term: Term) -> Tuple[Term, Term]:
    """Return head and body of a clause.

    Raises:
        PrologError: instantiation and type errors where the term is not a clause.
    """
    head: Term = term
    body: Term = TRUE
    if term.__class__ is tuple and term[0] is _NECK:
        head, body = deref(term[1]), deref(term[2])
    if head.__class__ is tuple and head[0].name == ":" and len(head) == 3:
        head = deref(head[2])
    kind = head.__class__
    if kind is Var:
        raise instantiation_error()
    if kind is not tuple and kind is not Atom:
        raise type_error("callable", head)
    if body.__class__ is Var:
        body = (_CALL, body)
    else:
        body = check_body(body)
    return head, body


def _print(text: str) -> None:
    sys.stdout.write(text)


def _print_error(text: str) -> None:
    sys.stderr.write(text)
