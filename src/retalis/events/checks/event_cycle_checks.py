"""Check of events that raise themselves at once, without a condition and without end.

`find_cycles` searches for cycles in the graph whose edges are the rules with one event: from the event to the head.
"""

from collections import Counter
from typing import Dict, Iterator, List, NamedTuple, Optional, Set

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.types import Functor, Term, Trail, deref
from ...prolog.terms.unification import undo, unify
from ..language.pattern_tree import (
    ActionPattern,
    EventPattern,
    InstantPattern,
    OrPattern,
    Pattern,
    WithinPattern,
)
from ..language.rule_heads import ALARMS, event_raised_by
from .program_model import ProgramModel, SourceRule, key_of


class _TriggerEdge(NamedTuple):
    """Edge of the graph of events: an event that fires a rule alone and at once, and the head of the rule."""

    rule: SourceRule
    head: Term
    event: Term


def find_cycles(program: ProgramModel) -> Iterator[RuleError]:
    """Yield rules by which an event raises itself immediately and without end."""
    # Removing edges outside of cycles first keeps the search fast for programs with thousands of rules.
    edges = _remove_acyclic_edges([edge for rule in program.rules for edge in _trigger_edges_of(rule)])
    indices_by_event = _indices_by_event(edges)
    reported: Set[int] = set()
    for index, edge in enumerate(edges):
        cycle = None if index in reported else _shortest_cycle(edges, indices_by_event, index)
        if cycle is None or any(edge_index in reported for edge_index in cycle):
            continue
        reported.update(cycle)
        names = " <- ".join(
            str(key_of(edges[edge_index].head)) for edge_index in reversed([*cycle, cycle[0]])
        )
        subject = (
            f"{key_of(edge.head)} fires itself"
            if len(cycle) == 1
            else f"these events fire each other ({names})"
        )
        yield RuleError(
            f"{subject}, at once and without end: give the rule a condition (where) or another head",
            edge.rule.definition.place,
        )


def _trigger_edges_of(rule: SourceRule) -> Iterator[_TriggerEdge]:
    head = rule.definition.head
    # Alarms and queries raise their event later, so a cycle through them takes time.
    if head is None or key_of(head) in ALARMS or event_raised_by(head) is not deref(head):
        return
    for event in _events_sufficient_for(rule.definition.pattern):
        if key_of(event) is not None and key_of(head) is not None:
            yield _TriggerEdge(rule, head, event)


def _events_sufficient_for(pattern: Pattern) -> Iterator[Term]:
    """Yield the events that match a pattern on their own and unconditionally."""
    if isinstance(pattern, EventPattern):
        yield pattern.term
    elif isinstance(pattern, OrPattern):
        for branch in pattern.branches:
            yield from _events_sufficient_for(branch)
    elif isinstance(pattern, (WithinPattern, InstantPattern)) or (
        isinstance(pattern, ActionPattern) and not pattern.every
    ):
        yield from _events_sufficient_for(pattern.pattern)


def _indices_by_event(edges: List[_TriggerEdge]) -> Dict[Optional[Functor], List[int]]:
    """Return the indices of the edges that begin at each functor."""
    indices: Dict[Optional[Functor], List[int]] = {}
    for index, edge in enumerate(edges):
        indices.setdefault(key_of(edge.event), []).append(index)
    return indices


def _remove_acyclic_edges(edges: List[_TriggerEdge]) -> List[_TriggerEdge]:
    """Return the edges that can be part of a cycle: all others are removed in topological order."""
    producer_counts = Counter(key_of(edge.head) for edge in edges)
    indices_by_event = _indices_by_event(edges)
    removed: Set[int] = set()
    # Kahn's algorithm: an edge that begins at an event without incoming edges is not part of a cycle.
    sources = [key for key in indices_by_event if not producer_counts[key]]
    while sources:
        for index in indices_by_event.get(sources.pop(), ()):
            removed.add(index)
            key = key_of(edges[index].head)
            producer_counts[key] -= 1
            if not producer_counts[key]:
                sources.append(key)
    return [edge for index, edge in enumerate(edges) if index not in removed]


def _shortest_cycle(
    edges: List[_TriggerEdge], indices_by_event: Dict[Optional[Functor], List[int]], start: int
) -> Optional[List[int]]:
    """Return the indices of the edges of the shortest cycle through an edge, or None."""
    predecessor: Dict[int, int] = {}
    level = [start]
    while level:
        next_level = []
        for index in level:
            for next_index in indices_by_event.get(key_of(edges[index].head), ()):
                edge = edges[next_index]
                # Breadth first, so the first way back is the shortest.
                if next_index == start and _may_trigger(edges[index], edge):
                    cycle = [index]
                    while cycle[-1] != start:
                        cycle.append(predecessor[cycle[-1]])
                    return cycle[::-1]
                if next_index not in predecessor and next_index != start and _may_trigger(edges[index], edge):
                    predecessor[next_index] = index
                    next_level.append(next_index)
        level = next_level
    return None


def _may_trigger(edge: _TriggerEdge, next_edge: _TriggerEdge) -> bool:
    trail: Trail = []
    # The functors are equal; the arguments may exclude each other.
    unifies = unify(copy(edge.head), copy(next_edge.event), trail)
    undo(trail, 0)
    return bool(unifies)
