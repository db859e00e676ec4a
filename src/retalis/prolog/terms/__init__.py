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
does not look for cycles, so a program can make a term that contains itself. Comparing, unifying and looking for
variables see after `LATE` steps whether they walk one, and go on with each part once; all other walks raise
`TermTooLarge` then.
"""

from . import timestamps
from .cycles import LATE, LATE_ROUND, refuse_cycles
from .keys import PLAIN, term_key, variant_key
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
    CompoundTerm,
    EventAction,
    Frame,
    Functor,
    Lazy,
    Runs,
    Step,
    String,
    Term,
    Trail,
    Values,
    Var,
    atom,
    deref,
    functor,
    serial,
)
from .lists import conjunction, conjuncts, list_items, list_parts, make_list
from .order import by_age, by_number, compare, unlike
from .steps import MOST, ROUNDS
from .timestamps import (
    DATIME6,
    DATIME7,
    FIRST,
    LAST,
    SECOND,
    Stamp,
    WholeSeconds,
    datime,
    from_any,
    from_seconds,
    interval_term,
    shown,
)
from .unification import may_unify, same_constant, undo, unify
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
    "are_ground",
    "Atom",
    "atom",
    "ATOMIC",
    "by_age",
    "by_number",
    "COLON",
    "COMMA",
    "compare",
    "conjunction",
    "conjuncts",
    "CompoundTerm",
    "CONS",
    "copy",
    "datime",
    "DATIME6",
    "DATIME7",
    "deref",
    "EMPTY_BLOCK",
    "EventAction",
    "FALSE",
    "FIRST",
    "Frame",
    "freeze",
    "from_any",
    "from_seconds",
    "Functor",
    "functor",
    "interval_term",
    "is_ground",
    "is_larger",
    "is_plain",
    "LAST",
    "LATE",
    "LATE_ROUND",
    "Lazy",
    "list_items",
    "list_parts",
    "make_list",
    "may_unify",
    "MINUS",
    "MOST",
    "NIL",
    "positions",
    "rebuild",
    "refuse_cycles",
    "resolve",
    "ROUNDS",
    "Runs",
    "same_constant",
    "SECOND",
    "serial",
    "shown",
    "SLASH",
    "Step",
    "Stamp",
    "String",
    "Term",
    "PLAIN",
    "term_key",
    "timestamps",
    "Trail",
    "TRUE",
    "undo",
    "unify",
    "unlike",
    "Values",
    "Var",
    "variables",
    "variant_key",
    "WholeSeconds",
]
