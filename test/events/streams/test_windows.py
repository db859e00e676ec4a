"""Windows, compared with their definitions over plain lists."""

from typing import Any, Callable, Dict, List

import pytest
from events.streams.operator_driver import (
    Arrival,
    OperatorDriver,
    arrival_lists,
    element_of,
    entry_count,
    expected_output,
    list_accumulators,
)
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis import RuleError
from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.session_window import SessionWindow
from retalis.events.streams.windows import (
    AlignedTumblingWindow,
    AnchoredTumblingWindow,
    HoppingWindow,
    SlidingCountWindow,
    SlidingTimeWindow,
    TumblingCountWindow,
)

ARRIVAL_LISTS = arrival_lists(st.sampled_from([1, 2.5]))
RESTORE_POSITIONS = st.integers(0, 20)
few_examples = example_settings(max_examples=30)


def newest_end(arrivals: Any) -> Any:
    return max(arrival.end for arrival in arrivals)


def last_group(arrivals: Any) -> List[Any]:
    return [arrival for arrival in arrivals if arrival.key == arrivals[-1].key]


def prefixes(arrivals: Any) -> List[Any]:
    return [arrivals[: number + 1] for number in range(len(arrivals))]


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 8))
def test_sliding_time_window(arrivals: Any, restore_before: Any, span: int) -> None:
    """The window contains the elements that began less than the span before the newest end."""
    expected: List[Any] = []
    for prefix in prefixes(arrivals):
        lower_bound = newest_end(prefix) - span
        if prefix[-1].start > lower_bound:
            expected.append(
                expected_output([arrival for arrival in last_group(prefix) if arrival.start > lower_bound])
            )
    driver = OperatorDriver(lambda: SlidingTimeWindow(list_accumulators, span), restore_before)
    assert driver.feed(arrivals) == expected
    if arrivals:
        inside = [arrival for arrival in arrivals if arrival.start > newest_end(arrivals) - span]
        assert len(driver.operator) == len(inside)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 5))
def test_sliding_count_window(arrivals: Any, restore_before: Any, size: int) -> None:
    driver = OperatorDriver(lambda: SlidingCountWindow(list_accumulators, size), restore_before)
    assert driver.feed(arrivals) == [
        expected_output(last_group(prefix)[-size:]) for prefix in prefixes(arrivals)
    ]
    assert len(driver.operator) == sum(
        min(size, sum(arrival.key == key for arrival in arrivals)) for key in "ab"
    )


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 5), st.booleans())
def test_tumbling_count_window(arrivals: Any, restore_before: Any, batch_size: int, running: bool) -> None:
    expected: List[Any] = []
    for prefix in prefixes(arrivals):
        group = last_group(prefix)
        size = (len(group) - 1) % batch_size + 1
        if running or size == batch_size:
            expected.append(expected_output(group[-size:]))
    assert (
        OperatorDriver(
            lambda: TumblingCountWindow(list_accumulators, batch_size, running), restore_before
        ).feed(arrivals)
        == expected
    )


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 6), st.integers(1, 6))
def test_hopping_window(arrivals: Any, restore_before: Any, span: int, every: int) -> None:
    """At each multiple of a step, a group contains its elements that ended in the span before it."""
    expected: List[Any] = []
    last_instant = newest_end(arrivals) + span + every if arrivals else 0
    for instant in range(0, last_instant + 1, every):
        inside = [
            arrival
            for arrival in arrivals
            if arrival.clock_time < instant and instant - span <= arrival.end < instant
        ]
        groups = [[arrival for arrival in inside if arrival.key == key] for key in "ab"]
        interval = (instant - span, instant)
        expected.append([({arrival.number for arrival in group}, *interval) for group in groups if group])
    driver = OperatorDriver(lambda: HoppingWindow(list_accumulators, span, every), restore_before)
    outputs = [(set(items), start, end) for items, start, end in driver.feed(arrivals)]
    assert sorted(outputs, key=str) == sorted(
        (output for outputs_at_instant in expected for output in outputs_at_instant), key=str
    )
    assert [end for _, _, end in outputs] == sorted(end for _, _, end in outputs)
    assert len(driver.operator) == 0
    # An element that ends between two windows is in none of them, and never late.
    late = [
        arrival
        for arrival in arrivals
        if (arrival.end // every + 1) * every - span <= arrival.end
        and (arrival.end + span) // every * every <= arrival.clock_time // every * every
    ]
    assert restore_before < len(arrivals) or driver.operator.late_count == len(late)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 6), st.booleans())
def test_anchored_tumbling_window(arrivals: Any, restore_before: Any, span: int, running: bool) -> None:
    """A window begins at the end of its first element, and ends when the clock is a span later."""
    expected: List[Any] = []
    open_windows: Dict[Any, Any] = {}

    def close(now: int) -> None:
        closing = sorted(
            (window[0].end, key) for key, window in open_windows.items() if window[0].end + span <= now
        )
        for start, key in closing:
            window = open_windows.pop(key)
            if not running:
                expected.append((tuple([arrival.number for arrival in window]), start, start + span))

    for arrival in arrivals:
        close(arrival.clock_time)
        window = open_windows.setdefault(arrival.key, [])
        if window and not window[0].end <= arrival.end < window[0].end + span:
            continue
        if not window and arrival.end + span <= arrival.clock_time:
            del open_windows[arrival.key]  # its window has ended
            continue
        window.append(arrival)
        if running:
            expected.append(expected_output(window))
    close(1 << 40)
    outputs = OperatorDriver(
        lambda: AnchoredTumblingWindow(list_accumulators, span, running), restore_before
    ).feed(arrivals)
    assert sorted(outputs) == sorted(expected) if not running else outputs == expected


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, st.integers(1, 8))
def test_aligned_tumbling_window(arrivals: Any, restore_before: Any, span: int) -> None:
    """The elements in the window of the newest end; elements of an earlier window are late."""
    expected: List[Any] = []
    for prefix in prefixes(arrivals):
        window = [
            arrival for arrival in last_group(prefix) if arrival.end // span == newest_end(prefix) // span
        ]
        if prefix[-1] in window:
            expected.append(expected_output(window))
    assert (
        OperatorDriver(lambda: AlignedTumblingWindow(list_accumulators, span), restore_before).feed(arrivals)
        == expected
    )


WINDOWS: Dict[str, Callable[[], Any]] = {
    "last seconds": lambda: SlidingTimeWindow(list_accumulators, 100),
    "last items": lambda: SlidingCountWindow(list_accumulators, 100),
    "batches": lambda: TumblingCountWindow(list_accumulators, 4, False),
    "from the first": lambda: AnchoredTumblingWindow(list_accumulators, 100, False),
    "present": lambda: AlignedTumblingWindow(list_accumulators, 1000),
    "instants": lambda: HoppingWindow(list_accumulators, 100, 50),
    "sessions": lambda: SessionWindow(list_accumulators, 100, None),
}


@pytest.mark.parametrize("window_type", WINDOWS)
def test_oldest_element_is_dropped(window_type: Any) -> None:
    driver = OperatorDriver(WINDOWS[window_type])
    arrivals = [
        Arrival(number, "ab"[number % 2], 10 + number, 10 + number, number, 0, 10 + number)
        for number in range(14)
    ]
    for number, arrival in enumerate(arrivals[:6], 1):
        driver.operator.process(element_of(arrival), arrival.clock_time, 0)
        assert len(driver.operator) == number
    for remaining in range(5, -1, -1):
        driver.operator.drop_oldest()
        assert len(driver.operator) == remaining
    outputs = driver.feed(arrivals[6:])
    assert outputs
    assert all(set(items) <= set(range(6, 14)) for items, _, _ in outputs)


@pytest.mark.parametrize("window_type", WINDOWS)
def test_dropped_elements_are_not_stored(window_type: Any) -> None:
    """The state of a window stays small however many elements are dropped."""
    window = WINDOWS[window_type]()
    for number in range(1500):
        window.process(element_of(Arrival(number, f"k{number // 3}", 10, 10, number, 0, 10)), 10, 0)
        if len(window) > 5:
            window.drop_oldest()
    assert len(window) == 5
    assert entry_count(window) <= 90


@pytest.mark.parametrize("window_type", WINDOWS)
def test_end_too_far_ahead_does_not_advance_window(window_type: Any) -> None:
    """A timestamp of a wrong clock neither empties a window nor makes later elements late."""
    window = WINDOWS[window_type]()
    window.tracks_elements, window.compute_max_timestamp = True, lambda: 1000
    for number in range(3):
        window.process(element_of(Arrival(number, "a", 900 + number, 900 + number, number, 0, 900)), 900, 0)
    window.process(element_of(Arrival(3, "b", 9000, 9000, 3, 0, 903)), 903, 0)
    late_count = window.late_count
    outputs = window.process(element_of(Arrival(4, "a", 904, 904, 4, 0, 904)), 904, 0)
    assert window.late_count == late_count
    outputs = outputs or window.advance_to(1010)
    assert [tuple([element.match for element in output.elements]) for output in outputs][-1] == (0, 1, 2, 4)


def test_refused_value_leaves_no_group() -> None:
    window = SlidingTimeWindow(lambda: [AGGREGATES["sum"].make_accumulator(0, None)], 10)
    with pytest.raises(RuleError, match="finite"):
        window.process(element_of(Arrival(0, "a", 1, 1, float("inf"), 0, 1)), 1, 0)
    assert (len(window), window.states) == (0, {})


def test_window_after_failed_sum_has_result() -> None:
    """The sum of a window overflows; the window ends nevertheless."""
    factories: List[Callable[[], Any]] = [
        lambda: TumblingCountWindow(sum_accumulators, 2, False),
        lambda: HoppingWindow(sum_accumulators, 10, 10),
    ]
    numbers = [1e308, 1e308, 1.0, 2.0]

    def sum_accumulators() -> List[Any]:
        return [AGGREGATES["sum"].make_accumulator(0, None)]

    for make_window in factories:
        window = make_window()
        outputs: List[Any] = []
        for position, number in enumerate(numbers):
            arrival = Arrival(position, "a", 5 * position, 5 * position, number, 0, 5 * position)
            outputs += window.advance_to(arrival.clock_time) + window.process(
                element_of(arrival), arrival.clock_time, 0
            )
        outputs += window.advance_to(100)
        assert [output.results for output in outputs] == [(), (3.0,)]
        assert "too large" in outputs[0].error.message
        assert outputs[1].error is None


def test_removed_elements_are_not_stored() -> None:
    """All queues of a window store only the elements inside it, however many passed through."""
    sliding, hopping = SlidingTimeWindow(list_accumulators, 10), HoppingWindow(list_accumulators, 10, 5)
    for number in range(2000):
        end = 5 * number - (7 if number % 3 == 0 else 0)
        for window in (sliding, hopping):
            window.advance_to(5 * number)
            window.process(element_of(Arrival(number, "a", end, end, number, 0, 5 * number)), 5 * number, 0)
    for window in (sliding, hopping):
        assert len(window) <= 5
        assert entry_count(window) <= 80
        assert all(len(group.elements) <= 80 for group in window.states.values())
