"""Terms of which only the outer parts are written."""

from typing import Any, List

from ..terms import CONS, NIL, Term, atom, deref, make_list

_LEFT_OUT = atom("...")
_DEEPEST = 200
"""A limit above this holds for lists only: what is deeper is written whole."""


def cut_off(term: Term, most: int, depth: int = 1) -> Term:
    """Return a term with ``...`` for what lies deeper than a number of terms in each other.

    An item of a list counts as being as deep as its place: that keeps long lists short.
    """
    term = deref(term)
    if depth > most:
        return _LEFT_OUT
    if term.__class__ is not tuple or depth > _DEEPEST:
        return term
    if term[0] is not CONS:
        return (term[0], *[cut_off(argument, most, depth + 1) for argument in term[1:]])
    items: List[Term] = []
    rest: Any = term
    while rest.__class__ is tuple and rest[0] is CONS:
        items.append(cut_off(rest[1], most, min(depth, _DEEPEST) + 1))
        depth += 1
        rest = deref(rest[2])
        if rest is NIL:
            return make_list(items)
        if depth >= most:
            return make_list(items, _LEFT_OUT)
    return make_list(items, cut_off(rest, most, min(depth, _DEEPEST) + 1))
