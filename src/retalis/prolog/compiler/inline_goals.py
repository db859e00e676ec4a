"""Compilation of inline goals: goals that leave no choice point and call no frame of the program.

Unification, arithmetic, comparison, type tests, deterministic built-ins and predicates that are functions become
Python statements that fall through on success and execute the scope's ``fail`` statement otherwise. Conditions whose
parts are all inline become a Python ``if``.

Two optimizations belong here. A unification with a variable that has no value yet writes at most an assignment:
the variable becomes a name for the value. Consecutive built-ins whose intermediate values are used nowhere else
become one call of a fused function (`join_goals`), so that the intermediate values never become terms.

An arithmetic expression is compiled bottom-up: each operation becomes one assignment to a temporary, and its result
is described by a class (`Operand`). A known class removes tests: the sum of two locals that hold integers needs no
check. For an operand of unknown class the generated code tests for the common case and calls the general evaluator
(``machine.arithmetic.evaluate_exact``) for the rest, so results and errors are those of the interpreter.
"""

from typing import Any, Dict, FrozenSet, List, Mapping, Optional, Sequence, Set, Tuple

from ..machine.arithmetic import EVALUABLE
from ..terms import timestamps
from ..terms.list_terms import conjunction
from ..terms.term_traversal import variables
from ..terms.types import Atom, CompoundTerm, Functor, Term, Var, deref, functor
from .clause_nodes import (
    COMPARISONS,
    KNOWN_ARG,
    ORDERS,
    TYPE_TESTS,
    CallNode,
    Cut,
    Fail,
    FunctionalModes,
    GoalNode,
    IfThenElse,
    JoinedGoals,
    Needed,
    PredicateResolver,
    needed_by,
)
from .code_scope import Operand, Scope, ScopeState
from .unification_code import decoded_local, differs, forget_fresh, match, write_argument, write_functor

_MAX_JOINED_GOALS = 4
"""Consecutive goals that one function may evaluate."""

_PLUS, _MINUS, _TIMES = functor("+", 2), functor("-", 2), functor("*", 2)
_BASIC_OPERATORS = {_PLUS: ("+", "add"), _MINUS: ("-", "subtract"), _TIMES: ("*", "multiply")}
_BIT_SYMBOLS = {functor("/\\", 2): "&", functor("\\/", 2): "|", functor("xor", 2): "^"}
_INTEGER_OPERATIONS = {
    functor("//", 2),
    functor("mod", 2),
    functor("rem", 2),
    functor("div", 2),
    functor(">>", 2),
    functor("<<", 2),
}
_FLOOR_SYMBOLS = {functor("mod", 2): "%", functor("div", 2): "//"}
_TRUNCATING_DIVISION = functor("//", 2)
_INTEGER_FUNCTIONS = {
    *_INTEGER_OPERATIONS,
    *_BIT_SYMBOLS,
    functor("\\", 1),
    functor("gcd", 2),
    functor("msb", 1),
}
_ROUNDING_FUNCTIONS = {functor(name, 1) for name in ("integer", "truncate", "round", "floor", "ceiling")}
_INSTANT_FUNCTIONS = {
    *(functor(name, 1) for name in ("+", "eval", "rational", "rationalize")),
    *(functor(name, 2) for name in ("max", "min")),
    timestamps.DATIME6,
    timestamps.DATIME7,
}
"""Functions whose value may be a timestamp that carries its exact instant (see `arithmetic`)."""
_MAX_EXPRESSION_DEPTH = 30
"""Nesting of arithmetic that is compiled; deeper operations are evaluated from their term."""


class JoinedNode(CallNode):
    """Consecutive goals that one function evaluates.

    Attributes:
        function: takes the inputs, all arguments but the last; returns the output, or None if a goal fails.
    """

    __slots__ = ("function",)

    def __init__(self, goals: Sequence[CallNode], joined: JoinedGoals):
        super().__init__("joined", goals[0].key, (*joined.inputs, joined.output), True)
        self.function = joined.function
        self.source = conjunction([goal.source for goal in goals if goal.source is not None])


def join_goals(
    database: PredicateResolver, counts: Mapping[Any, int], nodes: Sequence[GoalNode]
) -> Sequence[GoalNode]:
    """Return goals with consecutive ones fused to a `JoinedNode` if the first one's predicate offers that.

    Args:
        database: the predicates; the `FunctionalModes` of the first goal decide through ``joins``.
        counts: how often each variable occurs in the clause; an intermediate value occurs twice.
        nodes: the goals.
    """
    fused: List[GoalNode] = []
    remaining = list(nodes)
    while remaining:
        goals = _leading_functions(database, remaining)
        modes = database.predicate(goals[0].key).functional_modes if goals else None
        joins = None if modes is None else modes.joins
        joined = None if joins is None else joins([(goal.key, *goal.args) for goal in goals], counts)
        if joined is None:
            fused.append(remaining.pop(0))
        else:
            fused.append(JoinedNode(goals[: joined.length], joined))
            del remaining[: joined.length]
    return fused


def _leading_functions(database: PredicateResolver, nodes: Sequence[GoalNode]) -> List[CallNode]:
    functions: List[CallNode] = []
    for node in nodes[:_MAX_JOINED_GOALS]:
        if not isinstance(node, CallNode) or node.form != "builtin":
            break
        if database.predicate(node.key).functional_modes is None:
            break
        functions.append(node)
    return functions


def write_call(scope: Scope, node: CallNode) -> None:
    """Write an inline call, which executes the scope's ``fail`` statement if it fails."""
    _WRITERS[node.form](scope, node)


def _write_unify(scope: Scope, node: CallNode) -> None:
    """Write ``=/2``; a variable without a value becomes a name for the other term."""
    left, right = deref(node.args[0]), deref(node.args[1])
    if left.__class__ is not Var:
        left, right = right, left
    if left.__class__ is not Var:
        _write_unify_terms(scope, left, right)
        return
    # A variable without a value is not created: it becomes another name for the value.
    if left not in scope.names:
        if right.__class__ is Var and right not in scope.names:
            scope.names[left] = scope.names[right] = scope.create(right)
            scope.fresh.discard(right)
            return
        if left not in variables(right):
            scope.names[left] = scope.build(right)
            # A term that is not a variable is stored in a local, so that it is built once however often the variable
            # is used.
            if right.__class__ is not Var:
                name = scope.clause.local(left)
                scope.write(f"{name} = {scope.names[left]}")
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


def _write_unify_terms(scope: Scope, left: Term, right: Term) -> None:
    """Write the unification of two terms that are not variables."""
    if left.__class__ is tuple and right.__class__ is tuple:
        if left[0] is not right[0]:
            scope.write(scope.fail)
            return
        scope.may_bind = True
        scope.write(f"if not unify({scope.build(left)}, {scope.build(right)}, trail):")
        scope.write(f"    {scope.fail}")
        forget_fresh(scope, left)
        forget_fresh(scope, right)
    elif left.__class__ is not right.__class__ or not (left is right or left == right):
        scope.write(scope.fail)


def _write_is(scope: Scope, node: CallNode) -> None:
    """Write ``is/2``: assignment to a variable without a value, otherwise unification with the value."""
    target = deref(node.args[0])
    value, operand_class = write_evaluation_to_term(scope, node.args[1])
    if target.__class__ is Var and target not in scope.names:
        if target in variables(node.args[1]):
            scope.create(target)
        # A temporary (``t1``, ``n1``) is assigned only once, so it can serve as the local of the variable.
        elif value[0] in "tn":
            scope.names[target] = value
            scope.numbers[target] = value, operand_class
            return
        else:
            name = scope.clause.local(target)
            scope.write(f"{name} = {value}")
            scope.names[target] = name
            scope.numbers[target] = name, operand_class
            return
    name = scope.temp("p")
    scope.write(f"{name} = {scope.build(target)}")
    scope.may_bind = True
    scope.dereference(name)
    scope.write("if k is Var:")
    scope.write(f"    {name}.ref = {value}")
    scope.write(f"    push({name})")
    # A temporary is compared by its class at run time; the class of a literal is known here.
    scope.write(
        f"elif k is not {value}.__class__ or not same({name}, {value}):"
        if value[0] in "tn"
        else f"elif {differs(deref(node.args[1]), name, value)}:"
    )
    scope.write(f"    {scope.fail}")


def _write_builtin(scope: Scope, node: CallNode) -> None:
    modes = scope.unit.database.predicate(node.key).functional_modes
    if modes is not None:
        _write_function(scope, node, modes)
        return
    scope.write(f"if not {_builtin_expression(scope, node)}:")
    scope.write(f"    {scope.fail}")


def _builtin_expression(scope: Scope, node: CallNode) -> str:
    scope.may_bind = True
    args = "".join(f", {scope.build(arg)}" for arg in node.args)
    # The built-in may bind its arguments or store them, so nothing is known of their variables afterwards.
    for arg in node.args:
        forget_fresh(scope, arg)
    return f"{scope.unit.builtin(node.key)}(M{args})"


def _write_joined(scope: Scope, node: CallNode) -> None:
    """Write the call of the function that evaluates joined goals."""
    assert isinstance(node, JoinedNode)
    *inputs, output = node.args
    result = scope.temp("p")
    call = scope.unit.constant(node.function)
    scope.write(f"{result} = {call}({', '.join([scope.build(arg) for arg in inputs])})")
    scope.write(f"if {result} is None:")
    scope.write(f"    {scope.fail}")
    for arg in inputs:
        forget_fresh(scope, arg)
    output = deref(output)
    if output.__class__ is Var and output in scope.names:
        _write_output(scope, output, result)
    else:
        match(scope, result, output)


def _write_function(scope: Scope, node: CallNode, modes: FunctionalModes) -> None:
    """Write a call of a function and the unification of its outputs; outputs to void variables are skipped."""
    inputs = [node.args[position] for position in modes.inputs]
    result = scope.temp()
    call = scope.unit.constant(modes.function)
    if node.key is KNOWN_ARG:
        write_argument(scope, result, call, *inputs)
    else:
        scope.write(f"{result} = {call}({', '.join([scope.build(arg) for arg in inputs])})")
        scope.write(f"if {result} is None:")
        scope.write(f"    {scope.fail}")
    for arg in inputs:
        forget_fresh(scope, arg)
    for index, (position, to_term) in enumerate(zip(modes.outputs, modes.to_term_functions)):
        arg = deref(node.args[position])
        if arg.__class__ is Var and scope.clause.is_void(arg):
            continue
        value = result if modes.has_single_output else f"{result}[{index}]"
        name = scope.temp("p")
        scope.write(
            f"{name} = {value}" if to_term is None else f"{name} = {scope.unit.constant(to_term)}({value})"
        )
        # arg/3 most often fills variables of a term that was just created, so the unbound case comes first.
        if node.key is KNOWN_ARG and arg.__class__ is Var and arg in scope.names:
            _write_output(scope, arg, name)
        else:
            match(scope, name, arg)


def _write_output(scope: Scope, var: Var, value: str) -> None:
    """Write the unification of a value with a variable that has a name and is most likely unbound."""
    name = scope.names[var]
    scope.may_bind = True
    scope.fresh.discard(var)
    scope.dereference(name)
    scope.write(f"if k is Var and {value}.__class__ is not Var:")
    scope.write(f"    {name}.ref = {value}")
    scope.write(f"    push({name})")
    scope.write(f"elif not unify({name}, {value}, trail):")
    scope.write(f"    {scope.fail}")


def _write_function_call(scope: Scope, node: CallNode) -> None:
    """Write a call of a predicate as a function; see `semidet_functions`."""
    result = scope.temp()
    scope.may_bind = True
    args = ", ".join([scope.build(arg) for arg in node.args])
    for arg in node.args:
        forget_fresh(scope, arg)
    functions = scope.unit.database.function_code(node.key)
    # The attribute is read at each call, because a change of the predicate replaces its functions.
    functions.precompile(node.first_is_enough)
    function = scope.unit.constant(functions)
    scope.write(f"{result} = {function}.{'first' if node.first_is_enough else 'only'}({args})")
    scope.write(f"if not {result}:")
    scope.write(f"    if {result} is None:")
    scope.write(f"        {scope.give_up}")
    scope.write(f"    {scope.fail}")


def _write_simple_test(scope: Scope, node: CallNode) -> None:
    scope.write(f"if not ({simple_test(scope, node)}):")
    scope.write(f"    {scope.fail}")


def simple_test(scope: Scope, node: GoalNode) -> Optional[str]:
    """Return the condition of a test that binds nothing, after writing what it needs; None for other goals."""
    if not isinstance(node, CallNode):
        return None
    if node.form == "arithmetic":
        left, _ = write_evaluation(scope, node.args[0])
        right, _ = write_evaluation(scope, node.args[1])
        return f"{left} {COMPARISONS[node.key]} {right}"
    if node.form == "type":
        return TYPE_TESTS[node.key].format(decoded_local(scope, node.args[0]))
    if node.form == "order":
        return _order_condition(scope, node)
    return None


def _order_condition(scope: Scope, node: CallNode) -> str:
    """Return the condition of a comparison in the standard order of terms."""
    left, right = deref(node.args[0]), deref(node.args[1])
    operator = ORDERS[node.key]
    if operator in ("== 0", "!= 0"):
        if left.__class__ is Atom:
            left, right = right, left
        # Atoms are interned, so identity decides. Other terms may be equal without being the same object.
        if right.__class__ is Atom:
            name, operator_word = decoded_local(scope, left), "is" if operator == "== 0" else "is not"
            return f"{name} {operator_word} {scope.unit.constant(right)}"
        left_name, right_name = decoded_local(scope, left), decoded_local(scope, right)
        is_same = (
            f"({left_name} is {right_name} or {left_name}.__class__ is not Var and {left_name}.__class__ is not Atom"
            f" and compare({left_name}, {right_name}, always_different) == 0)"
        )
        return is_same if operator == "== 0" else f"not {is_same}"
    return f"compare({scope.build(left)}, {scope.build(right)}) {operator}"


def _write_differ(scope: Scope, node: CallNode) -> None:
    """Write the test that two terms do not unify."""
    # The bindings are undone in either case: only the result of the unification counts.
    mark = scope.temp("m")
    scope.write(f"{mark} = len(trail)")
    scope.write(f"if unify({scope.build(node.args[0])}, {scope.build(node.args[1])}, trail):")
    scope.write(f"    undo(trail, {mark})")
    scope.write(f"    {scope.fail}")
    scope.write(f"undo(trail, {mark})")
    for arg in node.args:
        forget_fresh(scope, arg)


_WRITERS = {
    "unify": _write_unify,
    "differ": _write_differ,
    "is": _write_is,
    "arithmetic": _write_simple_test,
    "order": _write_simple_test,
    "type": _write_simple_test,
    "builtin": _write_builtin,
    "functor": write_functor,
    "function": _write_function_call,
    "joined": _write_joined,
}


UnsetVariables = Tuple[Set[Needed], Set[Var]]
"""Variables without a local, and variables without a known number, after a test that has failed; see `forget`."""


def write_inline(scope: Scope, node: GoalNode) -> None:
    """Write an inline goal, which executes the scope's ``fail`` statement if it fails."""
    if isinstance(node, CallNode):
        write_call(scope, node)
    elif isinstance(node, Cut):
        _write_cut(scope, node)
    elif isinstance(node, IfThenElse):
        _write_condition(scope, node)
    else:
        scope.write(scope.fail)


def _write_cut(scope: Scope, node: Cut) -> None:
    # A soft cut keeps the choice points of the test. The entry is replaced, not deleted: heights above it stay valid.
    if node.is_soft:
        height = scope.names[node.height]
        scope.write(f"choices[{height}] = (DEAD, choices[{height}][-1])")
        return
    height_name = scope.names.get(node.height)
    if height_name is None or (scope.pending_choice is not None and node.has_cut):
        # Nothing has been pushed since the clause was entered, so the cut only drops the pending choice point of the
        # following clauses, and no statement is needed.
        scope.pending_choice = None
        scope.fail = scope.fail_after_cut
        return
    scope.write(f"del choices[{height_name}:]")


def _write_condition(scope: Scope, node: IfThenElse) -> None:
    """Write an if-then-else whose parts are all inline as a Python ``if``."""
    later = scope.needed_later
    scope.needed_later = later | needed_by(node.then)
    unset = write_test(scope, node.test)
    saved_scope = scope.snapshot()
    scope.depth += 1
    start = len(scope.lines)
    write_sequence(scope, node.then, later)
    middle, then_state = len(scope.lines), scope.snapshot()
    scope.restore(saved_scope)
    # The else branch starts without the values that the test would have computed.
    forget(scope, unset)
    scope.depth -= 1
    scope.write("else:")
    scope.depth += 1
    write_sequence(scope, node.otherwise, later)
    # If one branch always fails, the code after the condition is reached from the other one only, and its knowledge
    # holds. Otherwise the branches have to agree on names.
    if node.then and isinstance(node.then[-1], Fail):
        if len(scope.lines) == middle + 1:
            scope.write("pass")
    elif node.otherwise and isinstance(node.otherwise[-1], Fail):
        scope.restore(then_state)
        if start == middle:
            scope.lines.insert(middle, "    " * scope.depth + "pass")
    else:
        _merge_branches(scope, then_state, later, start, middle)
    scope.depth -= 1


def write_sequence(scope: Scope, nodes: Sequence[GoalNode], later: FrozenSet[Needed]) -> None:
    """Write consecutive inline goals; ``later`` are the variables and heights needed after them."""
    nodes = join_goals(scope.unit.database, scope.clause.counts, nodes)
    for position, node in enumerate(nodes):
        scope.needed_later = later | needed_by(nodes[position + 1 :])
        write_inline(scope, node)
    scope.needed_later = later


def forget(scope: Scope, unset: UnsetVariables) -> None:
    """Remove the knowledge of locals and numbers that a failed test may not have set."""
    names, numbers = unset
    for var in names:
        scope.names.pop(var, None)
    for var in numbers:
        scope.numbers.pop(var, None)


def _merge_branches(
    scope: Scope, then_state: ScopeState, later: FrozenSet[Needed], start: int, middle: int
) -> None:
    """Give each variable that is needed later the same name at the ends of both branches.

    This is the merge of two control flow paths: names that differ are assigned to the variable's canonical name in
    each branch, and a variable that one branch has not bound is created there.

    Args:
        scope: the function, at the end of the else branch.
        then_state: the knowledge at the end of the then branch.
        later: variables and heights that are needed later.
        start: index of the first line of the then branch.
        middle: index of the line after the then branch, ``else:``.
    """
    then_lines: List[str] = []
    indent = "    " * scope.depth
    else_names, then_names = scope.names, then_state.names
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
                scope.write(f"{name} = {right or 'Var()'}")
    if len(scope.lines) == middle + 1:
        scope.write("pass")
    if not then_lines and middle == start:
        then_lines.append(f"{indent}pass")
    scope.lines[middle:middle] = then_lines
    scope.names = merged
    # A variable is fresh, and a number known, only if that holds after both branches.
    scope.fresh &= then_state.fresh
    then_numbers = then_state.numbers
    scope.numbers = {
        var: value for var, value in scope.numbers.items() if then_numbers.get(var) == value and var in merged
    }


def write_test(scope: Scope, test: List[GoalNode]) -> UnsetVariables:
    """Write an ``if`` line whose condition is true if a test (a list of inline goals) succeeds.

    Bindings of a failed test are undone.

    Returns:
        Variables that may lack a name or a number if the test fails, for `forget`.
    """
    named_before, numbers_before = set(scope.names), dict(scope.numbers)
    if len(test) == 1:
        condition = simple_test(scope, test[0])
        if condition is not None:
            scope.write(f"if {condition}:")
            return set(), set()
    # Python has no labelled exit: the test is the body of a loop that runs once, and ``break`` is its failure.
    flag, mark = scope.temp("ok"), scope.temp("m")
    outer_fail, scope.fail = scope.fail, "break"
    scope.write(f"{flag} = False")
    # The test works on copies of the locals: dereferencing replaces a local by its value, which must not outlive a
    # binding that the failed test undoes.
    outer_names = scope.names
    scope.names = dict(outer_names)
    for var in sorted(needed_by(test), key=scope.clause.number):
        if var.__class__ is Var and var in outer_names:
            scope.names[var] = scope.temp("w")
            scope.write(f"{scope.names[var]} = {outer_names[var]}")
    loop_start = len(scope.lines)
    outer_binds, scope.may_bind = scope.may_bind, False
    scope.write("while True:")
    scope.depth += 1
    write_sequence(scope, test, scope.needed_later)
    scope.write(f"{flag} = True")
    scope.write("break")
    scope.depth -= 1
    # Only now is it known whether the test binds anything that needs a mark.
    if scope.may_bind:
        scope.lines.insert(loop_start, "    " * scope.depth + f"{mark} = len(trail)")
        scope.write(f"if not {flag}:")
        scope.write(f"    undo(trail, {mark})")
    scope.may_bind |= outer_binds
    scope.fail = outer_fail
    scope.names.update(outer_names)
    scope.write(f"if {flag}:")
    return set(scope.names) - named_before, {
        var for var, value in scope.numbers.items() if numbers_before.get(var) != value
    }


def write_evaluation(scope: Scope, expression: Term, depth: int = 0) -> Operand:
    """Write the evaluation of an arithmetic expression and return its operand."""
    expression = deref(expression)
    if expression.__class__ is int:
        return scope.unit.constant(expression), "int"
    if expression.__class__ is float and expression - expression == 0:
        return scope.unit.constant(expression), "float"
    if expression.__class__ is Var:
        return _write_number_of_variable(scope, expression)
    if depth < _MAX_EXPRESSION_DEPTH:
        if expression.__class__ is tuple and expression[0] in EVALUABLE:
            return _write_operation(scope, expression, depth)
        if expression.__class__ is Atom and expression.functor in EVALUABLE:
            target = scope.temp()
            scope.write(f"{target} = {scope.unit.constant(EVALUABLE[expression.functor])}()")
            return target, "num"
    # Unknown functions and deep expressions are evaluated from their term, which raises the errors as well.
    target = scope.temp()
    scope.write(f"{target} = evaluate_exact({scope.build(expression)})")
    return target, "any"


def write_evaluation_to_term(scope: Scope, expression: Term) -> Operand:
    """Write the evaluation of an expression whose value becomes a term, and return its operand."""
    value, operand_class = write_evaluation(scope, expression)
    if operand_class != "any":
        return value, operand_class
    target = scope.temp()
    scope.write(
        f"{target} = {value} if {value}.__class__ is int or {value}.__class__ is float else without_instant({value})"
    )
    return target, "num"


def _write_number_of_variable(scope: Scope, var: Var) -> Operand:
    known_operand = scope.numbers.get(var)
    if known_operand is not None:
        return known_operand
    name = scope.local(var)
    target = scope.temp("n")
    if scope.is_entry:
        scope.write(f"if {name}.__class__ is int or {name}.__class__ is float:")
        scope.write(f"    {target} = {name}")
        scope.write("else:")
        scope.depth += 1
        _write_number_of_bound_variable(scope, name, target)
        scope.depth -= 1
    else:
        # In a continuation the value is most often a variable that an earlier call has bound; at entry it is most
        # often the number itself. Testing the likely case first saves a dereference per operation.
        _write_number_of_bound_variable(scope, name, target)
    scope.numbers[var] = target, "any"
    return target, "any"


def _write_number_of_bound_variable(scope: Scope, name: str, target: str) -> None:
    """Write the evaluation of a local that is most likely a variable bound to a number."""
    scope.write(f"{target} = {name}.ref if {name}.__class__ is Var else {name}")
    scope.write(f"if {target}.__class__ is not int and {target}.__class__ is not float:")
    scope.write(f"    {target} = evaluate_exact({name})")


def _write_operation(scope: Scope, expression: CompoundTerm, depth: int) -> Operand:
    key: Functor = expression[0]
    if key in _BASIC_OPERATORS:
        return _write_basic_operation(scope, key, expression, depth)
    # Operands are evaluated from the last to the first, as the interpreter does: an expression with two errors must
    # raise the same one in both.
    operands = [write_evaluation(scope, arg, depth + 1) for arg in expression[:0:-1]][::-1]
    names = ", ".join(name for name, _ in operands)
    call = f"{scope.unit.constant(EVALUABLE[key])}({names})"
    target = scope.temp()
    symbol = "//" if key is _TRUNCATING_DIVISION else _BIT_SYMBOLS.get(key) or _FLOOR_SYMBOLS.get(key)
    if symbol is not None:
        untyped = [name for name, operand_class in operands if operand_class != "int"]
        test = " and ".join(f"{name}.__class__ is int" for name in untyped) or "True"
        if key in _FLOOR_SYMBOLS:
            test = f"{operands[1][0]} and {test}"
        elif key is _TRUNCATING_DIVISION:
            # Python's // rounds down; for non-negative operands that equals the truncation of ISO Prolog. Division by
            # longer integers may take long and is left to the evaluator.
            test += f" and {operands[0][0]} >= 0 < {operands[1][0]} < {1 << 64}"
        scope.write(f"{target} = {operands[0][0]} {symbol} {operands[1][0]} if {test} else {call}")
    else:
        scope.write(f"{target} = {call}")
    if key in _INSTANT_FUNCTIONS:
        return target, "any"
    return target, "int" if key in _INTEGER_FUNCTIONS or key in _ROUNDING_FUNCTIONS else "num"


def _write_basic_operation(scope: Scope, key: Functor, expression: CompoundTerm, depth: int) -> Operand:
    symbol, general_function = _BASIC_OPERATORS[key]
    # A variable plus or minus an integer, the step of most loops, is one conditional expression without a temporary.
    left_term, right_term = deref(expression[1]), deref(expression[2])
    target = scope.temp()
    untyped = _untyped_local(scope, left_term), _untyped_local(scope, right_term)
    if untyped[0] is not None and right_term.__class__ is int:
        left, right = untyped[0], scope.unit.constant(right_term)
        scope.write(
            f"{target} = {left} {symbol} {right} if {left}.__class__ is int else {general_function}({left}, {right})"
        )
        return target, "num"
    if untyped[1] is not None and left_term.__class__ is int:
        left, right = scope.unit.constant(left_term), untyped[1]
        scope.write(
            f"{target} = {left} {symbol} {right} if {right}.__class__ is int else {general_function}({left}, {right})"
        )
        return target, "num"
    right, right_class = write_evaluation(scope, right_term, depth + 1)
    left, left_class = write_evaluation(scope, left_term, depth + 1)
    scope.write(f"{target} = {left} {symbol} {right}")
    if key is _TIMES:
        # Repeated multiplication grows integers exponentially, so each product is checked against the bounds at once.
        # The comparison is false for inf and nan as well, which `check_result` then rejects.
        scope.write(f"if not MIN_INTEGER < {target} < MAX_INTEGER:")
        scope.write(f"    check_result({target})")
        classes = {left_class, right_class}
        return target, "int" if classes == {"int"} else "float" if "float" in classes else "num"
    # A sum is at most one bit longer than its operands, so sums of integers need no check of their size.
    if left_class == right_class == "int":
        return target, "int"
    # x - x is 0 for finite numbers and nan (true) for inf and nan: one test for both.
    scope.write(f"if {target} - {target}:")
    scope.write(f"    check_result({target})")
    return target, "float" if "float" in (left_class, right_class) else "num"


def _untyped_local(scope: Scope, term: Term) -> "str | None":
    """Return the local of a variable whose numeric value is not known yet; None for other terms."""
    if term.__class__ is not Var or term in scope.numbers or not scope.is_entry:
        return None
    return scope.local(term)
