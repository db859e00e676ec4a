"""Arithmetic: the evaluable functions, and the evaluation of an expression that is known only at run time.

Integers are unbounded; `/` of integers is an integer where it is exact and a float otherwise; an operation
on floats whose result is not a finite number raises, as SWI-Prolog does with its default flags.
"""

import math
from typing import Any, Callable, Dict, List, TypeVar, Union

from ...foundation import TermTooLarge, look
from ..machine import (
    domain_error,
    evaluation_error,
    indicator,
    instantiation_error,
    resource_error,
    type_error,
)
from ..terms import (
    CONS,
    LATE,
    MOST,
    NIL,
    SECOND,
    Atom,
    CompoundTerm,
    Functor,
    Lazy,
    String,
    Term,
    Var,
    deref,
    functor,
    refuse_cycles,
    timestamps,
)
from .instants import WholeInstant, is_instant_number, of_instant, plain

Number = Union[int, float]
F = TypeVar("F", bound=Callable[..., Number])

EVALUABLE: Dict[Functor, Callable[..., Number]] = {}
"""Functions of numbers, by name and arity."""

HUGE = 1 << 20
"""Bits of the largest integer that an operation may make (315,653 digits): a product takes 30 ms."""

LARGEST = 1 << HUGE
LEAST = -LARGEST

SLOW = 1 << 35
"""Product of the bits of two integers from which on an operation that is quadratic in them takes more than 50 ms."""


def evaluable(name: str, arity: int) -> Callable[[F], F]:
    """Register a Python function of ``arity`` numbers as the evaluable ``name/arity``."""

    def register(function: F) -> F:
        EVALUABLE[functor(name, arity)] = function
        return function

    return register


def evaluate(term: Any) -> Number:
    """Return the value of an arithmetic expression, as a program sees it.

    Raises:
        PrologError: instantiation, type or evaluation errors.
    """
    value = measure(term)
    return value if value.__class__ is int or value.__class__ is float else plain(value)


def measure(term: Any) -> Number:
    """Return the value of an arithmetic expression for subtraction or comparison: a stamp remembers its instant.

    Raises:
        PrologError: instantiation, type or evaluation errors.
    """
    kind = term.__class__
    if kind is int or kind is float:
        return term  # type: ignore[no-any-return]
    if kind is Var:
        term = deref(term)
        kind = term.__class__
        if kind is int or kind is float:
            return term  # type: ignore[no-any-return]
    if kind is tuple and len(term) <= 3:
        function = EVALUABLE.get(term[0])
        if function is not None:
            # Most expressions are one operation on numbers.
            left: Any = deref(term[1])
            kind = left.__class__
            if kind is int or kind is float:
                if len(term) == 2:
                    return function(left)
                right: Any = deref(term[2])
                kind = right.__class__
                if kind is int or kind is float:
                    return function(left, right)
    return _evaluate_deep(term)


def _evaluate_deep(term: Term) -> Number:
    """Evaluate with a stack of its own: the last operand first, a function once its operands have values."""
    values: List[Number] = []
    stack: List[Union[Term, _Apply]] = [term]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            look()
            if steps == LATE:
                refuse_cycles(term)
        item: Any = stack.pop()
        if item.__class__ is _Apply:
            arity = item.arity
            values[-arity:] = [item.apply(*reversed(values[-arity:]))]
            continue
        item = deref(item)
        kind = item.__class__
        if kind is int or kind is float:
            values.append(item)
        elif kind is tuple:
            if item[0] is CONS:
                values.append(_listed(item))
                continue
            stack.append(_Apply(item[0]))
            if len(stack) > MOST:
                raise TermTooLarge
            stack.extend(item[1:])
        else:
            values.append(_constant(item))
    return values[0]


class _Apply:
    """An operation whose operands are on the stack of values."""

    __slots__ = ("functor", "arity")

    def __init__(self, key: Functor):
        self.functor = key
        self.arity = key.arity

    def apply(self, *operands: Number) -> Number:
        """Return the value of the function."""
        function = EVALUABLE.get(self.functor)
        if function is None:
            raise type_error("evaluable", indicator(self.functor))
        return function(*operands)


def _listed(item: CompoundTerm) -> Number:
    """Return the code that a list of one character, or of its code, is; a ROS time ``[Sec,NSec]`` is a stamp."""
    first, rest = deref(item[1]), deref(item[2])
    if first.__class__ is int and rest.__class__ is tuple and rest[0] is CONS and deref(rest[2]) is NIL:
        part = deref(rest[1])
        if part.__class__ is int and 0 <= part < SECOND:
            return of_instant(timestamps.from_parts(first, part))
    if first.__class__ is Var:
        raise instantiation_error()
    code = first if first.__class__ is int and first >= 0 else None
    text = first.name if first.__class__ is Atom and first is not NIL else ""
    if len(text) != 1 and code is None:
        raise type_error("character", first)
    if rest is not NIL:
        raise type_error("[]", item)
    return ord(text) if code is None else code


def _constant(item: Term) -> Number:
    if item.__class__ is Var:
        raise instantiation_error()
    if item.__class__ is Atom:
        function = EVALUABLE.get(item.functor)
        if function is not None:
            return function()
        if item is NIL:
            raise type_error("evaluable", item)
        raise type_error("evaluable", indicator(item.functor))
    if item.__class__ is String:
        if len(item.text) == 1:
            return ord(item.text)
        raise type_error("[]", item)
    if item.__class__ is Lazy:
        return measure(item.term())
    if is_instant_number(item):
        return item  # type: ignore[return-value]
    raise type_error("evaluable", item)


def checked(value: Number) -> Number:
    """Return a result, unless it is infinite or nan, or an integer too large to go on with."""
    if value - value == 0:
        if value.__class__ is int and not LEAST < value < LARGEST:
            raise resource_error("memory")
        return value
    raise evaluation_error("undefined" if value != value else "float_overflow")


def integer(value: Any) -> int:
    """Return an operand that has to be an integer."""
    if value.__class__ is not int:
        if value.__class__ is WholeInstant:
            return int(value)
        raise type_error("integer", plain(checked(value)))
    return value


def not_less(least: int, value: Number) -> int:
    """Return an operand that has to be an integer and not less than 0, or 1."""
    if integer(value) < least:
        raise domain_error(f"not_less_than_{'one' if least else 'zero'}", value)
    return value  # type: ignore[return-value]


def bounded(left: int, right: int) -> None:
    """Refuse an operation on two integers that is quadratic in their sizes where it would take too long."""
    if left.bit_length() * right.bit_length() > SLOW:
        raise resource_error("integer_size")


def _divisible(left: Number, right: Number) -> None:
    """Check the operands of an integer division."""
    size = integer(right).bit_length()
    if not size:
        integer(left)
        raise evaluation_error("zero_divisor")
    if size > 64 and (integer(left).bit_length() - size) * size > SLOW:
        raise resource_error("integer_size")


def _to_float(value: Number) -> float:
    try:
        return checked(float(value))
    except OverflowError:
        raise evaluation_error("float_overflow") from None


# The four operations, also called by generated code with terms that may not be numbers yet.


def add(left: Term, right: Term) -> Number:
    """Evaluate both sides and return their sum."""
    left, right = measure(left), measure(right)
    value = left + right
    return value if value - value == 0 else checked(value)


def subtract(left: Term, right: Term) -> Number:
    """Evaluate both sides and return their difference."""
    left, right = measure(left), measure(right)
    value = left - right
    return value if value - value == 0 else checked(value)


def multiply(left: Term, right: Term) -> Number:
    """Evaluate both sides and return their product."""
    left, right = measure(left), measure(right)
    value = left * right
    return value if LEAST < value < LARGEST else checked(value)


EVALUABLE[functor("+", 2)] = add
EVALUABLE[functor("-", 2)] = subtract
EVALUABLE[functor("*", 2)] = multiply


@evaluable("/", 2)
def divide(left: Number, right: Number) -> Number:
    """Return the quotient: an integer where both are and it is exact, else a float."""
    if left.__class__ is int and right.__class__ is int:
        _divisible(left, right)
        quotient, rest = divmod(left, right)
        if rest == 0:
            return quotient
        try:
            return left / right
        except OverflowError:
            raise evaluation_error("float_overflow") from None
    if right == 0:
        raise evaluation_error("undefined" if left == 0 or left != left else "zero_divisor")
    return checked(left / right)


@evaluable("//", 2)
def truncated_quotient(left: Number, right: Number) -> int:
    """Return the integer quotient, truncated towards zero."""
    integer(left)
    _divisible(left, right)
    quotient = abs(left) // abs(right)
    return quotient if (left >= 0) == (right > 0) else -quotient  # type: ignore[return-value]


@evaluable("rem", 2)
def remainder(left: Number, right: Number) -> int:
    """Return the rest of truncated division; it has the sign of ``left``."""
    integer(left)
    _divisible(left, right)
    rest = abs(left) % abs(right)
    return rest if left >= 0 else -rest  # type: ignore[return-value]


@evaluable("mod", 2)
def modulo(left: Number, right: Number) -> int:
    """Return the rest of floored division; it has the sign of ``right``."""
    integer(left)
    _divisible(left, right)
    return left % right  # type: ignore[return-value]


@evaluable("div", 2)
def floored_quotient(left: Number, right: Number) -> int:
    """Return the integer quotient, rounded down."""
    integer(left)
    _divisible(left, right)
    return left // right  # type: ignore[return-value]


@evaluable("+", 1)
def _plus(value: Number) -> Number:
    return value


@evaluable("-", 1)
def negate(value: Number) -> Number:
    """Return the negative."""
    return -value


@evaluable("abs", 1)
def _abs(value: Number) -> Number:
    return abs(value)


@evaluable("sign", 1)
def _sign(value: Number) -> Number:
    if value.__class__ is int:
        return (value > 0) - (value < 0)
    return math.copysign(1.0, value) if value == value and value else abs(value)


@evaluable("max", 2)
def maximum(left: Number, right: Number) -> Number:
    """Return the greater one; of equal ones the float."""
    if left == right:
        return right if right.__class__ is float else left
    return left if left > right or right != right else right


@evaluable("min", 2)
def minimum(left: Number, right: Number) -> Number:
    """Return the lesser one; of equal ones the float."""
    if left == right:
        return right if right.__class__ is float else left
    return left if left < right or right != right else right


@evaluable("succ", 1)
def _succ(value: Number) -> int:
    return integer(value) + 1


@evaluable("plus", 2)
def _plus2(left: Number, right: Number) -> Number:
    return add(left, right)


@evaluable("gcd", 2)
def _gcd(left: Number, right: Number) -> int:
    bounded(integer(left), integer(right))
    return math.gcd(left, right)  # type: ignore[arg-type]


@evaluable("lcm", 2)
def _lcm(left: Number, right: Number) -> int:
    left, right = integer(left), integer(right)
    bounded(left, right)
    return abs(left // math.gcd(left, right) * right) if left and right else 0
