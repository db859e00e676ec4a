"""Code for clauses that build a list (or another chain of terms) while they recurse.

``app([H|T], L, [H|R]) :- app(T, L, R)`` called with an unbound third argument makes one cell a turn, each
ending in a variable that the next turn binds. The loop written here collects the items instead and makes
the cells in one go, from the last to the first, so that no variable is needed in between.
"""

from typing import List, NamedTuple, Optional, Sequence, Tuple

from ..terms import CompoundTerm, Functor, Term, Var, deref
from .inline import write_inline
from .nodes import CallNode, GoalNode, needed_by
from .scope import ClauseVariables, Scope
from .unification import match, take_apart


class Shape(NamedTuple):
    """What makes a clause build: position of the argument that is built, and of the hole in its cell."""

    position: int
    hole: int


def shape_of(
    clause: ClauseVariables, args: Sequence[Term], nodes: Sequence[GoalNode], key: Functor, switch: int
) -> Optional[Shape]:
    """Return the shape of a clause whose last goal calls its own predicate, or None where it does not fit.

    Args:
        clause: counts of its variables.
        args: of its head.
        nodes: its body; inline goals may be arithmetic only, which cannot notice when a cell is made.
        key: functor of the predicate.
        switch: the argument that the predicate switches on, a compound term.
    """
    call = nodes[-1] if nodes else None
    if not isinstance(call, CallNode) or call.inline or call.key is not key:
        return None
    if any(not isinstance(node, CallNode) or node.form not in ("is", "arithmetic") for node in nodes[:-1]):
        return None
    found = None
    for at, arg in enumerate(args):
        arg = deref(arg)
        if arg.__class__ is not tuple or at == switch:
            continue
        hole = deref(call.args[at])
        places = [number for number, item in enumerate(arg) if number and deref(item) is hole]
        if found is not None or hole.__class__ is not Var or len(places) != 1 or clause.counts[hole] != 2:
            return None
        found = Shape(at, places[0])
    return found


def write_building(
    scope: Scope,
    locals_: Sequence[str],
    args: Sequence[Term],
    nodes: Sequence[GoalNode],
    shape: Shape,
    switch: int,
) -> None:
    """Write the loop for an unbound argument; afterwards the general code of the clause follows."""
    call = nodes[-1]
    assert isinstance(call, CallNode)
    source, built = locals_[switch], locals_[shape.position]
    pattern, cell = deref(args[switch]), deref(args[shape.position])
    assert pattern.__class__ is tuple
    assert cell.__class__ is tuple
    before = scope.branch()
    scope.dereference(built)
    scope.line("if k is Var:")
    scope.depth += 1
    scope.line("items = []")
    scope.line("for _ in LOOP:")
    scope.depth += 1
    for at, arg in enumerate(args):
        arg = deref(arg)
        if arg.__class__ is Var and at != shape.position:
            scope.names.setdefault(arg, locals_[at])
    take_apart(scope, source, pattern, 0, check=False)
    for at, arg in enumerate(args):
        arg = deref(arg)
        if at not in (switch, shape.position) and not (arg.__class__ is Var and scope.clause.is_void(arg)):
            match(scope, locals_[at], arg)
    for at, node in enumerate(nodes[:-1]):
        scope.later = needed_by(nodes[at + 1 :])
        write_inline(scope, node)
    items = [scope.build(item) for number, item in enumerate(cell) if number not in (0, shape.hole)]
    scope.line(f"items.append({', '.join(items) if len(items) == 1 else '(' + ', '.join(items) + ')'})")
    _advance(scope, locals_, call, shape)
    scope.dereference(source)
    scope.line(f"if k is not tuple or {source}[0] is not {scope.unit.constant(pattern[0])}:")
    scope.line("    break")
    scope.depth -= 1
    scope.line("else:")
    scope.line("    BUDGET.turned()")
    scope.line("last = hole = Var()")
    _cells(scope, cell, shape)
    scope.line(f"{built}.ref = last")
    scope.line(f"push({built})")
    again = [*locals_]
    again[shape.position] = "hole"
    scope.line("if len(items) > 255:")
    scope.line(f"    return ({', '.join([scope.unit.predicate(call.key), *again, 'after'])})")
    scope.line(f"{built} = hole")
    scope.line("continue")
    scope.depth -= 1
    scope.restore(before)
    scope.looped = True


def _advance(scope: Scope, locals_: Sequence[str], call: CallNode, shape: Shape) -> None:
    """Write the arguments of the next turn."""
    changed: List[Tuple[str, str]] = []
    for at, arg in enumerate(call.args):
        if at != shape.position:
            value = scope.build(arg)
            if value != locals_[at]:
                changed.append((locals_[at], value))
    if changed:
        targets, sources = zip(*changed)
        scope.line(f"{', '.join(targets)} = {', '.join(sources)}")


def _cells(scope: Scope, cell: CompoundTerm, shape: Shape) -> None:
    """Write the making of the cells, from the last to the first."""
    count = len(cell) - 2
    parts = []
    number = 0
    for at in range(1, len(cell)):
        if at == shape.hole:
            parts.append("last")
        else:
            parts.append("item" if count == 1 else f"item[{number}]")
            number += 1
    scope.line("items.reverse()")
    scope.line("for item in items:")
    scope.line(f"    last = ({', '.join([scope.unit.constant(cell[0]), *parts])})")
