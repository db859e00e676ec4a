"""The operators of patterns, by the functors of the terms that they are read from."""

from typing import Dict

from ...prolog.syntax import EVENT_OPERATORS, EventOperator, OperatorKind
from ...prolog.terms import Functor

OPERATORS: Dict[str, EventOperator] = {
    one.name: one for one in EVENT_OPERATORS if one.kind is OperatorKind.PAIR
}
"""The operators between two patterns, by name."""

_NOT_BETWEEN = (OperatorKind.RULE, OperatorKind.RUN, OperatorKind.AGGREGATE)

SPELLINGS: Dict[Functor, str] = {
    key: one.name for one in EVENT_OPERATORS if one.kind not in _NOT_BETWEEN for key in one.keys
}
"""Functor of a term -> the operator that it is in patterns, in whose form it is read."""

ARROWS = frozenset(key for one in EVENT_OPERATORS if one.meant == "<-" for key in one.keys)

NO_EVENTS = {one.name: len(one.patterns) for one in EVENT_OPERATORS if not one.names_events}
"""What has a name that events do not have, and how many arguments it takes; with others it is an event."""

NO_FACTS = frozenset(key for one in EVENT_OPERATORS if not one.names_facts for key in one.keys[:1])
"""Facts of these were meant as rules: they are the names of nothing else."""
