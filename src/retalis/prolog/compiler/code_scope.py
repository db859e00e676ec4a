"""The source being written: units (what one ``exec`` makes) and scopes (one Python function each)."""

import math
from functools import partial
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple

from ...foundation import codegen
from ..machine.arithmetic import MAX_INTEGER, MIN_INTEGER, add, checked, measure, multiply, plain, subtract
from ..machine.machine import DEAD, RESUME, Code, Machine
from ..machine.resource_limits import LOOP
from ..terms.term_traversal import ATOMIC, copy, is_ground, resolve, variables
from ..terms.types import Atom, Frame, Functor, Lazy, String, Term, Var, deref, functor
from ..terms.unification import by_number, compare, same_constant, undo, unify, unlike
from .clause_nodes import Height, KnownDatabase, Needed

COMPARE = functor("compare", 3)
_MAX_EXPRESSION_PARTS = 60
"""Compound terms with more parts than this are copied from a template, not built by an expression."""


def fill(template: Term, old: Tuple[Var, ...], *new: Term) -> Term:
    """Return a template with its variables replaced."""
    return copy(template, dict(zip(old, new)))


def _compare_numbered(left: Term, right: Term, variables: Callable[[Var, Var], int] = by_number) -> int:
    return compare(left, right, variables)


def base_namespace(machine: Machine) -> Dict[str, Any]:
    """Return what generated code may name."""
    return {
        "Var": Var,
        "Lazy": Lazy,
        "Atom": Atom,
        "String": String,
        "PLAIN": ATOMIC,
        "M": machine,
        "BUDGET": machine.budget,
        "trail": machine.trail,
        "push": machine.trail.append,
        "pop": machine.trail.pop,
        "choices": machine.choices,
        "choose": machine.choices.append,
        "unify": unify,
        "undo": undo,
        "deref": deref,
        "resolve": resolve,
        "compare": compare,
        "unlike": unlike,
        "same": same_constant,
        "fill": fill,
        "measure": measure,
        "plain": plain,
        "add": add,
        "subtract": subtract,
        "multiply": multiply,
        "checked": checked,
        "LARGEST": MAX_INTEGER,
        "LEAST": MIN_INTEGER,
        "LOOP": LOOP,
        "ONE": (None,),
        "RESUME": RESUME,
        "DEAD": DEAD,
    }


class Unit:
    """Functions that are compiled together, with the constants that they name.

    Args:
        machine: runs the code.
        database: knows predicates.
        repeats: whether a goal is run again on the machine where the code cannot tell; what it does until then
            must leave no trace, so it gives up rather than number variables that it compares.
    """

    def __init__(self, machine: Machine, database: KnownDatabase, repeats: bool = False):
        self.database = database
        self._given = codegen.BoundNames(base_namespace(machine))
        self.namespace = self._given.values
        self.repeats = repeats
        if repeats:
            self.namespace["compare"] = _compare_numbered
        self._functions: List[str] = []
        self._codes: List[Tuple[Code, str]] = []
        self.jobs: List[Callable[[], None]] = []
        self._kept: Dict[Functor, Callable[..., Any]] = {}

    def constant(self, value: Any) -> str:
        """Return an expression for a value: a literal, or the name of a global."""
        kind = value.__class__
        if kind is int and -(1 << 62) < value < 1 << 62:
            return str(value) if value >= 0 else f"({value})"
        if kind is float and math.isfinite(value):
            return repr(value) if math.copysign(1.0, value) > 0 else f"({value!r})"
        return self._given.constant(value, id(value))  # which keeps the value alive, so its id stays its own

    def predicate(self, key: Functor) -> str:
        """Return the name of a predicate."""
        return self.constant(self.database.predicate(key))

    def at_once(self, key: Functor) -> bool:
        """Tell whether a predicate is called in line though it may return a frame."""
        predicate = self.database.predicate(key)
        return predicate.kind == "control" and predicate.function is not None

    def gate(self, key: Functor, argument: Functor, positions: Tuple[int, ...]) -> Optional[str]:
        """Return what tells whether a call can have anything to do, as an expression; see `Predicate.gate`."""
        gate = self.database.predicate(key).gate
        return None if gate is None else f"{self.constant(gate(argument, positions))}.passes"

    def builtin(self, key: Functor) -> str:
        """Return the name of the Python function of a built-in that is called in line."""
        function = self.database.predicate(key).function
        assert function is not None
        if self.repeats and key is COMPARE:
            function = self._kept.setdefault(key, partial(function, variables=by_number))
        return self.constant(function)

    def code(self, name: str, function: str) -> Code:
        """Return a code object that will run the generated function of this name."""
        code = Code(name, _unset)
        self._codes.append((code, function))
        return code

    def unique(self, stem: str) -> str:
        """Return a new name for a function."""
        return f"{stem}{len(self._codes)}_{len(self._functions)}"

    def add(self, lines: List[str]) -> None:
        """Add a finished function."""
        self._functions.append("\n".join(lines))

    def source(self) -> str:
        """Return the whole source, after all jobs (functions that others asked for) are done."""
        while self.jobs:
            self.jobs.pop()()
        return "\n\n\n".join(self._functions) + "\n"

    def finish(self, source: str, title: str) -> Dict[str, Any]:
        """Execute the source and give each code object its function."""
        codegen.define(source, self.namespace, title)
        for code, function in self._codes:
            code.run = self.namespace[function]
        return self.namespace


def _unset(frame: Frame) -> Optional[Frame]:
    raise AssertionError("code that was not generated")


class ClauseVariables:
    """Names and counts of the variables of the clause that is being compiled."""

    def __init__(self, parts: Tuple[Term, ...]):
        self.counts: Dict[Var, int] = {}
        stack = list(parts)
        while stack:
            item = deref(stack.pop())
            if item.__class__ is Var:
                self.counts[item] = self.counts.get(item, 0) + 1
            elif item.__class__ is tuple:
                stack.extend(item[1:])
        self._numbers: Dict[Needed, int] = {}

    def local(self, var: Needed) -> str:
        """Return the Python name of a variable or height."""
        number = self._numbers.setdefault(var, len(self._numbers))
        return var.name if isinstance(var, Height) else f"v{number}"

    def number(self, var: Needed) -> int:
        """Return a number that orders variables."""
        return self._numbers.setdefault(var, len(self._numbers))

    def is_void(self, var: Var) -> bool:
        """Tell whether a variable occurs once only."""
        return self.counts.get(var, 0) == 1


class Loop(NamedTuple):
    """The loop that a clause is in: its last call of the predicate itself is another turn.

    Attributes:
        key: the predicate.
        locals: its arguments.
        statement: what goes to the next turn.
        end: an argument and the constant with which another turn would just succeed.
    """

    key: Functor
    locals: List[str]
    statement: str
    end: Optional[Tuple[int, str]]


ScopeState = Tuple[Dict[Needed, str], Set[Var], Dict[Var, Tuple[str, str]], str, Optional[str], str, bool]
"""What is known at a point of a function, see `Scope.branch`."""


class Scope:
    """A Python function being written, and what is known at this point of it.

    Attributes:
        names: Python names of the variables that have a value by now.
        fresh: those that are surely unbound variables which nobody else has seen.
        numbers: names that hold the numeric value of a variable.
        fail: the statement that fails.
        cut: the statement that fails after a cut.
        give_up: the statement that has the goal run on the machine instead, where functions are called.
        pending: the statement that pushes the choice point for the clauses that follow, until it is written.
        after: expression for the frame that follows the clause.
        pushes: whether it deals with the stack of choice points.
        calls_at_once: the predicate whose last call is done by the function itself, which returns what that gives.
        at_one_go: whether a pattern was unpacked as a whole, and this is what is done if that did not work.
    """

    def __init__(self, unit: Unit, clause: ClauseVariables, fail: str = "return None"):
        self.unit = unit
        self.clause = clause
        self.lines: List[str] = []
        self.depth = 1
        self.names: Dict[Needed, str] = {}
        self.fresh: Set[Var] = set()
        self.numbers: Dict[Var, Tuple[str, str]] = {}
        self.fail = fail
        self.cut = "return None"
        self.give_up = "return None"
        self.pending: Optional[str] = None
        self.after = "after"
        self.entry = True
        self.at_one_go = False
        self.loop: Optional[Loop] = None
        self.looped = False
        self.calls_at_once: Optional[Functor] = None
        self.binds = False
        self.pushes = False
        self.later: FrozenSet[Needed] = frozenset()
        self._temps = 0

    def line(self, text: str) -> None:
        """Write a line."""
        self.lines.append("    " * self.depth + text)

    def push(self, text: str) -> None:
        """Write a line that pushes a choice point, or looks at how many there are."""
        self.line(text)
        self.pushes = True

    def temp(self, stem: str = "t") -> str:
        """Return a new local name."""
        self._temps += 1
        return f"{stem}{self._temps}"

    def branch(self) -> ScopeState:
        """Return the knowledge at this point, to come back to with `restore`."""
        return (
            dict(self.names),
            set(self.fresh),
            dict(self.numbers),
            self.fail,
            self.pending,
            self.after,
            self.entry,
        )

    def restore(self, state: ScopeState) -> None:
        """Go back to the knowledge that `branch` returned."""
        names, fresh, numbers, self.fail, self.pending, self.after, self.entry = state
        self.names, self.fresh, self.numbers = dict(names), set(fresh), dict(numbers)

    def create(self, var: Var) -> str:
        """Write the creation of a variable that has no value yet."""
        name = self.clause.local(var)
        self.line(f"{name} = Var()")
        self.names[var] = name
        self.fresh.add(var)
        return name

    def local(self, var: Var) -> str:
        """Return the Python name of a variable, creating it where it is new."""
        name = self.names.get(var)
        return self.create(var) if name is None else name

    def dereference(self, name: str) -> None:
        """Write the dereferencing of a local in place; ``k`` is its class afterwards."""
        self.line(f"k = {name}.__class__")
        self.line("while k is Var:")
        self.line(f"    r = {name}.ref")
        self.line("    if r is None:")
        self.line("        break")
        self.line(f"    {name} = r")
        self.line("    k = r.__class__")

    def build(self, term: Term) -> str:
        """Return an expression for a term, after writing the variables that it needs."""
        term = deref(term)
        if term.__class__ is Var:
            if term not in self.names and self.clause.is_void(term):
                return "Var()"
            name = self.local(term)
            self.fresh.discard(term)
            return name
        if term.__class__ is not tuple:
            return self.unit.constant(term)
        if is_ground(term):
            return self.unit.constant(resolve(term))
        if is_large(term):
            found = variables(term)
            parts = ", ".join(self.build(var) for var in found)
            return f"fill({self.unit.constant(term)}, {self.unit.constant(tuple(found))}, {parts})"
        parts = ", ".join([self.unit.constant(term[0]), *[self.build(arg) for arg in term[1:]]])
        return f"({parts})"


def is_large(term: Term) -> bool:
    """Tell whether a term has more than `_MAX_EXPRESSION_PARTS` compound parts."""
    size = 0
    stack = [(term, 0)]
    while stack:
        item, depth = stack.pop()
        item = deref(item)
        if item.__class__ is tuple:
            size += len(item)
            if size > _MAX_EXPRESSION_PARTS or depth > 12:
                return True
            stack.extend((arg, depth + 1) for arg in item[1:])
    return False
