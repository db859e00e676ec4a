"""Shared run buffers: equality is independent of their division."""

from typing import Any, List, Tuple

import pytest

from retalis import atom
from retalis.events.matches.match_types import PartialMatch
from retalis.events.network.repetition_runs import BufferSlice, SharedLog, repetitions


def events(names: str) -> List[Any]:
    """Return a match for each of some event names."""
    return [
        PartialMatch((), instant, instant, instant, atom(name), None) for instant, name in enumerate(names)
    ]


def chain(*slices: Any) -> BufferSlice:
    """Return a chain of slices, each ``(names, begin, end)``."""
    return BufferSlice(tuple((SharedLog(events(names)), begin, end) for names, begin, end in slices))


@pytest.mark.parametrize(
    "slices", [[("ab", 0, 2)], [("xab", 1, 3)], [("abx", 0, 2)], [("xax", 1, 2), ("b", 0, 1)]]
)
def test_chains_of_equal_terms_are_equal(slices: List[Tuple[Any, ...]]) -> None:
    assert chain(*slices) == chain(("ab", 0, 2))
    assert hash(chain(*slices)) == hash(chain(("ab", 0, 2)))


@pytest.mark.parametrize("slices", [[("ba", 0, 2)], [("ab", 0, 1)], [("abc", 1, 3)]])
def test_chains_of_different_terms_differ(slices: List[Tuple[Any, ...]]) -> None:
    assert chain(*slices) != chain(("ab", 0, 2))


def test_hash_of_slice_is_independent_of_log() -> None:
    log = SharedLog(events("a"))
    assert hash(BufferSlice(((log, 0, 1),))) == hash(chain(("a", 0, 1)))
    log.items += events("bc")
    assert BufferSlice(((log, 1, 3),)) == chain(("bc", 0, 2))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_repetitions_of_nested_match(count: int) -> None:
    matches = events("abcde")[:count]
    match = matches[0]
    for last in matches[1:]:
        match = PartialMatch((), 0, last.end, None, None, (match, last))
    assert repetitions(match, count) == matches


@pytest.mark.parametrize("count", [2, 5])
def test_repetitions_of_match_with_chain(count: int) -> None:
    matches, (last,) = events("abcde")[:count], events("x")
    match = PartialMatch((), 0, count, None, None, (BufferSlice(((SharedLog(matches), 0, count),)),))
    assert repetitions(match, count) == matches
    assert repetitions(PartialMatch((), 0, 9, None, None, (match, last)), count + 1) == [*matches, last]
