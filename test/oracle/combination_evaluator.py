"""Evaluator without state for policy ``unrestricted``: all combinations of events that satisfy the whole pattern.

Each of these combinations fires exactly once, at its last arrival. The evaluator enumerates all assignments of events
to the leaves of the pattern, and keeps those that satisfy its operators; each belongs to the arrival that completed
it. It shares only conditions and the tables of times with the other evaluator.

Star_times, aggregates and forall_seq are not supported: their results depend on runs and on consumed events.
"""

from collections import Counter
from dataclasses import replace
from itertools import accumulate
from typing import Any, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple
from typing import Counter as CounterOf

from events.operator_table import PAIRS

from retalis import Term
from retalis.prolog.terms.term_traversal import copy

from .evaluator import instant_of
from .goal_evaluator import first, instance, show
from .matches import Event, Match
from .pattern_classes import (
    NEGATIONS,
    STREAMED,
    Aggregate,
    Both,
    Cnot,
    Do,
    Fnot,
    Instant,
    Leaf,
    Multiply,
    Or,
    Pattern,
    Rule,
    Star,
    Sub,
    Without,
    strip,
    walk,
)
from .rule_conditions import Conditions, all_solutions


class TimedMatch(NamedTuple):
    """A match and the number of the arrival that completed it."""

    match: Match
    arrival: int
    allowed_keys: Tuple[Any, ...] = ()
    """Keys of the negations that allow the match, tested since its operands were stored."""


def defined_for(rules: Sequence[Rule]) -> bool:
    """Return whether this evaluator supports the rules: one rule, no runs, no forall_seq."""
    if len(rules) != 1 or has_outer_absence(rules[0]):
        return False
    if rules[0].policy_by("unrestricted") != "unrestricted" or rules[0].after_match != "keep":
        return False
    # A without between a cnot and its sequence is not evaluated here.
    between = [
        condition
        for node in walk(rules[0].pattern)
        if isinstance(node, Cnot)
        for condition in strip(node.pattern)[1]
    ]
    if any(isinstance(condition, Without) for condition in between):
        return False
    return not any(
        isinstance(node, (Star, Aggregate, Sub, *STREAMED))
        or (isinstance(node, Both) and node.kind == "forall_seq")
        for node in walk(rules[0].pattern)
    )


def has_outer_absence(rule: Rule) -> bool:
    """Return whether a pattern that a cnot or fnot forbids has variables of patterns further left."""
    tests = Conditions(rule)
    return any(isinstance(node, NEGATIONS) and tests.waits_for_left(node, {}, node) for node in tests.place)


class Combinations:
    """All matches of one rule's pattern in a list of events.

    Attributes:
        now: the number of the last arrival if events are retracted. A match that a retracted event suppressed is
            then tested against all events, including later ones; matches that held before continue to hold.
    """

    def __init__(self, rule: Rule, out_of_order: bool) -> None:
        self.rule = rule
        self.out_of_order = rule.late_by(out_of_order)
        self.tests = Conditions(rule)
        self.now: Optional[int] = None
        self._allowed_keys: Set[Any] = set()

    def stored_matches(self, node: Pattern, events: Sequence[Event]) -> List[TimedMatch]:
        """Return all matches of a pattern, which fire or are operands: later events do not suppress them."""
        matches = self.timed_matches(node, events)
        for match in matches:
            self._allowed_keys.update(match.allowed_keys)
        return matches

    def timed_matches(self, node: Pattern, events: Sequence[Event]) -> List[TimedMatch]:
        """Return all matches of a pattern.

        A match that one condition suppresses is tested by all of them when it is tried again.
        """
        operator, conditions = strip(node)
        matches = self._operator(operator, events, conditions)
        absences = {
            condition: self.stored_matches(condition.absent, events)
            for condition in conditions
            if isinstance(condition, Without)
        }
        result: List[Any] = []
        for match, arrival, keys in matches:
            passed = self.tests.settle(match, operator)
            for condition in conditions:
                if passed is None:
                    break
                if not isinstance(condition, Without):
                    passed = self.tests.passes(passed, [self.tests.test_of(condition)])
                    continue
                absent_arrivals = [
                    r_arrival
                    for r, r_arrival, _ in absences[condition]
                    if r.start < passed.end and passed.start < r.end and self.tests.agree(r, passed.bindings)
                ]
                key = self._key_of(condition, passed)
                keys = (*keys, key)
                if not self._is_allowed(key, arrival, absent_arrivals):
                    passed = None
            if passed is not None:
                result.append(TimedMatch(passed, arrival, keys))
        return result

    def _operator(
        self, node: Any, events: Sequence[Event], conditions: List[Pattern]
    ) -> Iterable[TimedMatch]:
        if isinstance(node, Leaf):
            return [TimedMatch(match, e.number) for e in events for match in self.tests.leaf(node, e)]
        if isinstance(node, Or):
            return self.timed_matches(node.left, events) + self.timed_matches(node.right, events)
        if isinstance(node, Both):
            return [pair for _, _, pair in self._pairs(node, events)]
        if isinstance(node, Do):
            solutions = [
                (first(node.goal, match.bindings), match, arrival, keys)
                for match, arrival, keys in self.timed_matches(node.pattern, events)
            ]
            return [
                TimedMatch(replace(match, bindings=b), arrival, keys)
                for b, match, arrival, keys in solutions
                if b is not None
            ]
        if isinstance(node, Multiply):
            return [
                TimedMatch(replace(match, bindings=bindings), arrival, keys)
                for match, arrival, keys in self.timed_matches(node.pattern, events)
                for bindings in all_solutions(node.goal, match.bindings)
            ]
        if isinstance(node, Instant):
            return [
                TimedMatch(instant_of(node, match), arrival, keys)
                for match, arrival, keys in self.timed_matches(node.pattern, events)
            ]
        assert isinstance(node, (Cnot, Fnot))
        return self._absent(node, events)

    def _pairs(self, node: Both, events: Sequence[Event]) -> Iterable[Tuple[Match, Match, TimedMatch]]:
        # Both sides are evaluated at each event, also if one has no match: negations remember what they have allowed.
        lefts, rights = (self.stored_matches(side, events) for side in (node.left, node.right))
        for p in lefts:
            for q in rights:
                in_time = node.kind != "seq" or self.out_of_order or p.arrival < q.arrival
                same = len(p.match.numbers) == 1 and p.match.numbers == q.match.numbers
                if same or not in_time or not PAIRS[node.kind].fits(p.match, q.match):
                    continue
                match = self.tests.join(p.match, q.match, *PAIRS[node.kind].interval(p.match, q.match), node)
                if match is not None and self.tests.in_window(match):
                    yield p.match, q.match, TimedMatch(match, max(p.arrival, q.arrival))

    def _absent(self, node: Any, events: Sequence[Event]) -> Iterable[TimedMatch]:
        absent = self.stored_matches(node.absent, events)
        inner, between = strip(node.pattern)
        if isinstance(node, Cnot) and isinstance(inner, Both) and inner.kind == "seq":
            tests = [self.tests.test_of(condition) for condition in between]
            for p, q, (match, arrival, _) in self._pairs(inner, events):
                passed = self.tests.passes(match, tests)
                if passed is None:
                    continue
                absent_arrivals = [
                    r_arrival
                    for r, r_arrival, _ in absent
                    if p.end < r.start and r.end < q.start and self.tests.agree(r, passed.bindings)
                ]
                key = self._key_of(node, passed)
                if self._is_allowed(key, arrival, absent_arrivals):
                    yield TimedMatch(passed, arrival, (key,))
        else:
            for match, arrival, keys in self.timed_matches(node.pattern, events):
                absent_arrivals = [
                    r_arrival
                    for r, r_arrival, _ in absent
                    if r.end < match.start and self.tests.agree(r, match.bindings)
                ]
                key = self._key_of(node, match)
                if self._is_allowed(key, arrival, absent_arrivals):
                    yield TimedMatch(match, arrival, (*keys, key))

    @staticmethod
    def _key_of(node: Pattern, match: Match) -> Any:
        """Return the key of a match that a negation has tested."""
        return id(node), match.variant(), tuple(sorted(match.numbers))

    def _is_allowed(self, key: Any, arrival: int, absent_arrivals: List[int]) -> bool:
        """Return whether nothing suppresses the match of a key, given the arrivals of the events that would."""
        if any(r_arrival <= arrival for r_arrival in absent_arrivals):
            return False
        return self.now is None or key in self._allowed_keys or arrival == self.now or not absent_arrivals


def firings(
    rule: Rule,
    stream: Iterable[Tuple[Term, Any, Any]],
    out_of_order: bool = False,
    youngest: Any = None,
) -> List[CounterOf[Tuple[str, Any, Any]]]:
    """Return the matches that fire at each arrival, as multisets, because this evaluator defines no order.

    With ``youngest``, only combinations whose events ended at most that many seconds before the newest end fire:
    those that garbage control with this window must keep.
    """
    events = [Event(term, start, end, number) for number, (term, start, end) in enumerate(stream)]
    clocks = list(accumulate((event.end for event in events), max))
    combinations = Combinations(rule, out_of_order)
    results: List[CounterOf[Tuple[str, Any, Any]]] = [Counter() for _ in events]
    for match, arrival, _ in combinations.timed_matches(combinations.tests.pattern, events):
        if not combinations.tests.in_window(match):
            continue
        if youngest is not None and any(
            events[number].end < clocks[arrival] - youngest for number in match.numbers
        ):
            continue
        bindings = match.bindings if rule.do is None else first(rule.do, match.bindings)
        if bindings is not None:
            results[arrival][show(copy(instance(rule.head, bindings))), match.start, match.end] += 1
    return results
