"""Operators of patterns, indexed by the functors of the terms that they are parsed from.

All tables are derived from `EVENT_OPERATORS`, the single list of operators that the parser of terms and the event
language share.
"""

from typing import Dict, Tuple

from ...foundation.errors import counted
from ...prolog.syntax.event_operators import EVENT_OPERATORS, EventOperator, OperatorKind
from ...prolog.terms.types import Functor

OPERATORS: Dict[str, EventOperator] = {
    one.name: one for one in EVENT_OPERATORS if one.kind is OperatorKind.PAIR
}
"""Operators between two patterns, by name."""

_RUNS = (OperatorKind.RUN, OperatorKind.AGGREGATE, OperatorKind.DEADLINE)

SPELLINGS: Dict[Functor, str] = {
    key: one.name
    for one in EVENT_OPERATORS
    if one.kind not in (OperatorKind.RULE, *_RUNS)
    for key in one.keys
}
"""Functor of a term -> the operator that it denotes in a pattern."""

RUNS: Dict[Functor, EventOperator] = {
    key: one for one in EVENT_OPERATORS if one.kind in _RUNS for key in one.keys
}
"""Functor of a term -> the operator that it denotes as the right operand of a sequence only."""

ARROWS = frozenset(key for one in EVENT_OPERATORS if one.meant == "<-" for key in one.keys)

NO_EVENTS = {one.name: len(one.patterns) for one in EVENT_OPERATORS if not one.names_events}
"""Reserved names, which no event has, and their number of arguments; with another number they are events."""

WRITTEN = tuple(
    (name, len(one.patterns), one.form)
    for one in EVENT_OPERATORS
    if one.form
    for name in one.functors or (one.name,)
)
"""Names of the constructs that are written in functional notation only, with arity and form."""


def _forms() -> Dict[str, str]:
    forms: Dict[str, str] = {}
    for name, number, form in WRITTEN:
        before = f"{forms[name]}, or {number}" if name in forms else f"takes {counted(number, 'argument')}"
        forms[name] = f"{before}: {form}"
    return forms


FORMS = _forms()
"""Arity and form of each name of `WRITTEN`, in words for messages."""

NO_FACTS = frozenset(key for one in EVENT_OPERATORS if not one.names_facts for key in one.keys[:1])
"""Functors that have no meaning as facts: a fact with one of them was intended as a rule."""


def names_of_kind(kind: OperatorKind, **facts: bool) -> Tuple[str, ...]:
    """Return the names of the operators of a kind for which the given facts hold, in the order of the table."""
    return tuple(
        [
            one.name
            for one in EVENT_OPERATORS
            if one.kind is kind and all(getattr(one, fact) == known for fact, known in facts.items())
        ]
    )
