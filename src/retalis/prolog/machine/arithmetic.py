"""Arithmetic: evaluation of expressions, and the evaluable functions.

`evaluate` computes the value of a term at run time; the compiler calls the same functions for expressions that it
translates to Python. Integers are unbounded up to `MAX_INTEGER_BITS`. The quotient ``/`` of integers is an integer if
it is exact, and a float otherwise. A float operation whose result is not finite raises an evaluation error. These are
the defaults of SWI-Prolog 9 (``prefer_rationals`` false, ``float_overflow`` error).

Timestamps: an operand can be a ``datime`` or a ROS time ``[Sec,NSec]``. Its value is a number of seconds since the
epoch. The resolution of a double near the present is 2.4e-7 s, so a plain float would lose the nanoseconds.
`IntegerTimestamp` and `FloatTimestamp` are numbers that also carry the exact instant: the difference or comparison
of two of them is exact to the nanosecond. They exist within one evaluation only; `number` returns the number that a
program sees.
"""

import math
import random
import sys
import time
from struct import pack, unpack
from typing import Any, Callable, Dict, List, Tuple, TypeVar, Union

from ...foundation.errors import TermTooLarge, UsageError
from ...foundation.limit_checks import check_limits
from ..terms import timestamps
from ..terms.term_traversal import CYCLE_CHECK_STEP, MAX_STEPS, require_acyclic
from ..terms.timestamps import SECOND
from ..terms.types import CONS, NIL, Atom, CompoundTerm, Functor, Lazy, String, Term, Var, deref, functor
from .errors import domain_error, evaluation_error, indicator, instantiation_error, resource_error, type_error


class _TimestampNumber:
    """Base class of numbers that carry an exact instant.

    Attributes:
        instant: nanoseconds since the epoch.
        number: the number that programs see, in seconds since the epoch.
    """

    __slots__ = ()

    instant: int
    number: Union[int, float]

    def _comparable(self, other: Any) -> Tuple[Any, Any]:
        """Return the values to compare: the instants of two timestamps, otherwise numbers."""
        if isinstance(other, _TimestampNumber):
            return self.instant, other.instant
        return self.number, other

    def __lt__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left < right

    def __le__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left <= right

    def __gt__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left > right

    def __ge__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left >= right

    def __eq__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left == right

    def __ne__(self, other: Any) -> Any:
        left, right = self._comparable(other)
        return left != right

    def __hash__(self) -> int:
        return hash(self.number)

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, _TimestampNumber):
            return (self.instant - other.instant) / SECOND
        # Whole seconds minus an integer is an integer, as in Prolog; all other differences are floats.
        if self.number.__class__ is int and other.__class__ is int:
            return self.number - other
        try:
            return (self.instant - timestamps.from_seconds(other)) / SECOND
        except (UsageError, OverflowError):  # an infinity, or an integer beyond all floats
            return float(self.number) - other

    def __rsub__(self, other: Any) -> Any:
        return -self.__sub__(other)


class IntegerTimestamp(_TimestampNumber, int):
    """A timestamp of whole seconds: an integer."""

    @property
    def number(self) -> int:  # type: ignore[override]
        """The number that programs see."""
        return int(self)

    @property
    def instant(self) -> int:  # type: ignore[override]
        """Nanoseconds since the epoch."""
        return int(self) * SECOND

    def __truediv__(self, divisor: Any) -> Any:
        if divisor.__class__ is int and not int(self) % divisor:
            return int(self) // divisor  # as `/` of integers does
        return int(self) / divisor


class FloatTimestamp(_TimestampNumber, float):
    """A timestamp with fractions of a second: the nearest float, and the exact instant in ns."""

    instant: int

    @property
    def number(self) -> float:  # type: ignore[override]
        """The number that programs see."""
        return float(self)


def timestamp_number(instant: int) -> Union[int, float]:
    """Return an instant in ns as a number of seconds since the epoch that carries the instant."""
    seconds, nanoseconds = divmod(int(instant), SECOND)
    if not nanoseconds:
        return IntegerTimestamp(seconds)
    number = FloatTimestamp(timestamps.to_seconds(instant))
    number.instant = int(instant)
    return number


def without_instant(value: Any) -> Any:
    """Return a number as programs see it, without an instant."""
    return value.number if isinstance(value, _TimestampNumber) else value


Number = Union[int, float]
EvaluableFunction = TypeVar("EvaluableFunction", bound=Callable[..., Number])

EVALUABLE: Dict[Functor, Callable[..., Number]] = {}
"""Evaluable functions by name and arity."""

MAX_INTEGER_BITS = 1 << 20
"""Bits of the largest integer that an operation may return (315,653 decimal digits): one product takes 30 ms."""

MAX_INTEGER = 1 << MAX_INTEGER_BITS
MIN_INTEGER = -MAX_INTEGER

MAX_BIT_PRODUCT = 1 << 35
"""Product of the operands' bits from which an operation of quadratic complexity takes more than 50 ms."""


def evaluable(name: str, arity: int) -> Callable[[EvaluableFunction], EvaluableFunction]:
    """Register a Python function of ``arity`` numbers as the evaluable functor ``name/arity``."""

    def register(function: EvaluableFunction) -> EvaluableFunction:
        EVALUABLE[functor(name, arity)] = function
        return function

    return register


def evaluate(term: Any) -> Number:
    """Return the value of an arithmetic expression, as programs see it.

    Raises:
        PrologError: instantiation, type or evaluation errors.
    """
    value = evaluate_exact(term)
    return value if value.__class__ is int or value.__class__ is float else without_instant(value)


def evaluate_exact(term: Any) -> Number:
    """Return the value of an arithmetic expression.

    Timestamps are returned as numbers that carry their instant, so that subtraction and comparison of them are exact.

    Raises:
        PrologError: instantiation, type or evaluation errors.
    """
    operand_class = term.__class__
    if operand_class is int or operand_class is float:
        return term  # type: ignore[no-any-return]
    if operand_class is Var:
        term = deref(term)
        operand_class = term.__class__
        if operand_class is int or operand_class is float:
            return term  # type: ignore[no-any-return]
    if operand_class is tuple and len(term) <= 3:
        function = EVALUABLE.get(term[0])
        if function is not None:
            # Most expressions are one operation on numbers, and need no stack. Nested ones fall through.
            left: Any = deref(term[1])
            operand_class = left.__class__
            if operand_class is int or operand_class is float:
                if len(term) == 2:
                    return function(left)
                right: Any = deref(term[2])
                operand_class = right.__class__
                if operand_class is int or operand_class is float:
                    return function(left, right)
    return _evaluate_nested(term)


def _evaluate_nested(term: Term) -> Number:
    """Evaluate an expression of any depth with an explicit stack."""
    # A compound term pushes a `_PendingCall` below its arguments. The arguments are popped from last to first, so
    # when the call is reached, their values are the last ones on `values`, in reverse order.
    values: List[Number] = []
    stack: List[Union[Term, _PendingCall]] = [term]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            check_limits()
            if steps == CYCLE_CHECK_STEP:
                require_acyclic(term)
        item: Any = stack.pop()
        if item.__class__ is _PendingCall:
            arity = item.arity
            values[-arity:] = [item.apply(*reversed(values[-arity:]))]
            continue
        item = deref(item)
        item_class = item.__class__
        if item_class is int or item_class is float:
            values.append(item)
        elif item_class is tuple:
            if item[0] is CONS:
                values.append(_list_value(item))
                continue
            stack.append(_PendingCall(item[0]))
            if len(stack) > MAX_STEPS:
                raise TermTooLarge
            stack.extend(item[1:])
        else:
            values.append(_constant(item))
    return values[0]


class _PendingCall:
    """A function to be called when the values of its operands are on the stack of values."""

    __slots__ = ("functor", "arity")

    def __init__(self, key: Functor):
        self.functor = key
        self.arity = key.arity

    def apply(self, *operands: Number) -> Number:
        """Return the value of the function for its operands."""
        function = EVALUABLE.get(self.functor)
        if function is None:
            raise type_error("evaluable", indicator(self.functor))
        return function(*operands)


def _list_value(item: CompoundTerm) -> Number:
    """Return the value of a list: a character or code in a one-element list, or a ROS time ``[Sec,NSec]``."""
    first, rest = deref(item[1]), deref(item[2])
    # ISO has no two-element lists here, so ROS times cannot change the meaning of a standard program.
    if first.__class__ is int and rest.__class__ is tuple and rest[0] is CONS and deref(rest[2]) is NIL:
        nanoseconds = deref(rest[1])
        if nanoseconds.__class__ is int and 0 <= nanoseconds < SECOND:
            return timestamp_number(timestamps.from_parts(first, nanoseconds))
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
    """Return the value of a term that is neither a number nor compound, such as ``pi`` or a one-character string."""
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
        return evaluate_exact(item.term())
    if isinstance(item, _TimestampNumber):
        return item  # type: ignore[return-value]
    raise type_error("evaluable", item)


def check_result(value: Number) -> Number:
    """Return a result if it is finite and not too large.

    Raises:
        PrologError: an evaluation error for infinity or nan, a resource error for an integer above `MAX_INTEGER`.
    """
    # The difference is nan for infinity and nan: one test for both, and for integers as well.
    if value - value == 0:
        if value.__class__ is int and not MIN_INTEGER < value < MAX_INTEGER:
            raise resource_error("memory")
        return value
    raise evaluation_error("undefined" if value != value else "float_overflow")


def integer(value: Any) -> int:
    """Return an operand that must be an integer."""
    if value.__class__ is not int:
        if value.__class__ is IntegerTimestamp:
            return int(value)
        raise type_error("integer", without_instant(check_result(value)))
    return value


def integer_at_least(lower_bound: int, value: Number) -> int:
    """Return an operand that must be an integer of at least ``lower_bound``, which is 0 or 1."""
    if integer(value) < lower_bound:
        raise domain_error(f"not_less_than_{'one' if lower_bound else 'zero'}", value)
    return value  # type: ignore[return-value]


def check_bit_product(left: int, right: int) -> None:
    """Raise a resource error if an operation of quadratic complexity on two integers would take too long."""
    if left.bit_length() * right.bit_length() > MAX_BIT_PRODUCT:
        raise resource_error("integer_size")


def _check_division(left: Number, right: Number) -> None:
    """Validate the operands of an integer division."""
    divisor_bits = integer(right).bit_length()
    if not divisor_bits:
        # The type error of a left operand takes precedence over the zero divisor.
        integer(left)
        raise evaluation_error("zero_divisor")
    # Long division takes time in proportion to the bits of the quotient times those of the divisor. Division by one
    # machine word takes linear time.
    if divisor_bits > 64 and (integer(left).bit_length() - divisor_bits) * divisor_bits > MAX_BIT_PRODUCT:
        raise resource_error("integer_size")


def _to_float(value: Number) -> float:
    try:
        return check_result(float(value))
    except OverflowError:
        raise evaluation_error("float_overflow") from None


# The basic operations. Compiled clauses call these three with unevaluated terms, so they evaluate their operands. The
# functions below receive numbers.


def add(left: Term, right: Term) -> Number:
    """Return the sum of two expressions."""
    left, right = evaluate_exact(left), evaluate_exact(right)
    value = left + right
    return value if value - value == 0 else check_result(value)


def subtract(left: Term, right: Term) -> Number:
    """Return the difference of two expressions."""
    left, right = evaluate_exact(left), evaluate_exact(right)
    value = left - right
    return value if value - value == 0 else check_result(value)


def multiply(left: Term, right: Term) -> Number:
    """Return the product of two expressions."""
    left, right = evaluate_exact(left), evaluate_exact(right)
    value = left * right
    return value if MIN_INTEGER < value < MAX_INTEGER else check_result(value)


EVALUABLE[functor("+", 2)] = add
EVALUABLE[functor("-", 2)] = subtract
EVALUABLE[functor("*", 2)] = multiply


@evaluable("/", 2)
def divide(left: Number, right: Number) -> Number:
    """Return the quotient: an integer if both operands are integers and it is exact, otherwise a float."""
    if left.__class__ is int and right.__class__ is int:
        _check_division(left, right)
        quotient, rest = divmod(left, right)
        if rest == 0:
            return quotient
        try:
            return left / right
        except OverflowError:
            raise evaluation_error("float_overflow") from None
    if right == 0:
        raise evaluation_error("undefined" if left == 0 or left != left else "zero_divisor")
    return check_result(left / right)


@evaluable("//", 2)
def truncated_quotient(left: Number, right: Number) -> int:
    """Return the integer quotient, truncated towards zero."""
    integer(left)
    _check_division(left, right)
    # Python's `//` rounds down; ISO's default is truncation, so the sign is applied afterwards.
    quotient = abs(left) // abs(right)
    return quotient if (left >= 0) == (right > 0) else -quotient  # type: ignore[return-value]


@evaluable("rem", 2)
def remainder(left: Number, right: Number) -> int:
    """Return the remainder of truncated division, with the sign of ``left``."""
    integer(left)
    _check_division(left, right)
    rest = abs(left) % abs(right)
    return rest if left >= 0 else -rest  # type: ignore[return-value]


@evaluable("mod", 2)
def modulo(left: Number, right: Number) -> int:
    """Return the remainder of floored division, with the sign of ``right``."""
    integer(left)
    _check_division(left, right)
    return left % right  # type: ignore[return-value]


@evaluable("div", 2)
def floored_quotient(left: Number, right: Number) -> int:
    """Return the integer quotient, rounded down."""
    integer(left)
    _check_division(left, right)
    return left // right  # type: ignore[return-value]


@evaluable("+", 1)
def _plus(value: Number) -> Number:
    return value


@evaluable("-", 1)
def negate(value: Number) -> Number:
    """Return the negation."""
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
    """Return the larger number; the float if an integer and a float are equal."""
    if left == right:
        return right if right.__class__ is float else left
    # Comparisons with nan are false: the result is the other operand.
    return left if left > right or right != right else right


@evaluable("min", 2)
def minimum(left: Number, right: Number) -> Number:
    """Return the smaller number; the float if an integer and a float are equal."""
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
    check_bit_product(integer(left), integer(right))
    return math.gcd(left, right)  # type: ignore[arg-type]


@evaluable("lcm", 2)
def _lcm(left: Number, right: Number) -> int:
    left, right = integer(left), integer(right)
    check_bit_product(left, right)
    return abs(left // math.gcd(left, right) * right) if left and right else 0


def integer_root(degree: int, value: int) -> int:
    """Return the largest integer whose power of ``degree`` is at most ``value``.

    Args:
        degree: at least 1.
        value: at least 0.

    Raises:
        PrologError: a resource error if the computation would take too long.
    """
    bits = value.bit_length()
    # The root is 1 for any degree that exceeds the bits, and a power of that degree would be computed in vain.
    if degree >= bits:
        return value if degree == 1 else min(value, 1)
    # Each of the steps, whose number grows with the logarithm of the bits, takes quadratic time.
    if bits * bits * bits.bit_length() > MAX_BIT_PRODUCT:
        raise resource_error("integer_size")
    # Newton's method from above: the estimates decrease until they reach the root.
    root = 1 << -(-bits // degree)
    while True:
        estimate = ((degree - 1) * root + value // root ** (degree - 1)) // degree
        if estimate >= root:
            return root
        root = estimate


@evaluable(">>", 2)
def shift_right(left: Number, right: Number) -> int:
    """Return ``left`` shifted right by ``right`` bits."""
    left, right = integer(left), integer(right)
    return left >> right if right >= 0 else shift_left(left, -right)


@evaluable("<<", 2)
def shift_left(left: Number, right: Number) -> int:
    """Return ``left`` shifted left by ``right`` bits."""
    left, right = integer(left), integer(right)
    if right < 0:
        return left >> -right
    # Checked before the shift, which would allocate the result. Zero may be shifted by any number of bits.
    if left and right + left.bit_length() > MAX_INTEGER_BITS:
        raise resource_error("memory")
    return left << right if left else 0


@evaluable("/\\", 2)
def bit_and(left: Number, right: Number) -> int:
    """Return the bitwise conjunction."""
    return integer(left) & integer(right)


@evaluable("\\/", 2)
def bit_or(left: Number, right: Number) -> int:
    """Return the bitwise disjunction."""
    return integer(left) | integer(right)


@evaluable("xor", 2)
def _xor(left: Number, right: Number) -> int:
    return integer(left) ^ integer(right)


@evaluable("\\", 1)
def _invert(value: Number) -> int:
    return ~integer(value)


@evaluable("msb", 1)
def _msb(value: Number) -> int:
    return integer_at_least(1, value).bit_length() - 1


@evaluable("lsb", 1)
def _lsb(value: Number) -> int:
    number = integer_at_least(1, value)
    return (number & -number).bit_length() - 1


@evaluable("popcount", 1)
def _popcount(value: Number) -> int:
    return bin(integer_at_least(0, value)).count("1")


@evaluable("getbit", 2)
def _getbit(value: Number, bit: Number) -> int:
    return (integer_at_least(0, value) >> integer_at_least(0, bit)) & 1


def _rounding_function(function: Callable[[float], int]) -> Callable[[Number], int]:
    def apply(value: Any) -> int:
        if value.__class__ is int:
            return value
        # Infinity and nan have no integer value and are returned unchanged, as SWI-Prolog does if a program has
        # allowed them by the flags for float errors.
        return function(value) if value - value == 0 else value

    return apply


def round_half_away(value: float) -> int:
    """Return the nearest integer, with halves rounded away from zero."""
    # Python's `round` rounds halves to even, and `floor(x + 0.5)` is wrong for 0.49999999999999994.
    rounded = math.floor(abs(value))
    rounded += abs(value) - rounded >= 0.5
    return rounded if value >= 0 else -rounded


EVALUABLE[functor("floor", 1)] = _rounding_function(math.floor)
EVALUABLE[functor("ceiling", 1)] = EVALUABLE[functor("ceil", 1)] = _rounding_function(math.ceil)
EVALUABLE[functor("truncate", 1)] = _rounding_function(math.trunc)
EVALUABLE[functor("integer", 1)] = _rounding_function(round_half_away)
EVALUABLE[functor("round", 1)] = _rounding_function(round_half_away)


@evaluable("float", 1)
def _float(value: Number) -> float:
    return _to_float(value)


@evaluable("float_integer_part", 1)
def _integer_part(value: Number) -> Number:
    return value if value.__class__ is int else math.copysign(math.trunc(check_result(value)), value)


@evaluable("float_fractional_part", 1)
def _fractional_part(value: Number) -> Number:
    return 0 if value.__class__ is int else math.fmod(value, 1.0) if value - value == 0 else value


def _register_real(name: str, function: Callable[[float], float]) -> None:
    """Register a function of one float; a value outside its domain is an undefined result."""

    def apply(value: Number) -> float:
        try:
            return check_result(function(_to_float(value)))
        except OverflowError:
            raise evaluation_error("float_overflow") from None
        except ValueError:
            raise evaluation_error("undefined") from None

    EVALUABLE[functor(name, 1)] = apply


for _name in (
    "sqrt",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "exp",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
):
    _register_real(_name, getattr(math, _name))
for _name in ("erf", "erfc", "lgamma"):
    _register_real(_name, getattr(math, _name))


def _register_logarithm(name: str, function: Callable[[Number], float]) -> None:
    def apply(value: Number) -> float:
        if value <= 0:
            raise evaluation_error("undefined")
        # An integer is not converted: the logarithm of one beyond the largest float is finite.
        return check_result(function(value if value.__class__ is int else check_result(value)))

    EVALUABLE[functor(name, 1)] = apply


_register_logarithm("log", math.log)
_register_logarithm("log2", math.log2)
_register_logarithm("log10", math.log10)


@evaluable("log", 2)
def _log(base: Number, value: Number) -> float:
    if value <= 0 or base <= 0:
        raise evaluation_error("undefined")
    if base == 1:
        raise evaluation_error("zero_divisor")
    return math.log(value) / math.log(base)


@evaluable("atan2", 2)
@evaluable("atan", 2)
def _atan2(y: Number, x: Number) -> float:
    return math.atan2(_to_float(y), _to_float(x))


@evaluable("copysign", 2)
def _copysign(value: Number, sign: Number) -> Number:
    if value.__class__ is int:
        return abs(value) * (-1 if math.copysign(1.0, sign) < 0 else 1)
    return math.copysign(value, sign)


@evaluable("nexttoward", 2)
def _nexttoward(value: Number, target: Number) -> float:
    value, target = _to_float(value), _to_float(target)
    if value == target or value != value:
        return value
    if value == 0:
        return math.copysign(sys.float_info.min * sys.float_info.epsilon, target)
    # The bit patterns of IEEE 754 doubles of one sign are ordered like their magnitudes, so the neighbour is one
    # pattern away. (`math.nextafter` exists from Python 3.9 on.)
    bits = unpack("<q", pack("<d", value))[0]
    bits += 1 if (target > value) == (value > 0) else -1
    return float(unpack("<d", pack("<q", bits))[0])


@evaluable("hypot", 2)
def _hypot(x: Number, y: Number) -> float:
    return check_result(math.hypot(x, y))


@evaluable("^", 2)
def power(base: Number, exponent: Number) -> Number:
    """Return the power: an integer for integers, unless the exponent is negative."""
    if exponent.__class__ is int:
        if exponent == 0:
            return 1
        if base.__class__ is int and (exponent > 0 or base in (0, 1, -1)):
            return _integer_power(base, exponent)
    return _float_power(base, exponent)


@evaluable("**", 2)
def _power_operator(base: Number, exponent: Number) -> Number:
    """Return the power, as ``^`` does."""
    return power(base, exponent)


def _integer_power(base: Any, exponent: Any) -> int:
    if base in (0, 1, -1):
        if exponent >= 0:
            result: int = base**exponent
            return result
        if base == 0:
            raise evaluation_error("zero_divisor")
        return base if exponent % 2 else 1
    # Checked before the power is computed: 7^7^7^7 would take all memory.
    if base.bit_length() * exponent > MAX_INTEGER_BITS:
        raise resource_error("memory")
    value: int = base**exponent
    return value


def _float_power(base: Number, exponent: Number) -> float:
    base, exponent = _to_float(base), _to_float(exponent)
    if base == 0 and exponent < 0:
        raise evaluation_error("zero_divisor")
    try:
        return check_result(math.pow(base, exponent))
    except OverflowError:
        raise evaluation_error("float_overflow") from None
    except ValueError:
        raise evaluation_error("undefined") from None


@evaluable("powm", 3)
def _powm(base: Number, exponent: Number, modulus: Number) -> int:
    modulus_bits = integer_at_least(1, modulus).bit_length()
    # Each bit of the exponent costs one product of the modulus's size, plus the time of a product of 400 bits.
    if (
        integer_at_least(0, exponent).bit_length() * (modulus_bits * modulus_bits + 400 * 400)
        > MAX_BIT_PRODUCT
    ):
        raise resource_error("integer_size")
    return pow(integer(base), integer(exponent), integer(modulus))


@evaluable("cot", 1)
def _cot(value: Number) -> float:
    # An infinity has no tangent.
    if value == 0 or value in (math.inf, -math.inf):
        raise evaluation_error("undefined")
    return 1.0 / math.tan(value)


@evaluable("acot", 1)
def _acot(value: Number) -> float:
    return math.atan(1.0 / value) if value else math.pi / 2


@evaluable("random", 1)
def _random(limit: Number) -> int:
    return random.randrange(integer_at_least(1, limit))


@evaluable("numerator", 1)
def _numerator(value: Number) -> int:
    return integer(value)


@evaluable("denominator", 1)
def _denominator(value: Number) -> int:
    integer(value)
    return 1


@evaluable("eval", 1)
def _eval(value: Number) -> Number:
    return value


@evaluable("rational", 1)
@evaluable("rationalize", 1)
def _rational(value: Number) -> Number:
    # `is_integer` is false for infinities and nan, which `math.trunc` cannot convert.
    return math.trunc(value) if value.__class__ is float and value.is_integer() else value


def _datime_function(key: Functor) -> Callable[..., Number]:
    def seconds(*fields: Number) -> Number:
        """Return the seconds since the epoch of a datime, as a number that carries the instant."""
        try:
            return timestamp_number(timestamps.from_term((key, *fields)))
        except UsageError:
            raise domain_error("datime", (key, *fields)) from None

    return seconds


for _key in (timestamps.DATIME6, timestamps.DATIME7):
    EVALUABLE[_key] = _datime_function(_key)


def _register_constants() -> None:
    constant: Callable[[Number], Callable[[], Number]] = lambda value: lambda: value  # noqa: E731
    for name, value in (
        ("pi", math.pi),
        ("e", math.e),
        ("inf", math.inf),
        ("infinite", math.inf),
        ("nan", math.nan),
        ("epsilon", sys.float_info.epsilon),
        ("max_tagged_integer", (1 << 60) - 1),
        ("min_tagged_integer", -(1 << 60)),
        ("max_integer", (1 << 63) - 1),
        ("min_integer", -(1 << 63)),
    ):
        EVALUABLE[functor(name, 0)] = constant(value)
    EVALUABLE[functor("random", 0)] = random.random
    EVALUABLE[functor("random_float", 0)] = random.random
    EVALUABLE[functor("cputime", 0)] = time.process_time
    EVALUABLE[functor("realtime", 0)] = lambda: int(time.time())


_register_constants()
