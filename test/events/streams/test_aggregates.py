"""Measures of windows, compared with direct computation."""

import math
import statistics
from fractions import Fraction

import pytest
from events.streams.stream_feeder import Came, entries, item_of, stream
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis import RuleError, atom, list_items
from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.stream_operators import StreamElement
from retalis.events.streams.windows import SlidingTimeWindow
from retalis.prolog.terms.term_traversal import term_key

SPAN = 6
PARTS = (0, 0.1, 0.25, 0.5, 0.9, 1)
NUMBERS = st.one_of(
    st.integers(-5, 5),
    st.sampled_from([0.1, 1.0, 2.0, -0.0, 1e16, -1e16, 5e-324, 10**25]),
    st.floats(-1e6, 1e6),
)


def quotient(total, number, values):
    """Return a fraction as a number: exact where there are integers only, else rounded once."""
    found = Fraction(total) / number
    whole = all(isinstance(value, int) for value in values) and found.denominator == 1
    return int(found) if whole else float(found)


def quantile(part, values):
    ordered = sorted(values)
    place = part * (len(ordered) - 1)
    low = ordered[math.floor(place)]
    rest = place - math.floor(place)
    return low if rest == 0 else low + (ordered[math.floor(place) + 1] - low) * rest


def deviation(values):
    mean = sum(map(Fraction, values)) / len(values)
    return math.sqrt(sum((Fraction(value) - mean) ** 2 for value in values) / (len(values) - 1))


def of(name, setting=None, at=0):
    return AGGREGATES[name].make_accumulator(at, setting)


def measured(arrivals, makers, span=SPAN):
    """Yield what is in a sliding window, in the order in which it came, and what is measured of it."""
    window = SlidingTimeWindow(lambda: [make() for make in makers], span)
    window.tracks_elements = True
    for came in arrivals:
        for output in window.process(
            StreamElement(came, came.start, came.end, (came.key,), (came.value,)), 0, 0
        ):
            yield [item.match for item in output.elements], output.results


@example_settings(max_examples=50)
@given(stream(NUMBERS))
@example(
    [Came(at, "a", at, at, value, 0, at) for at, value in enumerate([1e16, 1.0, -1e16, 1.0, 0.1, 3, 2, 1])]
)
def test_of_numbers(arrivals):
    names = ("count", "sum", "avg", "min", "max", "median", "rate")
    makers = [lambda name=name: of(name, SPAN if name == "rate" else None) for name in names]
    makers += [lambda part=part: of("quantile", part) for part in PARTS]
    for inside, found in measured(arrivals, makers):
        values = [one.value for one in inside]
        total = sum(map(Fraction, values))
        expected = [len(values), quotient(total, 1, values), quotient(total, len(values), values)]
        expected += [min(values), max(values), quantile(0.5, values), len(values) / SPAN]
        expected += [quantile(part, values) for part in PARTS]
        assert list(found) == expected
        kinds = [type(one) for one in expected[:5]]
        assert [type(one) for one in found[:5]] == kinds


@example_settings(max_examples=30)
@given(stream(st.one_of(st.integers(-5, 5), st.integers(-(10**9), 10**9).map(lambda one: one / 1024))))
def test_deviation(arrivals):
    """That of a sample: exact up to the root; there is none of one number."""
    for inside, found in measured(arrivals, [lambda: of("stddev")]):
        values = [one.value for one in inside]
        assert found == (deviation(values),)
        assert found == (pytest.approx(statistics.stdev(map(Fraction, values)), rel=1e-12),)


TERMS = st.sampled_from([1, 1.0, 2, atom("a"), (atom("f"), 1), (atom("f"), 1.0)])


@example_settings(max_examples=30)
@given(stream(TERMS))
def test_of_terms(arrivals):
    """In the order in which they came; two terms are different where they do not unify."""
    names = ("first", "last", "list", "distinct", "count_distinct")
    for inside, found in measured(arrivals, [lambda name=name: of(name) for name in names]):
        values = [one.value for one in inside]
        different = list({term_key(value): value for value in reversed(values)}.values())[::-1]
        shown = [list_items(one) if name in ("list", "distinct") else one for name, one in zip(names, found)]
        expected = [values[0], values[-1], values, sorted_by_first(different, values), len(different)]
        assert [repr(one) for one in shown] == [repr(one) for one in expected]


def sorted_by_first(different, values):
    keys = [term_key(value) for value in values]
    return sorted(different, key=lambda value: keys.index(term_key(value)))


@example_settings(max_examples=20)
@given(stream(NUMBERS))
def test_rate_without_a_span_is_that_between_the_ends(arrivals):
    known = list(measured(arrivals, [lambda: of("rate")]))
    for inside, found in known:
        ends = [one.end for one in inside]
        assert found == (float(Fraction((len(ends) - 1) * 10**9, max(ends) - min(ends))),)


@example_settings(max_examples=100)
@given(st.integers(1, 10**6), st.integers(1, 10**15))
def test_rate_by_the_seconds_of_the_window_is_rounded_once(number, span):
    assert of("rate", Fraction(span, 10**9)).result(None, number) == float(Fraction(number * 10**9, span))


@pytest.mark.parametrize("name", ["median", "quantile"])
def test_a_quantile_between_two_numbers_of_which_the_difference_is_no_float(name):
    arrivals = [Came(at, "a", at, at, value, 0, at) for at, value in enumerate([-1.5e308, 1.5e308])]
    assert [found for _, found in measured(arrivals, [lambda: of(name, 0.5)])][-1] == (0.0,)


def test_a_program_s_own_measure_takes_the_values_oldest_first():
    arrivals = [Came(at, "a", at, at, value, 0, at) for at, value in enumerate([3, 1, 2])]
    found = [one for _, one in measured(arrivals, [lambda: of("fold", lambda values: sum(values) * 10)])]
    assert found == [(30,), (40,), (60,)]


def test_where_one_has_no_result_nothing_is_given_on():
    arrivals = [Came(at, "a", at, at, at, 0, at) for at in range(3)]
    makers = [lambda: of("count"), lambda: of("fold", lambda values: 1 if len(values) > 2 else None)]
    assert [found for _, found in measured(arrivals, makers)] == [(3, 1)]


@pytest.mark.parametrize("name", ["sum", "avg", "stddev", "median", "quantile"])
@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan")])
def test_no_sum_of_what_is_not_finite(name, value):
    with pytest.raises(RuleError, match=f"aggregate {name}: the value is '.*': expected a finite number"):
        of(name, 0.5).check(item_of(Came(0, "a", 1, 1, value, 0, 1)))


@pytest.mark.parametrize("name", ["min", "max"])
def test_the_infinities_have_an_order(name):
    of(name).check(item_of(Came(0, "a", 1, 1, float("inf"), 0, 1)))
    with pytest.raises(RuleError, match=f"aggregate {name}: the value is '1.5NaN': expected a number"):
        of(name).check(item_of(Came(0, "a", 1, 1, float("nan"), 0, 1)))


def test_several_measures_have_their_own_values():
    window = SlidingTimeWindow(lambda: [of("sum"), of("max", None, 1), of("count", None, 2)], 10)
    for at in range(3):
        outputs = window.process(StreamElement(None, at, at, (), (at, -at)), 0, 0)
    assert outputs[0].results == (3, 0, 3)


@pytest.mark.parametrize(
    "name", ["count", "sum", "avg", "stddev", "min", "max", "median", "count_distinct", "distinct", "rate"]
)
def test_what_is_in_is_not_looked_through_for_a_result(name):
    """A result does not cost more where more is in the window; what has left is not held."""
    measure, inside = of(name, 0.5 if name == "median" else None), []
    for at in range(500):
        item = item_of(Came(at, "a", at, at, at % 3, 0, at))
        item.order = at
        inside.append(item)
        measure.add(item)
        if len(inside) > 30:
            inside[0].is_removed = True
            measure.remove(inside.pop(0))
        if len(inside) > 1:
            assert measure.result(NOTHING, len(inside)) is not None
    assert sum(entries(one) for one in getattr(measure, "alike", {}).values()) <= 3 * 36


NOTHING = None
"""In the place of the members, which are not looked at."""
