"""Compilation of arithmetic expressions to Python expressions on local variables.

An expression is compiled bottom-up: each operation becomes one assignment to a temporary, and its result is described
by a class (`Operand`). A known class removes tests: the sum of two locals that hold integers needs no check. For an
operand of unknown class the generated code tests for the common case and calls the general evaluator
(``machine.arithmetic.evaluate_exact``) for the rest, so results and errors are those of the interpreter.
"""

from typing import Tuple

from ..machine.arithmetic import EVALUABLE
from ..terms import timestamps
from ..terms.types import Atom, CompoundTerm, Functor, Term, Var, deref, functor
from .code_scope import Scope

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
    *(timestamps.DATIME6, timestamps.DATIME7),
}
"""Functions whose value may be a timestamp that carries its exact instant (see `arithmetic`)."""
_MAX_EXPRESSION_DEPTH = 30

Operand = Tuple[str, str]
"""A Python expression without side effects, and its class: "int", "float", "num" (either of them), or "any".

The value of class "any" is a number as well, but may carry the exact instant of a timestamp. Such values exist only
within an evaluation and never become terms; see `arithmetic`.
"""


def evaluate(scope: Scope, expression: Term, depth: int = 0) -> Operand:
    """Write the evaluation of an arithmetic expression and return its operand."""
    expression = deref(expression)
    if expression.__class__ is int:
        return scope.unit.constant(expression), "int"
    if expression.__class__ is float and expression - expression == 0:
        return scope.unit.constant(expression), "float"
    if expression.__class__ is Var:
        return _write_variable(scope, expression)
    if depth < _MAX_EXPRESSION_DEPTH:
        if expression.__class__ is tuple and expression[0] in EVALUABLE:
            return _write_operation(scope, expression, depth)
        if expression.__class__ is Atom and expression.functor in EVALUABLE:
            target = scope.temp()
            scope.line(f"{target} = {scope.unit.constant(EVALUABLE[expression.functor])}()")
            return target, "num"
    # Unknown functions and deep expressions are evaluated from their term, which raises the errors as well.
    target = scope.temp()
    scope.line(f"{target} = evaluate_exact({scope.build(expression)})")
    return target, "any"


def evaluate_to_term(scope: Scope, expression: Term) -> Operand:
    """Write the evaluation of an expression whose value becomes a term, and return its operand."""
    value, value_class = evaluate(scope, expression)
    if value_class != "any":
        return value, value_class
    target = scope.temp()
    scope.line(
        f"{target} = {value} if {value}.__class__ is int or {value}.__class__ is float else without_instant({value})"
    )
    return target, "num"


def _write_variable(scope: Scope, var: Var) -> Operand:
    number_type = scope.numbers.get(var)
    if number_type is not None:
        return number_type
    name = scope.local(var)
    target = scope.temp("n")
    if scope.entry:
        scope.line(f"if {name}.__class__ is int or {name}.__class__ is float:")
        scope.line(f"    {target} = {name}")
        scope.line("else:")
        scope.depth += 1
        _write_bound(scope, name, target)
        scope.depth -= 1
    else:
        # In a continuation the value is most often a variable that an earlier call has bound; at entry it is most
        # often the number itself. Testing the likely case first saves a dereference per operation.
        _write_bound(scope, name, target)
    scope.numbers[var] = target, "any"
    return target, "any"


def _write_bound(scope: Scope, name: str, target: str) -> None:
    """Write the evaluation of a local that is most likely a variable bound to a number."""
    scope.line(f"{target} = {name}.ref if {name}.__class__ is Var else {name}")
    scope.line(f"if {target}.__class__ is not int and {target}.__class__ is not float:")
    scope.line(f"    {target} = evaluate_exact({name})")


def _write_operation(scope: Scope, expression: CompoundTerm, depth: int) -> Operand:
    key: Functor = expression[0]
    if key in _BASIC_OPERATORS:
        return _write_basic(scope, key, expression, depth)
    # Operands are evaluated from the last to the first, as the interpreter does: an expression with two errors must
    # raise the same one in both.
    operands = [evaluate(scope, arg, depth + 1) for arg in expression[:0:-1]][::-1]
    names = ", ".join(name for name, _ in operands)
    call = f"{scope.unit.constant(EVALUABLE[key])}({names})"
    target = scope.temp()
    symbol = "//" if key is _TRUNCATING_DIVISION else _BIT_SYMBOLS.get(key) or _FLOOR_SYMBOLS.get(key)
    if symbol is not None:
        untyped = [name for name, number_type in operands if number_type != "int"]
        test = " and ".join(f"{name}.__class__ is int" for name in untyped) or "True"
        if key in _FLOOR_SYMBOLS:
            test = f"{operands[1][0]} and {test}"
        elif key is _TRUNCATING_DIVISION:
            # Python's // rounds down; for non-negative operands that equals the truncation of ISO Prolog. Division by
            # longer integers may take long and is left to the evaluator.
            test += f" and {operands[0][0]} >= 0 < {operands[1][0]} < {1 << 64}"
        scope.line(f"{target} = {operands[0][0]} {symbol} {operands[1][0]} if {test} else {call}")
    else:
        scope.line(f"{target} = {call}")
    if key in _INSTANT_FUNCTIONS:
        return target, "any"
    return target, "int" if key in _INTEGER_FUNCTIONS or key in _ROUNDING_FUNCTIONS else "num"


def _write_basic(scope: Scope, key: Functor, expression: CompoundTerm, depth: int) -> Operand:
    symbol, slow = _BASIC_OPERATORS[key]
    # A variable plus or minus an integer, the step of most loops, is one conditional expression without a temporary.
    left_term, right_term = deref(expression[1]), deref(expression[2])
    target = scope.temp()
    untyped = _untyped_local(scope, left_term), _untyped_local(scope, right_term)
    if untyped[0] is not None and right_term.__class__ is int:
        left, right = untyped[0], scope.unit.constant(right_term)
        scope.line(
            f"{target} = {left} {symbol} {right} if {left}.__class__ is int else {slow}({left}, {right})"
        )
        return target, "num"
    if untyped[1] is not None and left_term.__class__ is int:
        left, right = scope.unit.constant(left_term), untyped[1]
        scope.line(
            f"{target} = {left} {symbol} {right} if {right}.__class__ is int else {slow}({left}, {right})"
        )
        return target, "num"
    right, right_class = evaluate(scope, right_term, depth + 1)
    left, left_class = evaluate(scope, left_term, depth + 1)
    scope.line(f"{target} = {left} {symbol} {right}")
    if key is _TIMES:
        # Repeated multiplication grows integers exponentially, so each product is checked against the bounds at once.
        # The comparison is false for inf and nan as well, which `checked` then rejects.
        scope.line(f"if not MIN_INTEGER < {target} < MAX_INTEGER:")
        scope.line(f"    check_result({target})")
        classes = {left_class, right_class}
        return target, "int" if classes == {"int"} else "float" if "float" in classes else "num"
    # A sum is at most one bit longer than its operands, so sums of integers need no check of their size.
    if left_class == right_class == "int":
        return target, "int"
    # x - x is 0 for finite numbers and nan (true) for inf and nan: one test for both.
    scope.line(f"if {target} - {target}:")
    scope.line(f"    check_result({target})")
    return target, "float" if "float" in (left_class, right_class) else "num"


def _untyped_local(scope: Scope, term: Term) -> "str | None":
    """Return the local of a variable whose numeric value is not known yet; None for other terms."""
    if term.__class__ is not Var or term in scope.numbers or not scope.entry:
        return None
    return scope.local(term)
