"""Absence with a deadline, compared with its definition."""

from typing import Any, Dict, List

from events.streams.operator_driver import Arrival, OperatorDriver, arrival_lists, element_of, entry_count
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.absence_timeout import AbsenceTimeout, Correlation

ARRIVAL_LISTS = arrival_lists(st.just(1), channels=(0, 0, 1))
RESTORE_POSITIONS = st.integers(0, 20)
SPANS = st.integers(1, 12)
few_examples = example_settings(max_examples=40)


def correlation_of(arrivals: Any, all_cancel: Any, open_keys: Any = (), named: bool = False) -> Any:
    """Return a correlation by the keys of arrivals; a match is the number of its arrival."""

    def key(match: Any, channel: Any) -> Any:
        group_key = arrivals[match].key
        return None if group_key in open_keys else group_key

    def cancels(match: Any, other: Any) -> Any:
        first, second = arrivals[match], arrivals[other]
        same_key = first.key == second.key or first.key in open_keys or second.key in open_keys
        return same_key and (all_cancel or (match + other) % 2 == 0)

    name = (lambda match: arrivals[match].key) if named else None
    return Correlation(key, cancels, all_cancel, name)


def expected_outputs(arrivals: Any, span: Any, correlation: Any) -> Any:
    """Return outputs by definition: P, and no Q with eP < sQ and eQ < eP + span that arrived before eP + span."""
    outputs: List[Any] = []
    for arrival in arrivals:
        if arrival.channel or arrival.end + span <= arrival.clock_time:
            continue
        cancelling = [
            other
            for other in arrivals
            if other.channel
            and arrival.end < other.start
            and other.end < arrival.end + span
            and other.clock_time < arrival.end + span
            and correlation.cancels(arrival.number, other.number)
        ]
        if not cancelling:
            outputs.append(((arrival.number,), arrival.start, arrival.end + span))
    return outputs


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS)
def test_absence_for_equal_keys(arrivals: Any, restore_before: Any, span: Any) -> None:
    correlation = correlation_of(arrivals, True)
    driver = OperatorDriver(lambda: AbsenceTimeout(span, correlation), restore_before)
    assert sorted(driver.feed(arrivals)) == sorted(expected_outputs(arrivals, span, correlation))
    late = [
        arrival for arrival in arrivals if not arrival.channel and arrival.end + span <= arrival.clock_time
    ]
    assert restore_before < len(arrivals) or driver.operator.late_count == len(late)


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS)
def test_absence_with_condition(arrivals: Any, restore_before: Any, span: Any) -> None:
    correlation = correlation_of(arrivals, False)
    outputs = OperatorDriver(lambda: AbsenceTimeout(span, correlation), restore_before).feed(arrivals)
    assert sorted(outputs) == sorted(expected_outputs(arrivals, span, correlation))


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS, st.booleans())
def test_absence_with_open_keys(arrivals: Any, restore_before: Any, span: Any, all_cancel: bool) -> None:
    """An element with an unbound key is compared with all elements."""
    correlation = correlation_of(arrivals, all_cancel, open_keys=("b",))
    outputs = OperatorDriver(lambda: AbsenceTimeout(span, correlation), restore_before).feed(arrivals)
    assert sorted(outputs) == sorted(expected_outputs(arrivals, span, correlation))


def outputs_of_latest_ends(arrivals: Any, span: Any) -> Any:
    """Return the outputs if of the waiting elements with one key only the one that ends last is kept."""
    waiting: Dict[Any, Any] = {}
    outputs: List[Any] = []
    for arrival in [*arrivals, Arrival(-1, "", 0, 0, 1, 1, 1 << 40)]:
        for key, other in list(waiting.items()):
            if other.end + span <= arrival.clock_time:
                outputs.append(((other.number,), other.start, other.end + span))
                del waiting[key]
        if arrival.number < 0:
            break
        other = waiting.get(arrival.key)
        if arrival.channel:
            if other is not None and other.end < arrival.start and arrival.end < other.end + span:
                del waiting[arrival.key]
        elif (
            arrival.end + span > arrival.clock_time
            and (other is None or other.end <= arrival.end)
            and not any(
                earlier.channel
                and earlier.key == arrival.key
                and arrival.end < earlier.start
                and earlier.end < arrival.end + span
                for earlier in arrivals[: arrival.number]
            )
        ):
            waiting[arrival.key] = arrival
    return outputs


@few_examples
@given(ARRIVAL_LISTS, RESTORE_POSITIONS, SPANS)
@example([Arrival(0, "a", 20, 20, 1, 0, 20), Arrival(1, "a", 19, 19, 1, 0, 20)], 0, 2)
def test_later_end_replaces_earlier_one(arrivals: Any, restore_before: Any, span: Any) -> None:
    """Whichever of the two arrives first, as long as the earlier one still waits."""
    correlation = correlation_of(arrivals, True, named=True)
    outputs = OperatorDriver(lambda: AbsenceTimeout(span, correlation), restore_before).feed(arrivals)
    assert sorted(outputs) == sorted(outputs_of_latest_ends(arrivals, span))


def operator_after(span: int, arrivals: Any) -> AbsenceTimeout:
    """Return an operator that has processed the arrivals."""
    operator = AbsenceTimeout(span, correlation_of(arrivals, True))
    for arrival in arrivals:
        operator.advance_to(arrival.clock_time)
        operator.process(element_of(arrival), arrival.clock_time, arrival.channel)
    return operator


def test_forbidden_elements_expire() -> None:
    """Of the forbidden elements of one key, two are enough for each span of time."""
    arrivals = [Arrival(number, "a", number, number, 1, 1, number) for number in range(2000)]
    operator = operator_after(100, arrivals)
    assert len(operator) <= 5
    assert entry_count(operator) <= 110
    operator.process(element_of(arrivals[0]), 10_000, 0)
    assert len(operator) == 0


def test_forbidden_elements_with_condition_expire() -> None:
    """If a condition decides about cancelling, all forbidden elements of the span are stored, and few more."""
    arrivals = [Arrival(number, "a", number, number, 1, 1, number) for number in range(2000)]
    operator = AbsenceTimeout(300, correlation_of(arrivals, False))
    for arrival in arrivals:
        operator.process(element_of(arrival), arrival.clock_time, arrival.channel)
        assert len(operator) == min(arrival.number + 1, 300)
    (frontier,) = operator._forbidden.values()  # noqa: SLF001
    assert frontier.element_count == 300
    assert len(frontier.elements) <= 600
    operator.process(element_of(arrivals[0]), 2270, 0)
    assert len(operator) == len(frontier.elements) == 29
    operator.process(element_of(arrivals[0]), 9000, 0)
    assert len(operator) == 0
    assert not operator._forbidden  # noqa: SLF001


def test_cancelled_elements_leave_the_heap() -> None:
    arrivals = [Arrival(number, "a", number, number, 1, number % 2, number) for number in range(2000)]
    operator = operator_after(1 << 30, arrivals)
    assert entry_count(operator) <= 160


def test_redundant_elements_are_not_counted() -> None:
    arrivals = [Arrival(number, "a", number, number, 1, 1, number) for number in range(10)]
    operator = operator_after(1000, arrivals)
    for remaining in range(len(operator) - 1, -1, -1):
        operator.drop_oldest()
        assert len(operator) == remaining


def test_oldest_waiting_element_is_dropped_first() -> None:
    arrivals = [
        Arrival(number, f"k{number}", number, number, 1, int(number > 2), number) for number in range(5)
    ]
    operator = operator_after(1000, arrivals)
    for remaining in range(4, -1, -1):
        operator.drop_oldest()
        assert len(operator) == remaining
    assert operator.next_deadline is None
