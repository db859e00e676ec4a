"""Repetitions and aggregates: a first match starts a run, and later matches extend it in place."""

from typing import Any, List, Optional, Sequence, Tuple

from ..errors import RuleError
from ..terms import Term, Var, resolve, undo, unify, variables
from .aggregates import Collector
from .building import compile_builder
from .conditions import Test
from .matches import Found, Held, Match, Place, identity, unify_sides
from .nodes import Node
from .policy import Emit, Frame, Mode, emit_each

Values = Tuple[Term, ...]


class Run(Match):
    """A first match with what extended it.

    Attributes:
        last: the largest end so far.
        fixed: the values, set by the first repetition, of variables that stand elsewhere in the rule; or None.
        state: what an aggregate has collected.
        taken: the matches that extended it, where they are tracked.
        steps: the values of each of them.
    """

    __slots__ = ("last", "fixed", "state", "taken", "steps", "first")

    def __init__(self, first: Match):
        super().__init__(first.values, first.start, first.end, first.event, None, (first,))
        self.first = first
        self.last = first.end
        self.fixed: Optional[Values] = None
        self.state: Any = None
        self.taken: List[Match] = []
        self.steps: List[Values] = []


class Running(Node):
    """``P seq (Q star_times)`` and ``P seq aggregate(K, Q, R)``.

    Args:
        rule: the rule it belongs to.
        first: the node of P.
        repeated: the node of Q.

    Attributes:
        step_vars: the variables that a repetition's own conditions know, and what they find.
        fixed: those of them that have one value in a run, since they stand elsewhere in the rule.
    """

    def __init__(self, rule: Any, first: Node, repeated: Node):
        self.rule = rule
        self.first = first
        self.repeated = repeated
        shared = [var for var in first.vars if var in repeated.vars]
        self.pairs = tuple((first.vars.index(var), repeated.vars.index(var)) for var in shared)
        self.place = Place(rule, tuple(one for one, _ in self.pairs))
        self.incoming = Place(rule, tuple(two for _, two in self.pairs))
        self.span: Optional[int] = None
        self.result_new: List[Var] = []
        self.tests: List[Test] = []
        self.late_tests: List[Test] = []
        self.step_tests: List[Test] = []
        self.carried: List[Tuple[Any, Node]] = []
        self.step_vars = [*first.vars, *(var for var in repeated.vars if var not in first.vars)]
        self._step_at = [at for at, var in enumerate(repeated.vars) if var not in first.vars]

    def finish(self, outside: Any, collector: Optional[Collector], result: Term) -> None:
        """Say what the run gives on, when all conditions on repetitions are known.

        Args:
            outside: the variables that stand elsewhere in the rule.
            collector: what an aggregate does; None for ``star_times``.
            result: the term of an aggregate's result.
        """
        own = self.first.vars
        self.collector = collector
        self.fixed = [var for var in self.step_vars if var in outside and var not in own]
        self.fixed_at = [self.step_vars.index(var) for var in self.fixed]
        known = [*own, *self.fixed]
        if collector is not None:
            self.result_is_open = result.__class__ is Var and result not in known
            self.result_new = [var for var in variables(result) if var not in known]
            self._result_at = len(known)
            known += self.result_new
            self.make_result = compile_builder(result, known, f"result in {self.rule.name}")
        self.vars = known

    def test(self, test: Test, names: Sequence[Var], late: bool) -> None:
        """Add a condition; ``names`` are the variables it leaves.

        One that looks at an aggregate's result (``late``) decides what fires; any other is part of the match.
        """
        (self.late_tests if late else self.tests).append(test)
        self.vars = list(names)

    def places(self) -> Sequence[Place]:
        """Return where matches wait."""
        return (self.place, *(absence.place for absence, _ in self.carried))

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the bounds; see `Node.set_span`."""
        self.span = span
        self.place.span = limit

    def bind(self, out: Emit, mode: Mode) -> None:
        """Connect the node; see `Node.bind`."""
        policy = mode.policy
        self.tracked = mode.tracked
        self.place.identify(_by_term if policy.replacing else _by_occurrence)
        self.out = out
        if policy.consuming:
            self.repeated.bind(self._extend_one(out, policy.newest), mode)
        else:
            self.repeated.bind(self._extend_all(out), mode)
        self.first.bind(self._start(out), mode)
        for absence, negated in self.carried:
            negated.bind(absence.arrive, mode)

    def _start(self, out: Emit) -> Emit:
        place = self.place
        collector = self.collector

        def arrive(match: Match, after: Frame) -> Frame:
            run = Run(match)
            older: Any = place.same.get(place.name(run))  # type: ignore[union-attr, misc]
            if older is not None and older.start == run.start and older.first.end == run.end:
                return after
            if collector is not None:
                run.state = collector.start
            place.add(run, place.key_of(run))
            span = self.span
            if collector is not None and collector.initial is None:
                return after
            if span is not None and match.end - match.start > span:
                return after
            values = self._fit(run.values, None, run.start, run.end)
            result = None if values is None else self.result_of(run, values)
            return after if result is None else out(result, after)

        return arrive

    def _extend_one(self, out: Emit, newest: bool) -> Emit:
        def arrive(match: Match, after: Frame) -> Frame:
            key = self.incoming.key_of(match)
            runs = self.place.candidates(key)
            if newest:
                runs.reverse()
            for run in runs:
                extended, result = self.extend(run, match, key)
                if extended:
                    return after if result is None else out(result, after)
            return after

        return arrive

    def _extend_all(self, out: Emit) -> Emit:
        def arrive(match: Match, after: Frame) -> Frame:
            key = self.incoming.key_of(match)
            runs = self.place.candidates(key)
            if not runs:
                return after
            results = (
                result
                for run in runs
                if run.bucket is not None
                for result in (self.extend(run, match, key)[1],)
                if result is not None
            )
            return emit_each(results, out, after)

        return arrive

    def extend(self, run: Any, match: Match, key: Any) -> Tuple[bool, Optional[Match]]:
        """Extend a run if the match fits; returns whether it did, and the result to emit."""
        if match.start <= (run.last if self.collector is None else run.end):
            return False, None
        last = run.last if run.last >= match.end else match.end
        span = self.span
        if span is not None and last - run.start > span:
            return False, None
        values: Any = run.values
        if key is None or run.bucket.key is None:
            sides = unify_sides(run, match, self.pairs)
            if sides is None:
                return False, None
            values, match = sides[0].values, sides[1]
        step: Any = values + tuple([match.values[at] for at in self._step_at])
        for test in self.step_tests:
            step = test(step, match.start, match.end)
            if step is None:
                return False, None
        fixed = tuple([step[at] for at in self.fixed_at])
        if run.fixed is not None:
            agreed = _agreed(run.fixed, fixed)
            if agreed is None:
                return False, None
            fixed = agreed
        found = self._fit(values, fixed, run.start, last)
        if found is None:
            return False, None
        if self.collector is not None:
            try:
                run.state = self.collector.add(run.state, step)
            except RuleError as error:
                self.rule.network.rule_failed(self.rule, error)
                return False, None
        run.last = last
        run.fixed = fixed
        run.values = values
        if self.tracked:
            run.taken.append(match)
            run.steps.append(step)
            self.rule.network.tracker.hold_repetition(run, match, self)
        return True, self.result_of(run, found)

    def take_back(self, run: Any, match: Match) -> Optional[Run]:
        """Take a repetition out of a run; return the run where its result is to be fired anew."""
        if run.bucket is None or match not in run.taken:
            return None
        last = run.taken[-1] is match
        at = run.taken.index(match)
        del run.taken[at], run.steps[at]
        collector = self.collector
        run.last = run.end
        run.state = None if collector is None else collector.start
        run.values = run.first.values
        run.fixed = None
        for one, step in zip(run.taken, run.steps):
            run.last = max(run.last, one.end)
            run.fixed = tuple([step[at] for at in self.fixed_at])
            if collector is not None:
                run.state = collector.add(run.state, step)
        return None if last or not run.taken else run  # type: ignore[no-any-return]

    def retry(self, run: Any, after: Frame) -> Frame:
        """Fire the result of a run as it is after something was taken back."""
        if run.bucket is None:
            return after
        values = self._fit(run.values, run.fixed, run.start, run.last)
        result = None if values is None else self.result_of(run, values)
        return after if result is None else self.out(result, after)

    def _fit(self, first: Values, fixed: Optional[Values], start: int, end: int) -> Optional[Values]:
        """Return the values of a run with those of its conditions, the result still open; None where one fails."""
        values: Any = first
        if self.fixed:
            values += tuple([Var() for _ in self.fixed]) if fixed is None else fixed
        if self.result_new:
            values += tuple([Var() for _ in self.result_new])
        for test in self.tests:
            values = test(values, start, end)
            if values is None:
                return None
        return values  # type: ignore[no-any-return]

    def result_of(self, run: Any, values: Values) -> Optional[Match]:
        """Return the result of a run as it stands, or None where it is not to fire."""
        found: Any = values
        start, end = run.start, run.last
        collector = self.collector
        if collector is not None:
            found = self._with_result(found, collector.result(run.state))
            for test in self.late_tests:
                if found is None:
                    return None
                found = test(found, start, end)
            if found is None:
                return None
        own = Found(found[len(run.values) :])
        # Without what is held the start would look like a condition around a match.
        held = (Held(tuple(run.taken)),)
        event = run.event if run.fixed is None else None
        return Match(found, start, end, event, None, (run.first, *held, own))

    def _with_result(self, values: Values, value: Term) -> Optional[Values]:
        """Put the result where its variables stand among the values."""
        if self.result_is_open:
            at = self._result_at
            return (*values[:at], value, *values[at + 1 :])
        return self._unify_result(values, value)

    def _unify_result(self, values: Values, value: Term) -> Optional[Values]:
        term = self.make_result(values)
        trail: List[Any] = []
        result = None
        if unify(term, value, trail):
            result = tuple([resolve(one) for one in values])
        undo(trail, 0)
        return result


def _by_term(run: Match) -> Any:
    return identity(run.first)  # type: ignore[attr-defined]


def _by_occurrence(run: Match) -> Any:
    first = run.first  # type: ignore[attr-defined]
    return (identity(first), int(first.start), int(first.end))


def _agreed(left: Values, right: Values) -> Optional[Values]:
    """Unify values pairwise; return them, or None where they differ."""
    trail: List[Any] = []
    result = None
    if all(unify(one, other, trail) for one, other in zip(left, right)):
        result = tuple([resolve(one) for one in left])
    undo(trail, 0)
    return result
