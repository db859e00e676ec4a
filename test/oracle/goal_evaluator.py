"""The oracle's own logic: substitutions as dictionaries, and an evaluator for simple goals.

A substitution maps variables to terms. It is never changed; an extension is a new substitution.
"""

from fractions import Fraction
from typing import Any, Callable, Dict, Iterator, List, Optional, Set

from retalis import Atom, String, Term, Var, atom, functor, list_items, make_list
from retalis.prolog.terms.types import CONS, NIL, Lazy

Bindings = Dict[Var, Term]


class GoalError(Exception):
    """A goal that raises an error in Prolog."""


def value_of(term: Term, bindings: Bindings) -> Term:
    """Return the value of a term that may be a bound variable."""
    while term.__class__ is Var and term in bindings:
        term = bindings[term]
    return term


def instance(term: Term, bindings: Bindings) -> Term:
    """Return a term with all bound variables replaced."""
    term = value_of(term, bindings)
    if term.__class__ is tuple:
        return (term[0], *(instance(argument, bindings) for argument in term[1:]))
    return term


def unbound(term: Term, bindings: Bindings) -> Set[Var]:
    """Return the unbound variables of a term."""
    term = value_of(term, bindings)
    if term.__class__ is Var:
        return {term}
    if term.__class__ is tuple:
        return {var for argument in term[1:] for var in unbound(argument, bindings)}
    return set()


def unify(left: Term, right: Term, bindings: Bindings) -> Optional[Bindings]:
    """Return the bindings extended so that both terms are equal, or None."""
    left, right = value_of(left, bindings), value_of(right, bindings)
    if left is right:
        return bindings
    if left.__class__ is Var:
        return {**bindings, left: right}
    if right.__class__ is Var:
        return {**bindings, right: left}
    if left.__class__ is tuple and right.__class__ is tuple:
        if left[0] is not right[0]:
            return None
        for left_argument, right_argument in zip(left[1:], right[1:]):
            extended = unify(left_argument, right_argument, bindings)
            if extended is None:
                return None
            bindings = extended
        return bindings
    return bindings if left.__class__ is right.__class__ and left == right else None


def merge(left: Bindings, right: Bindings) -> Optional[Bindings]:
    """Return the union of two substitutions, or None if a variable has two values."""
    result: Optional[Bindings] = left
    for var, value in right.items():
        if result is None:
            return None
        result = unify(var, value, result)
    return result


def identical(left: Term, right: Term) -> bool:
    """Return whether two terms without bound variables are identical; 1 and 1.0 are not."""
    if left.__class__ is tuple and right.__class__ is tuple:
        return len(left) == len(right) and left[0] is right[0] and all(map(identical, left[1:], right[1:]))
    return left.__class__ is right.__class__ and left == right


def show(term: Term, bindings: Optional[Bindings] = None) -> str:
    """Return the canonical text of a term; variables are A, B, ... in the order of their occurrence."""
    return _show(instance(term, bindings or {}), {})


def _show(term: Term, names: Dict[Var, str]) -> str:
    if term.__class__ is Var:
        return names.setdefault(term, chr(ord("A") + len(names)) if len(names) < 26 else f"V{len(names)}")
    if term.__class__ is Atom:
        return _quoted(term.name)
    if term.__class__ is String:
        return f'"{term.text}"'
    if term.__class__ is Lazy:
        return _show(term.term(), names)
    if term.__class__ is not tuple:
        return str(term)
    items = list_items(term)
    if items is not None:
        return "[" + ",".join(_show(item, names) for item in items) + "]"
    return _quoted(term[0].name) + "(" + ",".join(_show(argument, names) for argument in term[1:]) + ")"


def _quoted(name: str) -> str:
    plain = name == "[]" or (name[:1].islower() and name.replace("_", "a").isalnum())
    return name if plain else "'" + name.replace("\\", "\\\\").replace("'", "\\'") + "'"


_COMPARE = {
    "<": lambda left, right: left < right,
    ">": lambda left, right: left > right,
    "=<": lambda left, right: left <= right,
    ">=": lambda left, right: left >= right,
    "=:=": lambda left, right: left == right,
    "=\\=": lambda left, right: left != right,
}
_ARITHMETIC: Dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda left, right: left + right,
    "-": lambda left, right: left - right,
    "*": lambda left, right: left * right,
    "mod": lambda left, right: left % right,
    "min": min,
    "max": max,
}
TRUE, FAIL, FALSE = atom("true"), atom("fail"), atom("false")


def number(term: Term, bindings: Bindings) -> Any:
    """Return the value of an arithmetic expression."""
    term = value_of(term, bindings)
    if term.__class__ is int or term.__class__ is float:
        return term
    if term.__class__ is tuple and len(term) == 3 and term[0].name in _ARITHMETIC:
        return _ARITHMETIC[term[0].name](number(term[1], bindings), number(term[2], bindings))
    if term.__class__ is tuple and term[0] is CONS and value_of(term[2], bindings) is NIL:
        item = value_of(term[1], bindings)
        if item.__class__ is int:
            return item  # [X] is the code X
        if item.__class__ is Atom and len(item.name) == 1:
            return ord(item.name)  # [x] that of the character
    if term.__class__ is tuple and term[0] is CONS:
        parts: List[Any] = [value_of(item, bindings) for item in list_items(term) or ()]
        if len(parts) == 2 and all(part.__class__ is int for part in parts) and 0 <= parts[1] < 10**9:
            return parts[0] + (parts[1] / 1e9 if parts[1] else 0)  # [Sec,NSec] is a time
    if term.__class__ is tuple and term[0] is functor("-", 1):
        return -number(term[1], bindings)
    raise GoalError(f"no number: {show(term, bindings)}")


def quotient(dividend: Any, divisor: int) -> Any:
    """Return the quotient as ``/`` does: an integer if it is exact, else a float."""
    if isinstance(dividend, int) and dividend % divisor == 0:
        return dividend // divisor
    return float(Fraction(dividend) / divisor) if isinstance(dividend, int) else dividend / divisor


def solve(goal: Term, bindings: Bindings, facts: Optional[Dict[str, Term]] = None) -> Iterator[Bindings]:  # noqa: C901 - a case for each kind of goal
    """Yield the solutions of a goal in order.

    ``facts`` are terms that hold for a predicate of one argument (``t1``, ``t2`` of check).

    Raises:
        GoalError: if Prolog raises an error.
    """
    goal = value_of(goal, bindings)
    facts = facts or {}
    name = goal[0].name if goal.__class__ is tuple else getattr(goal, "name", None)
    args = goal[1:] if goal.__class__ is tuple else ()
    if goal is TRUE:
        yield bindings
    elif goal is FAIL or goal is FALSE:
        return
    elif name == "," and len(args) == 2:
        for first in solve(args[0], bindings, facts):
            yield from solve(args[1], first, facts)
    elif name == ";" and len(args) == 2:
        yield from solve(args[0], bindings, facts)
        yield from solve(args[1], bindings, facts)
    elif name == "\\+" and len(args) == 1:
        if next(solve(args[0], bindings, facts), None) is None:
            yield bindings
    elif name in _COMPARE and len(args) == 2:
        if _COMPARE[name](number(args[0], bindings), number(args[1], bindings)):
            yield bindings
    elif name in ("=", "is") and len(args) == 2:
        right = args[1] if name == "=" else number(args[1], bindings)
        extended = unify(args[0], right, bindings)
        if extended is not None:
            yield extended
    elif name == "\\=" and len(args) == 2:
        if unify(args[0], args[1], bindings) is None:
            yield bindings
    elif name in ("==", "\\==") and len(args) == 2:
        if identical(instance(args[0], bindings), instance(args[1], bindings)) == (name == "=="):
            yield bindings
    elif name in ("@<", "@>") and len(args) == 2:
        left, right = (_standard(value_of(arg, bindings)) for arg in args)
        if left < right if name == "@<" else left > right:
            yield bindings
    elif name == "member" and len(args) == 2:
        items = value_of(args[1], bindings)
        while items.__class__ is tuple and items[0] is CONS:
            extended = unify(args[0], items[1], bindings)
            if extended is not None:
                yield extended
            items = value_of(items[2], bindings)
    elif name in facts and len(args) == 1:
        extended = unify(args[0], facts[name], bindings)
        if extended is not None:
            yield extended
    else:
        raise GoalError(f"unknown goal {show(goal, bindings)}")


def _standard(term: Term) -> Any:
    """Return a key of the standard order: numbers (a float before an equal integer), atoms, compound terms."""
    if isinstance(term, tuple):
        return (2, len(term), term[0].name, [_standard(argument) for argument in term[1:]])
    if isinstance(term, Atom):
        return (1, term.name, 0)
    return (0, term, int(term.__class__ is int))


def first(goal: Term, bindings: Bindings, facts: Optional[Dict[str, Term]] = None) -> Optional[Bindings]:
    """Return the first solution of a goal; None if it fails or raises an error.

    "A goal that fails stops that firing silently; a goal that raises an error stops that firing."
    """
    try:
        return next(solve(goal, bindings, facts), None)
    except GoalError:
        return None


__all__ = [
    "NIL",
    "Bindings",
    "GoalError",
    "first",
    "instance",
    "make_list",
    "merge",
    "number",
    "quotient",
    "show",
    "solve",
    "unbound",
    "unify",
    "value_of",
]
