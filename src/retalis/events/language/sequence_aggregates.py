"""Aggregate functions of sequences: initial state, accumulation, and result.

An aggregate function is a fold: `AggregateKind.add` maps a state and a value to the next state, and never changes
the state in place. States are shared by partial matches that have a common prefix, so each partial match can be
extended without a copy of what was collected.
"""

from math import isfinite
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.types import NIL, Term, Values
from ..streams.accumulators import check_finite, check_ordered


class AggregateKind(NamedTuple):
    """Aggregate function.

    Attributes:
        name: name in rules.
        arity: number of arguments: 1 with a collected value, else 0.
        start: state without any value.
        initial: result without any value; None if there is none.
        add: returns the state with one more value.
        result: returns the result of a state.
        check: raises an error for a value that is not a suitable number; None if values can be any terms.
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
        """The function as it is written in rules."""
        return f"{self.name}(X)" if self.arity else self.name

    @property
    def numeric(self) -> bool:
        """True if values must be numbers."""
        return self.check is not None


def _state_result(state: Term) -> Term:
    return state


def _minimum(state: Any, value: Any) -> Any:
    return value if state is None or value < state else state


def _maximum(state: Any, value: Any) -> Any:
    return value if state is None or value > state else state


def _sum(state: Any, value: Any) -> Any:
    """Return the sum of two finite numbers.

    Raises:
        OverflowError: if it is too large for a float.
    """
    total = state + value
    # An infinite sum would stay infinite, whatever is added later, so it is reported instead.
    if total.__class__ is float and not isfinite(total):
        raise OverflowError
    return total


def _average(state: Tuple[float, int]) -> Term:
    total, count = state
    # Integers whose average is an integer stay exact, as `avg` of integers of any size.
    if total.__class__ is int and total % count == 0:
        return total // count
    return total / count


def _list_result(state: Any) -> Term:
    """Return the list of a state, which is nested pairs, newest value outermost: adding takes constant time."""
    items = []
    while state:
        state, value = state
        items.append(value)
    items.reverse()
    return make_list(items)


AGGREGATES: Dict[str, AggregateKind] = {
    kind.name: kind
    for kind in (
        AggregateKind("count", 0, 0, 0, lambda state, value: state + 1, _state_result, None),
        AggregateKind("sum", 1, 0, 0, _sum, _state_result, check_finite),
        AggregateKind("min", 1, None, None, _minimum, _state_result, check_ordered),
        AggregateKind("max", 1, None, None, _maximum, _state_result, check_ordered),
        AggregateKind(
            "avg",
            1,
            (0, 0),
            None,
            lambda state, value: (_sum(state[0], value), state[1] + 1),
            _average,
            check_finite,
        ),
        AggregateKind("list", 1, (), NIL, lambda state, value: (state, value), _list_result, None),
    )
}
"""Aggregate functions by name."""


class Collector:
    """Aggregate of one rule: the function, and the access to the value in a match.

    Args:
        kind: name of the function, in `AGGREGATES`.
        value: returns the aggregated term from the values of a match.
        evaluate: returns the number that an arithmetic expression has with the values of the match.
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
        """Return whether a value is a valid state of the aggregate; used for states that are read from a file."""
        try:
            if self.kind.check is None:
                if self.name == "count":
                    return state.__class__ is int
                # A list is stored as nested pairs, which end in the empty tuple.
                while state.__class__ is tuple and len(state) == 2:
                    state = state[0]
                return state == ()  # type: ignore[no-any-return]
            # The state of ``avg`` is the sum and the count.
            if self.start == (0, 0):
                if state.__class__ is not tuple or len(state) != 2:
                    return False
                state, count = state
                if count.__class__ is not int or count < 0:
                    return False
            if state is not self.start:
                self.kind.check(state, self.name)
        except RuleError:
            return False
        return True

    def add(self, state: Any, values: Values) -> Any:
        """Return the state with the value of one more match.

        Raises:
            RuleError: if a numeric aggregate gets a value that is not a number.
        """
        value = self._value(values)
        check = self.kind.check
        if check is not None:
            # Plain numbers are by far the most frequent values, and need no evaluation.
            if value.__class__ not in (int, float):
                value = self._evaluate(value, values)
            check(value, self.name)
        try:
            return self.kind.add(state, value)
        except OverflowError:
            raise RuleError(f"aggregate {self.name}: a number is too large") from None
