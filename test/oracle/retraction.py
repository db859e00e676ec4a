"""Retraction: ``rev(E)`` retracts every occurrence of E, and all events that were derived from it.

There are two methods:

* Under ``unrestricted`` the results depend on the events only, so the combinations are computed again without the
  retracted events: results that are missing then are retracted, new ones fire (`Recombined`).
* Under the other policies consumed partners do not return, so matches have the numbers of their events, and those
  with a retracted event are removed (`Tagged`). Star_times and aggregates always use this method.

The order of retractions is not defined: the consequences of one event are compared as a multiset.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Dict, FrozenSet, Iterable, Iterator, List, Optional, Sequence, Set, Tuple
from typing import Counter as CounterOf

from events.operator_table import EITHER_ORDER

from retalis import Term, functor
from retalis.prolog.terms.term_traversal import copy

from .combination_evaluator import Combinations, TimedMatch, has_outer_absence
from .combination_evaluator import defined_for as defined_without_state
from .evaluator import NOTHING, Fit, RuleState, Sides
from .goal_evaluator import first, instance, show
from .matches import Event, Match, Run
from .pattern_classes import (
    NEGATIONS,
    STREAMED,
    Aggregate,
    Both,
    Cnot,
    Do,
    Fnot,
    Multiply,
    Pattern,
    Rule,
    Star,
    Within,
    Without,
    strip,
    take_out_subpatterns,
    walk,
)
from .rule_conditions import Test

REV = functor("rev", 1)
Step = CounterOf[Tuple[str, Any, Any]]
Stream = Iterable[Tuple[Term, Any, Any]]


def defined_for(rules: Sequence[Rule], policy: str, out_of_order: bool) -> bool:
    """Return whether the oracle defines the revision of these rules."""
    plain = take_out_subpatterns(list(rules))
    if any(rule.after_match != "keep" and len(list(revisable_parts(rule))) > 1 for rule in plain):
        return False  # the first match that returns skips the others, and their order is not defined
    nodes = [node for rule in rules for node in walk(rule.pattern)]
    if any(isinstance(node, STREAMED) for node in nodes):
        return False  # see test_streams.py of the network
    if not any(isinstance(node, NEGATIONS) for node in nodes):
        return True
    limited = any(rule.window is not None for rule in rules) or any(isinstance(n, Within) for n in nodes)
    has_outer = any(has_outer_absence(rule) for rule in plain)
    policies = {rule.policy_by(policy) for rule in plain}
    if "unrestricted" in policies:
        return not limited and len(policies) == 1 and not has_outer and combines(rules)
    repeats = (Star, Aggregate, Do, Multiply)
    if any(isinstance(strip(node)[0], repeats) for node in nodes if isinstance(node, Without)):
        return False  # see `events/matches/test_negation.py`
    if has_outer and any(isinstance(node, repeats) for node in nodes):
        return False
    late = any(rule.late_by(out_of_order) for rule in plain)
    at_pairs = has_outer or any(isinstance(node, (Cnot, Without)) for node in nodes)
    return not limited and not (late and at_pairs)


def revisable_parts(rule: Rule) -> Iterator[Pattern]:
    """Yield the parts of a rule whose results may return when an event is retracted."""
    for node in walk(rule.pattern):
        if isinstance(node, (*NEGATIONS, Star, Aggregate)):
            yield node


def combines(rules: Sequence[Rule]) -> bool:
    """Return whether the combinations of events alone determine the results under ``unrestricted``.

    They do not if there are runs or windows, or if the retraction of an event may derive another event that forbids a
    match that has fired: such a match is not retracted.
    """
    nodes = [node for rule in rules for node in walk(rule.pattern)]
    negated = [node for node in nodes if isinstance(node, NEGATIONS) for node in walk(node.absent)]
    return not any(isinstance(node, NEGATIONS) for node in negated) and (
        defined_without_state(rules)
        and not any(isinstance(node, Within) for node in nodes)
        and (rules[0].window is None)
    )


def run_with_retraction(rules: Sequence[Rule], stream: Stream, policy: str, out_of_order: bool) -> List[Step]:
    """Return the dispatched events at each event of the stream, which is included, as multisets."""
    if len(rules) == 1 and rules[0].policy_by(policy) == "unrestricted" and combines(rules):
        return Recombined(rules[0], out_of_order).run(stream)
    return Tagged(rules, policy, out_of_order).run(stream)


class Recombined:
    """One rule under ``unrestricted``."""

    def __init__(self, rule: Rule, out_of_order: bool) -> None:
        self.rule = rule
        self.combinations = Combinations(rule, out_of_order)
        self.events: List[Event] = []
        self.fired: Dict[Any, Tuple[str, Any, Any]] = {}

    def run(self, stream: Stream) -> List[Step]:
        """Return the dispatched events at each event."""
        return [self._step(number, *item) for number, item in enumerate(stream)]

    def _step(self, number: int, term: Term, start: Any, end: Any) -> Step:
        step: Step = Counter([(show(term), start, end)])
        self.combinations.now = number
        if term.__class__ is tuple and term[0] is REV:
            retracted = show(term[1])
            self.events = [event for event in self.events if show(event.term) != retracted]
        else:
            self.events.append(Event(term, start, end, number))
        before, self.fired = self.fired, self._matches_by_combination()
        for key, (text, _, _) in before.items():
            if key not in self.fired:
                step[f"rev({text})", start, end] += 1
        for key, fired in self.fired.items():
            if key not in before:
                step[fired] += 1
        return step

    def _matches_by_combination(self) -> Dict[Any, Tuple[str, Any, Any]]:
        """Return the results of all events that were not retracted, by their combination."""
        matches: List[TimedMatch] = self.combinations.stored_matches(
            self.combinations.tests.pattern, self.events
        )
        holding: Dict[Any, Any] = {}
        for match, _, _ in matches:
            bindings = match.bindings if self.rule.do is None else first(self.rule.do, match.bindings)
            if bindings is not None:
                key: Any = (match.variant(), tuple(sorted(match.numbers)))
                while key in holding:  # the same solution of an event_multiply twice
                    key = (key,)
                holding[key] = show(copy(instance(self.rule.head, bindings))), match.start, match.end
        return holding


@dataclass(eq=False)
class ProcessedMatch:
    """A second side or a repetition that was not stored, and the events of all matches that it has completed."""

    match: Match
    completed_numbers: List[FrozenSet[int]] = field(default_factory=list)


class RevisedState(RuleState):
    """State of a rule that can remove events, and evaluates again the matches that they suppressed."""

    def __init__(self, rule: Rule, policy: str, out_of_order: bool) -> None:
        super().__init__(rule, policy, out_of_order)
        self.suppressed: Dict[Pattern, List[Match]] = {}
        self.all_runs: List[Tuple[Any, Run, List[Pattern]]] = []
        self.again: Dict[Pattern, List[Match]] = {}
        self.passed: Dict[Pattern, List[ProcessedMatch]] = {}
        """Second sides and repetitions that were not stored, in the order of arrival."""
        self.retracted: Set[int] = set()
        self.reviving = False
        self.limited_by_overlaps = {strip(node)[0] for node in self.place if isinstance(node, Without)}
        self.has_outer_absence = has_outer_absence(rule)

    def forget(self, numbers: FrozenSet[int]) -> None:
        """Remove the partial matches that hold one of these events."""
        self.retracted |= numbers
        for passed in self.passed.values():
            passed[:] = [record for record in passed if not record.match.numbers & numbers]
        for waiting in [*self.waiting.values(), *self.suppressed.values()]:
            waiting[:] = [match for match in waiting if not match.numbers & numbers]
        for runs in self.runs.values():
            runs[:] = [run for run in runs if not run.start.numbers & numbers]
        self.all_runs = [record for record in self.all_runs if not record[1].start.numbers & numbers]
        for node, run, conditions in self.all_runs:
            if any(q.numbers & numbers for q in run.repetitions):
                self.again.setdefault(node, []).extend(self._replay_run(node, run, conditions, numbers))

    def _replay_run(
        self, node: Pattern, run: Run, conditions: List[Pattern], numbers: FrozenSet[int]
    ) -> List[Match]:
        """Extend a run again without the retracted events; return the results that contain such an event."""
        repetitions, run.repetitions = run.repetitions, []
        run.now, run.values = run.start, []
        results: List[Match] = []
        is_changed = False
        for q in repetitions:
            if q.numbers & numbers:
                is_changed = True
                continue
            fired = self._extended(node, run, q, conditions)
            if is_changed and fired is not None:
                results += fired
        return results

    def begin(self, node: Any, p: Match, conditions: List[Pattern]) -> Run:
        """Begin a run and store it, even after it has been replaced."""
        run = super().begin(node, p, conditions)
        self.all_runs.append((node, run, conditions))
        return run

    def repetition(
        self, node: Any, starts: List[Match], repetitions: List[Match], conditions: List[Pattern]
    ) -> List[Match]:
        """Extend `RuleState` by the results of runs without the retracted events, which come first."""
        again = self.again.pop(node, []) if self.reviving else []
        passed = self.passed.setdefault(node, [])
        if not self.out_of_order:
            passed += [ProcessedMatch(q) for q in repetitions]
        return again + super().repetition(node, starts, repetitions, conditions)

    def _extended(self, node: Any, run: Run, q: Match, conditions: List[Pattern]) -> Optional[List[Match]]:
        """Process matches in the order of arrival, including those that a revision has released."""
        if self.reviving and not self.precedes(run.start, q):
            return None
        fired = super()._extended(node, run, q, conditions)
        if fired is not None:
            for record in self.passed.get(node, []):
                if record.match is q:
                    record.completed_numbers.append(run.start.numbers)
        return fired

    def _started(self, node: Any, p: Match, conditions: List[Pattern], waiting: List[Match]) -> List[Match]:
        """Extend `RuleState`: a start that revision has released takes later repetitions."""
        if self.reviving and not self.out_of_order:
            waiting = [record.match for record in self.passed[node] if self.is_available(p, record)]
        return super()._started(node, p, conditions, waiting)

    def precedes(self, p: Match, q: Match) -> bool:
        """Return whether a first side arrived before a second one, if the order of arrival matters."""
        return self.out_of_order or max(p.numbers) < max(q.numbers)

    def is_available(self, p: Match, passed: ProcessedMatch, always: bool = False) -> bool:
        """Return whether a processed match fits a released first side: it arrived later, and is not consumed.

        It is not consumed if all matches that it has completed were retracted, or if it ``always`` takes all first
        sides.
        """
        is_consumed = (
            self.consuming
            and not always
            and any(not numbers & self.retracted for numbers in passed.completed_numbers)
        )
        return self.precedes(p, passed.match) and not is_consumed

    def expire(self) -> None:
        """Extend `RuleState`: processed matches expire like stored ones."""
        super().expire()
        if self.clock is not None:
            for node, passed in self.passed.items():
                passed[:] = [record for record in passed if not self.expired(node, record.match)]

    def skip(self) -> None:
        """Extend `RuleState`: recorded matches that a fired match skips are deleted, too."""
        super().skip()
        for node, passed in self.passed.items():
            if node not in self.below_absent:
                passed[:] = [record for record in passed if not self.skipping.skips(record.match)]

    def revive(self) -> List[List[Match]]:
        """Return the matches that retracted events suppressed and that fire now."""
        self.skipping.begin_event()
        for node in [*self.suppressed, *self.again]:
            # After match: a skipped match does not return.
            if node not in self.below_absent:
                for released in (self.suppressed.get(node, []), self.again.get(node, [])):
                    released[:] = [match for match in released if not self.skipping.is_past(match)]
        self.reviving = True
        matches = self.whole(self.pattern, NOTHING)
        self.reviving = False
        return matches

    def single(self, node: Pattern, event: Event) -> List[Match]:
        """Extend `RuleState`: matches that P cnot R and P fnot R reject are recorded, to be evaluated again."""
        if not isinstance(node, (Cnot, Fnot)):
            return super().single(node, event)
        self._absent(node, event)
        suppressed = self.suppressed.setdefault(node, [])
        candidates = self.arrive(node.pattern, event)
        if self.reviving:
            candidates = suppressed + candidates
            suppressed[:] = []
        results: List[Match] = []
        for match in candidates:
            is_forbidden = any(self.forbidden(gap, match.bindings) for gap in match.allowed_gaps)
            allowed = None if is_forbidden else self.allowed(node, match)
            if allowed is None:
                suppressed.append(match)
            else:
                results.append(allowed)
        return results

    def filter_conditions(
        self, node: Pattern, conditions: List[Pattern], matches: List[Match]
    ) -> List[Match]:
        """Extend `RuleState`: matches that a without rejects are recorded, to be evaluated again."""
        absence = next((condition for condition in conditions if isinstance(condition, Without)), None)
        if absence is None:
            return super().filter_conditions(node, conditions, matches)
        suppressed = self.suppressed.setdefault(absence, [])
        if self.reviving:
            matches = suppressed + matches
            suppressed[:] = []
        results: List[Match] = []
        for match in matches:
            is_forbidden = any(self.forbidden(gap, match.bindings) for gap in match.allowed_gaps)
            passed = [] if is_forbidden else super().filter_conditions(node, conditions, [match])
            results += passed
            suppressed += [] if passed else [match]
        return results

    def _in_order(self, node: Both, sides: Sides, fit: Fit) -> List[Match]:
        """Extend `RuleState`: the partners of a released side are those that it could have had."""
        if self.out_of_order:
            return super()._in_order(node, sides, fit)
        passed = self.passed.setdefault(node, [])

        def in_order(p: Match, q: Match) -> Optional[Match]:
            return fit(p, q) if not self.reviving or self.precedes(p, q) else None

        results: List[Match] = []

        def second(q: Match) -> None:
            matches = super(RevisedState, self)._in_order(
                node, sides._replace(lefts=[], rights=[q]), in_order
            )
            passed.append(ProcessedMatch(q, [match.numbers for match in matches]))
            results.extend(matches)
            if matches and node.kind == "forall_seq":
                # A second side takes all first ones, so it is evaluated again with those that it did not take.
                self.store_unmatched(node, q)

        def first(p: Match) -> None:
            matches = self._later(node, p, passed, fit) if self.reviving else []
            results.extend(matches)
            if not matches or not (self.consuming or node.kind == "forall_seq"):
                super(RevisedState, self)._in_order(node, sides._replace(lefts=[p], rights=[]), fit)

        arrivals = [*((q, second) for q in sides.rights), *((p, first) for p in sides.lefts)]
        if self.reviving:  # in the order of arrival
            arrivals.sort(key=lambda arrival: max(arrival[0].numbers))
        for match, process in arrivals:
            process(match)
        return results

    def _later(self, node: Both, p: Match, passed: List[ProcessedMatch], fit: Fit) -> List[Match]:
        """Return the matches of a released first side with second sides that arrived after it.

        It takes the first one that was not consumed; under unrestricted all.
        """
        for_all = node.kind == "forall_seq"
        matches: List[Any] = []
        for record in passed:
            match = fit(p, record.match) if self.is_available(p, record, for_all) else None
            if match is not None:
                matches.append(match)
                record.completed_numbers.append(match.numbers)
                unmatched = self.suppressed.get(node, [])
                if not for_all:
                    unmatched[:] = [q for q in unmatched if q is not record.match]
                if self.consuming or for_all:
                    break
        return matches

    def store_unmatched(self, node: Both, q: Match) -> None:
        """Record a second side of a seq without a first side."""
        self.suppressed.setdefault(node, []).append(q)

    def two_sided(self, node: Both, event: Event, tests: List[Test], cnot: Optional[Cnot]) -> List[Match]:
        """Extend `RuleState`: pairs that an absence may have rejected are evaluated again."""
        again: List[Match] = []
        has_absence = cnot is not None or node in self.limited_by_overlaps or self.has_outer_absence
        if self.reviving and node.kind in EITHER_ORDER and has_absence:
            again = self._released_pairs(node, lambda p, q: self.fit(node, p, q, tests, cnot))
        elif self.reviving and has_absence:
            unmatched = self.suppressed.setdefault(node, [])
            for q in list(unmatched):

                def fit(p: Match, q: Match = q) -> Optional[Match]:
                    is_in_order = max(p.numbers) < max(q.numbers)
                    return self.fit(node, p, q, tests, cnot) if is_in_order else None

                for_all = node.kind == "forall_seq"
                policy, is_consumed = ("all", True) if for_all else (self.policy, self.consuming)
                matches = self._take(self.waiting[node, "left"], fit, policy, is_consumed=is_consumed)
                again += matches
                if matches:
                    if not for_all:
                        unmatched.remove(q)
                    for record in self.passed.get(node, []):
                        if record.match is q:
                            record.completed_numbers += [match.numbers for match in matches]
        return again + super().two_sided(node, event, tests, cnot)

    def _released_pairs(self, node: Both, fit: Fit) -> List[Match]:
        """Return the pairs of stored sides in either order that fit now; the later side completes each pair."""
        lefts, rights = (self.waiting.setdefault((node, side), []) for side in ("left", "right"))
        self.completed.setdefault(node, set())
        results: List[Match] = []
        # An event that fits both sides completes first as the right side.
        arrivals = [
            *((max(q.numbers), False, q) for q in rights),
            *((max(p.numbers), True, p) for p in lefts),
        ]
        for number, is_left, match in sorted(arrivals, key=lambda arrival: arrival[:2]):
            own, partners = (lefts, rights) if is_left else (rights, lefts)
            # An event that has completed as the right side waits as the left one, without partners that came before.
            if match not in own or (is_left and match.numbers in self.completed[node]):
                continue

            def fit_earlier(
                partner: Match, match: Match = match, is_left: bool = is_left, number: int = number
            ) -> Optional[Match]:
                if max(partner.numbers) > number:
                    return None
                return fit(match, partner) if is_left else fit(partner, match)

            pairs = self.complete(partners, fit_earlier)
            results += pairs
            if pairs and self.consuming:
                own.remove(match)
        return results


class Tagged:
    """Rules under a policy that consumes partners."""

    def __init__(self, rules: Sequence[Rule], policy: str, out_of_order: bool) -> None:
        self.states = [RevisedState(rule, policy, out_of_order) for rule in take_out_subpatterns(list(rules))]
        self.alive: Dict[int, Tuple[Event, FrozenSet[int]]] = {}
        self.count = 0

    def run(self, stream: Stream) -> List[Step]:
        """Return the dispatched events at each event."""
        steps: List[Any] = []
        for term, start, end in stream:
            step: Step = Counter()
            if term.__class__ is tuple and term[0] is REV:
                step[show(term), start, end] += 1
                self._retract(show(term[1]), start, end, step)
            else:
                self._dispatch(Event(term, start, end), frozenset(), step)
            steps.append(step)
        return steps

    def _dispatch(self, event: Event, origin: FrozenSet[int], step: Step) -> None:
        self.count += 1
        event = event._replace(number=self.count)
        self.alive[event.number] = (event, origin)
        step[show(event.term), event.start, event.end] += 1
        for state in self.states:
            state.begin_event(event)
            self._fire(state, state.whole(state.pattern, event), step)

    def _fire(self, state: RevisedState, whole: List[List[Match]], step: Step) -> None:
        fired = [result for matches in whole for result in state.fire(matches)]
        state.skip()
        for match, result in fired:
            self._dispatch(result, match.numbers, step)

    def _retract(self, text: str, start: Any, end: Any, step: Step) -> None:
        """Retract all occurrences of an event and everything derived from them, each once."""
        retracted: Set[int] = {n for n, (event, _) in self.alive.items() if show(event.term) == text}
        external = set(retracted)
        for number, (_, origin) in sorted(self.alive.items()):
            if origin & retracted:
                retracted.add(number)
        for number in sorted(retracted):
            event, _ = self.alive.pop(number)
            if number not in external:
                step[f"rev({show(event.term)})", start, end] += 1
        for state in self.states:
            state.forget(frozenset(retracted))
        for state in self.states:
            self._fire(state, state.revive(), step)
