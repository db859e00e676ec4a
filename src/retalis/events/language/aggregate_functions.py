"""What aggregates collect: how they begin, what a further value does, and what they show."""

from math import isfinite
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.types import NIL, Term, Values
from ..streams.accumulators import check_finite, check_ordered


class AggregateKind(NamedTuple):
    """A kind of aggregate.

    Attributes:
        name: how rules spell it.
        arity: how many arguments it takes: what is collected, or none.
        start: the state without any value.
        initial: the result without any value; None where there is none.
        add: gives the state with one more value.
        result: gives the result of a state.
        check: refuses the values that are not numbers of the right kind; None where values may be any terms.
    """

    name: str
    arity: int
    start: Any
    initial: Optional[Term]
    add: Callable[[Any, Term], Any]
    result: Callable[[Any], Term]
    check: Optional[Callable[[Any, str], None]]

    @property
    def form(self) -> str:
        """How it is written."""
        return f"{self.name}(X)" if self.arity else self.name

    @property
    def numeric(self) -> bool:
        """True if values have to be numbers."""
        return self.check is not None


def _same(state: Term) -> Term:
    return state


def _least(state: Any, value: Any) -> Any:
    return value if state is None or value < state else state


def _greatest(state: Any, value: Any) -> Any:
    return value if state is None or value > state else state


def _sum(state: Any, value: Any) -> Any:
    """Return the sum of two finite numbers.

    Raises:
        OverflowError: if it is too large for a float.
    """
    total = state + value
    if total.__class__ is float and not isfinite(total):
        raise OverflowError
    return total


def _average(state: Tuple[float, int]) -> Term:
    total, number = state
    if total.__class__ is int and total % number == 0:
        return total // number
    return total / number


def _listed(state: Any) -> Term:
    """Return the list of a state, which is a chain with the newest value outermost: adding one costs the same."""
    items = []
    while state:
        state, value = state
        items.append(value)
    items.reverse()
    return make_list(items)


AGGREGATES: Dict[str, AggregateKind] = {
    kind.name: kind
    for kind in (
        AggregateKind("count", 0, 0, 0, lambda state, value: state + 1, _same, None),
        AggregateKind("sum", 1, 0, 0, _sum, _same, check_finite),
        AggregateKind("min", 1, None, None, _least, _same, check_ordered),
        AggregateKind("max", 1, None, None, _greatest, _same, check_ordered),
        AggregateKind(
            "avg",
            1,
            (0, 0),
            None,
            lambda state, value: (_sum(state[0], value), state[1] + 1),
            _average,
            check_finite,
        ),
        AggregateKind("list", 1, (), NIL, lambda state, value: (state, value), _listed, None),
    )
}
"""By their names."""


class Collector:
    """An aggregate of one rule: a kind, and how to get the value from a match.

    Args:
        kind: one of `AGGREGATES`.
        value: gives the value from the values of a match.
        evaluate: gives the number of a value that is an expression, from the values of the match.
    """

    def __init__(self, kind: str, value: Callable[[Values], Term], evaluate: Callable[[Term, Values], Term]):
        self.kind = AGGREGATES[kind]
        self.name = kind
        self.start = self.kind.start
        self.initial = self.kind.initial
        self.result = self.kind.result
        self._value = value
        self._evaluate = evaluate

    def is_state(self, state: Any) -> bool:
        """Tell whether a value is what the aggregate may have collected."""
        try:
            if self.kind.check is None:
                if self.name == "count":
                    return state.__class__ is int
                while state.__class__ is tuple and len(state) == 2:
                    state = state[0]
                return state == ()  # type: ignore[no-any-return]
            if self.start == (0, 0):
                if state.__class__ is not tuple or len(state) != 2:
                    return False
                state, number = state
                if number.__class__ is not int or number < 0:
                    return False
            if state is not self.start:
                self.kind.check(state, self.name)
        except RuleError:
            return False
        return True

    def add(self, state: Any, values: Values) -> Any:
        """Return the state with the value of one more match.

        Raises:
            RuleError: where it needs a number and gets none.
        """
        value = self._value(values)
        check = self.kind.check
        if check is not None:
            if value.__class__ not in (int, float):
                value = self._evaluate(value, values)
            check(value, self.name)
        try:
            return self.kind.add(state, value)
        except OverflowError:
            raise RuleError(f"aggregate {self.name}: a number is too large") from None
