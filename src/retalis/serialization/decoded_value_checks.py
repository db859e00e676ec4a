"""Validators for decoded data, which return values in the form that the engine uses.

State files are not trusted, so each value is checked before it reaches the engine. A check is a function that returns
the value, or raises a `UsageError` that quotes it. `mapping_with`, `tuple_of`, and `sequence_of` combine checks of
items into checks of sequences, and prefix error messages with the name or the position of the item.
"""

from math import isfinite
from typing import Any, Callable, Dict, FrozenSet, List, Sequence, Tuple, cast

from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Functor, String, Term, Var

Decoded = Any
"""A value whose type is only established by its check."""

ValueCheck = Callable[[Decoded], Decoded]
"""Function that returns a value in the form that the engine uses, or raises a `UsageError`."""

MAX_INSTANT = 1 << 80
"""Limit of instants in ns: larger than any value by which the engine itself represents "never"."""

MAX_COUNT = (1 << 63) - 1
"""Maximum of counts."""

MAX_KEY_DEPTH = 8
"""Maximum nesting of keys: hashing a deeply nested tuple would overflow the stack of the process."""


class FlatKey(tuple):  # type: ignore[type-arg]
    """A dictionary key of a term, see `term_key`, which is not a term itself."""

    __slots__ = ()


_SEQUENCES = frozenset((list, tuple, FlatKey))
_TERMS = frozenset((int, float, Atom, String, Var, tuple))
_INSTANTS = frozenset((int, FloatSeconds, Stamp))
_INSTANTS_OF_PARTS = frozenset((FloatSeconds, Stamp))
"""Classes of instants among the values of a match; an ``int`` there is a term."""
_KEYS = frozenset((int, Atom, String, Functor))


def invalid_value(value: object, expected: str) -> UsageError:
    """Return the error for an invalid value."""
    try:
        text_of_value = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):  # an integer with too many digits, or a deeply nested sequence
        text_of_value = type(value).__name__
    return UsageError(f"'{text_of_value[:80]}': expected {expected}")


def any_value(value: Decoded) -> Decoded:
    """Return the value unchecked; it is checked later against the program."""
    return value


def none(value: Decoded) -> None:
    """Check that a value is None."""
    if value is not None:
        raise invalid_value(value, "nothing")


def instance_of(expected_class: type, expected: str) -> ValueCheck:
    """Return a check for instances of exactly one class; ``expected`` describes it in the error."""

    def check(value: Decoded) -> Decoded:
        if value.__class__ is not expected_class:
            raise invalid_value(value, expected)
        return value

    return check


boolean = instance_of(bool, "true or false")
text = instance_of(str, "a text")
atom = instance_of(Atom, "an atom")
functor = instance_of(Functor, "a functor")
variable = instance_of(Var, "a variable")


def integer(minimum: int = -MAX_COUNT, maximum: int = MAX_COUNT) -> ValueCheck:
    """Return a check for integers in a range."""

    def check(value: Decoded) -> int:
        if value.__class__ is not int or not minimum <= value <= maximum:
            raise invalid_value(value, f"an integer from {minimum} to {maximum}")
        return value

    return check


count = integer(0)
"""Check of a count."""


match_order = integer(0, 2 * MAX_INSTANT)
"""Check of the order of a match, which is a timestamp or a number that follows one."""


def instant(value: Decoded) -> int:
    """Check an instant in nanoseconds, in any of its forms."""
    if value.__class__ not in _INSTANTS or not -MAX_INSTANT <= value <= MAX_INSTANT:
        raise invalid_value(value, "an instant")
    return value


def seconds(value: Decoded) -> float:
    """Check a finite number of seconds."""
    if value.__class__ not in (int, float) or not isfinite(value):
        raise invalid_value(value, "a number of seconds")
    return value


def path(value: Decoded) -> str:
    """Check a file path."""
    if value.__class__ is not str or "\0" in value:
        raise invalid_value(value, "a path")
    return value


def term(value: Decoded) -> Term:
    """Check a term. Its arguments were checked when it was decoded."""
    if value.__class__ not in _TERMS:
        raise invalid_value(value, "a term")
    return cast(Term, value)


def value_of_match(value: Decoded) -> Term:
    """Check the value of a variable of a match: a term, or the start or end of a part of the match."""
    return instant(value) if value.__class__ in _INSTANTS_OF_PARTS else term(value)


def callable_term(value: Decoded) -> Term:
    """Check a term that can be an event or a goal."""
    if value.__class__ is not tuple and value.__class__ is not Atom:
        raise invalid_value(value, "an atom or a compound term")
    return value


def key(value: Decoded, depth: int = MAX_KEY_DEPTH) -> Decoded:
    """Check a dictionary key that consists of constants, terms of constants, and tuples of such keys."""
    value_class = value.__class__
    if value_class in _KEYS or value is None or value_class is str or value_class is FlatKey:
        return tuple(value) if value_class is FlatKey else value
    if value_class is tuple:
        if all(item.__class__ in _KEYS for item in value):
            return value
    elif value_class is list and depth:
        return tuple([key(item, depth - 1) for item in value])
    raise invalid_value(value, "a key")


def optional(check: ValueCheck) -> ValueCheck:
    """Return a check that also accepts None."""
    return lambda value: None if value is None else check(value)


def one_of(*values: Decoded) -> ValueCheck:
    """Return a check for one of the given constants."""

    def check(value: Decoded) -> Decoded:
        # Classes are compared as well, because True equals 1.
        for allowed in values:
            if value.__class__ is allowed.__class__ and value == allowed:
                return allowed
        raise invalid_value(value, f"one of {', '.join(map(str, values))}")

    return check


def items(value: Decoded) -> Sequence[Decoded]:
    """Return the items of a sequence."""
    if value.__class__ not in _SEQUENCES:
        raise invalid_value(value, "a sequence")
    return value


_CLASSES_ACCEPTED: Dict[ValueCheck, FrozenSet[type]] = {term: _TERMS, text: frozenset((str,))}
"""Checks that return values of these classes unchanged, and reject all others."""


def sequence_of(check: ValueCheck, make: Callable[[List[Decoded]], Decoded] = list) -> ValueCheck:
    """Return a check for a sequence of items with the same check.

    Args:
        check: check of an item.
        make: creates the result from the list of checked items.
    """
    classes = _CLASSES_ACCEPTED.get(check, frozenset())

    def check_sequence(value: Decoded) -> Decoded:
        checked: List[Decoded] = []
        # Columns have thousands of terms: their classes are compared by functions that are implemented in C.
        if classes.issuperset(map(type, items(value))):
            return make(value)
        try:
            # If an item is rejected, those before it remain in the list, which gives its index.
            checked += map(check, value)
        except UsageError as error:
            raise UsageError(f"item {len(checked)}: {error.message}") from None
        return checked if make is list else make(checked)

    return check_sequence


def integers(minimum: int = 0, maximum: int = MAX_COUNT) -> ValueCheck:
    """Return a check for a sequence of integers in a range."""
    check_sequence = sequence_of(integer(minimum, maximum))

    def check(value: Decoded) -> Decoded:
        numbers = items(value)
        if set(map(type, numbers)) == {int} and minimum <= min(numbers) and max(numbers) <= maximum:
            return numbers
        return check_sequence(numbers)

    return check


match_orders = integers(0, 2 * MAX_INSTANT)
"""Check of a sequence of orders of matches."""


def tuple_of(*checks: ValueCheck) -> ValueCheck:
    """Return a check for a sequence with one check per item; the result is a tuple."""
    length = len(checks)

    def check(value: Decoded) -> Tuple[Decoded, ...]:
        if len(items(value)) != length:
            raise invalid_value(value, f"{length} items")
        return tuple([check(item) for check, item in zip(checks, value)])

    return check


def mapping_with(**checks: ValueCheck) -> ValueCheck:
    """Return a check for a mapping with exactly these names; the result is a dictionary."""
    unchecked = dict_of(text, any_value)
    named_checks = {name: with_name(name, check) for name, check in checks.items()}

    def check(value: Decoded) -> Dict[str, Decoded]:
        mapping = unchecked(value)
        if list(mapping) != list(checks):
            raise invalid_value(list(mapping), f"the fields {', '.join(checks)}")
        return {name: check(mapping[name]) for name, check in named_checks.items()}

    return check


def record(make: Callable[..., Any], /, **checks: ValueCheck) -> ValueCheck:
    """Return a check for the items of a named tuple; the result is the named tuple."""
    check_items = tuple_of(*[with_name(name, check) for name, check in checks.items()])
    return lambda value: make(*check_items(value))


def with_name(name: str, check: ValueCheck) -> ValueCheck:
    """Return a check that prefixes error messages with a name."""

    def check_named(value: Decoded) -> Decoded:
        try:
            return check(value)
        except UsageError as error:
            raise UsageError(f"{name}: {error.message}") from None

    return check_named


def dict_of(key_check: ValueCheck, value_check: ValueCheck) -> ValueCheck:
    """Return a check for a mapping, encoded as a sequence of pairs, without duplicate keys."""
    check_pairs = sequence_of(tuple_of(key_check, value_check))

    def check(value: Decoded) -> Dict[Decoded, Decoded]:
        pairs = check_pairs(value)
        result = dict(pairs)
        if len(result) != len(pairs):
            raise invalid_value(value, "each key once")
        return result

    return check
