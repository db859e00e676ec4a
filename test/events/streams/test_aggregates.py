"""Aggregates of windows, compared with direct computation."""

import math
import statistics
from collections import deque
from fractions import Fraction
from functools import reduce
from typing import Any, Iterator, List

import pytest
from events.streams.operator_driver import Arrival, arrival_lists, element_of, entry_count
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis import RuleError, UsageError, atom, list_items, make_list
from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.stream_operators import StreamElement
from retalis.events.streams.windows import SlidingTimeWindow
from retalis.prolog.terms.term_traversal import term_key

SPAN = 6
FRACTIONS = (0, 0.1, 0.25, 0.5, 0.9, 1)
NUMBERS = st.one_of(
    st.integers(-5, 5),
    st.sampled_from([0.1, 1.0, 2.0, -0.0, 1e16, -1e16, 5e-324, 10**25]),
    st.floats(-1e6, 1e6),
)


def quotient(total: Any, divisor: int, values: Any) -> Any:
    """Return a fraction as a number: an exact integer if all values are integers, else a float rounded once."""
    fraction = Fraction(total) / divisor
    is_whole = all(isinstance(value, int) for value in values) and fraction.denominator == 1
    return int(fraction) if is_whole else float(fraction)


def quantile(fraction: float, values: Any) -> Any:
    ordered = sorted(values)
    position = fraction * (len(ordered) - 1)
    low = ordered[math.floor(position)]
    rest = position - math.floor(position)
    return low if rest == 0 else low + (ordered[math.floor(position) + 1] - low) * rest


def deviation(values: Any) -> Any:
    mean = sum(map(Fraction, values)) / len(values)
    return math.sqrt(sum((Fraction(value) - mean) ** 2 for value in values) / (len(values) - 1))


def accumulator(name: str, setting: Any = None, position: int = 0) -> Any:
    return AGGREGATES[name].make_accumulator(position, setting)


def window_results(arrivals: Any, makers: Any, span: Any = SPAN) -> Iterator[Any]:
    """Yield the elements of a sliding window in order of arrival, and the results of its accumulators."""
    window = SlidingTimeWindow(lambda: [make() for make in makers], span)
    window.tracks_elements = True
    for arrival in arrivals:
        for output in window.process(
            StreamElement(arrival, arrival.start, arrival.end, (arrival.key,), (arrival.value,)), 0, 0
        ):
            yield [element.match for element in output.elements], output.results


@example_settings(max_examples=50)
@given(arrival_lists(NUMBERS))
@example(
    [
        Arrival(position, "a", position, position, value, 0, position)
        for position, value in enumerate([1e16, 1.0, -1e16, 1.0, 0.1, 3, 2, 1])
    ]
)
def test_numeric_aggregates(arrivals: Any) -> None:
    names = ("count", "sum", "avg", "min", "max", "median", "rate")
    makers = [lambda name=name: accumulator(name, SPAN if name == "rate" else None) for name in names]
    makers += [lambda fraction=fraction: accumulator("quantile", fraction) for fraction in FRACTIONS]
    for window, results in window_results(arrivals, makers):
        values = [arrival.value for arrival in window]
        total = sum(map(Fraction, values))
        expected = [len(values), quotient(total, 1, values), quotient(total, len(values), values)]
        expected += [min(values), max(values), quantile(0.5, values), len(values) / SPAN]
        expected += [quantile(fraction, values) for fraction in FRACTIONS]
        assert list(results) == expected
        types = [type(result) for result in expected[:5]]
        assert [type(result) for result in results[:5]] == types


@example_settings(max_examples=30)
@given(
    arrival_lists(
        st.one_of(st.integers(-5, 5), st.integers(-(10**9), 10**9).map(lambda number: number / 1024))
    )
)
def test_sample_deviation(arrivals: Any) -> None:
    """The sample deviation is exact up to the root; one number has no deviation."""
    for window, results in window_results(arrivals, [lambda: accumulator("stddev")]):
        values = [arrival.value for arrival in window]
        assert results == (deviation(values),)
        assert results == (pytest.approx(statistics.stdev(map(Fraction, values)), rel=1e-12),)


TERMS = st.sampled_from([1, 1.0, 2, atom("a"), (atom("f"), 1), (atom("f"), 1.0)])


@example_settings(max_examples=30)
@given(arrival_lists(TERMS))
def test_term_aggregates(arrivals: Any) -> None:
    """Results are in order of arrival; two terms differ if they do not unify."""
    names = ("first", "last", "list", "distinct", "count_distinct", "changes")
    for window, results in window_results(arrivals, [lambda name=name: accumulator(name) for name in names]):
        values = [arrival.value for arrival in window]
        different = list({term_key(value): value for value in reversed(values)}.values())[::-1]
        shown = [
            list_items(result) if name in ("list", "distinct") else result
            for name, result in zip(names, results)
        ]
        expected = [values[0], values[-1], values, sorted_by_first(different, values), len(different)]
        expected.append(sum(term_key(value) != term_key(other) for value, other in zip(values, values[1:])))
        assert [repr(result) for result in shown] == [repr(result) for result in expected]


def sorted_by_first(different: Any, values: Any) -> List[Any]:
    keys = [term_key(value) for value in values]
    return sorted(different, key=lambda value: keys.index(term_key(value)))


@example_settings(max_examples=20)
@given(arrival_lists(NUMBERS))
def test_rate_without_span_uses_first_and_last_end(arrivals: Any) -> None:
    measured = list(window_results(arrivals, [lambda: accumulator("rate")]))
    for window, results in measured:
        ends = [arrival.end for arrival in window]
        assert results == (float(Fraction((len(ends) - 1) * 10**9, max(ends) - min(ends))),)


@example_settings(max_examples=100)
@given(st.integers(1, 10**6), st.integers(1, 10**15))
def test_rate_of_window_is_rounded_once(number: int, span: int) -> None:
    assert accumulator("rate", Fraction(span, 10**9)).result(None, number) == float(
        Fraction(number * 10**9, span)
    )


@pytest.mark.parametrize("name", ["median", "quantile"])
def test_quantile_of_overflowing_difference(name: str) -> None:
    arrivals = [
        Arrival(position, "a", position, position, value, 0, position)
        for position, value in enumerate([-1.5e308, 1.5e308])
    ]
    assert [results for _, results in window_results(arrivals, [lambda: accumulator(name, 0.5)])][-1] == (
        0.0,
    )


def test_fold_receives_values_oldest_first() -> None:
    arrivals = [
        Arrival(position, "a", position, position, value, 0, position)
        for position, value in enumerate([3, 1, 2])
    ]
    results = [
        result
        for _, result in window_results(
            arrivals, [lambda: accumulator("fold", lambda values: sum(values) * 10)]
        )
    ]
    assert results == [(30,), (40,), (60,)]


def test_missing_result_suppresses_output() -> None:
    arrivals = [Arrival(position, "a", position, position, position, 0, position) for position in range(3)]
    makers = [
        lambda: accumulator("count"),
        lambda: accumulator("fold", lambda values: 1 if len(values) > 2 else None),
    ]
    assert [results for _, results in window_results(arrivals, makers)] == [(3, 1)]


@pytest.mark.parametrize("name", ["sum", "avg", "stddev", "median", "quantile"])
@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan")])
def test_infinite_value_is_refused_by_sum(name: str, value: float) -> None:
    with pytest.raises(RuleError, match=f"aggregate {name}: the value is '.*': expected a finite number"):
        accumulator(name, 0.5).check(element_of(Arrival(0, "a", 1, 1, value, 0, 1)))


@pytest.mark.parametrize("name", ["min", "max"])
def test_extremes_accept_infinity_but_not_nan(name: str) -> None:
    accumulator(name).check(element_of(Arrival(0, "a", 1, 1, float("inf"), 0, 1)))
    with pytest.raises(RuleError, match=f"aggregate {name}: the value is '1.5NaN': expected a number"):
        accumulator(name).check(element_of(Arrival(0, "a", 1, 1, float("nan"), 0, 1)))


def test_accumulators_read_their_own_value() -> None:
    window = SlidingTimeWindow(
        lambda: [accumulator("sum"), accumulator("max", None, 1), accumulator("count", None, 2)], 10
    )
    for position in range(3):
        outputs = window.process(StreamElement(None, position, position, (), (position, -position)), 0, 0)
    assert outputs[0].results == (3, 0, 3)


@pytest.mark.parametrize(
    "name",
    [
        "count",
        "sum",
        "avg",
        "stddev",
        "min",
        "max",
        "median",
        "quantile",
        "count_distinct",
        "distinct",
        "changes",
        "rate",
    ],
)
def test_result_does_not_read_window(name: str) -> None:
    """The cost of a result does not depend on the size of the window; removed elements are not stored."""
    aggregate, window = accumulator(name, SETTINGS.get(name)), []
    for position in range(500):
        element = element_of(Arrival(position, "a", position, position, position % 3, 0, position))
        element.order = position
        window.append(element)
        aggregate.add(element)
        if len(window) > 30:
            window[0].is_removed = True
            aggregate.remove(window.pop(0))
        if len(window) > 1:
            assert aggregate.result(NO_ELEMENTS, len(window)) is not None
    assert entry_count(aggregate) <= 31
    if name == "distinct":
        # Removed elements of a value are compacted when there are 16 more than others.
        groups = aggregate.by_value.values()
        assert 10 <= max(map(entry_count, groups)) <= 2 * 11 + 16


NO_ELEMENTS = None
"""In place of the elements of the window, which are not read."""


SETTINGS = {"quantile": 0.9, "fold": make_list}


def values_strategy(name: str) -> Any:
    return st.lists(NUMBERS if AGGREGATES[name].is_numeric else TERMS, min_size=1, max_size=20)


@pytest.mark.parametrize("name", AGGREGATES)
@example_settings(max_examples=30)
@given(st.data())
def test_state_of_repetitions_is_persistent(name: str, data: Any) -> None:
    """A state has the same result after further values were added to it, and after it was stored."""
    values = data.draw(values_strategy(name))
    fold = AGGREGATES[name].make_fold(SETTINGS.get(name))
    states = [fold.initial_state]
    results = []
    for value in values:
        states.append(fold.add(states[-1], value))
        results.append(repr(fold.result(states[-1])))
    for number, state in enumerate(states[1:], 1):
        stored = fold.state_type.check(fold.state_type.encode(state))
        for continued in (state, stored):
            assert repr(fold.result(continued)) == results[number - 1]
            if number < len(values):
                assert repr(fold.result(fold.add(continued, values[number]))) == results[number]
    empty = fold.state_type.check(fold.state_type.encode(fold.initial_state))
    assert repr(fold.result(fold.add(empty, values[0]))) == results[0]


ROUNDED_AT_EACH_VALUE = ("sum", "avg")


@pytest.mark.parametrize("name", [name for name in AGGREGATES if name not in ROUNDED_AT_EACH_VALUE])
@example_settings(max_examples=30)
@given(st.data())
def test_repetitions_have_results_of_window(name: str, data: Any) -> None:
    values = data.draw(values_strategy(name))
    fold = AGGREGATES[name].make_fold(SETTINGS.get(name))
    window: Any = deque()
    aggregate, state = accumulator(name, SETTINGS.get(name, 1)), fold.initial_state
    assert aggregate.accepts_empty == (fold.empty_result is not None)
    for number, value in enumerate(values):
        element = element_of(Arrival(number, "a", number, number, value, 0, number))
        element.order = number
        window.append(element)
        aggregate.add(element)
        state = fold.add(state, value)
        if name != "stddev" or number:
            assert repr(fold.result(state)) in (
                repr(aggregate.result(window, number + 1)),
                repr(number + 1) if name == "rate" else None,
            )


def test_distinct_values_of_repetitions_take_few_sets() -> None:
    state = reduce(AGGREGATES["distinct"].make_fold(None).add, range(1000), _initial_state("distinct"))
    assert len(state.keys) < 12


def test_quantile_of_many_repetitions() -> None:
    fold = AGGREGATES["median"].make_fold(None)
    values = [*range(0, 3000, 2), *range(2999, 0, -2)]
    state = reduce(fold.add, values, fold.initial_state)
    assert fold.result(state) == 1499.5
    restored = fold.state_type.check(fold.state_type.encode(state))
    assert restored == state


def _initial_state(name: str) -> Any:
    return AGGREGATES[name].make_fold(None).initial_state


@pytest.mark.parametrize(("name", "value"), [("stddev", [1, [2.5, 0], [4, 0]]), ("median", [math.inf])])
def test_malformed_state_is_refused(name: str, value: Any) -> None:
    with pytest.raises(UsageError, match="expected"):
        AGGREGATES[name].make_fold(None).state_type.check(value)
