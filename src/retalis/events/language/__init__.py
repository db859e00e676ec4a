"""The language of event rules: operators and patterns, read from terms and checked."""

from .aggregates import AGGREGATES, Collector
from .alarms import ALARMS, alarm_of, is_absolute
from .calls import Subgoal, Unknown, called_by, calls, unknown_calls
from .collecting import check_aggregate
from .definition import RuleDefinition
from .eventnames import event_fault
from .heads import SYNCHRONIZED, check_head
from .labels import RULE, Property, is_rule, label_error, labelled
from .occurrences import occurrences
from .operators import ARROWS, NO_FACTS, OPERATORS, SPELLINGS, names_of_kind
from .pattern import (
    PATTERNS,
    SEQ,
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
from .reading import PatternReader, Spot
from .schedules import TIMER, Schedule, schedule_fault, schedule_of, sets_timer
from .stateforms import HOLDS, STATE, StateForm, asked_state, declares_state, state_form

__all__ = [
    "Absent",
    "Action",
    "Aggregate",
    "AGGREGATES",
    "alarm_of",
    "ALARMS",
    "ARROWS",
    "asked_state",
    "bound_by",
    "Subgoal",
    "called_by",
    "calls",
    "check_aggregate",
    "check_head",
    "children",
    "Collector",
    "Condition",
    "RuleDefinition",
    "declares_state",
    "Either",
    "event_fault",
    "HOLDS",
    "is_absolute",
    "is_rule",
    "label_error",
    "labelled",
    "names_of_kind",
    "NO_FACTS",
    "occurrences",
    "Occurs",
    "OPERATORS",
    "own_terms",
    "Pair",
    "Pattern",
    "PATTERNS",
    "Property",
    "PatternReader",
    "Repeated",
    "RULE",
    "Schedule",
    "schedule_fault",
    "schedule_of",
    "SEQ",
    "sets_timer",
    "SPELLINGS",
    "Spot",
    "Star",
    "STATE",
    "state_form",
    "StateForm",
    "surely_bound_by",
    "SYNCHRONIZED",
    "TIMER",
    "Unknown",
    "unknown_calls",
    "walk",
    "Within",
]
