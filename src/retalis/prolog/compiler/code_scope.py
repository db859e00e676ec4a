"""Source under construction: compilation units and function scopes.

A `CompilationUnit` is the source that one ``exec`` defines: functions, and the constants that they name. A `Scope` is
one Python function and the knowledge at the current point of it, the compile-time state of an abstract
interpretation: which variables have a value and in which local, which are certainly unbound and unshared, which
locals hold numbers. Both branches of a condition start from the same knowledge (`Scope.snapshot`, `Scope.restore`),
and only what holds at the end of both may be assumed after it.

Terms never appear in the source as text: each constant is bound to a global name, and only small integers and finite
floats become literals.
"""

import math
from functools import partial
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple

from ...foundation import codegen
from ..machine.arithmetic import (
    MAX_INTEGER,
    MIN_INTEGER,
    add,
    check_result,
    evaluate_exact,
    multiply,
    subtract,
    without_instant,
)
from ..machine.machine import DEAD, RESUME, Code, Machine
from ..machine.resource_limits import LOOP
from ..terms.term_traversal import ATOMIC, copy, is_ground, resolve, variables
from ..terms.types import Atom, Frame, Functor, Lazy, String, Term, Var, deref, functor
from ..terms.unification import always_different, compare, compare_by_serial, same_constant, undo, unify
from .clause_nodes import Height, Needed, PredicateResolver

COMPARE = functor("compare", 3)
_MAX_EXPRESSION_PARTS = 60
"""Parts of a compound term that is built by an expression; larger terms are copied from a template."""

_MAX_EXPRESSION_DEPTH = 12
"""Nesting of such a term; Python limits that of expressions."""


def fill(template: Term, old: Tuple[Var, ...], *new: Term) -> Term:
    """Return a copy of a template whose variables ``old`` are replaced by ``new``."""
    return copy(template, dict(zip(old, new)))


def _compare_numbered(
    left: Term, right: Term, compare_variables: Callable[[Var, Var], int] = compare_by_serial
) -> int:
    """Compare two terms without numbering variables.

    Raises:
        AttributeError: if two variables without numbers have to be compared; the function then gives up.
    """
    return compare(left, right, compare_variables)


def base_namespace(machine: Machine) -> Dict[str, Any]:
    """Return the global names of generated code."""
    return {
        "Var": Var,
        "Lazy": Lazy,
        "Atom": Atom,
        "String": String,
        "ATOMIC": ATOMIC,
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
        "always_different": always_different,
        "same": same_constant,
        "fill": fill,
        "evaluate_exact": evaluate_exact,
        "without_instant": without_instant,
        "add": add,
        "subtract": subtract,
        "multiply": multiply,
        "check_result": check_result,
        "MAX_INTEGER": MAX_INTEGER,
        "MIN_INTEGER": MIN_INTEGER,
        "LOOP": LOOP,
        "ONE": (None,),  # iterable of a ``for`` statement that serves as a block, see `PredicateGenerator`
        "RESUME": RESUME,
        "DEAD": DEAD,
    }


class CompilationUnit:
    """Functions that are compiled together, and the constants that they name.

    Args:
        machine: runs the code.
        database: the predicates that the code may call.
        is_repeatable: whether the machine runs the goal again if the code gives up. The code must have no effect
            then, so comparison of unbound variables without numbers, which would number them, gives up instead.

    Attributes:
        jobs: calls that write further functions; `complete_source` runs them until none is left.
    """

    def __init__(self, machine: Machine, database: PredicateResolver, is_repeatable: bool = False):
        self.database = database
        self._names = codegen.BoundNames(base_namespace(machine))
        self.namespace = self._names.values
        self.is_repeatable = is_repeatable
        if is_repeatable:
            self.namespace["compare"] = _compare_numbered
        self._functions: List[str] = []
        self._codes: List[Tuple[Code, str]] = []
        self.jobs: List[Callable[[], None]] = []
        self._builtins: Dict[Functor, Callable[..., Any]] = {}

    def constant(self, value: Any) -> str:
        """Return an expression for a value: a literal, or the name of a global."""
        value_class = value.__class__
        # Literals save a look-up of a global; longer integers become constants, because the source would grow with
        # them.
        if value_class is int and -(1 << 62) < value < 1 << 62:
            return str(value) if value >= 0 else f"({value})"
        if value_class is float and math.isfinite(value):
            return repr(value) if math.copysign(1.0, value) > 0 else f"({value!r})"
        # The namespace keeps the value alive, so its id is not reused.
        return self._names.constant(value, id(value))

    def predicate(self, key: Functor) -> str:
        """Return the name of the constant for a predicate."""
        return self.constant(self.database.predicate(key))

    def is_called_inline(self, key: Functor) -> bool:
        """Return whether a predicate is called inline although it may return a frame."""
        predicate = self.database.predicate(key)
        return predicate.kind == "control" and predicate.function is not None

    def pushdown_filter(self, key: Functor, argument: Functor, positions: Tuple[int, ...]) -> Optional[str]:
        """Return an expression for the pushdown filter of a call, or None if the predicate has none.

        Args:
            key: functor of the predicate.
            argument: functor of the call's first argument.
            positions: positions in that argument whose values the filter compares.
        """
        make_filter = self.database.predicate(key).make_pushdown_filter
        return None if make_filter is None else f"{self.constant(make_filter(argument, positions))}.passes"

    def builtin(self, key: Functor) -> str:
        """Return the name of the Python function of a built-in that is called inline."""
        function = self.database.predicate(key).function
        assert function is not None
        if self.is_repeatable and key is COMPARE:
            function = self._builtins.setdefault(key, partial(function, variables=compare_by_serial))
        return self.constant(function)

    def make_code(self, name: str, function: str) -> Code:
        """Return a code object that runs the generated function of this name once the unit is finished."""
        code = Code(name, _not_generated)
        self._codes.append((code, function))
        return code

    def unique_name(self, stem: str) -> str:
        """Return a new name for a function."""
        return f"{stem}{len(self._codes)}_{len(self._functions)}"

    def add_function(self, lines: List[str]) -> None:
        """Add a finished function."""
        self._functions.append("\n".join(lines))

    def complete_source(self) -> str:
        """Run all jobs and return the whole source."""
        # A job may add jobs: a continuation asks for the continuations within it.
        while self.jobs:
            self.jobs.pop()()
        return "\n\n\n".join(self._functions) + "\n"

    def define(self, source: str, title: str) -> Dict[str, Any]:
        """Execute the source and give each code object its function."""
        codegen.define(source, self.namespace, title)
        for code, function in self._codes:
            code.run = self.namespace[function]
        return self.namespace


def _not_generated(frame: Frame) -> Optional[Frame]:
    raise AssertionError("code that was not generated")


class ClauseVariables:
    """Variables of the clause that is being compiled: their Python names, order, and counts of occurrences."""

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
        """Return the number of a variable, in order of first use."""
        return self._numbers.setdefault(var, len(self._numbers))

    def is_void(self, var: Var) -> bool:
        """Return whether a variable occurs only once in the clause."""
        return self.counts.get(var, 0) == 1


class Loop(NamedTuple):
    """Loop around a clause that replaces its recursive last call.

    Attributes:
        key: functor of the predicate.
        next_iteration: statement that starts the next iteration; "" if the end of the block does.
        base_case: position of an argument and a constant for which another iteration would only succeed; None if
            there is none.
    """

    key: Functor
    argument_names: List[str]
    next_iteration: str
    base_case: Optional[Tuple[int, str]]


Operand = Tuple[str, str]
"""A Python expression without side effects, and its class: "int", "float", "num" (either of them), or "any".

The value of class "any" is a number as well, but may carry the exact instant of a timestamp. Such values exist only
within an evaluation and never become terms; see `arithmetic`.
"""


class ScopeState(NamedTuple):
    """Knowledge at a point of a function; the attributes are those of `Scope`."""

    names: Dict[Needed, str]
    fresh: Set[Var]
    numbers: Dict[Var, Operand]
    fail: str
    pending_choice: Optional[str]
    continuation: str
    is_entry: bool


class Scope:
    """Python function under construction, and the knowledge at the current point of it.

    Attributes:
        lines: the statements so far.
        depth: indentation of the next statement.
        names: Python names of the variables that have a value.
        fresh: variables that are certainly unbound and that no term refers to.
        numbers: the operand that holds the numeric value of a variable.
        fail: the statement that fails.
        fail_after_cut: the statement that fails after a cut.
        give_up: the statement that leaves the goal to the machine, in predicates that are called as functions.
        pending_choice: the statement that pushes the choice point of the following clauses; None once it has been
            written.
        continuation: expression for the frame that follows the clause.
        is_entry: whether the code belongs to the entry function, whose arguments are most often bound.
        unpacking_failed: whether the code is the fallback for a pattern whose unpacking as a whole has failed.
        loop: the loop around the clause, or None.
        has_iteration: whether a call has been written as an iteration of that loop.
        direct_last_call: the predicate whose last call the function runs itself, returning the frame that it returns.
        may_bind: whether the code may bind variables, so that failure has to undo the trail.
        uses_choices: whether the code accesses the choice point stack.
        needed_later: variables and heights that the goals after the current one need.
    """

    def __init__(self, unit: CompilationUnit, clause: ClauseVariables, fail: str = "return None"):
        self.unit = unit
        self.clause = clause
        self.lines: List[str] = []
        self.depth = 1
        self.names: Dict[Needed, str] = {}
        self.fresh: Set[Var] = set()
        self.numbers: Dict[Var, Operand] = {}
        self.fail = fail
        self.fail_after_cut = "return None"
        self.give_up = "return None"
        self.pending_choice: Optional[str] = None
        self.continuation = "after"
        self.is_entry = True
        self.unpacking_failed = False
        self.loop: Optional[Loop] = None
        self.has_iteration = False
        self.direct_last_call: Optional[Functor] = None
        self.may_bind = False
        self.uses_choices = False
        self.needed_later: FrozenSet[Needed] = frozenset()
        self._temps = 0

    def write(self, text: str) -> None:
        """Write a line."""
        self.lines.append("    " * self.depth + text)

    def write_choice(self, text: str) -> None:
        """Write a line that accesses the choice point stack."""
        self.write(text)
        self.uses_choices = True

    def temp(self, stem: str = "t") -> str:
        """Return a new local name."""
        self._temps += 1
        return f"{stem}{self._temps}"

    def snapshot(self) -> ScopeState:
        """Return the knowledge at this point, for `restore`."""
        return ScopeState(
            dict(self.names),
            set(self.fresh),
            dict(self.numbers),
            self.fail,
            self.pending_choice,
            self.continuation,
            self.is_entry,
        )

    def restore(self, state: ScopeState) -> None:
        """Replace the knowledge by a state that `snapshot` returned."""
        # Copied again: both branches of a condition may be restored from one state.
        names, fresh, numbers, self.fail, self.pending_choice, self.continuation, self.is_entry = state
        self.names, self.fresh, self.numbers = dict(names), set(fresh), dict(numbers)

    def create(self, var: Var) -> str:
        """Write the creation of a variable that has no value yet."""
        name = self.clause.local(var)
        self.write(f"{name} = Var()")
        self.names[var] = name
        self.fresh.add(var)
        return name

    def local(self, var: Var) -> str:
        """Return the Python name of a variable, after writing its creation if it has no value yet."""
        name = self.names.get(var)
        return self.create(var) if name is None else name

    def dereference(self, name: str) -> None:
        """Write the dereferencing of a local in place; afterwards ``k`` is its class.

        The loop is written inline, because a call of `deref` costs more than the rest of most unifications.
        """
        self.write(f"k = {name}.__class__")
        self.write("while k is Var:")
        self.write(f"    r = {name}.ref")
        self.write("    if r is None:")
        self.write("        break")
        self.write(f"    {name} = r")
        self.write("    k = r.__class__")

    def build(self, term: Term) -> str:
        """Return an expression for a term, after writing the variables that it needs."""
        term = deref(term)
        if term.__class__ is Var:
            if term not in self.names and self.clause.is_void(term):
                return "Var()"
            name = self.local(term)
            # The term that is built refers to the variable, so other code can bind it from here on.
            self.fresh.discard(term)
            return name
        if term.__class__ is not tuple:
            return self.unit.constant(term)
        if is_ground(term):
            return self.unit.constant(resolve(term))
        # Python limits the nesting of expressions, and its compiler is slow for long ones.
        if is_large(term):
            template_variables = variables(term)
            parts = ", ".join(self.build(var) for var in template_variables)
            return (
                f"fill({self.unit.constant(term)}, {self.unit.constant(tuple(template_variables))}, {parts})"
            )
        parts = ", ".join([self.unit.constant(term[0]), *[self.build(arg) for arg in term[1:]]])
        return f"({parts})"


def is_large(term: Term) -> bool:
    """Return whether a term has more parts or is nested deeper than an expression may be."""
    size = 0
    stack = [(term, 0)]
    while stack:
        item, depth = stack.pop()
        item = deref(item)
        if item.__class__ is tuple:
            size += len(item)
            if size > _MAX_EXPRESSION_PARTS or depth > _MAX_EXPRESSION_DEPTH:
                return True
            stack.extend((arg, depth + 1) for arg in item[1:])
    return False
