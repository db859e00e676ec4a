"""Checks of state that no time ends: partial matches that are kept forever, and states of keys."""

from typing import Any, Iterator, List, Optional, Tuple

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.types import atom
from ..language.pattern_tree import (
    AbsencePattern,
    AggregatePattern,
    InstantPattern,
    KleenePattern,
    NotPattern,
    NotPrecededPattern,
    PairPattern,
    Pattern,
    RatePattern,
    RepeatedPattern,
    RuleDefinition,
    WindowPattern,
    WindowSpec,
    WithinPattern,
    bound_by,
    children,
    occurrences,
    walk,
)
from .program_model import ProgramModel, SourceRule, operator_place, subterms, wrap_term

_UNRESTRICTED, _OFF = atom("unrestricted"), atom("off")


def find_unbounded_waits(program: ProgramModel) -> Iterator[RuleError]:
    """Yield rules whose partial matches are never dropped, neither by the consumption policy nor by time."""
    flags = program.rule_base.flags
    if flags.get("garbage_control") is not _OFF:
        return
    properties = program.rule_base.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        values = (
            {} if label is None else {prop.name: prop.value for prop in properties.get(term_key(label), ())}
        )
        policy = values.get("policy", flags.get("event_consumption_policy"))
        if policy is not _UNRESTRICTED or any("window" in name for name in values):
            continue
        node = _unbounded_join(rule.definition.pattern)
        if node is not None:
            operator = node.operator if isinstance(node, PairPattern) else "seq"
            yield RuleError(
                "partial matches of this pattern are kept forever: the policy is unrestricted, and no window ends "
                "it; write (...) within SECONDS, or turn on garbage_control",
                operator_place(rule, operator),
            )


def find_unbounded_keys(program: ProgramModel) -> Iterator[RuleError]:
    """Yield stream operators that keep a state for each value of a variable without a time bound.

    A rule whose label has a time to live is not reported, even if that is 0: its state is intended.
    """
    flags = program.rule_base.flags
    bounds = flags.key_bounds()
    if flags.get("garbage_control") is not _OFF or bounds.max_idle_time is not None:
        return
    properties = program.rule_base.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        label_properties = () if label is None else properties.get(term_key(label), ())
        # A window of the rule bounds its partial matches, and a time to live the states of keys.
        if any(prop.name in ("window", "event_rule_window", "ttl") for prop in label_properties):
            continue
        for node in _operators_without_bound(rule.definition.pattern):
            if _has_unbounded_keys(node, rule.definition):
                yield RuleError(
                    f"no time ends the state that is kept here for each key, up to {bounds.max_keys} keys; write "
                    "(...) within SECONDS, or give the rule a label with property(ttl, SECONDS), or "
                    "property(ttl, 0) if the keys are few",
                    operator_place(rule, "with") if isinstance(node, RatePattern) else _aggregate_place(rule),
                )


def _operators_without_bound(pattern: Pattern) -> Iterator[Pattern]:
    """Yield the stream operators that are not inside a ``within``."""
    stack: List[Tuple[Any, bool]] = [(pattern, False)]
    while stack:
        node, is_bounded = stack.pop()
        if isinstance(node, (WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern)):
            if not is_bounded:
                yield node
            # A bound above other operators limits their inputs as well; above a stream operator, only its outputs.
            is_bounded = False
        elif isinstance(node, WithinPattern):
            is_bounded = True
        elif isinstance(node, InstantPattern):
            is_bounded = False
        stack += [(child, is_bounded) for child in reversed(children(node, False))]
        if isinstance(node, (NotPattern, AbsencePattern, NotPrecededPattern)):
            stack.append((node.negated, False))


def _has_unbounded_keys(node: Pattern, definition: RuleDefinition) -> bool:
    """Return whether a stream operator keeps a state for each value of a variable."""
    if isinstance(node, RatePattern):
        return node.operator == "change" and any(variables(term) for term in node.keys)
    if not isinstance(node, WindowPattern) or not _has_lasting_keys(node.window):
        return False
    # A match that is not complete in time ends the state of its key.
    if node.window.kind == "steps" and node.window.span:
        return False
    measured = [value for value in node.values if value is not None]
    operator_counts = occurrences([*measured, *node.window.navigated_vars], node.collected)
    head = [] if definition.head is None else [definition.head]
    rule_counts = occurrences(head, definition.pattern)
    return any(rule_counts[var] > operator_counts.get(var, 0) for var in bound_by(node.collected))


def _has_lasting_keys(window: WindowSpec) -> bool:
    """Return whether time alone does not end the state of a key."""
    if window.kind == "held":
        return not window.step and window.max_length is None
    return window.kind in ("newest", "batch", "steps")


def _aggregate_place(rule: SourceRule) -> Optional[Place]:
    """Return the place of the first aggregate in a rule."""
    for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of):
        if subterm.term.__class__ is tuple and subterm.term[0].name == "aggregate":
            return subterm.place
    return rule.definition.place


def _unbounded_join(pattern: Pattern) -> Optional[Pattern]:
    """Return the first part of a pattern that joins events and is not inside a ``within``, or None."""
    stack: List[Any] = [pattern]
    while stack:
        node = stack.pop()
        if isinstance(node, WithinPattern):
            # A bound above an instant does not limit the matches below it.
            stack += [part.pattern for part in walk(node) if isinstance(part, InstantPattern)]
            continue
        # These store partial matches; alternatives and conditions store nothing.
        if isinstance(node, (PairPattern, KleenePattern, AggregatePattern, RepeatedPattern)):
            join: Pattern = node
            return join
        stack += reversed(children(node, False))
    return None
