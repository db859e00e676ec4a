"""Folds: aggregate functions of repeated events, whose values only grow in number.

`Fold.add` maps a state and a value to the next state and never changes a state in place: partial matches with a
common prefix share the state of that prefix, so each of them can be extended without a copy of the collected values.
The persistent structures that this needs are in `running_statistics`.
"""

from functools import reduce
from math import isfinite
from typing import Any, Callable, List, NamedTuple, Optional, Tuple

from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import NIL, Term
from ...serialization.stored_field_types import (
    COUNT,
    FINITE,
    INTEGER,
    TERM,
    FieldType,
    compact_record_of,
    integer,
    nested_pairs_of,
    optional,
    sequence_of,
    stored_as,
    tuple_of,
)
from .running_statistics import KeySet, QuantileState, SumState, add_key, standard_deviation


class Fold(NamedTuple):
    """Aggregate function over a growing sequence of values.

    Attributes:
        initial_state: state without any value.
        state_type: type of the states, for state files.
        empty_result: result without any value; None if there is none.
        add: returns the state with one more value.
        result: returns the result of a state, or None if there is none; raises OverflowError if it is too large for
            a float.
        is_per_second: whether the result is divided by the seconds from the end of the start to the last end.
    """

    initial_state: Any
    state_type: FieldType[Any]
    empty_result: Optional[Term]
    add: Callable[[Any, Any], Any]
    result: Callable[[Any], Optional[Term]]
    is_per_second: bool = False


def get_state(state: Term) -> Term:
    """Return a state that is its result."""
    return state


def choose_smaller(state: Any, value: Any) -> Any:
    """Return the smaller one of a state and a number."""
    return value if state is None or value < state else state


def choose_larger(state: Any, value: Any) -> Any:
    """Return the larger one of a state and a number."""
    return value if state is None or value > state else state


def add_finite(state: Any, value: Any) -> Any:
    """Return the sum of two finite numbers.

    Raises:
        OverflowError: if it is too large for a float.
    """
    total = state + value
    # An infinite sum would stay infinite, whatever is added later, so it is reported instead.
    if total.__class__ is float and not isfinite(total):
        raise OverflowError
    return total


def compute_average(state: Tuple[float, int]) -> Term:
    """Return the average of a state, a sum and a count.

    Raises:
        OverflowError: if it is too large for a float.
    """
    total, count = state
    # Integers whose average is an integer stay exact, as `avg` of integers of any size.
    return total // count if total.__class__ is int and total % count == 0 else total / count


def _values_of_state(state: Any) -> List[Term]:
    """Return the values of a state, which is nested pairs, newest value outermost: adding takes constant time."""
    items = []
    while state:
        state, value = state
        items.append(value)
    items.reverse()
    return items


def _make_list_of_state(state: Any) -> Term:
    return make_list(_values_of_state(state))


class _DeviationState(NamedTuple):
    """Number of values, their sum, and the sum of their squares."""

    size: int = 0
    total: SumState = SumState()
    squares: SumState = SumState()


def _add_to_deviation(state: _DeviationState, value: Any) -> _DeviationState:
    numerator, denominator = value.as_integer_ratio()
    bits = denominator.bit_length() - 1
    return _DeviationState(
        state.size + 1,
        state.total.with_fraction(numerator, bits),
        state.squares.with_fraction(numerator * numerator, 2 * bits),
    )


def _compute_deviation(state: _DeviationState) -> Optional[Term]:
    return standard_deviation(state.total, state.squares, state.size) if state.size > 1 else None


_SUM_STATE = compact_record_of(
    SumState,
    total=INTEGER,
    scale=integer(0, 1 << 13),
)


def _make_deviation_state(values: Any) -> _DeviationState:
    count, total, squares = values
    return _DeviationState(count, SumState(*total), SumState(*squares))


def make_quantile_fold(quantile: float) -> Fold:
    """Return the fold of a quantile, from 0 to 1."""

    def add(state: QuantileState, value: Any) -> QuantileState:
        return state.with_number(value, quantile)

    return Fold(
        initial_state=QuantileState(),
        # The heaps are made again by adding the numbers in order of arrival.
        state_type=stored_as(
            sequence_of(FINITE), lambda values: reduce(add, values, QuantileState()), QuantileState.numbers
        ),
        empty_result=None,
        add=add,
        result=lambda state: state.value(quantile),
    )


def make_user_fold(setting: Callable[[List[Term]], Optional[Term]]) -> Fold:
    """Return the fold of a user-defined aggregate, whose setting computes the result from the values."""
    return Fold(
        initial_state=(),
        state_type=nested_pairs_of(TERM),
        empty_result=None,
        add=lambda state, value: (state, value),
        result=lambda state: setting(_values_of_state(state)),
    )


class _DistinctState(NamedTuple):
    """Different values as nested pairs in order of arrival, their number, and their keys."""

    pairs: Any = ()
    size: int = 0
    keys: KeySet = ()


def _add_distinct(state: _DistinctState, value: Term) -> _DistinctState:
    key = term_key(value)
    if any(key in keys for keys in state.keys):
        return state
    return _DistinctState((state.pairs, value), state.size + 1, add_key(state.keys, key))


_DISTINCT_STATE = stored_as(
    sequence_of(TERM),
    lambda values: reduce(_add_distinct, values, _DistinctState()),
    lambda state: _values_of_state(state.pairs),
)


class _ChangesState(NamedTuple):
    """Number of changes, and the last value; None without any value."""

    size: int = 0
    last: Optional[Term] = None


def _add_to_changes(state: _ChangesState, value: Term) -> _ChangesState:
    is_change = state.last is not None and term_key(state.last) != term_key(value)
    return _ChangesState(state.size + is_change, value)


DEVIATION_FOLD = Fold(
    initial_state=_DeviationState(),
    state_type=stored_as(tuple_of(COUNT, _SUM_STATE, _SUM_STATE), _make_deviation_state, lambda state: state),
    empty_result=None,
    add=_add_to_deviation,
    result=_compute_deviation,
)

FIRST_FOLD = Fold(
    initial_state=None,
    state_type=optional(TERM),
    empty_result=None,
    add=lambda first, value: value if first is None else first,
    result=get_state,
)

LAST_FOLD = Fold(
    initial_state=None,
    state_type=optional(TERM),
    empty_result=None,
    add=lambda last, value: value,
    result=get_state,
)

LIST_FOLD = Fold(
    initial_state=(),
    state_type=nested_pairs_of(TERM),
    empty_result=NIL,
    add=lambda state, value: (state, value),
    result=_make_list_of_state,
)

DISTINCT_FOLD = Fold(
    initial_state=_DistinctState(),
    state_type=_DISTINCT_STATE,
    empty_result=NIL,
    add=_add_distinct,
    result=lambda state: _make_list_of_state(state.pairs),
)

COUNT_DISTINCT_FOLD = Fold(
    initial_state=_DistinctState(),
    state_type=_DISTINCT_STATE,
    empty_result=0,
    add=_add_distinct,
    result=lambda state: state.size,
)

CHANGES_FOLD = Fold(
    initial_state=_ChangesState(),
    state_type=compact_record_of(
        _ChangesState,
        size=COUNT,
        last=optional(TERM),
    ),
    empty_result=0,
    add=_add_to_changes,
    result=lambda state: state.size,
)

RATE_FOLD = Fold(
    initial_state=0,
    state_type=COUNT,
    empty_result=None,
    add=lambda count, value: count + 1,
    result=get_state,
    is_per_second=True,
)
