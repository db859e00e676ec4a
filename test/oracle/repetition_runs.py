"""Star_times and aggregates: runs, which a start begins and repetitions extend in place."""

from dataclasses import replace
from typing import Any, Dict, List, Optional, Set, Tuple

from retalis import Var
from retalis.prolog.terms.term_traversal import variables

from .goal_evaluator import Bindings, GoalError, instance, number, unbound, unify
from .matches import EMPTY_RESULTS, NUMERIC, RESULTS, Gap, Match, Run
from .pattern_classes import Aggregate, Pattern, Rule, Star, Within, Without, pattern_variables
from .rule_conditions import Conditions


class IdentifyingRepetitions(Conditions):
    """The runs of one rule."""

    def __init__(self, rule: Rule, policy: str, out_of_order: bool = False, expiry: bool = True) -> None:
        super().__init__(rule)
        self.out_of_order = rule.late_by(out_of_order)
        self.waiting: Dict[Tuple[Pattern, str], List[Match]] = {}
        self.policy = rule.policy_by(policy)
        self.expiry = expiry
        self.consuming = self.policy != "unrestricted"
        self.runs: Dict[Pattern, List[Run]] = {}

    def repetition(
        self, node: Any, starts: List[Match], repetitions: List[Match], conditions: List[Pattern]
    ) -> List[Match]:
        """Process new starts and repetitions of a star_times or aggregate; return the matches that fire."""
        runs = self.runs.setdefault(node, [])
        waiting = self.waiting.setdefault((node, "repeated"), [])
        results: List[Match] = []
        for q in repetitions:
            for run in reversed(runs) if self.policy.startswith("recent") else list(runs):
                fired = self._extended(node, run, q, conditions)
                if fired is None:
                    continue
                results += fired
                if self.consuming:
                    break  # Policies: the newest or the oldest fitting run; under unrestricted all.
        for p in starts:
            results += self._started(node, p, conditions, waiting)
        if self.out_of_order:
            # Policies: the second side of a seq also waits, for late first sides.
            for q in repetitions:
                self.wait(node, waiting, q)
        return results

    def _started(self, node: Any, p: Match, conditions: List[Pattern], waiting: List[Match]) -> List[Match]:
        runs = self.runs[node]
        same = [run for run in runs if run.start.variant() == p.variant()]
        if any((run.start.start, run.start.end) == (p.start, p.end) for run in same):
            return []  # Policies: a start with the same term and stamps as a running one adds none.
        if self.policy == "recent":
            # Policies: under recent a newer start with the same term replaces the older.
            runs[:] = [run for run in runs if run not in same]
        run = self.begin(node, p, conditions)
        if not (self.expiry and self.expired(node, p)):
            runs.append(run)
        # Table: zero repetitions fire at the start; count, sum and list with 0, 0 and [].
        results = self._result(node, run, conditions)
        # Patterns: seq takes a late first side under out_of_order; each Q that precedes it is a later one of
        # its run.
        for q in list(waiting):
            fired = self._extended(node, run, q, conditions)
            if fired is not None:
                results += [replace(match, along=p.is_last()) for match in fired]
                if self.consuming:
                    waiting.remove(q)
        return results

    def begin(self, node: Any, p: Match, conditions: List[Pattern]) -> Run:
        """Return a new run."""
        return Run(p, p)

    def wait(self, node: Pattern, waiting: List[Match], match: Match, identical_too: bool = False) -> None:
        """Store a match at its place."""
        if self.policy == "recent" and not identical_too:
            # Policies: under recent an arrival replaces the same term at the same place, whatever the stamps.
            variant = match.variant()
            waiting[:] = [other for other in waiting if other.variant() != variant]
        if not (self.expiry and self.expired(node, match)):
            waiting.append(match)

    def _extended(self, node: Any, run: Run, q: Match, conditions: List[Pattern]) -> Optional[List[Match]]:
        """Extend a run in place and return the match that fires, or None if the repetition does not fit."""
        # Table: a star_times starts after the last one (or the start) ended, an aggregate after the start.
        last = run.now if isinstance(node, Star) else run.start
        if not last.end < q.start:
            return None
        # Patterns: one single event is not both sides.
        start = run.start
        if start.is_one_event() and q.is_one_event() and start.numbers == q.numbers:
            return None
        # Policies: the end of a run is the largest so far.
        joined = self.join(run.now, q, run.start.start, max(run.now.end, q.end), node)
        if joined is None or not self.in_window(joined):
            return None
        fits = [
            self.test_of(condition) for condition in conditions if not self._about_result(node, condition)
        ]
        if self.passes(joined, fits) is None:
            return None
        if isinstance(node, Aggregate):
            try:
                run.values = [*run.values, self._value(node, joined)]
            except GoalError:
                return None
        # Table: a variable that occurs elsewhere in the rule has one value for the whole match, set by the
        # first repetition; any other is fresh each time.
        inside = self._only_inside(node)
        bindings = {var: instance(var, joined.bindings) for var in joined.bindings if var not in inside}
        own = {var: instance(var, joined.bindings) for var in joined.bindings if var in inside}
        renamed: Bindings = {var: Var() for var in inside}
        pending = tuple(self._of_one_repetition(item, own, renamed) for item in joined.pending)
        run.repetitions.append(q)
        run.now = replace(joined, bindings=bindings, terms=run.start.terms, pending=pending)
        return self._result(node, run, conditions)

    @staticmethod
    def _of_one_repetition(item: Any, own: Bindings, renamed: Bindings) -> Any:
        """Return the undecided tests with the values of the variables that are fresh in each repetition."""
        if isinstance(item, Gap):
            return item if item.fresh is not None else replace(item, fresh=own)
        return replace(item, goal=instance(item.goal, renamed))

    @staticmethod
    def _value(node: Aggregate, match: Match) -> Any:
        if node.value is None:
            return 1
        value = instance(node.value, match.bindings)
        return number(value, match.bindings) if node.kind in NUMERIC else value

    @staticmethod
    def _aggregated(node: Aggregate, run: Run) -> Any:
        if not run.values:
            return EMPTY_RESULTS.get(node.kind)
        if node.kind == "rate":
            # per second since the end of the start
            return len(run.values) / float(run.now.end - run.start.end)
        return RESULTS[node.kind](run.values)

    def _result(self, node: Any, run: Run, conditions: List[Pattern]) -> List[Match]:
        match = replace(run.now, allowed_gaps=())
        if not self.in_window(match):
            return []
        if isinstance(node, Aggregate):
            value = self._aggregated(node, run)
            bindings = None if value is None else unify(node.result, value, match.bindings)
            if bindings is None:
                return []
            match = replace(match, bindings=bindings)
        passed = self.passes(match, [self.test_of(condition) for condition in conditions])
        return [] if passed is None else [passed]

    @staticmethod
    def _about_result(node: Any, condition: Any) -> bool:
        """Return whether a condition uses the result of an aggregate: it then selects matches, not runs."""
        if isinstance(node, Star) or isinstance(condition, Within):
            return False
        if isinstance(condition, Without):
            return bool(unbound(node.result, {}).intersection(pattern_variables(condition.absent)))
        return bool(unbound(node.result, {}) & unbound(condition.goal, {}))

    def _only_inside(self, node: Any) -> Set[Var]:
        """Return the variables of the repeated pattern that occur nowhere else in the rule.

        The expression that an aggregate collects does not count as another occurrence.
        """
        outside = self.outside(node.repeated)
        if isinstance(node, Aggregate) and node.value is not None:
            outside = self.outside(node) | set(pattern_variables(node.first)) | set(variables(node.result))
        return set(pattern_variables(node.repeated)) - outside
