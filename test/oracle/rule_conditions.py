"""Conditions and windows of one rule: tests of its matches, and the clock that expires them.

Comments name the section of the language's definition that the code next to them implements.
"""

from dataclasses import replace
from typing import Any, Callable, Dict, Iterable, List, Optional, Set

from retalis import Term, Var
from retalis.prolog.terms.term_traversal import copy, variables

from .goal_evaluator import Bindings, GoalError, first, instance, merge, show, solve, unbound, unify
from .matches import Event, Gap, Match, Pending
from .pattern_classes import (
    NEGATIONS,
    STREAMED,
    Check,
    Instant,
    Leaf,
    Pattern,
    Rule,
    Where,
    Within,
    Without,
    children,
    expand,
    parts,
    pattern_variables,
    walk,
)

Test = Callable[[Match], Optional[Match]]
"""Test of a match: returns the match with the bindings of the test, or None."""


class Conditions:
    """The pattern of one rule with its conditions, windows and clock."""

    def __init__(self, rule: Rule) -> None:
        self.rule = rule
        self.pattern = expand(rule.pattern)
        self.place = {node: position for position, node in enumerate(walk(self.pattern))}
        self.left_of: Dict[Pattern, List[Var]] = {}
        self._note_left(self.pattern, [])
        self.limits: Dict[Pattern, List[Any]] = {}
        self._note_limits(self.pattern, [])
        self.clock: Any = None

    def _note_left(self, node: Pattern, before: List[Var]) -> None:
        """Store the variables to the left of each pattern."""
        self.left_of[node] = list(before)
        seen = list(before)
        for part in parts(node):
            if isinstance(part, Pattern):
                self._note_left(part, seen)
                seen += may_bind(part)
            elif part is not None and not isinstance(part, (str, bool)):
                seen += variables(part)

    def _note_limits(self, node: Pattern, limits: List[Any]) -> None:
        """Store the seconds of each within around each pattern."""
        if isinstance(node, Within):
            limits = [*limits, node.seconds]
        self.limits[node] = limits
        if isinstance(node, (*STREAMED, Instant)):
            limits = []  # Streams: a within limits the emitted matches; instants: the time between them.
        for child in children(node):
            # A forbidden pattern is no part of the match that a within limits.
            own = isinstance(node, NEGATIONS) and child is node.absent
            self._note_limits(child, [] if own else limits)

    def outside(self, node: Pattern) -> Set[Var]:
        """Return the variables of the rule outside of a pattern."""
        outside = set(variables(self.rule.head))
        if self.rule.do is not None:
            outside |= set(variables(self.rule.do))

        def gather(other: Pattern) -> None:
            for part in parts(other):
                if part is node:
                    continue
                if isinstance(part, Pattern):
                    gather(part)
                elif part is not None and not isinstance(part, (str, bool)):
                    outside.update(variables(part))

        if node is not self.pattern:
            gather(self.pattern)
        return outside

    # Conditions.

    def test_of(self, condition: Pattern) -> Test:
        """Return a condition as a test."""
        if isinstance(condition, Within):
            # Table, within: e - s < N seconds, whatever the pattern is.
            return lambda match: match if match.end - match.start < condition.seconds else None
        if isinstance(condition, Without):
            # Table, without: no R overlaps P.
            return lambda match: self.outside_gap(Gap(condition, match.start, match.end), match)
        assert isinstance(condition, (Where, Check))

        def test(match: Match) -> Optional[Match]:
            # Table, check: as where, with t1 and t2 true inside the goal.
            facts = {"t1": match.start, "t2": match.end} if isinstance(condition, Check) else {}
            waits = replace(match, pending=(*match.pending, Pending(condition.goal, facts)))
            return self.settle(waits, condition)

        return test

    def settle(self, match: Match, node: Pattern) -> Optional[Match]:
        """Call the conditions of a match whose variables are bound; return None if one does not hold.

        Patterns: a condition under several operators sees the variables of all patterns to its left.
        """
        pending: List[Any] = []
        bindings = match.bindings
        for item in match.pending:
            if isinstance(item, Gap):
                if self.waits_for_left(item.node, bindings, node):
                    pending.append(item)
                elif self.forbidden(item, bindings):
                    return None
                continue
            if unbound(item.goal, bindings) & set(self.left_of[node]):
                pending.append(Pending(instance(item.goal, bindings), item.facts))
                continue
            # Table, where: the goal's first solution, which may bind the head.
            solution = first(item.goal, bindings, item.facts)
            if solution is None:
                return None
            bindings = solution
        return replace(match, bindings=bindings, pending=tuple(pending))

    def waits_for_left(self, absence: Any, bindings: Bindings, node: Pattern) -> bool:
        """Return whether a forbidden pattern has variables of patterns to the left that are still unbound."""
        mentioned = set(pattern_variables(absence.absent)) & set(self.left_of[absence])
        left = set(self.left_of[node])
        return any(unbound(var, bindings) & left for var in mentioned)

    def forbidden(self, gap: Gap, bindings: Bindings) -> bool:
        """Return whether a forbidden event lies in a gap."""
        for r in self.absent(gap.node):
            inside = r.end < gap.before and (gap.after is None or gap.after < r.start)
            if isinstance(gap.node, Without):
                inside = r.start < gap.before and gap.after < r.end
            if inside and self.agree(r, {**bindings, **(gap.fresh or {})}):
                return True
        return False

    def absent(self, node: Pattern) -> List[Match]:
        """Return the matches of the pattern that a cnot or fnot forbids."""
        raise NotImplementedError

    def outside_gap(self, gap: Gap, match: Match) -> Optional[Match]:
        """Return a match unless a forbidden event is known to rule it out, else None."""
        if self.waits_for_left(gap.node, match.bindings, gap.node):
            return replace(match, pending=(*match.pending, gap))
        if self.forbidden(gap, match.bindings):
            return None
        return replace(match, allowed_gaps=(*match.allowed_gaps, gap))

    @staticmethod
    def passes(match: Match, tests: Iterable[Test]) -> Optional[Match]:
        """Return a match with the bindings of all tests, or None if one rejects it."""
        result: Optional[Match] = match
        for test in tests:
            if result is not None:
                result = test(result)
        return result

    def join(self, p: Match, q: Match, start: Any, end: Any, node: Pattern) -> Optional[Match]:
        """Return two matches as one if their shared variables agree, else None."""
        bindings = merge(p.bindings, q.bindings)
        if bindings is None:
            return None
        numbers, pending = p.numbers | q.numbers, p.pending + q.pending
        joined = Match(start, end, bindings, p.terms + q.terms, numbers, pending, composed=True)
        return self.settle(joined, node)

    def agree(self, absent: Match, of: Bindings) -> bool:
        """Return whether a forbidden match applies to these bindings: its variables agree and its conditions hold.

        A pattern that the forbidden one itself forbids is one of these conditions.
        """
        bindings = merge(of, absent.bindings)
        for item in absent.pending:
            if bindings is None:
                return False
            if not isinstance(item, Gap):
                bindings = first(item.goal, bindings, item.facts)
            elif self.forbidden(item, bindings):
                return False
        return bindings is not None

    def leaf(self, node: Leaf, event: Event) -> List[Match]:
        """Return the match of a pattern of one event. Table: it unifies, the interval is its own."""
        bindings = unify(node.term, copy(event.term), {})
        if bindings is None:
            return []
        terms = ((self.place[node], show(event.term)),)
        return [Match(event.start, event.end, bindings, terms, frozenset([event.number]))]

    # Windows.

    def in_window(self, match: Match) -> bool:
        """Labels: e - s =< V seconds, exactly, at every operator of the rule."""
        return self.rule.window is None or match.end - match.start <= self.rule.window

    def advance(self, event: Event) -> None:
        """Time: a rule's clock is the newest end among the events that its patterns matched."""
        leaves = [node for node in self.place if isinstance(node, Leaf)]
        if any(unify(leaf.term, copy(event.term), {}) is not None for leaf in leaves):
            self.clock = event.end if self.clock is None else max(self.clock, event.end)

    def expired(self, node: Pattern, match: Match) -> bool:
        """Policies: a match that can no longer complete is removed; windows expire by the clock."""
        if self.clock is None:
            return False
        age = self.clock - match.start
        if self.rule.window is not None and age > self.rule.window:
            return True
        return any(age >= seconds for seconds in self.limits[node])


def may_bind(node: Pattern) -> List[Var]:
    """Return the variables that a pattern may bind: none that occurs only in a forbidden pattern."""
    bound: List[Var] = []
    for part in parts(node):
        if isinstance(node, NEGATIONS) and part is node.absent:
            continue
        if isinstance(part, Pattern):
            bound += may_bind(part)
        elif part is not None and not isinstance(part, (str, bool)):
            bound += variables(part)
    return list(dict.fromkeys(bound))


def all_solutions(goal: Term, bindings: Bindings) -> List[Bindings]:
    """Table, event_multiply: every solution, in order; none of a goal that raises an error."""
    try:
        return list(solve(goal, bindings))
    except GoalError:
        return []
