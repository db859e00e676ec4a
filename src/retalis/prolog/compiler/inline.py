"""Code for goals that are straight Python, alone, in order, and as tests.

They leave no choice point and call no predicate of the program.
"""

from typing import Dict, FrozenSet, List, Sequence, Set, Tuple

from ..terms import Var
from .calls import simple_test, write_call
from .joining import join
from .nodes import CallNode, Cut, Fail, GoalNode, IfThenElse, Needed, needed_by
from .scope import Scope, ScopeState

Missed = Tuple[Set[Needed], Set[Var]]


def write_inline(scope: Scope, node: GoalNode) -> None:
    """Write an inline goal; it fails by the scope's fail statement."""
    if isinstance(node, CallNode):
        write_call(scope, node)
    elif isinstance(node, Cut):
        _cut(scope, node)
    elif isinstance(node, IfThenElse):
        _condition(scope, node)
    else:
        scope.line(scope.fail)


def _cut(scope: Scope, node: Cut) -> None:
    if node.soft:
        height = scope.names[node.height]
        scope.line(f"choices[{height}] = (DEAD, choices[{height}][-1])")
        return
    known = scope.names.get(node.height)
    if known is None or (scope.pending is not None and node.cuts):
        # Nothing has been pushed since the clause was entered: only the clauses that follow are given up.
        scope.pending = None
        scope.fail = scope.cut
        return
    scope.line(f"del choices[{known}:]")


def _condition(scope: Scope, node: IfThenElse) -> None:
    """Write an if-then-else whose parts are all inline."""
    later = scope.later
    scope.later = later | needed_by(node.then)
    missed = write_test(scope, node.test)
    before = scope.branch()
    scope.depth += 1
    start = len(scope.lines)
    write_sequence(scope, node.then, later)
    middle, then_state = len(scope.lines), scope.branch()
    scope.restore(before)
    forget(scope, missed)
    scope.depth -= 1
    scope.line("else:")
    scope.depth += 1
    write_sequence(scope, node.otherwise, later)
    if node.then and isinstance(node.then[-1], Fail):
        if len(scope.lines) == middle + 1:
            scope.line("pass")
    elif node.otherwise and isinstance(node.otherwise[-1], Fail):
        scope.restore(then_state)
        if start == middle:
            scope.lines.insert(middle, "    " * scope.depth + "pass")
    else:
        _join(scope, then_state, later, start, middle)
    scope.depth -= 1


def write_sequence(scope: Scope, nodes: Sequence[GoalNode], later: FrozenSet[Needed]) -> None:
    """Write inline goals one after the other; ``later`` is what is needed after them."""
    nodes = join(scope.unit.database, scope.clause.counts, nodes)
    for at, node in enumerate(nodes):
        scope.later = later | needed_by(nodes[at + 1 :])
        write_inline(scope, node)
    scope.later = later


def forget(scope: Scope, missed: Missed) -> None:
    """Forget what a failed test may have left unset."""
    names, numbers = missed
    for var in names:
        scope.names.pop(var, None)
    for var in numbers:
        scope.numbers.pop(var, None)


def _join(scope: Scope, then_state: ScopeState, later: FrozenSet[Needed], start: int, middle: int) -> None:
    """Give the variables that are needed later the same names at the ends of both branches."""
    then_lines: List[str] = []
    indent = "    " * scope.depth
    else_names, then_names = scope.names, then_state[0]
    merged: Dict[Needed, str] = {}
    for var in {**then_names, **else_names}:
        left, right = then_names.get(var), else_names.get(var)
        if left == right:
            merged[var] = right  # type: ignore[assignment]
        elif var in later and var.__class__ is Var:
            name = merged[var] = scope.clause.local(var)
            if left != name:
                then_lines.append(f"{indent}{name} = {left or 'Var()'}")
            if right != name:
                scope.line(f"{name} = {right or 'Var()'}")
    if len(scope.lines) == middle + 1:
        scope.line("pass")
    if not then_lines and middle == start:
        then_lines.append(f"{indent}pass")
    scope.lines[middle:middle] = then_lines
    scope.names = merged
    scope.fresh &= then_state[1]
    numbers = then_state[2]
    scope.numbers = {
        var: value for var, value in scope.numbers.items() if numbers.get(var) == value and var in merged
    }


def write_test(scope: Scope, test: List[GoalNode]) -> Missed:
    """Write an ``if`` line that is true where a test (a list of inline goals) succeeds.

    Bindings of a test that fails are undone.

    Returns:
        What may have no value where it fails, for `forget`.
    """
    known, numbers = set(scope.names), dict(scope.numbers)
    if len(test) == 1:
        condition = simple_test(scope, test[0])
        if condition is not None:
            scope.line(f"if {condition}:")
            return set(), set()
    flag, mark = scope.temp("ok"), scope.temp("m")
    fail, scope.fail = scope.fail, "break"
    scope.line(f"{flag} = False")
    # The test works on copies: what it finds by following its own bindings must not outlive them.
    outer = scope.names
    scope.names = dict(outer)
    for var in sorted(needed_by(test), key=scope.clause.number):
        if var.__class__ is Var and var in outer:
            scope.names[var] = scope.temp("w")
            scope.line(f"{scope.names[var]} = {outer[var]}")
    at = len(scope.lines)
    binds, scope.binds = scope.binds, False
    scope.line("while True:")
    scope.depth += 1
    write_sequence(scope, test, scope.later)
    scope.line(f"{flag} = True")
    scope.line("break")
    scope.depth -= 1
    if scope.binds:
        scope.lines.insert(at, "    " * scope.depth + f"{mark} = len(trail)")
        scope.line(f"if not {flag}:")
        scope.line(f"    undo(trail, {mark})")
    scope.binds |= binds
    scope.fail = fail
    scope.names.update(outer)
    scope.line(f"if {flag}:")
    return set(scope.names) - known, {
        var for var, value in scope.numbers.items() if numbers.get(var) != value
    }
