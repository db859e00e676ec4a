"""Code for calls that are straight Python: unification, arithmetic, tests, and built-ins as functions."""

from typing import Optional

from ..terms import Atom, Term, Var, deref, variables
from .compounds import dereferenced, write_argument, write_functor
from .expressions import number, number_of_program
from .joining import JoinedNode
from .known import KnownFunction
from .nodes import COMPARISONS, KNOWN_ARG, ORDERS, TYPE_TESTS, CallNode, GoalNode
from .scope import Scope
from .unification import differs, forget_fresh, match


def write_call(scope: Scope, node: CallNode) -> None:
    """Write an inline call; it fails by the scope's fail statement."""
    _WRITERS[node.form](scope, node)


def _unify(scope: Scope, node: CallNode) -> None:
    left, right = deref(node.args[0]), deref(node.args[1])
    if left.__class__ is not Var:
        left, right = right, left
    if left.__class__ is not Var:
        _unify_terms(scope, left, right)
        return
    if left not in scope.names:
        if right.__class__ is Var and right not in scope.names:
            scope.names[left] = scope.names[right] = scope.create(right)
            scope.fresh.discard(right)
            return
        if left not in variables(right):
            scope.names[left] = scope.build(right)
            if right.__class__ is not Var:
                name = scope.clause.local(left)
                scope.line(f"{name} = {scope.names[left]}")
                scope.names[left] = name
                if right.__class__ in (int, float) and right - right == 0:
                    scope.numbers[left] = name, right.__class__.__name__
            return
    if right.__class__ is Var and right not in scope.names:
        scope.names[right] = scope.local(left)
        scope.fresh.discard(left)
        return
    scope.fresh.discard(left)
    match(scope, scope.local(left), right)


def _unify_terms(scope: Scope, left: Term, right: Term) -> None:
    """Unify two terms that are both no variables: argument by argument."""
    if left.__class__ is tuple and right.__class__ is tuple:
        if left[0] is not right[0]:
            scope.line(scope.fail)
            return
        scope.binds = True
        scope.line(f"if not unify({scope.build(left)}, {scope.build(right)}, trail):")
        scope.line(f"    {scope.fail}")
        forget_fresh(scope, left)
        forget_fresh(scope, right)
    elif left.__class__ is not right.__class__ or not (left is right or left == right):
        scope.line(scope.fail)


def _is(scope: Scope, node: CallNode) -> None:
    target = deref(node.args[0])
    value, kind = number_of_program(scope, node.args[1])
    if target.__class__ is Var and target not in scope.names:
        if target in variables(node.args[1]):
            scope.create(target)
        elif value[0] in "tn":
            scope.names[target] = value
            scope.numbers[target] = value, kind
            return
        else:
            name = scope.clause.local(target)
            scope.line(f"{name} = {value}")
            scope.names[target] = name
            scope.numbers[target] = name, kind
            return
    name = scope.temp("p")
    scope.line(f"{name} = {scope.build(target)}")
    scope.binds = True
    scope.dereference(name)
    scope.line("if k is Var:")
    scope.line(f"    {name}.ref = {value}")
    scope.line(f"    push({name})")
    scope.line(
        f"elif k is not {value}.__class__ or not same({name}, {value}):"
        if value[0] in "tn"
        else f"elif {differs(deref(node.args[1]), name, value)}:"
    )
    scope.line(f"    {scope.fail}")


def _builtin(scope: Scope, node: CallNode) -> None:
    functional = scope.unit.database.predicate(node.key).functional
    if functional is not None:
        _function(scope, node, functional)
        return
    scope.line(f"if not {_builtin_call(scope, node)}:")
    scope.line(f"    {scope.fail}")


def _builtin_call(scope: Scope, node: CallNode) -> str:
    scope.binds = True
    args = "".join(f", {scope.build(arg)}" for arg in node.args)
    for arg in node.args:
        forget_fresh(scope, arg)
    return f"{scope.unit.builtin(node.key)}(M{args})"


def _joined(scope: Scope, node: CallNode) -> None:
    """Write the call of the function of goals that are joined."""
    assert isinstance(node, JoinedNode)
    *inputs, output = node.args
    result = scope.temp("p")
    call = scope.unit.constant(node.function)
    scope.line(f"{result} = {call}({', '.join([scope.build(arg) for arg in inputs])})")
    scope.line(f"if {result} is None:")
    scope.line(f"    {scope.fail}")
    for arg in inputs:
        forget_fresh(scope, arg)
    output = deref(output)
    if output.__class__ is Var and output in scope.names:
        _bind_output(scope, output, result)
    else:
        match(scope, result, output)


def _function(scope: Scope, node: CallNode, functional: KnownFunction) -> None:
    """Write a call for the outputs, and their unification; void variables are left alone."""
    inputs = [node.args[at] for at in functional.inputs]
    result = scope.temp()
    call = scope.unit.constant(functional.function)
    if node.key is KNOWN_ARG:
        write_argument(scope, result, call, *inputs)
    else:
        scope.line(f"{result} = {call}({', '.join([scope.build(arg) for arg in inputs])})")
        scope.line(f"if {result} is None:")
        scope.line(f"    {scope.fail}")
    for arg in inputs:
        forget_fresh(scope, arg)
    for index, (at, show) in enumerate(zip(functional.outputs, functional.shows)):
        arg = deref(node.args[at])
        if arg.__class__ is Var and scope.clause.is_void(arg):
            continue
        value = result if functional.single else f"{result}[{index}]"
        name = scope.temp("p")
        scope.line(f"{name} = {value}" if show is None else f"{name} = {scope.unit.constant(show)}({value})")
        if node.key is KNOWN_ARG and arg.__class__ is Var and arg in scope.names:
            _bind_output(scope, arg, name)
        else:
            match(scope, name, arg)


def _bind_output(scope: Scope, var: Var, value: str) -> None:
    """Write the unification of a variable that is there already, most likely unbound, with a value."""
    name = scope.names[var]
    scope.binds = True
    scope.fresh.discard(var)
    scope.dereference(name)
    scope.line(f"if k is Var and {value}.__class__ is not Var:")
    scope.line(f"    {name}.ref = {value}")
    scope.line(f"    push({name})")
    scope.line(f"elif not unify({name}, {value}, trail):")
    scope.line(f"    {scope.fail}")


def _direct(scope: Scope, node: CallNode) -> None:
    """Write a call of a predicate as a function, see `compiler.direct`."""
    result = scope.temp()
    scope.binds = True
    args = ", ".join([scope.build(arg) for arg in node.args])
    for arg in node.args:
        forget_fresh(scope, arg)
    direct = scope.unit.database.direct(node.key)
    direct.prepare(node.once)
    function = scope.unit.constant(direct)
    scope.line(f"{result} = {function}.{'first' if node.once else 'only'}({args})")
    scope.line(f"if not {result}:")
    scope.line(f"    if {result} is None:")
    scope.line(f"        {scope.give_up}")
    scope.line(f"    {scope.fail}")


def _test(scope: Scope, node: CallNode) -> None:
    scope.line(f"if not ({simple_test(scope, node)}):")
    scope.line(f"    {scope.fail}")


def simple_test(scope: Scope, node: GoalNode) -> Optional[str]:
    """Return the Python condition of a test that binds nothing, after writing what it needs; None for others."""
    if not isinstance(node, CallNode):
        return None
    if node.form == "arithmetic":
        left, _ = number(scope, node.args[0])
        right, _ = number(scope, node.args[1])
        return f"{left} {COMPARISONS[node.key]} {right}"
    if node.form == "type":
        return TYPE_TESTS[node.key].format(dereferenced(scope, node.args[0]))
    if node.form == "order":
        return _order(scope, node)
    return None


def _order(scope: Scope, node: CallNode) -> str:
    left, right = deref(node.args[0]), deref(node.args[1])
    operator = ORDERS[node.key]
    if operator in ("== 0", "!= 0"):
        if left.__class__ is Atom:
            left, right = right, left
        if right.__class__ is Atom:
            name, word = dereferenced(scope, left), "is" if operator == "== 0" else "is not"
            return f"{name} {word} {scope.unit.constant(right)}"
        one, other = dereferenced(scope, left), dereferenced(scope, right)
        is_same = (
            f"({one} is {other} or {one}.__class__ is not Var and {one}.__class__ is not Atom"
            f" and compare({one}, {other}, unlike) == 0)"
        )
        return is_same if operator == "== 0" else f"not {is_same}"
    return f"compare({scope.build(left)}, {scope.build(right)}) {operator}"


def _differ(scope: Scope, node: CallNode) -> None:
    mark = scope.temp("m")
    scope.line(f"{mark} = len(trail)")
    scope.line(f"if unify({scope.build(node.args[0])}, {scope.build(node.args[1])}, trail):")
    scope.line(f"    undo(trail, {mark})")
    scope.line(f"    {scope.fail}")
    scope.line(f"undo(trail, {mark})")
    for arg in node.args:
        forget_fresh(scope, arg)


_WRITERS = {
    "unify": _unify,
    "differ": _differ,
    "is": _is,
    "arithmetic": _test,
    "order": _test,
    "type": _test,
    "builtin": _builtin,
    "functor": write_functor,
    "direct": _direct,
    "joined": _joined,
}
