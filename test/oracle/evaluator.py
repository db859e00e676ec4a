"""Evaluator: the whole pattern processes each event with plain lists of its buffered matches.

It has no index, and expiry only on request; each operand has a list. Comments
name the sentence of the language's definition that the code next to them realises.
"""

from dataclasses import replace
from functools import partial
from typing import Any, Callable, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from events.operator_table import EITHER_ORDER, PAIRS

from retalis import Term, functor
from retalis.prolog.terms.term_traversal import copy

from .after_match_skipping import Skipping
from .goal_evaluator import first, instance, show
from .matches import POLICIES, Event, Gap, Match
from .pattern_classes import (
    NEGATIONS,
    STREAMED,
    Aggregate,
    Awaited,
    Both,
    Cnot,
    Do,
    Fnot,
    Instant,
    Leaf,
    Multiply,
    Or,
    Pattern,
    Preceded,
    Rule,
    Star,
    Without,
    strip,
    take_out_subpatterns,
    walk,
)
from .rule_conditions import Test, all_solutions
from .stream_operators import Streams

Fit = Callable[[Match, Match], Optional[Match]]
"""Test of a pair: returns the match of the two sides, or None."""


NOTHING = Event(functor("an event that no rule is about", 1)(0), 0, 0, 0)
"""The event with which patterns are evaluated at deadlines, and after retractions."""


class Sides(NamedTuple):
    """Matches of two sides: those that an event has completed, and the stored ones."""

    lefts: List[Match]
    rights: List[Match]
    p_waiting: List[Match]
    q_waiting: List[Match]


class RuleState(Streams):
    """One rule and its partial matches."""

    def __init__(self, rule: Rule, policy: str, out_of_order: bool = False, expiry: bool = True) -> None:
        super().__init__(rule, policy, out_of_order, expiry)
        self.completed: Dict[Pattern, Set[FrozenSet[int]]] = {}
        """Single events that have completed matches as the right side; revision may release their left sides."""
        self.skipping = Skipping(rule)
        absent = [node.absent for node in self.place if isinstance(node, (Awaited, Preceded, *NEGATIONS))]
        self.below_absent = {below for node in absent for below in walk(node)}

    def derived_events(self, event: Event) -> List[Event]:
        """Process an event; return the events that the rule derives from it, in order."""
        self.begin_event(event)
        fired = [result for matches in self.whole(self.pattern, event) for _, result in self.fire(matches)]
        self.skip()
        return fired

    def due_events(self, place: int, instant: Any) -> List[Event]:
        """Return the events that the rule derives at a deadline, in order."""
        self.skipping.begin_event()
        self.current_alarm = place, instant
        fired = [result for matches in self.whole(self.pattern, NOTHING) for _, result in self.fire(matches)]
        self.current_alarm = None
        self.skip()
        return fired

    def begin_event(self, event: Event) -> None:
        """Advance the clock of the rule, and drop expired matches, before an event is processed."""
        self.advance(event)
        self.expire()
        self.skipping.begin_event()

    def whole(self, node: Pattern, event: Event) -> List[List[Match]]:
        """Return the matches of the whole pattern that an event completes, in order.

        After match: each item is a match, or all results of the outermost do or event_multiply for one match.
        """
        operator, conditions = strip(node)
        if not isinstance(operator, (Do, Multiply)):
            return [[match] for match in self.arrive(node, event)]
        self._store_overlapping(conditions, event)
        return [
            self.filter_conditions(operator, conditions, self.apply_goal(operator, matches))
            for matches in self.whole(operator.pattern, event)
        ]

    def fire(self, matches: List[Match]) -> List[Tuple[Match, Event]]:
        """Return the events of the results of one match of the whole pattern, unless another match has skipped it."""
        if not matches or self.skipping.skips(matches[0]):
            return []
        results = [(match, self.result_of(match)) for match in matches]
        fired = [(match, result) for match, result in results if result is not None]
        if fired:
            self.skipping.fired(matches[0])
        return fired

    def skip(self) -> None:
        """Delete the skipped buffered matches after an event has been processed.

        Events that cnot or fnot forbids, and matches within them, remain.
        """
        for (node, side), waiting in self.waiting.items():
            if side != "absent" and node not in self.below_absent:
                waiting[:] = [match for match in waiting if not self.skipping.skips(match)]
        for node, runs in self.runs.items():
            if node not in self.below_absent:
                runs[:] = [run for run in runs if not self.skipping.skips(run.start)]

    def leaf(self, node: Leaf, event: Event) -> List[Match]:
        """After match: a skipped event is not part of a match; forbidden events remain forbidden."""
        if self.skipping.is_past(event) and node not in self.below_absent:
            return []
        return super().leaf(node, event)

    def result_of(self, match: Match) -> Optional[Event]:
        """Return the event that a match of the whole pattern fires, or None."""
        if not self.in_window(match):
            return None
        bindings: Any = match.bindings
        if self.rule.do is not None:  # Patterns: H do G <- P
            bindings = first(self.rule.do, bindings)
            if bindings is None:
                return None
        return Event(copy(instance(self.rule.head, bindings)), match.start, match.end)

    def arrive(self, node: Pattern, event: Event) -> List[Match]:
        """Return the matches of a pattern that an event completes, in order."""
        # Patterns: a condition belongs to the nearest operator below it.
        operator, conditions = strip(node)
        self._store_overlapping(conditions, event)
        tests = [self.test_of(condition) for condition in conditions]
        if isinstance(operator, Cnot):
            # Policies: conditions may be between a cnot and its seq.
            inner, between = strip(operator.pattern)
            if isinstance(inner, Both) and inner.kind == "seq":
                self._absent(operator, event)
                self._store_overlapping(between, event)
                lower = [self.test_of(condition) for condition in between]
                return self.two_sided(inner, event, [*lower, *tests], operator)
        if isinstance(operator, Both):
            return self.two_sided(operator, event, tests, None)
        if isinstance(operator, STREAMED):
            matches = self.streamed(operator, event)
            passed = [self.passes(match, tests) for match in matches if self.in_window(match)]
            return [match for match in passed if match is not None]
        if isinstance(operator, (Star, Aggregate)):
            starts = composed_first(self.arrive(operator.first, event))
            repetitions = composed_first(self.arrive(operator.repeated, event))
            return self.repetition(operator, starts, repetitions, conditions)
        return self.filter_conditions(operator, conditions, self.single(operator, event))

    def filter_conditions(
        self, node: Pattern, conditions: List[Pattern], matches: List[Match]
    ) -> List[Match]:
        """Return the matches of an operator that satisfy its conditions."""
        tests = [self.test_of(condition) for condition in conditions]
        settled = [self.settle(match, node) for match in matches]
        passed = [self.passes(match, tests) for match in settled if match is not None]
        return [match for match in passed if match is not None]

    def single(self, node: Pattern, event: Event) -> List[Match]:
        """Return the new matches of a pattern that selects no partners."""
        if isinstance(node, Leaf):
            return self.leaf(node, event)
        if isinstance(node, Or):  # Table, or: either happens, the interval is its own.
            return self.arrive(node.left, event) + self.arrive(node.right, event)
        if isinstance(node, (Do, Multiply)):
            return self.apply_goal(node, self.arrive(node.pattern, event))
        if isinstance(node, Instant):
            return [instant_of(node, match) for match in self.arrive(node.pattern, event)]
        assert isinstance(node, (Cnot, Fnot))
        self._absent(node, event)
        allowed = [self.allowed(node, match) for match in self.arrive(node.pattern, event)]
        return [match for match in allowed if match is not None]

    @staticmethod
    def apply_goal(node: Any, matches: List[Match]) -> List[Match]:
        """Return the results of a do or event_multiply for matches."""
        if isinstance(node, Do):
            # Table, do: the goal is called once before the result fires, and must succeed.
            solutions = [(match, first(node.goal, match.bindings)) for match in matches]
            return [
                replace(match, bindings=bindings) for match, bindings in solutions if bindings is not None
            ]
        return [
            replace(match, bindings=solution)
            for match in matches
            for solution in all_solutions(node.goal, match.bindings)
        ]

    def allowed(self, node: Pattern, match: Match) -> Optional[Match]:
        """Table: P cnot R and P fnot R need that no matching R ended before P started."""
        return self.outside_gap(Gap(node, None, match.start), match)

    def absent(self, node: Pattern) -> List[Match]:
        """Return the stored matches that a cnot or fnot forbids."""
        return self.waiting.get((node, "absent"), [])

    def _absent(self, node: Any, event: Event) -> None:
        """Store forbidden matches. Policies: they are never consumed."""
        self.waiting.setdefault((node, "absent"), []).extend(self.arrive(node.absent, event))

    def _store_overlapping(self, conditions: List[Pattern], event: Event) -> None:
        """Store what without forbids. Without: an event that is both R and part of P counts as R first."""
        for condition in conditions:
            if isinstance(condition, Without):
                self._absent(condition, event)

    # Two sides.

    def two_sided(self, node: Both, event: Event, tests: List[Test], cnot: Optional[Cnot]) -> List[Match]:
        """Return the pairs that an event completes."""
        sides = Sides(
            self.arrive(node.left, event),
            self.arrive(node.right, event),
            self.waiting.setdefault((node, "left"), []),
            self.waiting.setdefault((node, "right"), []),
        )

        def fit(p: Match, q: Match) -> Optional[Match]:
            return self.fit(node, p, q, tests, cnot)

        if node.kind in EITHER_ORDER:
            return self._either_order(node, sides, fit)
        return self._in_order(node, sides, fit)

    def _in_order(self, node: Both, sides: Sides, fit: Fit) -> List[Match]:
        """Policies, for seq and forall_seq: an event that fits both sides completes first, then waits."""
        lefts, rights, p_waiting, q_waiting = sides
        results: List[Match] = []

        def with_second(q: Match, p: Match) -> Optional[Match]:
            return fit(p, q)

        for_all = node.kind == "forall_seq"
        for q in rights:
            if for_all:
                # Table, forall_seq: all stored P, oldest first, consumed under every policy.
                pairs = self._take(p_waiting, partial(with_second, q), "all", is_consumed=True)
            else:
                pairs = self.complete(p_waiting, partial(with_second, q))
            results += pairs
            if not pairs:
                self.store_unmatched(node, q)
        unmatched: List[Any] = []
        for p in lefts:
            # Patterns: a late first side is accepted only under out_of_order.
            # Policies: unrestricted, every combination fires; else an event completes first, then waits.
            seconds = q_waiting if self.consuming else q_waiting + rights
            pairs = self.complete(seconds, partial(fit, p)) if self.out_of_order else []
            results += pairs
            # Policies: after a match it is not stored, except under unrestricted.
            if not pairs or not (self.consuming or for_all):
                unmatched.append(p)
        for p in unmatched:
            self.wait(node, p_waiting, p, identical_too=for_all)
        if self.out_of_order:
            # Policies: the second side of a seq is stored, too, for late first sides.
            for q in rights:
                self.wait(node, q_waiting, q)
        return results

    def _either_order(  # noqa: C901 - the cases in the order of the definition
        self, node: Both, sides: Sides, fit: Fit
    ) -> List[Match]:
        """Join the sides in either order of arrival.

        Composed sides come first, left before right, each completing or waiting; then the event itself where it
        is a side.
        """
        lefts, rights, p_waiting, q_waiting = sides
        results: List[Match] = []

        def complete_as_left(p: Match) -> bool:
            pairs = self.complete(q_waiting, lambda q: fit(p, q))
            results.extend(pairs)
            return bool(pairs)

        def complete_as_right(q: Match) -> bool:
            pairs = self.complete(p_waiting, lambda p: fit(p, q))
            results.extend(pairs)
            return bool(pairs)

        # Policies: after a match it is not stored, except under unrestricted.
        for p in lefts:
            if not p.is_last() and (not complete_as_left(p) or not self.consuming):
                self.wait(node, p_waiting, p)
        for q in rights:
            if not q.is_last() and (not complete_as_right(q) or not self.consuming):
                self.wait(node, q_waiting, q)
        # Policies: an event that fits both sides completes first (once: as the right side, else as the left one),
        # then waits. The matches of a late start are composed, and follow it.
        completed = self.completed.setdefault(node, set())
        waits: List[Match] = []

        def store_waiting() -> None:
            while waits:
                self.wait(node, q_waiting, waits.pop(0))

        for q in [q for q in rights if q.is_last()]:
            matched = complete_as_right(q)
            if matched and self.consuming and q.is_one_event():
                completed.add(q.numbers)
            if not matched or not self.consuming:
                waits.append(q)
                if not q.is_one_event():
                    store_waiting()
        for p in [p for p in lefts if p.is_last()]:
            if not p.is_one_event():
                store_waiting()
            if p.numbers in completed or not complete_as_left(p) or not self.consuming:
                self.wait(node, p_waiting, p)
        store_waiting()
        return results

    def fit(self, node: Both, p: Match, q: Match, tests: List[Test], cnot: Optional[Cnot]) -> Optional[Match]:
        """Return the join of a pair if times, shared variables, conditions and windows fit."""
        if not PAIRS[node.kind].fits(p, q):
            return None
        # Patterns: one single event is not both sides; composed sides may share events.
        if p.is_one_event() and q.is_one_event() and p.numbers == q.numbers:
            return None
        joined = self.join(p, q, *PAIRS[node.kind].interval(p, q), node)
        if joined is None or not self.in_window(joined):
            return None
        match = self.passes(joined, tests)
        if match is not None and cnot is not None:
            # Table, cnot: no matching R is entirely between the two.
            match = self.outside_gap(Gap(cnot, p.end, q.start), match)
        return match

    def store_unmatched(self, node: Both, q: Match) -> None:
        """Record a second side without a first side; used by revision."""

    # Partners and waiting matches.

    def complete(self, waiting: List[Match], fit: Callable[[Match], Optional[Match]]) -> List[Match]:
        """Return the results of a completing event under the rule's policy."""
        return self._take(waiting, fit, self.policy, is_consumed=self.consuming)

    @staticmethod
    def _take(
        waiting: List[Match], fit: Callable[[Match], Optional[Match]], policy: str, is_consumed: bool
    ) -> List[Match]:
        """Return the results of a completing event with the partners that a policy selects.

        ``waiting`` is in order of arrival, so newest and oldest refer to arrival, not to timestamps.
        """
        results: List[Any] = []
        for partner in list(reversed(waiting)) if policy.startswith("recent") else list(waiting):
            result = fit(partner)
            if result is None:
                continue  # Patterns: a rejected partner keeps its place.
            results.append(result)
            if is_consumed:
                waiting.remove(partner)
            if policy.startswith(("recent", "chronological")):
                break  # Policies: the newest or the oldest fitting partner; else all, oldest first.
        return results

    def expire(self) -> None:
        """Drop matches that can no longer complete, by the rule's clock."""
        if self.clock is None or not self.expiry:
            return
        for (node, side), waiting in self.waiting.items():
            if side != "absent":
                waiting[:] = [match for match in waiting if not self.expired(node, match)]
        for node, runs in self.runs.items():
            runs[:] = [run for run in runs if not self.expired(node, run.start)]


def instant_of(node: Instant, match: Match) -> Match:
    """Table, at_end and at_start: the interval is the instant of the end or of the start."""
    instant = match.end if node.name == "at_end" else match.start
    return replace(match, start=instant, end=instant)


def composed_first(matches: List[Match]) -> List[Match]:
    """Return new matches of one side in the order of processing: the event itself last."""
    return sorted(matches, key=Match.is_last)


class Program:
    """Rules with their state, which process events."""

    def __init__(
        self,
        rules: Sequence[Rule],
        policy: str = "recent",
        out_of_order: bool = False,
        expiry: bool = True,
        depth: int = 50,
    ) -> None:
        assert policy in POLICIES
        plain = take_out_subpatterns(list(rules))
        self.states = [RuleState(rule, policy, out_of_order, expiry) for rule in plain]
        self.depth = depth
        self.count = 0
        self.now: Any = 0

    def event(self, term: Term, start: Any, end: Any, depth: int = 0) -> List[Event]:
        """Dispatch an event: return it and all events that are derived from it, in order of dispatch.

        Depth first, the oldest rules first: events that a rule derives are processed before the next rule.
        """
        if depth > self.depth:
            raise RecursionError("rules that feed each other without end")
        # Time: deadlines up to the timestamp of an event precede the event.
        dispatched = [] if depth else self._until(end)
        self.count += 1
        event = Event(term, start, end, self.count)
        dispatched.append(event)
        for state in self.states:
            state.now = self.now
            for derived in state.derived_events(event):
                dispatched += self.event(derived.term, derived.start, derived.end, depth + 1)
        return dispatched

    def _until(self, instant: Any) -> List[Event]:
        """Process all deadlines until an instant, one after the other."""
        dispatched: List[Event] = []
        now = max(self.now, instant)
        while True:
            # Streams: in the order of the instants, then of the rules, then of their places in the rule.
            due = [
                (deadline, number, place)
                for number, state in enumerate(self.states)
                for deadline, place in state.due()
            ]
            if not due or min(due)[0] > now:
                self.now = now
                return dispatched
            self.now, number, place = min(due)
            state = self.states[number]
            state.now = self.now
            for derived in state.due_events(place, self.now):
                dispatched += self.event(derived.term, derived.start, derived.end, 1)


def run(
    rules: Sequence[Rule], stream: Iterable[Tuple[Term, Any, Any]], **options: Any
) -> List[Tuple[str, Any, Any]]:
    """Run a program over a stream and return all dispatched events: text of the term, start and end."""
    program = Program(rules, **options)
    return [
        (show(event.term), event.start, event.end)
        for term, start, end in stream
        for event in program.event(term, start, end)
    ]
