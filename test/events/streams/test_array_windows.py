"""Windows over arrays, compared with numpy."""

from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_reports import RecordingReports

from retalis import Engine, Reports, Settings, functor, make_list
from retalis.prolog.builtins.argument_checks import array_of
from retalis.prolog.terms.array_terms import array_term
from retalis.prolog.terms.timestamps import SECOND

NUMPY_FUNCTIONS: Dict[str, Any] = {
    "sum(X)": np.sum,
    "avg(X)": np.mean,
    "min(X)": np.nanmin,
    "max(X)": np.nanmax,
    "median(X)": np.median,
    "quantile(0.3, X)": lambda stack, axis: np.percentile(stack, 30, axis=axis),
    "stddev(X)": lambda stack, axis: np.std(stack, axis=axis, ddof=1),
}
WINDOWS = ["last(3)", "last(4, events)", "every(2)", "every(3, events)", "running(every(3, events))"]
SCAN = functor("scan", 2)
ROWS = st.lists(st.lists(st.floats(-100, 100, width=32), min_size=6, max_size=6), min_size=1, max_size=9)


def engine_of(rules: str, reports: Optional[Reports] = None) -> Tuple[Any, ...]:
    """Return an engine, and the list that receives the arrays of its events."""
    engine, results = Engine(None, Settings(), reports or RecordingReports()), []
    engine.on_event(
        lambda term, start, end: results.append(array_of(term[2])) if term[0].name == "out" else None
    )
    engine.load(rules=rules)
    return engine, results


def send(engine: Any, values: Any, second: int, key: int = 1) -> None:
    engine.event_at(SCAN(key, values), second * SECOND, second * SECOND)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(ROWS, st.sampled_from(["<f4", "<f8", "<i4"]), st.booleans())
@pytest.mark.parametrize("aggregate", NUMPY_FUNCTIONS)
def test_array_results_equal_numpy(aggregate: Any, rows: Any, dtype: Any, as_lists: bool) -> None:
    engine, results = engine_of(f"out(K, R) <- aggregate({aggregate}, scan(K, X), R, last(3, events)).")
    arrays = [np.array(row).astype(dtype) for row in rows]
    for second, array in enumerate(arrays):
        send(engine, make_list(array.tolist()) if as_lists else array_term(array), second)
    # A deviation needs two elements.
    first = 1 if aggregate == "stddev(X)" else 0
    assert len(results) == len(arrays) - first
    for position, result in enumerate(results, first):
        stack = np.array(arrays[max(0, position - 2) : position + 1], "f8" if dtype[1] == "f" else "i8")
        np.testing.assert_allclose(result, NUMPY_FUNCTIONS[aggregate](stack, axis=0), rtol=1e-12, atol=1e-9)
        assert aggregate[:3] not in ("sum", "min", "max") or (result.dtype.kind == "f") == (dtype[1] == "f")


@pytest.mark.parametrize("window", WINDOWS)
def test_windows_aggregate_arrays(window: str) -> None:
    engine, results = engine_of(f"out(K, R) <- aggregate(avg(X), scan(K, X), R, {window}).")
    for second in range(1, 13):
        send(engine, array_term(np.full(6, float(second))), second)
    assert results
    assert all(len(set(result.tolist())) == 1 for result in results)


def test_nan_stays_in_sums_but_not_in_extremes() -> None:
    text = "out(K, R) <- aggregate({}(X), scan(K, X), R, last(5)).\n"
    engine, results = engine_of("".join(map(text.format, ("sum", "avg", "min", "max", "median", "stddev"))))
    send(engine, array_term(np.array([np.nan, np.inf, 1, 2, 3.0])), 1)
    results.clear()
    send(engine, array_term(np.array([1, 1, 1, 1, 1.0])), 2)
    total, mean, least, greatest, middle, deviation = (result.tolist() for result in results)
    assert np.isnan(total[0])
    assert total[1:] == [np.inf, 2, 3, 4]
    assert np.isnan(mean[0])
    assert mean[1:] == [np.inf, 1, 1.5, 2]
    assert least == [1] * 5
    assert greatest == [1, np.inf, 1, 2, 3]
    assert np.isnan(middle[0])
    assert middle[1:] == [np.inf, 1, 1.5, 2]
    assert np.isnan(deviation[:2]).all()
    assert deviation[2:] == [0, 0.5**0.5, 2**0.5]


def test_median_of_infinite_elements() -> None:
    engine, results = engine_of("out(K, R) <- aggregate(median(X), scan(K, X), R, last(5)).")
    for second, value in enumerate([np.inf, np.inf, 1.0]):
        send(engine, array_term(np.array([value, 2.0, -np.inf])), second)
    assert [result.tolist() for result in results] == [[np.inf, 2.0, -np.inf]] * 3


@pytest.mark.parametrize("aggregate", NUMPY_FUNCTIONS)
def test_other_values_are_refused_beside_arrays(aggregate: Any) -> None:
    reports = RecordingReports()
    engine, results = engine_of(f"out(K, R) <- aggregate({aggregate}, scan(K, X), R, last(10)).", reports)
    send(engine, array_term(np.arange(6)), 0)
    send(engine, array_term(np.arange(6)), 1)
    count = len(results)
    for second, value in enumerate([7, make_list([1, 2, 3]), array_term(np.arange(7))], 2):
        send(engine, value, second)
    assert len(results) == count
    assert sum("expected an array of 6 elements" in report for report in reports.texts) == 3
    send(engine, array_term(np.arange(6)), 5)
    assert len(results) == count + 1


@pytest.mark.parametrize("aggregate", NUMPY_FUNCTIONS)
def test_arrays_are_refused_beside_numbers(aggregate: Any) -> None:
    reports = RecordingReports()
    engine, results = engine_of(f"out(K, R) <- aggregate({aggregate}, scan(K, X), R, last(10)).", reports)
    send(engine, array_term(np.arange(6)), 1, key=2)
    engine.event_at(SCAN(1, 5), 2 * SECOND, 2 * SECOND)
    send(engine, array_term(np.arange(6)), 3)
    assert any("expected a number" in report for report in reports.texts)
    send(engine, array_term(np.arange(6)), 4, key=2)
    np.testing.assert_allclose(results[-1], NUMPY_FUNCTIONS[aggregate](np.stack([np.arange(6)] * 2), axis=0))


def test_timestamps_count_as_numbers() -> None:
    engine = Engine()
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    engine.load(rules="out(R) <- aggregate(max(X), scan(_, X), R, last(10)).")
    send(engine, make_list([3, 500_000_000]), 1)
    assert "out(3.5)" in outputs


def test_array_window_is_restored() -> None:
    engine, _ = engine_of("out(K, R) <- aggregate([sum(X), median(X)], scan(K, X), [R, _], last(3, events)).")
    for number in range(2):
        send(engine, array_term(np.arange(6.0) * number), number)
    restored = Engine.restore(Engine.restore(engine.snapshot()).snapshot())
    outputs: List[Any] = []
    restored.on_event(lambda term, start, end: outputs.append(restored.show(term)))
    send(restored, array_term(np.arange(6.0)), 5)
    assert "out(1,[0.0,2.0,4.0,6.0,8.0,10.0])" in outputs


def test_array_is_refused_by_open_window_of_numbers() -> None:
    """An event of another key moves the time of the stream, but ends no window that begins with an event."""
    reports = RecordingReports()
    engine, _ = engine_of("sum(K, R) <- aggregate(sum(X), scan(K, X), R, every(10, first)).", reports)
    sums: List[Any] = []
    engine.on_event(lambda term, start, end: sums.append(term[1:]) if term[0].name == "sum" else None)
    engine.call("set_etalis_flag(watermark_delay, 20)")
    send(engine, 1, 1)
    send(engine, 1, 15, key=2)
    send(engine, make_list([1, 2, 3]), 5)
    send(engine, 2, 6)
    engine.event("tick", 100)
    assert sums == [(1, 3), (2, 1)]
    (error,) = [text for text in reports.texts if "aggregate sum" in text]
    assert "aggregate sum: the value is '[1,2,3]': expected a number" in error
