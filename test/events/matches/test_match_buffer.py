"""Match buffers: order of arrival, partners by time, and changes during iteration."""

from typing import Any, Dict, List, Optional
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reachable_objects import reachable

from retalis import Var, atom
from retalis.events.matches import match_buffer
from retalis.events.matches.interval_index import IntervalIndex, interval_bounds
from retalis.events.matches.match_buffer import MatchBuffer
from retalis.events.matches.match_types import PartialMatch


class Rule:
    """The attributes of a rule that a buffer reads."""

    order = 0
    stored_match_count = 0

    def count_stored(self, match: Any, span: Any) -> None:
        """Count a stored match."""
        self.stored_match_count += 1


def rule_of_buffer() -> Any:
    return Rule()


@pytest.fixture
def buffer() -> Any:
    """Return a buffer of the left side of ``meets``, with one shared variable."""
    buffer = MatchBuffer(rule_of_buffer(), (0,))
    buffer.partner_bounds = interval_bounds("meets", None, False)
    return buffer


def store_match(buffer: Any, value: Any, start: int, end: int) -> Any:
    """Store a match with a value in the buffer, and return it."""
    match = PartialMatch((value,), start, end, None, atom("p"), None)
    buffer.add(match, buffer.key_of(match))
    return match


def ends(matches: Any) -> List[Any]:
    """Return the ends of matches."""
    return [match.end for match in matches]


@pytest.mark.parametrize("match_count", [10, 500])
def test_partners_have_key_and_time(buffer: Any, match_count: int) -> None:
    for position in range(match_count):
        store_match(buffer, position % 2, position, position + 2)
    expected = store_match(buffer, 1, 4, 7)
    assert [match.start for match in buffer.partners(1, 7, 9, False)] == [5, 4]
    assert next(buffer.partners(1, 7, 9, True)) is expected
    assert ends(buffer.partners(1, 8, 9, True)) == []
    assert ends(buffer.partners(2, 7, 9, True)) == []


def test_index_is_created_after_many_misses(buffer: Any) -> None:
    for position in range(1000):
        store_match(buffer, 0, position, position)
    assert ends(buffer.partners(0, 999, 999, True)) == [999]
    assert reachable(buffer, IntervalIndex)
    assert ends(buffer.partners(0, 500, 500, False)) == [500]
    for match in buffer.stored_matches()[:999]:
        match.discard()
    assert ends(buffer.partners(0, 999, 999, True)) == [999]
    assert buffer.rule.stored_match_count == 1


def test_unused_index_is_removed(buffer: Any) -> None:
    for position in range(100):
        store_match(buffer, 0, position, position)
    assert ends(buffer.partners(0, 3, 3, True)) == [3]
    assert reachable(buffer, IntervalIndex)
    for position in range(200):
        store_match(buffer, 0, position, position)
    assert not reachable(buffer, IntervalIndex)
    assert ends(buffer.partners(0, 3, 3, True)) == [3, 3]


def test_key_without_matches_is_removed(buffer: Any) -> None:
    matches = [store_match(buffer, 0, position, position) for position in range(3)]
    for match in (matches[1], matches[0], matches[2]):
        match.discard()
    assert buffer.newest == {}
    assert buffer.stored_matches() == []


@pytest.mark.parametrize("max_misses", [0, 32])
@pytest.mark.parametrize("newest", [False, True])
def test_buffer_may_change_during_iteration(
    buffer: Any, monkeypatch: pytest.MonkeyPatch, max_misses: int, newest: bool
) -> None:
    monkeypatch.setattr(match_buffer, "MAX_MISSES_BEFORE_INDEX", max_misses)
    matches = [store_match(buffer, 0, position, 50 if position % 3 else position) for position in range(30)]
    expected = [position for position in range(30) if position % 3]
    if newest:
        expected.reverse()
    starts: List[Any] = []
    for match in buffer.partners(0, 50, 60, newest):
        starts.append(match.start)
        if len(starts) == 3:
            for removed in (starts[2], expected[3], expected[5]):
                matches[removed].discard()
            store_match(buffer, 0, 99, 50)
    assert starts == [*expected[:3], expected[4], *expected[6:]]


def test_matches_with_variables_have_every_key(buffer: Any) -> None:
    store_match(buffer, 1, 1, 5)
    store_match(buffer, Var(), 2, 5)
    store_match(buffer, 1, 3, 5)
    assert [match.start for match in buffer.partners(1, 5, 5, False)] == [1, 2, 3]
    assert [match.start for match in buffer.partners(1, 5, 5, True)] == [3, 2, 1]
    assert [match.start for match in buffer.partners(7, 5, 5, True)] == [2]
    assert [match.start for match in buffer.partners(None, 5, 5, True)] == [3, 2, 1]


def test_newest_match_of_identity_replaces_older(buffer: Any) -> None:
    buffer.set_identity_function(lambda match: match.term)
    store_match(buffer, 2, 1, 5)
    store_match(buffer, 2, 2, 5)
    assert [match.start for match in buffer.stored_matches()] == [2]
    assert list(buffer.newest) == [2]


@pytest.mark.parametrize("match_count", [2, 50])
def test_match_of_same_identity_is_replaced(buffer: Any, match_count: int) -> None:
    buffer.set_identity_function(lambda match: match.start % match_count)
    for position in range(match_count * 3):
        store_match(buffer, 0, position, 5)
        assert len(buffer.stored_matches()) == min(position + 1, match_count)
    assert [match.start for match in buffer.stored_matches()] == list(range(match_count * 2, match_count * 3))
    buffer.set_identity_function(None)
    store_match(buffer, 0, 0, 5)
    assert len(buffer.stored_matches()) == match_count + 1


@pytest.mark.parametrize("newest", [False, True])
def test_partner_removed_during_iteration_is_skipped(buffer: Any, newest: bool) -> None:
    matches = [store_match(buffer, 0, position, 50) for position in range(4)]
    expected = [3, 1, 0] if newest else [0, 2, 3]
    starts: List[Any] = []
    for match in buffer.partners(0, 50, 60, newest):
        starts.append(match.start)
        if len(starts) == 1:
            matches[2 if newest else 1].discard()
    assert starts == expected


KEYS = st.sampled_from([0, 0, 0, 1, None])
TIMES = st.integers(0, 9)
CHANGES = st.one_of(
    st.tuples(st.just("add"), KEYS, TIMES, TIMES),
    st.tuples(st.just("leave"), TIMES),
    st.tuples(st.just("search"), KEYS, TIMES, st.booleans()),
)


@pytest.mark.parametrize("identity_count", [None, 3])
@pytest.mark.parametrize("operator", [None, "meets", "seq", "during"])
def test_buffer_equals_linear_search(operator: Optional[str], identity_count: Optional[int]) -> None:
    """The thresholds are small here, so that indexes by time and by identity are created."""
    bounds = None if operator is None else interval_bounds(operator, None, True)
    limits: Dict[str, Any] = {
        "MAX_MISSES_BEFORE_INDEX": 3,
        "MAX_MISSES_WITH_INDEX": 1,
        "MAX_COMPARED_IDENTITIES": 1,
    }

    @settings(deadline=None, derandomize=True, max_examples=60)
    @given(st.lists(CHANGES, min_size=10, max_size=50))
    def check(steps: List[Any]) -> None:
        buffer = MatchBuffer(rule_of_buffer(), (0,))
        buffer.partner_bounds = bounds
        if identity_count is not None:
            buffer.set_identity_function(lambda match: (match.key, match.start % identity_count))
        matches: List[Any] = []
        for step, *values in steps:
            if step == "add":
                key, start, length = values
                if identity_count is not None:
                    matches = [
                        match
                        for match in matches
                        if (match.key, match.start % identity_count) != (key, start % identity_count)
                    ]
                matches.append(store_match(buffer, Var() if key is None else key, start, start + length))
            elif step == "leave":
                for match in matches[values[0] : values[0] + 1]:
                    match.discard()
                    matches.remove(match)
            else:
                key, start, newest = values
                limits = None if bounds is None or key is None else bounds.limits(start, start + 2)
                expected = [match for match in matches if fits(match, key, limits)]
                assert (
                    list(buffer.partners(key, start, start + 2, newest)) == expected[:: -1 if newest else 1]
                )
                assert [match for match in matches if match.key == key] == buffer.matches_of_key(key)
            assert buffer.rule.stored_match_count == len(matches)
        assert buffer.stored_matches() == matches

    with patch.multiple(match_buffer, **limits):
        check()


def fits(match: Any, key: Any, limits: Any) -> Any:
    """Return whether a match may be a partner for a key within limits; None for any."""
    if not (key is None or match.key is None or match.key == key):
        return False
    return limits is None or (limits[0] <= match.start <= limits[1] and limits[2] <= match.end <= limits[3])
