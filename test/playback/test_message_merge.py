"""Merge of the messages of several files by time."""

from functools import partial
from typing import Any, Callable, Iterator, List, Set, Tuple

from hypothesis import given
from hypothesis import strategies as st

from retalis.playback.message_merge import merge_by_time


def make_sources(
    times_by_source: Any, open_sources: Any = None
) -> List[Tuple[int, Callable[[], Iterator[Tuple[int, int, bytes]]]]]:
    """Return sources of messages for `merge_by_time`, sorted by their first time."""

    def read(number: Any, times: Any) -> Iterator[Any]:
        if open_sources is not None:
            open_sources.add(number)
        for position, time in enumerate(times):
            yield number, time, b"%d" % position
        if open_sources is not None:
            open_sources.discard(number)

    ordered = sorted((sorted(times) for times in times_by_source), key=lambda times: times[:1])
    return [(times[0] if times else 0, partial(read, number, times)) for number, times in enumerate(ordered)]


@given(st.lists(st.lists(st.integers(0, 12), max_size=6), max_size=6))
def test_merge_sorts_messages_by_time(times_by_source: List[Any]) -> None:
    merged: List[Any] = list(merge_by_time(make_sources(times_by_source)))
    sources = [list(read()) for _, read in make_sources(times_by_source)]
    # A stable sort keeps messages with equal times in the order of their sources.
    assert merged == sorted((message for source in sources for message in source), key=lambda item: item[1])


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 5)), max_size=8))
def test_only_overlapping_sources_are_open(intervals: List[Any]) -> None:
    ranges = [range(start, start + length + 1) for start, length in intervals]
    open_sources: Set[Any] = set()
    for _, time, _ in merge_by_time(make_sources(ranges, open_sources)):
        assert len(open_sources) <= sum(times[0] <= time <= times[-1] for times in ranges)
