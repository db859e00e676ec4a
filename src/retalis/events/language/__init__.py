"""The language of event rules: operators and patterns, read from terms and checked."""

from .alarms import ALARMS, alarm_of, is_absolute
from .calls import Call, Unknown, called_by, calls, unknown_calls
from .collecting import check_aggregate
from .definition import Definition
from .heads import SYNCHRONIZED, check_head
from .labels import RULE, Property, is_rule, label_error, labelled
from .occurrences import occurrences
from .operators import OPERATORS, Operator
from .pattern import (
    Absent,
    Action,
    Aggregate,
    Condition,
    Either,
    Occurs,
    Pair,
    Pattern,
    Repeated,
    Star,
    Within,
    bound_by,
    children,
    own_terms,
    surely_bound_by,
    walk,
)
from .reading import ARROWS, SPELLINGS, Reader, Spot

__all__ = [
    "Absent",
    "Action",
    "Aggregate",
    "alarm_of",
    "ALARMS",
    "ARROWS",
    "bound_by",
    "Call",
    "called_by",
    "calls",
    "check_aggregate",
    "check_head",
    "children",
    "Condition",
    "Definition",
    "Either",
    "is_absolute",
    "is_rule",
    "label_error",
    "labelled",
    "occurrences",
    "Occurs",
    "Operator",
    "OPERATORS",
    "own_terms",
    "Pair",
    "Pattern",
    "Property",
    "Reader",
    "Repeated",
    "RULE",
    "SPELLINGS",
    "Spot",
    "Star",
    "surely_bound_by",
    "SYNCHRONIZED",
    "Unknown",
    "unknown_calls",
    "walk",
    "Within",
]
