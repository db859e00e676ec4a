"""Terms: what programs, events and messages are made of.

A term is one of

* an `Atom` (interned: compare with ``is``),
* an ``int`` or a ``float`` (never a ``bool``),
* a `String`,
* a `Var`,
* a compound term: a plain ``tuple`` whose first item is its interned `Functor`, the rest its arguments,
* a `Lazy` term, which becomes one of the above when something looks at it.

Plain tuples, because nothing else in Python is built and taken apart as fast, and most of an engine's
time goes there. Compound terms are immutable; ground ones are shared and never copied.

Everything here works without recursion: a list of a million elements is as safe as one of three. Unification
does not look for cycles, so a program can make a term that contains itself; walking one raises `TermTooLarge`
after `MOST` steps, instead of going on forever.
"""

from ._steps import MOST, ROUNDS
from .kinds import (
    COLON,
    COMMA,
    CONS,
    EMPTY_BLOCK,
    FALSE,
    MINUS,
    NIL,
    SLASH,
    TRUE,
    Atom,
    Functor,
    Lazy,
    String,
    Term,
    Trail,
    Var,
    atom,
    deref,
    functor,
    serial,
)
from .lists import conjunction, conjuncts, list_items, list_parts, make_list
from .order import compare
from .unification import same_constant, undo, unify
from .walking import (
    ATOMIC,
    are_ground,
    copy,
    freeze,
    is_ground,
    is_larger,
    is_plain,
    positions,
    rebuild,
    resolve,
    variables,
)

__all__ = [
    "Atom",
    "COLON",
    "COMMA",
    "CONS",
    "EMPTY_BLOCK",
    "FALSE",
    "Functor",
    "Lazy",
    "MINUS",
    "MOST",
    "NIL",
    "ROUNDS",
    "SLASH",
    "String",
    "TRUE",
    "Term",
    "Trail",
    "Var",
    "atom",
    "compare",
    "conjunction",
    "conjuncts",
    "copy",
    "deref",
    "freeze",
    "functor",
    "ATOMIC",
    "are_ground",
    "is_ground",
    "is_larger",
    "is_plain",
    "list_items",
    "list_parts",
    "make_list",
    "positions",
    "rebuild",
    "resolve",
    "same_constant",
    "serial",
    "undo",
    "unify",
    "variables",
]
