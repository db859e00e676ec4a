"""Check of events that raise themselves at once, without a condition and without end.

`find_cycles` searches for cycles in the graph whose edges are the rules with one event: from the event to the head.
An edge follows another one if its event unifies with the head of the other one.
"""

from collections import Counter
from typing import Any, Dict, Hashable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.types import COMMA, Functor, Term, Var, deref, functor_of
from ...prolog.terms.unification import unify
from ..language.pattern_tree import (
    ActionPattern,
    EventPattern,
    InstantPattern,
    OrPattern,
    Pattern,
    WithinPattern,
)
from ..language.rule_heads import ALARMS, event_raised_by
from .program_model import ProgramModel, SourceRule


class _TriggerEdge(NamedTuple):
    """Edge of the graph of events: an event that fires a rule alone and at once, and the head of the rule."""

    rule: SourceRule
    head: Term
    event: Term


def find_cycles(program: ProgramModel) -> Iterator[RuleError]:
    """Yield rules by which an event raises itself immediately and without end."""
    # Functors exclude most edges before terms are unified, which keeps the search fast for thousands of rules.
    edges = _remove_acyclic_edges([edge for rule in program.rules for edge in _trigger_edges_of(rule)])
    successors = _find_successors(edges)
    reported: Set[int] = set()
    for index in _find_cyclic_edges(successors):
        cycle = None if index in reported else _shortest_cycle(successors, index)
        if cycle is None or not reported.isdisjoint(cycle) or not _can_complete(edges, cycle):
            continue
        reported.update(cycle)
        edge = edges[index]
        names = " <- ".join(
            str(functor_of(edges[edge_index].head)) for edge_index in reversed([*cycle, cycle[0]])
        )
        subject = (
            f"{functor_of(edge.head)} fires itself"
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
    if head is None or functor_of(head) in ALARMS or event_raised_by(head) is not deref(head):
        return
    for event in _events_sufficient_for(rule.definition.pattern):
        if functor_of(event) is not None and functor_of(head) is not None:
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
    indices: Dict[Optional[Functor], List[int]] = {}
    for index, edge in enumerate(edges):
        indices.setdefault(functor_of(edge.event), []).append(index)
    return indices


def _remove_acyclic_edges(edges: List[_TriggerEdge]) -> List[_TriggerEdge]:
    """Return the edges that can be part of a cycle: all others are removed in topological order."""
    producer_counts = Counter(functor_of(edge.head) for edge in edges)
    indices_by_event = _indices_by_event(edges)
    removed: Set[int] = set()
    # Kahn's algorithm: an edge that begins at an event without incoming edges is not part of a cycle.
    sources = [key for key in indices_by_event if not producer_counts[key]]
    while sources:
        for index in indices_by_event.get(sources.pop(), ()):
            removed.add(index)
            key = functor_of(edges[index].head)
            producer_counts[key] -= 1
            if not producer_counts[key]:
                sources.append(key)
    return [edge for index, edge in enumerate(edges) if index not in removed]


def _find_successors(edges: List[_TriggerEdge]) -> List[List[int]]:
    """Return for each edge the indices of the edges whose event unifies with its head."""
    indices_by_event = _indices_by_event(edges)
    constants = [_constant_arguments(edge.event) for edge in edges]
    # For each argument of each functor: the edges by the constant that their event has there; None is a variable.
    indices_by_constant: Dict[Tuple[Optional[Functor], int], Dict[Hashable, List[int]]] = {}
    for index, edge in enumerate(edges):
        for position, constant in enumerate(constants[index]):
            by_constant = indices_by_constant.setdefault((functor_of(edge.event), position), {})
            by_constant.setdefault(constant, []).append(index)
    successors = []
    for edge in edges:
        key = functor_of(edge.head)
        candidates = indices_by_event.get(key, [])
        # Without the most selective argument, the states of a machine would all be compared with each other.
        for position, constant in enumerate(_constant_arguments(edge.head)):
            by_constant = indices_by_constant.get((key, position), {})
            if constant is not None:
                same = [*by_constant.get(constant, ()), *by_constant.get(None, ())]
                candidates = min(candidates, same, key=len)
        successors.append(sorted(index for index in candidates if _may_trigger(edge, edges[index])))
    return successors


def _constant_arguments(term: Term) -> List[Hashable]:
    """Return the arguments of an event: a constant, the functor of a compound term, or None for a variable."""
    event: Any = deref(term)
    arguments = [deref(argument) for argument in event[1:]] if event.__class__ is tuple else []
    return [
        None if item.__class__ is Var else item[0] if item.__class__ is tuple else item for item in arguments
    ]


def _find_cyclic_edges(successors: List[List[int]]) -> List[int]:
    """Return the edges that can be part of a cycle, in order, by Kahn's algorithm."""
    predecessor_counts = Counter(index for indices in successors for index in indices)
    sources = [index for index in range(len(successors)) if not predecessor_counts[index]]
    removed: Set[int] = set()
    while sources:
        index = sources.pop()
        removed.add(index)
        for next_index in successors[index]:
            predecessor_counts[next_index] -= 1
            if not predecessor_counts[next_index]:
                sources.append(next_index)
    return [index for index in range(len(successors)) if index not in removed]


def _shortest_cycle(successors: List[List[int]], start: int) -> Optional[List[int]]:
    """Return the edges of the shortest cycle through an edge, or None."""
    predecessor: Dict[int, int] = {}
    level = [start]
    while level:
        next_level = []
        for index in level:
            for next_index in successors[index]:
                # Breadth first, so the first way back is the shortest.
                if next_index == start:
                    cycle = [index]
                    while cycle[-1] != start:
                        cycle.append(predecessor[cycle[-1]])
                    return cycle[::-1]
                if next_index not in predecessor:
                    predecessor[next_index] = index
                    next_level.append(next_index)
        level = next_level
    return None


def _may_trigger(edge: _TriggerEdge, next_edge: _TriggerEdge) -> bool:
    # The functors are equal; the arguments may exclude each other.
    return unify(copy(edge.head), copy(next_edge.event), [])


def _can_complete(edges: List[_TriggerEdge], cycle: List[int]) -> bool:
    """Return whether an event can pass through the edges of a cycle twice.

    Each edge may follow the one before, while an argument that is passed on ends the second round, as 1 does in
    ``q(1) <- p``, ``r(X) <- q(X)`` and ``p <- r(2)``.
    """
    head: Optional[Term] = None
    for index in [*cycle, *cycle]:
        # Copied together, since the head has variables of the event.
        _, event, next_head = copy((COMMA, edges[index].event, edges[index].head))
        if head is not None and not unify(head, event, []):
            return False
        head = next_head
    return True
