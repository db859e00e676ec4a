"""What aggregates collect: how they begin, what a further value does, and what they show."""

from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from ...foundation import RuleError
from ...prolog.terms import NIL, Term, Values, make_list


class AggregateKind(NamedTuple):
    """A kind of aggregate.

    Attributes:
        name: how rules spell it.
        arity: how many arguments it takes: what is collected, or none.
        start: the state without any value.
        initial: the result without any value; None where there is none.
        add: gives the state with one more value.
        result: gives the result of a state.
        numeric: whether values have to be numbers.
    """

    name: str
    arity: int
    start: Any
    initial: Optional[Term]
    add: Callable[[Any, Term], Any]
    result: Callable[[Any], Term]
    numeric: bool

    @property
    def form(self) -> str:
        """How it is written."""
        return f"{self.name}(X)" if self.arity else self.name


def _same(state: Term) -> Term:
    return state


def _least(state: Any, value: Any) -> Any:
    return value if state is None or value < state else state


def _greatest(state: Any, value: Any) -> Any:
    return value if state is None or value > state else state


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
        AggregateKind("count", 0, 0, 0, lambda state, value: state + 1, _same, False),
        AggregateKind("sum", 1, 0, 0, lambda state, value: state + value, _same, True),
        AggregateKind("min", 1, None, None, _least, _same, True),
        AggregateKind("max", 1, None, None, _greatest, _same, True),
        AggregateKind(
            "avg", 1, (0, 0), None, lambda state, value: (state[0] + value, state[1] + 1), _average, True
        ),
        AggregateKind("list", 1, (), NIL, lambda state, value: (state, value), _listed, False),
    )
}
"""By their names."""


class Collector:
    """An aggregate of one rule: a kind, and how to get the value from a match.

    Args:
        kind: one of `AGGREGATES`.
        value: gives the value from the values of a match.
        evaluate: gives the number of an expression, for values that are not numbers.
    """

    def __init__(
        self, kind: str, value: Callable[[Values], Term], evaluate: Callable[[Term], Optional[Term]]
    ):
        self.kind = AGGREGATES[kind]
        self.name = kind
        self.start = self.kind.start
        self.initial = self.kind.initial
        self.result = self.kind.result
        self._value = value
        self._evaluate = evaluate

    def add(self, state: Any, values: Values) -> Any:
        """Return the state with the value of one more match.

        Raises:
            RuleError: where it needs a number and gets none.
        """
        value = self._value(values)
        if self.kind.numeric and value.__class__ not in (int, float):
            number = self._evaluate(value)
            if number is None:
                raise RuleError(f"aggregate {self.name} needs numbers")
            value = number
        try:
            return self.kind.add(state, value)
        except OverflowError:
            raise RuleError(f"aggregate {self.name}: a number is too large") from None
