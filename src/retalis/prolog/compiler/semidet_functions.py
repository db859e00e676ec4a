"""Compilation of semideterministic predicates to plain Python functions, without frames or choice points.

A function returns True for a solution, False for none, and None if it cannot decide: if another clause might have a
solution as well, or the predicate uses goals that a function cannot run. The caller then undoes the bindings and runs
its goal on the machine. Running it twice is safe, because a function has no effects: it consists of unification,
arithmetic, comparison, pure built-ins, facts, and calls of other such predicates.

Each predicate has two functions. ``first`` is used if the first solution is enough (before a cut, in a test) and
ignores further clauses. ``only`` must prove that the solution is unique: it compares the first-level keys of the
remaining clauses with the arguments at entry, and gives up if another clause may match.
"""

from typing import Dict, Iterator, List, Optional, Sequence, Tuple

from ..terms.types import Functor, Term, Trail, functor
from ..terms.unification import undo
from .clause_nodes import (
    BodyParser,
    CallNode,
    Cut,
    GoalNode,
    Height,
    IfThenElse,
    PredicateFunction,
    PredicateResolver,
    SourcePredicate,
)
from .code_scope import ClauseVariables, CompilationUnit, Scope
from .inline_goals import write_sequence
from .predicate_code import ClauseParts, PredicateGenerator, key_of, title_of

BAIL = object()
"""Result of the function of a `CompiledGoal` if the goal must be executed by frames instead."""

_MAX_FUNCTION_CLAUSES = 8
"""Clauses of a predicate that can be a function."""
_MAX_CLAUSES_VISITED = 100
"""Clauses that a call may try, including those of the predicates that it calls."""
_MAX_NESTED_CALLS = 6
"""Nesting of calls of functions within functions."""

_PURE = frozenset(
    functor(name, arity)
    for arity, names in {
        1: "ground is_list is_datime",
        2: "=.. copy_term atom_length atom_codes atom_chars char_code atom_number atom_string number_codes "
        "upcase_atom downcase_atom string_length string_lower string_upper atomic_list_concat memberchk "
        "less_datime less_equal_datime equal_datime",
        3: "$arg functor compare atomic_list_concat between_datime datime_minus_datime datime_plus_sec "
        "datime_minus_sec month_days",
        4: "split_string",
    }.items()
    for name in names.split()
)
"""Deterministic built-ins without effects whose result depends on their arguments alone."""


class FunctionCode:
    """Functions of one predicate, generated when they are first called or when a caller is compiled.

    Attributes:
        first: returns whether there is a solution, and keeps the bindings of the first one; None if it cannot decide.
        only: returns whether there is exactly one solution, and keeps its bindings; None if it cannot decide.
    """

    __slots__ = ("first", "only", "_database", "_key", "_finds_facts", "_pending_functions")

    first: PredicateFunction
    only: PredicateFunction

    def __init__(self, database: PredicateResolver, key: Functor):
        self._database = database
        self._key = key
        self._finds_facts = False
        self.reset(None)

    def reset(self, predicate: Optional[SourcePredicate]) -> None:
        """Discard the functions after a change of the predicate.

        Functions that look facts up read the current clauses, so they stay valid as long as all clauses are facts.

        Args:
            predicate: the changed predicate; None to discard the functions in any case.
        """
        if not self._finds_facts or predicate is None or not predicate.has_only_ground_facts:
            self._finds_facts = False
            self._pending_functions = {"first", "only"}
            # Generation is deferred to the first call: a predicate may change many times without being called.
            self.first = lambda *args: self._generate(True)(*args)
            self.only = lambda *args: self._generate(False)(*args)

    def precompile(self, first_is_enough: bool) -> None:
        """Generate `first` (if ``first_is_enough``) or `only` before it is called."""
        if ("first" if first_is_enough else "only") in self._pending_functions:
            self._generate(first_is_enough)

    def _generate(self, first_is_enough: bool) -> PredicateFunction:
        database, key = self._database, self._key
        # Marked as generated first: a caller that is compiled meanwhile must not generate it again.
        self._pending_functions.discard("first" if first_is_enough else "only")
        predicate = database.predicate(key)
        function: PredicateFunction
        if call_cost(database, key) is None:
            function = _cannot_decide
        elif is_fact_table(predicate):
            self._finds_facts = True
            self.first, self.only = predicate.fact_finder(True), predicate.fact_finder(False)
            self._pending_functions.clear()
            return self.first if first_is_enough else self.only
        else:
            function = FunctionGenerator(database, key, clause_parts(predicate), predicate).generate_function(
                first_is_enough
            )
        if first_is_enough:
            self.first = function
        else:
            self.only = function
        return function


def _cannot_decide(*args: Term) -> None:
    return None


def is_fact_table(predicate: SourcePredicate) -> bool:
    """Return whether a predicate is a table of ground facts, which is searched through its indexes."""
    return predicate.has_only_ground_facts and (predicate.dynamic or len(predicate) > _MAX_FUNCTION_CLAUSES)


def clause_parts(predicate: SourcePredicate) -> List[ClauseParts]:
    """Return the clauses of a predicate for the generator."""
    return [
        ClauseParts(clause.head[1:] if clause.head.__class__ is tuple else (), clause.body, clause.place)
        for clause in predicate.active_clauses()
    ]


def call_cost(database: PredicateResolver, key: Functor, path: Tuple[Functor, ...] = ()) -> Optional[int]:
    """Return how many clauses a call of a predicate may try; None if it cannot be a function.

    Args:
        database: the predicates.
        key: functor of the predicate.
        path: predicates whose calls lead to this one.
    """
    predicate = database.predicate(key)
    if (
        database.is_interpreter_only
        or predicate.kind != "user"
        or predicate.hidden_predicate is not None
        or predicate.is_library_predicate
    ):
        return None
    # A recursive function would recurse in Python, whose stack is limited, while frames are not.
    if key in path or len(path) >= _MAX_NESTED_CALLS:
        return None
    if is_fact_table(predicate):
        return 1
    if predicate.dynamic or not 0 < len(predicate) <= _MAX_FUNCTION_CLAUSES:
        return None
    cost = 0
    for clause in predicate.active_clauses():
        if clause.is_large:
            return None
        entry = Height("height")
        nodes = function_parser(database, entry, (*path, key)).parse(clause.body)
        nested_cost = body_cost(database, nodes, (*path, key))
        if nested_cost is None or any(not node.is_inline for node in nodes):
            return None
        cost += 1 + nested_cost
    return cost if cost <= _MAX_CLAUSES_VISITED else None


def body_cost(
    database: PredicateResolver, nodes: Sequence[GoalNode], path: Tuple[Functor, ...] = ()
) -> Optional[int]:
    """Return how many clauses the calls in a body may try; None if one of its goals cannot be in a function."""
    total = 0
    for goal in calls_in(nodes):
        if goal.form == "function":
            cost = call_cost(database, goal.key, path)
            if cost is None:
                return None
            total += cost
        elif goal.form == "builtin" and not is_pure(database, goal.key):
            return None
    return total


def is_pure(database: PredicateResolver, key: Functor) -> bool:
    """Return whether a deterministic built-in has no effect and its result depends on its arguments alone."""
    return key in _PURE or database.predicate(key).functional_modes is not None


def calls_in(nodes: Sequence[GoalNode]) -> Iterator[CallNode]:
    """Yield all calls in a body, including those in conditions."""
    for node in nodes:
        if isinstance(node, CallNode):
            yield node
        elif isinstance(node, IfThenElse):
            yield from calls_in([*node.test, *node.then, *node.otherwise])


def function_parser(database: PredicateResolver, entry: Height, path: Tuple[Functor, ...] = ()) -> BodyParser:
    """Return a parser that treats calls of predicates that can be functions as inline goals."""
    cached: Dict[Functor, bool] = {}

    def can_be_function(key: Functor) -> bool:
        if key not in cached:
            cached[key] = call_cost(database, key, path) is not None
        return cached[key]

    return BodyParser(database, entry, can_be_function)


def mark_first_solution_calls(nodes: Sequence[GoalNode], first_is_enough: bool) -> None:
    """Mark the calls for which the first solution is enough.

    These are calls directly before a cut, the last call of a condition, and if ``first_is_enough``, the last call of
    the sequence.

    Args:
        nodes: the goals.
        first_is_enough: whether the first solution of the whole sequence is enough.
    """
    for position, node in enumerate(nodes):
        first_is_enough = (
            first_is_enough if position == len(nodes) - 1 else isinstance(nodes[position + 1], Cut)
        )
        if isinstance(node, CallNode):
            node.first_is_enough = first_is_enough
        elif isinstance(node, IfThenElse):
            mark_first_solution_calls(node.test, True)
            mark_first_solution_calls(node.then, first_is_enough)
            mark_first_solution_calls(node.otherwise, first_is_enough)


class FunctionGenerator(PredicateGenerator):
    """Generator of the functions of one predicate."""

    def generate_function(self, first_is_enough: bool) -> PredicateFunction:
        """Return the function for the first solution (if ``first_is_enough``), or for the only one."""
        unit = CompilationUnit(self.database.machine, self.database, is_repeatable=True)
        unit.namespace["key_of"] = key_of
        lines = ["    mark = len(trail)"]
        # Keys are read at entry: the head of a clause binds arguments, which must not influence the test for others.
        positions = [] if first_is_enough else self._selective_positions()
        lines += [f"    x{position + 1} = key_of({self.locals[position]})" for position in positions]
        for index in range(len(self.clauses)):
            lines += self._clause_block(unit, index, first_is_enough, positions)
        unit.add_function([f"def main({', '.join(self.locals)}):", *lines, "    return False"])
        place = next((clause.place for clause in self.clauses if clause.place is not None), None)
        source = unit.complete_source()
        title = f"{self.key} as a function"
        finder: PredicateFunction = unit.define(source, title_of(place, title))["main"]
        return finder

    def _selective_positions(self) -> List[int]:
        """Return the positions of arguments whose first-level keys distinguish clauses."""
        if len(self.clauses) == 1:
            return []
        keys = [
            [key_of(clause.args[position]) for clause in self.clauses] for position in range(self.key.arity)
        ]
        return [position for position, position_keys in enumerate(keys) if len(set(position_keys)) > 1]

    def _clause_block(
        self, unit: CompilationUnit, index: int, first_is_enough: bool, positions: List[int]
    ) -> List[str]:
        """Return the code of a clause, a block that ``break`` leaves to try the next clause."""
        clause = self.clauses[index]
        following_clauses = self.clauses[index + 1 :]
        entry = Height("height")
        scope = Scope(unit, ClauseVariables((*clause.args, clause.body)), "break")
        scope.depth = 2
        scope.fail_after_cut = "return False"
        nodes = function_parser(self.database, entry, (self.key,)).parse(clause.body)
        has_cut = any(isinstance(node, Cut) for node in nodes)
        mark_first_solution_calls(nodes, first_is_enough)
        self._write_head(
            scope,
            clause,
            None,
            self._copy_arguments(scope, clause, None) if following_clauses else self.locals,
        )
        write_sequence(scope, nodes, frozenset())
        # After a cut no other clause can have a solution, so the solution is the only one.
        later_clauses = () if first_is_enough or has_cut else following_clauses
        conditions = [self._may_match(unit, later_clause, positions) for later_clause in later_clauses]
        if conditions:
            scope.write(f"return None if {' or '.join(conditions)} else True")
        else:
            scope.write("return True")
        lines = ["    while True:", *scope.lines]
        # Bindings of a failed head must be undone before the next clause is tried.
        if following_clauses and scope.may_bind:
            lines += ["    while len(trail) > mark:", "        pop().ref = None"]
        return lines

    @staticmethod
    def _may_match(unit: CompilationUnit, clause: ClauseParts, positions: List[int]) -> str:
        """Return the condition under which a clause may match the arguments at entry."""
        tests = []
        for position in positions:
            key = key_of(clause.args[position])
            if key is not None:
                tests.append(f"(x{position + 1} is None or x{position + 1} == {unit.constant(key)})")
        return f"({' and '.join(tests)})" if tests else "True"


def give_up(trail: Trail, mark: int) -> object:
    """Undo bindings and return `BAIL`, which leaves the goal to the machine."""
    undo(trail, mark)
    return BAIL
