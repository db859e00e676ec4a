"""The values of a run of repetitions: where each of them stands, and what result they make."""

from typing import AbstractSet, Any, Callable, List, Optional, Sequence, Tuple

from ...prolog.terms import Term, Trail, Values, Var, positions, resolve, undo, unify, variables
from ..dispatch import compile_builder
from ..language import Collector
from ..matches import NO_ITEMS, Found, Match, Run
from .conditions import Test
from .deferred import Items
from .nodes import NetworkNode


class RunValues(NetworkNode):
    """What a node of runs knows of their values.

    Args:
        first: the node of what starts a run.
        repeated: the node of what extends it.

    Attributes:
        step_vars: the variables that a repetition's own conditions know, and what they find.
        fixed: those of them that have one value in a run, since they stand elsewhere in the rule.
    """

    _found: Callable[[Values], Values]
    """Takes the values that are found here and not carried on."""

    def __init__(self, first: NetworkNode, repeated: NetworkNode):
        self.first = first
        self.repeated = repeated
        self.span: Optional[int] = None
        self.result_new: List[Var] = []
        self._captures = 0
        self.tests: List[Test] = []
        self.late_tests: List[Test] = []
        own = set(first.vars)
        self.step_vars = [*first.vars, *(var for var in repeated.vars if var not in own)]
        self.open_vars: List[Var] = []

    def open(self, names: Sequence[Var]) -> None:
        """Have variables that no repetition gives a value, and that stand elsewhere, be the same in all."""
        here = set(self.step_vars)
        self.open_vars = [var for var in names if var not in here]
        self.step_vars = [*self.step_vars, *self.open_vars]

    def finish(
        self,
        outside: AbstractSet[Var],
        collector: Optional[Collector],
        result: Optional[Term],
        items: Optional[Items],
    ) -> None:
        """Say what the run gives on, when all conditions on repetitions are known.

        Args:
            outside: the variables that stand elsewhere in the rule.
            collector: what an aggregate does; None for ``star_times``.
            result: the term of an aggregate's result.
            items: where conditions on each repetition are tested further up, what they get.
        """
        own = self.first.vars
        of_first = set(own)
        of_step = positions(self.step_vars)
        self.collector = collector
        self.empty = None if collector is None else collector.start
        self.fixed = [var for var in self.step_vars if var in outside and var not in of_first]
        self.fixed_at = [of_step[var] for var in self.fixed]
        self.items = items
        self._same_at = len(own)
        known = [*own, *self.fixed]
        if items is not None:
            given = set(known)
            items.names = [var for var in self.step_vars if var not in given]
            self._items_at = [of_step[var] for var in items.names]
            known.insert(self._same_at, items.var)
            self._same_at += 1
        places = positions(known)
        self._open_at = [places[var] for var in self.open_vars]
        if collector is not None and result is not None:
            self.result_is_open = result.__class__ is Var and result not in places
            self.result_new = [var for var in variables(result) if var not in places]
            self._result_at = len(known)
            known += self.result_new
            self.make_result = compile_builder(result, known, "result of an aggregate")
        self.vars = known

    def capture(self, start: Var, end: Var) -> None:
        """Add the interval to the values, for a condition that may have to be tested further up too."""
        self.vars = [*self.vars, start, end]
        self._captures += 1

    def test(self, test: Test, names: Sequence[Var], late: bool) -> None:
        """Add a condition; ``names`` are the variables it leaves.

        One that looks at an aggregate's result (``late``) decides what fires; any other is part of the match.
        """
        (self.late_tests if late else self.tests).append(test)
        self.vars = list(names)

    def _result_without(self, run: Run) -> Optional[Match]:
        """Return the result of a run that has no repetitions yet."""
        span = self.span
        if span is not None and run.end - run.start > span:
            return None
        values = self._fit(run.values, NO_ITEMS, None, run.start, run.end)
        return None if values is None else self.result_of(run, values)

    def _fit(
        self, first: Values, items: Term, fixed: Optional[Values], start: int, end: int
    ) -> Optional[Values]:
        """Return the values of a run with those of its conditions, the result still open; None where one fails."""
        values: Any = first
        if self.items is not None:
            values += (items,)
        if self.fixed:
            values += tuple([Var() for _ in self.fixed]) if fixed is None else fixed
        if self.result_new:
            values += tuple([Var() for _ in self.result_new])
        if self._captures:
            values += (start, end) * self._captures
        for test in self.tests:
            values = test(values, start, end)
            if values is None:
                return None
        return values  # type: ignore[no-any-return]

    def result_of(self, run: Run, values: Values) -> Optional[Match]:
        """Return the result of a run as it stands, or None where it is not to fire."""
        found: Any = values
        start, end = run.start, run.last
        collector = self.collector
        if collector is not None:
            value = collector.result(run.state)
            if self.open_vars:
                found, value = self._with_open(run, found, value)
            found = self._with_result(found, value)
            for test in self.late_tests:
                if found is None:
                    return None
                found = test(found, start, end)
            if found is None:
                return None
        own = Found(self._found(found))
        event = run.event if run.fixed is None else None
        # Without what is held the start would look like a condition around a match.
        return Match(found, start, end, event, None, (run.first, run.held, own))

    def _with_open(self, run: Run, values: Values, value: Term) -> Tuple[Values, Term]:
        """Have a result say what conditions have made of the variables that no repetition gives a value."""
        trail: Trail = []
        for var, at in zip(run.open, self._open_at):
            unify(var, values[at], trail)
        found = tuple([resolve(one) for one in values]), resolve(value)
        undo(trail, 0)
        return found

    def _with_result(self, values: Values, value: Term) -> Optional[Values]:
        """Put the result where its variables stand among the values."""
        if self.result_is_open:
            at = self._result_at
            return (*values[:at], value, *values[at + 1 :])
        return self._unify_result(values, value)

    def _unify_result(self, values: Values, value: Term) -> Optional[Values]:
        term = self.make_result(values)
        trail: Trail = []
        result = None
        if unify(term, value, trail):
            result = tuple([resolve(one) for one in values])
        undo(trail, 0)
        return result
