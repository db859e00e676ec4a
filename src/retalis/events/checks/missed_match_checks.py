"""Checks of matches that a rule probably misses: a throttle or the default policy suppresses them."""

from typing import Any, Iterator, Optional, Set

from ...foundation.displayed_text import format_number
from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.types import Var, atom, deref
from ..language.pattern_tree import (
    ConditionPattern,
    EventPattern,
    PairPattern,
    Pattern,
    RatePattern,
    WithinPattern,
    walk,
)
from ..language.rule_heads import event_raised_by
from .condition_checks import IS, NUMERIC_COMPARISONS
from .program_model import ProgramModel, SourceRule, operator_place, subterms, wrap_term
from .time_checks import TIMED_OPERATORS, alternative_events, is_message
from .value_flow import ValueFlow
from .value_kinds import NUMBER

_RECENT = atom("recent")


def find_throttles_without_key(program: ProgramModel) -> Iterator[RuleError]:
    """Yield ``throttle`` and similar operators without a key for events that seem to have one.

    A key is the first argument of an event with several ones, is passed on to the head, and is not used as a number.
    """
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        head_vars = set() if head is None else set(variables(head))
        for node in walk(rule.definition.pattern, negated=True):
            if isinstance(node, RatePattern) and node.operator in TIMED_OPERATORS and not node.keys:
                key_variable = _key_variable(program, rule, node.pattern, head_vars)
                if key_variable is not None:
                    name = program.names_in(rule).get(key_variable, "Key")
                    notation = f"{node.operator}({format_number(node.span / 10**9)}"
                    yield RuleError(
                        f"{notation}) has one state for all values of {name}, so that an event of one suppresses "
                        f"those of others; unless this is intended, write {notation}, {name})",
                        operator_place(rule, "with"),
                    )


def _key_variable(
    program: ProgramModel, rule: SourceRule, pattern: Pattern, head_vars: Set[Var]
) -> Optional[Var]:
    """Return the variable that distinguishes the sources of the event of a pattern, or None."""
    events = [node.term for node in walk(pattern) if isinstance(node, EventPattern)]
    if len(events) != 1 or events[0].__class__ is not tuple or program.message_of(events[0]) is not None:
        return None
    event: Any = events[0]
    first, others = deref(event[1]), [deref(argument) for argument in event[2:]]
    if first.__class__ is not Var or first not in head_vars or not others:
        return None
    numeric = _variables_used_as_numbers(rule)
    kinds = program.derive(ValueFlow).kinds_of_event(event[0])
    first_kinds = kinds[0] if kinds else None
    if first in numeric or (first_kinds and NUMBER in first_kinds):
        return None
    # A key has a measured value beside it, which is compared or not passed on to the head.
    is_measured = any(
        other.__class__ is Var and (other in numeric or other not in head_vars) for other in others
    )
    return first if is_measured else None


def _variables_used_as_numbers(rule: SourceRule) -> Set[Var]:
    """Return the variables of comparisons and arithmetic in a rule."""
    return {
        var
        for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of)
        if subterm.term.__class__ is tuple and (subterm.key in NUMERIC_COMPARISONS or subterm.key is IS)
        for var in variables(subterm.term)
    }


def find_conditions_after_throttle(program: ProgramModel) -> Iterator[RuleError]:
    """Yield conditions on the output of ``throttle``: a match that fails them has suppressed others."""
    for rule in program.rules:
        for node in walk(rule.definition.pattern, negated=True):
            limited = node.pattern if isinstance(node, ConditionPattern) else None
            if isinstance(limited, RatePattern) and limited.operator == "throttle":
                yield RuleError(
                    "throttle is applied before the condition: a match that fails the condition suppresses later "
                    "ones that satisfy it; write (Pattern where Goal) with throttle(...), unless this is intended",
                    operator_place(rule, "with"),
                )


def find_missed_pairs(program: ProgramModel) -> Iterator[RuleError]:
    """Yield joins of messages within a span of time that miss pairs, because the default policy uses a message once.

    A rule whose label sets a policy is not reported: its policy is intended.
    """
    if program.rule_base.flags.get("event_consumption_policy") is not _RECENT:
        return
    properties = program.rule_base.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        label_properties = () if label is None else properties.get(term_key(label), ())
        if not any(prop.name == "policy" for prop in label_properties) and _pairs_messages(
            program, rule.definition.pattern
        ):
            yield RuleError(
                "under the policy recent a message is used for one pair only, so messages of topics with different "
                "rates miss partners within the time; for all pairs give the rule a label with "
                "property(policy, unrestricted), or property(policy, recent) if this is intended",
                operator_place(rule, "and"),
            )


def _pairs_messages(program: ProgramModel, pattern: Pattern) -> bool:
    """Return whether a pattern joins messages of two topics by ``and`` within a span of time."""
    for node in walk(pattern, negated=True):
        if not isinstance(node, WithinPattern):
            continue
        joined = node.pattern
        while isinstance(joined, (WithinPattern, ConditionPattern)):
            joined = joined.pattern
        if isinstance(joined, PairPattern) and joined.operator == "and":
            sides = [alternative_events(joined.left), alternative_events(joined.right)]
            if all(keys and all(is_message(program, key) for key in keys) for keys in sides):
                return True
    return False
