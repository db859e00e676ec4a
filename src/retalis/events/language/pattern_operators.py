"""The operators of patterns, by the functors of the terms that they are read from."""

from typing import Dict, Tuple

from ...foundation.errors import counted
from ...prolog.syntax.event_operators import EVENT_OPERATORS, EventOperator, OperatorKind
from ...prolog.terms.types import Functor

OPERATORS: Dict[str, EventOperator] = {
    one.name: one for one in EVENT_OPERATORS if one.kind is OperatorKind.PAIR
}
"""The operators between two patterns, by name."""

_RUNS = (OperatorKind.RUN, OperatorKind.AGGREGATE, OperatorKind.DEADLINE)

SPELLINGS: Dict[Functor, str] = {
    key: one.name
    for one in EVENT_OPERATORS
    if one.kind not in (OperatorKind.RULE, *_RUNS)
    for key in one.keys
}
"""Functor of a term -> the operator that it is in patterns, in whose form it is read."""

RUNS: Dict[Functor, EventOperator] = {
    key: one for one in EVENT_OPERATORS if one.kind in _RUNS for key in one.keys
}
"""Functor of a term -> the operator that it is as the right side of a sequence, and nowhere else."""

ARROWS = frozenset(key for one in EVENT_OPERATORS if one.meant == "<-" for key in one.keys)

NO_EVENTS = {one.name: len(one.patterns) for one in EVENT_OPERATORS if not one.names_events}
"""What has a name that events do not have, and how many arguments it takes; with others it is an event."""

WRITTEN = tuple(
    (name, len(one.patterns), one.form)
    for one in EVENT_OPERATORS
    if one.form
    for name in one.functors or (one.name,)
)
"""The names of what is written as functor and arguments only, how many it takes, and how it is written."""


def _forms() -> Dict[str, str]:
    found: Dict[str, str] = {}
    for name, number, form in WRITTEN:
        before = f"{found[name]}, or {number}" if name in found else f"takes {counted(number, 'argument')}"
        found[name] = f"{before}: {form}"
    return found


FORMS = _forms()
"""The same in words, by the names."""

NO_FACTS = frozenset(key for one in EVENT_OPERATORS if not one.names_facts for key in one.keys[:1])
"""Facts of these were meant as rules: they are the names of nothing else."""


def names_of_kind(kind: OperatorKind, **facts: bool) -> Tuple[str, ...]:
    """Return how the operators of a kind are called of which these facts hold, in the order of the table."""
    return tuple(
        [
            one.name
            for one in EVENT_OPERATORS
            if one.kind is kind and all(getattr(one, fact) == known for fact, known in facts.items())
        ]
    )
