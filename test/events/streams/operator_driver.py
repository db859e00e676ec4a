"""Driver of one stream operator for tests: feeds arrivals and runs due deadlines before each of them."""

from collections import deque
from typing import Any, List, NamedTuple, Tuple

from hypothesis import strategies as st

from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.stream_operators import StreamElement

END_OF_TIME = 1 << 40
"""An instant after all deadlines of a test."""


class Arrival(NamedTuple):
    """An element of the input, and the time of the clock at its arrival.

    Attributes:
        number: position in the input.
        key: group of the element.
        start: start of its interval.
        end: end of its interval; earlier than `clock_time` if the element is late.
        value: measured value.
        channel: operand of the operator that receives the element.
        clock_time: time of the clock at the arrival.
    """

    number: int
    key: str
    start: int
    end: int
    value: object
    channel: int
    clock_time: int


def arrival_lists(values: Any, max_delay: int = 12, channels: Any = (0,), max_size: int = 25) -> Any:
    """Return a strategy for lists of arrivals in order, or up to ``max_delay`` late."""
    row = st.tuples(
        st.sampled_from("aab"),
        st.integers(0, 3),  # step of the clock since the previous arrival
        # Most elements are in order: three of six delays are 0.
        st.sampled_from([0, 0, 0, min(1, max_delay), min(2, max_delay), max_delay]),
        st.integers(0, 3),  # length of the interval
        values,
        st.sampled_from(channels),
    )
    return st.lists(row, max_size=max_size).map(_arrivals_of_rows)


def _arrivals_of_rows(rows: Any) -> Any:
    arrivals, clock_time = [], 20
    for number, (key, step, delay, length, value, channel) in enumerate(rows):
        clock_time += step
        end = clock_time - delay
        arrivals.append(Arrival(number, key, end - length, end, value, channel, clock_time))
    return arrivals


def element_of(arrival: Any) -> StreamElement:
    """Return the stream element of an arrival; its match is the number of the arrival."""
    return StreamElement(arrival.number, arrival.start, arrival.end, (arrival.key,), (arrival.value,))


def list_accumulators() -> List[Any]:
    """Return the accumulators of a window that collects all values."""
    return [AGGREGATES["list"].make_accumulator(0, None)]


class OperatorDriver:
    """Feed one operator, and collect its outputs: the numbers of the elements, start, end.

    Args:
        make_operator: creates the operator.
        restore_before: number of the arrival before which the operator is replaced by one that is restored from its
            snapshot; never by default.
    """

    def __init__(self, make_operator: Any, restore_before: Any = None) -> None:
        self.make_operator = make_operator
        self.restore_before = restore_before
        self.operator = self._create()
        self.outputs: List[Any] = []

    def _create(self) -> Any:
        operator = self.make_operator()
        operator.tracks_elements = True
        return operator

    def feed(self, arrivals: Any) -> Any:
        """Process all arrivals, then all deadlines that remain, and return the outputs."""
        for number, arrival in enumerate(arrivals):
            self.advance_to(arrival.clock_time)
            if number == self.restore_before:
                restored = self._create()
                restored.restore(self.operator.snapshot())
                self.operator = restored
            self.outputs += map(
                _described, self.operator.process(element_of(arrival), arrival.clock_time, arrival.channel)
            )
        self.advance_to(END_OF_TIME)
        return self.outputs

    def advance_to(self, instant: Any) -> None:
        """Run the deadlines of the operator up to an instant, each at its own time."""
        while self.operator.next_deadline is not None and self.operator.next_deadline <= instant:
            deadline = self.operator.next_deadline
            self.outputs += sorted(map(_described, self.operator.advance_to(deadline)))
            # A deadline that is not consumed would run forever.
            assert self.operator.next_deadline is None or self.operator.next_deadline > deadline


def entry_count(container: Any) -> int:
    """Return the number of entries in all lists, queues and dictionaries that are attributes of an object."""
    attributes = [getattr(container, name) for name in getattr(container, "__slots__", ())]
    attributes = attributes or vars(container).values()
    return sum(len(value) for value in attributes if isinstance(value, (list, deque, dict)))


def _described(output: Any) -> Tuple[Any, ...]:
    return tuple([element.match for element in output.elements]), output.start, output.end


def expected_output(window: Any) -> Tuple[Any, ...]:
    """Return the output for arrivals that are aggregated together: numbers, first start, last end."""
    return (
        tuple([arrival.number for arrival in window]),
        min(arrival.start for arrival in window),
        max(arrival.end for arrival in window),
    )
