"""Checks of decoded data: each takes a value, and returns it in the form that the engine uses.

A check raises a `UsageError` that quotes the value. `fields`, `fixed`, and `each` make checks of sequences from
checks of their items, and put the name or the position in front of the message.
"""

from math import isfinite
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, cast

from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import Stamp, WholeSeconds
from ..prolog.terms.types import Atom, Functor, String, Term, Var

Decoded = Any
"""A value whose type only its check establishes."""

ValueCheck = Callable[[Decoded], Decoded]
"""Returns a value as the engine uses it, or raises a `UsageError`."""

MAX_INSTANT = 1 << 80
"""Bound of instants, in ns: larger than any that the engine sets itself, as a mark for "never"."""

MAX_COUNT = (1 << 63) - 1
"""The largest number of a count."""

MAX_KEY_DEPTH = 8
"""Nesting of keys: hashing a deep tuple would overflow the stack of the process."""


class FlatKey(tuple):  # type: ignore[type-arg]
    """A dictionary key of a term, see `term_key`, that is no term itself."""

    __slots__ = ()


_SEQUENCES = frozenset((list, tuple, FlatKey))
_TERMS = frozenset((int, float, Atom, String, Var, tuple))
_INSTANTS = frozenset((int, WholeSeconds, Stamp))
_FORMS = frozenset((WholeSeconds, Stamp))
_KEYS = frozenset((int, Atom, String, Functor))


def wrong(value: object, expected: str) -> UsageError:
    """Return the error of a value."""
    try:
        said = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):  # an integer of too many digits, or a deep sequence
        said = type(value).__name__
    return UsageError(f"'{said[:80]}': expected {expected}")


def anything(value: Decoded) -> Decoded:
    """Return a value that is checked later, when it is known what it belongs to."""
    return value


def nothing(value: Decoded) -> None:
    """Check None."""
    if value is not None:
        raise wrong(value, "nothing")


def instance_of(kind: type, expected: str) -> ValueCheck:
    """Return a check of an object of exactly one class; its error expects what a text says."""

    def check(value: Decoded) -> Decoded:
        if value.__class__ is not kind:
            raise wrong(value, expected)
        return value

    return check


boolean = instance_of(bool, "true or false")
text = instance_of(str, "a text")
atom = instance_of(Atom, "an atom")
functor = instance_of(Functor, "a functor")
variable = instance_of(Var, "a variable")


def integer(least: int = -MAX_COUNT, most: int = MAX_COUNT) -> ValueCheck:
    """Return a check of an integer in a range."""

    def check(value: Decoded) -> int:
        if value.__class__ is not int or not least <= value <= most:
            raise wrong(value, f"an integer from {least} to {most}")
        return value

    return check


count = integer(0)
"""Check of a number of things."""


def instant(value: Decoded) -> int:
    """Check an instant in ns, in any of its forms."""
    if value.__class__ not in _INSTANTS or not -MAX_INSTANT <= value <= MAX_INSTANT:
        raise wrong(value, "an instant")
    return value


def seconds(value: Decoded) -> float:
    """Check a finite number of seconds."""
    if value.__class__ not in (int, float) or not isfinite(value):
        raise wrong(value, "a number of seconds")
    return value


def path(value: Decoded) -> str:
    """Check the path of a file."""
    if value.__class__ is not str or "\0" in value:
        raise wrong(value, "a path")
    return value


def term(value: Decoded) -> Term:
    """Check a term; its arguments were checked when it was read."""
    if value.__class__ not in _TERMS:
        raise wrong(value, "a term")
    return cast(Term, value)


def value_of_match(value: Decoded) -> Term:
    """Check the value of a variable of a match: a term, or an instant at which a part of the match began or ended."""
    return instant(value) if value.__class__ in _FORMS else term(value)


def callable_term(value: Decoded) -> Term:
    """Check a term that can be an event or a goal."""
    if value.__class__ is not tuple and value.__class__ is not Atom:
        raise wrong(value, "an atom or a compound term")
    return value


def key(value: Decoded, depth: int = MAX_KEY_DEPTH) -> Decoded:
    """Check a dictionary key that was made of terms: constants, terms of constants, and tuples of such keys."""
    kind = value.__class__
    if kind in _KEYS or value is None or kind is str or kind is FlatKey:
        return tuple(value) if kind is FlatKey else value
    if kind is tuple:
        if all(item.__class__ in _KEYS for item in value):
            return value
    elif kind is list and depth:
        return tuple([key(item, depth - 1) for item in value])
    raise wrong(value, "a key")


def optional(check: ValueCheck) -> ValueCheck:
    """Return a check that lets None through."""
    return lambda value: None if value is None else check(value)


def one_of(*values: Decoded) -> ValueCheck:
    """Return a check of one of some texts, or other constants."""

    def check(value: Decoded) -> Decoded:
        for known in values:
            if value.__class__ is known.__class__ and value == known:
                return known
        raise wrong(value, f"one of {', '.join(map(str, values))}")

    return check


def items(value: Decoded) -> Sequence[Decoded]:
    """Return the items of a sequence."""
    if value.__class__ not in _SEQUENCES:
        raise wrong(value, "a sequence")
    return value


def each(
    check: ValueCheck, make: Callable[[List[Decoded]], Decoded] = list, most: Optional[int] = None
) -> ValueCheck:
    """Return a check of a sequence whose items are all alike.

    Args:
        check: that of an item.
        make: makes the result of the list of items.
        most: the largest number of items.
    """

    def check_each(value: Decoded) -> Decoded:
        if most is not None and len(items(value)) > most:
            raise wrong(value, f"at most {most} items")
        found: List[Decoded] = []
        try:
            found += map(check, items(value))  # if an item is refused, those before it stay in the list
        except UsageError as error:
            raise UsageError(f"item {len(found)}: {error.message}") from None
        return found if make is list else make(found)

    return check_each


def fixed(*checks: ValueCheck) -> ValueCheck:
    """Return a check of a sequence of so many items, each with a check of its own; the result is a tuple."""
    number = len(checks)

    def check(value: Decoded) -> Tuple[Decoded, ...]:
        if len(items(value)) != number:
            raise wrong(value, f"{number} items")
        return tuple([check(item) for check, item in zip(checks, value)])

    return check


def fields(**checks: ValueCheck) -> ValueCheck:
    """Return a check of a mapping of exactly these names; the result is a dictionary."""
    mapping = dict_of(text, anything)
    named_checks = {name: named(name, check) for name, check in checks.items()}

    def check(value: Decoded) -> Dict[str, Decoded]:
        found = mapping(value)
        if list(found) != list(checks):
            raise wrong(list(found), f"the fields {', '.join(checks)}")
        return {name: check(found[name]) for name, check in named_checks.items()}

    return check


def record(make: Callable[..., Any], /, **checks: ValueCheck) -> ValueCheck:
    """Return a check of the items of a named tuple, in their order; the result is one."""
    parts = fixed(*[named(name, check) for name, check in checks.items()])
    return lambda value: make(*parts(value))


def named(name: str, check: ValueCheck) -> ValueCheck:
    """Return a check that puts a name in front of its message."""

    def check_named(value: Decoded) -> Decoded:
        try:
            return check(value)
        except UsageError as error:
            raise UsageError(f"{name}: {error.message}") from None

    return check_named


def dict_of(key_check: ValueCheck, value_check: ValueCheck) -> ValueCheck:
    """Return a check of a mapping, which is read as a sequence of pairs; no key stands there twice."""
    pairs = each(fixed(key_check, value_check))

    def check(value: Decoded) -> Dict[Decoded, Decoded]:
        found = pairs(value)
        made = dict(found)
        if len(made) != len(found):
            raise wrong(value, "each key once")
        return made

    return check
