"""Throttle, burst, debounce and change, compared with their definitions."""

from typing import Any, List, Tuple

from events.streams.operator_driver import Arrival, OperatorDriver, arrival_lists, element_of, entry_count
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.rate_operators import Debounce, DistinctUntilChanged, Throttle
from retalis.prolog.terms.term_traversal import term_key

ARRIVAL_LISTS = arrival_lists(st.sampled_from([1, 1.0, 2]))
PUNCTUAL_ARRIVAL_LISTS = arrival_lists(st.just(1), max_delay=0)
RESTORE_POSITIONS = st.integers(0, 20)
SPANS = st.integers(1, 8)
few_examples = example_settings(max_examples=30)


def outputs_of(arrivals: Any) -> List[Tuple[Any, ...]]:
    return [((arrival.number,), arrival.start, arrival.end) for arrival in arrivals]


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS)
def test_throttle_passes_first_of_span(arrivals: Any, restore_before: Any, span: Any) -> None:
    """No passed element of the key ends less than the span before the newest end."""
    passed: List[Any] = []
    for number, arrival in enumerate(arrivals):
        newest = max(other.end for other in arrivals[: number + 1])
        if not any(other.key == arrival.key and other.end > newest - span for other in passed):
            passed.append(arrival)
    assert OperatorDriver(lambda: Throttle(span, False), restore_before).feed(arrivals) == outputs_of(passed)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS)
def test_burst_passes_after_silence(arrivals: Any, restore_before: Any, span: Any) -> None:
    """No element of the key ends less than the span before the newest end."""
    passed: List[Any] = []
    for number, arrival in enumerate(arrivals):
        newest = max(other.end for other in arrivals[: number + 1])
        if not any(other.key == arrival.key and other.end > newest - span for other in arrivals[:number]):
            passed.append(arrival)
    assert OperatorDriver(lambda: Throttle(span, True), restore_before).feed(arrivals) == outputs_of(passed)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS)
def test_change_passes_different_terms(arrivals: Any, restore_before: Any) -> None:
    """An element passes if its term differs from the one of the previous element of its key."""
    passed: List[Any] = []
    for number, arrival in enumerate(arrivals):
        before = [other for other in arrivals[:number] if other.key == arrival.key]
        if not before or term_key(before[-1].value) != term_key(arrival.value):
            passed.append(arrival)
    assert OperatorDriver(DistinctUntilChanged, restore_before).feed(arrivals) == outputs_of(passed)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS)
def test_change_after_first_passes_no_first_term(arrivals: Any, restore_before: Any) -> None:
    passed: List[Any] = []
    for number, arrival in enumerate(arrivals):
        before = [other for other in arrivals[:number] if other.key == arrival.key]
        if before and term_key(before[-1].value) != term_key(arrival.value):
            passed.append(arrival)
    driver = OperatorDriver(lambda: DistinctUntilChanged(passes_first=False), restore_before)
    assert driver.feed(arrivals) == outputs_of(passed)


def supersedes(other: Any, earlier: Any, span: Any) -> Any:
    """Return whether another element of the key arrived in the span after an element and ends no earlier."""
    return (
        other.number > earlier.number
        and other.key == earlier.key
        and other.end >= earlier.end
        and other.clock_time < earlier.end + span
    )


@few_examples
@given(arrival_lists(st.just(1), max_delay=3), RESTORE_POSITIONS, st.integers(7, 12))
def test_debounce_emits_after_span(arrivals: Any, restore_before: Any, span: int) -> None:
    """An element is emitted a span after its end if no element with the same or a later end arrives meanwhile."""
    settled: List[Any] = []
    for arrival in arrivals:
        newer = any(supersedes(other, arrival, span) for other in arrivals)
        older = any(
            other.number < arrival.number and other.key == arrival.key and other.end > arrival.end
            for other in arrivals
        )
        if not newer and not older:
            settled.append(((arrival.number,), arrival.start, arrival.end + span))
    assert sorted(OperatorDriver(lambda: Debounce(span), restore_before).feed(arrivals)) == sorted(settled)


@few_examples
@given(PUNCTUAL_ARRIVAL_LISTS, SPANS)
def test_debounce_of_elements_in_order(arrivals: Any, span: Any) -> None:
    settled = [
        ((arrival.number,), arrival.start, arrival.end + span)
        for arrival in arrivals
        if not any(supersedes(other, arrival, span) for other in arrivals)
    ]
    outputs = OperatorDriver(lambda: Debounce(span)).feed(arrivals)
    assert sorted(outputs) == sorted(settled)
    assert [end for _, _, end in outputs] == sorted(end for _, _, end in outputs)


ROWS_WITH_ENDS_AHEAD = st.lists(
    st.tuples(st.sampled_from("ab"), st.integers(0, 3), st.integers(-6, 12)), max_size=20
)


@few_examples
@given(ROWS_WITH_ENDS_AHEAD, RESTORE_POSITIONS, SPANS)
def test_debounce_of_ends_ahead_of_clock(rows: Any, restore_before: Any, span: Any) -> None:
    """An element waits a span from its end; an element of its key that ends in this span cancels it."""
    clock_time = 20
    arrivals: List[Any] = []
    waiting: List[Any] = []
    settled: List[Any] = []
    for number, (key, step, ahead) in enumerate(rows):
        clock_time += step
        arrivals.append(Arrival(number, key, clock_time + ahead, clock_time + ahead, 1, 0, clock_time))
    for arrival in arrivals:
        settled += [other for other in waiting if other.end + span <= arrival.clock_time]
        waiting = [other for other in waiting if other.end + span > arrival.clock_time]
        same = [other for other in waiting if other.key == arrival.key]
        cancelled = [other for other in same if other.end <= arrival.end < other.end + span]
        waiting = [other for other in waiting if other not in cancelled]
        if arrival.end + span > arrival.clock_time and not any(
            arrival.end < other.end < arrival.end + span for other in same
        ):
            waiting.append(arrival)
    expected = [((arrival.number,), arrival.start, arrival.end + span) for arrival in settled + waiting]
    assert sorted(OperatorDriver(lambda: Debounce(span), restore_before).feed(arrivals)) == sorted(expected)


def stored_keys(operator: Any) -> List[Any]:
    """Return the keys of the elements in the state of an operator."""
    *_, stored = operator.snapshot().values()
    return [getattr(item, "element", item).key_values for item in stored]


def test_oldest_key_is_dropped_first() -> None:
    for operator in (Throttle(100, False), Throttle(100, True), DistinctUntilChanged(), Debounce(100)):
        for number in range(5):
            operator.process(
                element_of(Arrival(number, f"k{number}", number, number, 1, 0, number)), number, 0
            )
        for remaining in (4, 3, 2):
            operator.drop_oldest()
            assert len(operator) == remaining
        assert stored_keys(operator) == [("k3",), ("k4",)]


def test_oldest_key_is_dropped_after_updates() -> None:
    """Entries of a key that were replaced do not delay the eviction."""
    for operator in (Throttle(1000, True), Debounce(1000)):
        for number in range(20):
            operator.process(
                element_of(Arrival(number, "ab"[number % 2], number, number, 1, 0, number)), number, 0
            )
        operator.drop_oldest()
        assert stored_keys(operator) == [("b",)]
        operator.drop_oldest()
        assert len(operator) == 0
        assert operator.next_deadline is None


def test_operator_state_stays_small() -> None:
    """The state stays small for a thousand keys one after the other, and for one key a thousand times."""
    for span in (3, 10_000):
        for operator in (Throttle(span, False), Throttle(span, True), Debounce(span)):
            for number in range(1000):
                key = f"k{number}" if span == 3 else "k"
                operator.advance_to(number)
                operator.process(element_of(Arrival(number, key, number, number, 1, 0, number)), number, 0)
            assert len(operator) <= 3
            assert entry_count(operator) <= 80


def test_timestamp_far_ahead_expires_no_key() -> None:
    operator = Throttle(5, False)
    operator.compute_max_timestamp = lambda: 100
    assert operator.process(element_of(Arrival(0, "a", 50, 50, 1, 0, 50)), 50, 0)
    assert operator.process(element_of(Arrival(1, "b", 9000, 9000, 1, 0, 51)), 51, 0)
    assert not operator.process(element_of(Arrival(2, "a", 52, 52, 1, 0, 52)), 52, 0)
