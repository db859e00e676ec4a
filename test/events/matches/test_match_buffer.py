"""Match buffers: order of arrival, partners by time, and changes during iteration."""

from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reachability import reachable

from retalis import Var, atom
from retalis.events.matches import match_buffer
from retalis.events.matches.interval_index import IntervalIndex, interval_bounds
from retalis.events.matches.match_buffer import MatchBuffer
from retalis.events.matches.match_types import PartialMatch


class Rule:
    """What a place wants of its rule."""

    order = 0
    stored_match_count = 0

    def count_stored(self, match, span):
        """Count it."""
        self.stored_match_count += 1


@pytest.fixture
def buffer():
    """Return a place of the left side of ``meets``, with one shared variable."""
    buffer = MatchBuffer(Rule(), (0,))
    buffer.partner_bounds = interval_bounds("meets", None, False)
    return buffer


def wait(buffer, value, start, end):
    """Let a match wait."""
    match = PartialMatch((value,), start, end, None, atom("p"), None)
    buffer.add(match, buffer.key_of(match))
    return match


def ends(found):
    """Return the ends of matches."""
    return [match.end for match in found]


@pytest.mark.parametrize("number", [10, 500])
def test_partners_are_those_of_the_key_at_the_right_time(buffer, number):
    for at in range(number):
        wait(buffer, at % 2, at, at + 2)
    wanted = wait(buffer, 1, 4, 7)
    assert [match.start for match in buffer.partners(1, 7, 9, False)] == [5, 4]
    assert next(buffer.partners(1, 7, 9, True)) is wanted
    assert ends(buffer.partners(1, 8, 9, True)) == []
    assert ends(buffer.partners(2, 7, 9, True)) == []


def test_far_matches_are_found_by_time_once_many_are_not_in_time(buffer):
    for at in range(1000):
        wait(buffer, 0, at, at)
    assert ends(buffer.partners(0, 999, 999, True)) == [999] and reachable(buffer, IntervalIndex)
    assert ends(buffer.partners(0, 500, 500, False)) == [500]
    for match in buffer.stored_matches()[:999]:
        match.discard()
    assert ends(buffer.partners(0, 999, 999, True)) == [999]
    assert buffer.rule.stored_match_count == 1


def test_an_index_goes_when_it_is_not_used(buffer):
    for at in range(100):
        wait(buffer, 0, at, at)
    assert ends(buffer.partners(0, 3, 3, True)) == [3]
    assert reachable(buffer, IntervalIndex)
    for at in range(200):
        wait(buffer, 0, at, at)
    assert not reachable(buffer, IntervalIndex)
    assert ends(buffer.partners(0, 3, 3, True)) == [3, 3]


def test_a_place_forgets_a_key_without_matches(buffer):
    matches = [wait(buffer, 0, at, at) for at in range(3)]
    for match in (matches[1], matches[0], matches[2]):
        match.discard()
    assert buffer.newest == {} and buffer.stored_matches() == []


@pytest.mark.parametrize("few", [0, 32])
@pytest.mark.parametrize("newest", [False, True])
def test_matches_may_come_and_go_while_partners_are_looked_at(buffer, monkeypatch, few, newest):
    monkeypatch.setattr(match_buffer, "MAX_MISSES_BEFORE_INDEX", few)
    matches = [wait(buffer, 0, at, 50 if at % 3 else at) for at in range(30)]
    expected = [at for at in range(30) if at % 3]
    if newest:
        expected.reverse()
    found = []
    for match in buffer.partners(0, 50, 60, newest):
        found.append(match.start)
        if len(found) == 3:
            for gone in (found[2], expected[3], expected[5]):
                matches[gone].discard()
            wait(buffer, 0, 99, 50)
    assert found == [*expected[:3], expected[4], *expected[6:]]


def test_matches_with_variables_are_partners_of_every_key(buffer):
    wait(buffer, 1, 1, 5)
    wait(buffer, Var(), 2, 5)
    wait(buffer, 1, 3, 5)
    assert [match.start for match in buffer.partners(1, 5, 5, False)] == [1, 2, 3]
    assert [match.start for match in buffer.partners(1, 5, 5, True)] == [3, 2, 1]
    assert [match.start for match in buffer.partners(7, 5, 5, True)] == [2]
    assert [match.start for match in buffer.partners(None, 5, 5, True)] == [3, 2, 1]


def test_the_newest_of_a_name_replaces_the_older(buffer):
    buffer.set_identity_function(lambda match: match.term)
    wait(buffer, 2, 1, 5)
    wait(buffer, 2, 2, 5)
    assert [match.start for match in buffer.stored_matches()] == [2]
    assert list(buffer.newest) == [2]


@pytest.mark.parametrize("number", [2, 50])
def test_among_many_of_a_key_the_one_of_the_same_name_is_replaced(buffer, number):
    buffer.set_identity_function(lambda match: match.start % number)
    for at in range(number * 3):
        wait(buffer, 0, at, 5)
        assert len(buffer.stored_matches()) == min(at + 1, number)
    assert [match.start for match in buffer.stored_matches()] == list(range(number * 2, number * 3))
    buffer.set_identity_function(None)
    wait(buffer, 0, 0, 5)
    assert len(buffer.stored_matches()) == number + 1


@pytest.mark.parametrize("newest", [False, True])
def test_a_partner_that_goes_while_the_one_before_it_is_looked_at_is_passed_over(buffer, newest):
    matches = [wait(buffer, 0, at, 50) for at in range(4)]
    expected = [3, 1, 0] if newest else [0, 2, 3]
    found = []
    for match in buffer.partners(0, 50, 60, newest):
        found.append(match.start)
        if len(found) == 1:
            matches[2 if newest else 1].discard()
    assert found == expected


KEYS = st.sampled_from([0, 0, 0, 1, None])
TIMES = st.integers(0, 9)
CHANGES = st.one_of(
    st.tuples(st.just("add"), KEYS, TIMES, TIMES),
    st.tuples(st.just("leave"), TIMES),
    st.tuples(st.just("search"), KEYS, TIMES, st.booleans()),
)


@pytest.mark.parametrize("names", [None, 3])
@pytest.mark.parametrize("operator", [None, "meets", "seq", "during"])
def test_a_buffer_finds_what_a_plain_search_finds(operator, names):
    """Few matches are passed over here before an index by time or by name is made."""
    reach = None if operator is None else interval_bounds(operator, None, True)
    few = patch.multiple(match_buffer, MAX_MISSES_BEFORE_INDEX=3, MAX_MISSES_WITH_INDEX=1)

    @settings(deadline=None, derandomize=True, max_examples=60)
    @given(st.lists(CHANGES, min_size=10, max_size=50))
    def changes(steps):
        buffer = MatchBuffer(Rule(), (0,))
        buffer.partner_bounds = reach
        if names is not None:
            buffer.set_identity_function(lambda match: (match.key, match.start % names))
        waiting = []
        for step, *values in steps:
            if step == "add":
                key, start, length = values
                if names is not None:
                    waiting = [one for one in waiting if (one.key, one.start % names) != (key, start % names)]
                waiting.append(wait(buffer, Var() if key is None else key, start, start + length))
            elif step == "leave":
                for match in waiting[values[0] : values[0] + 1]:
                    match.discard()
                    waiting.remove(match)
            else:
                key, start, newest = values
                limits = None if reach is None or key is None else reach.limits(start, start + 2)
                found = [one for one in waiting if fits(one, key, limits)]
                assert list(buffer.partners(key, start, start + 2, newest)) == found[:: -1 if newest else 1]
                assert [one for one in waiting if one.key == key] == buffer.matches_of_key(key)
            assert buffer.rule.stored_match_count == len(waiting)
        assert buffer.stored_matches() == waiting

    with few:
        changes()


def fits(match, key, limits):
    """Return whether a match may be a partner for a key within limits; None for any."""
    if not (key is None or match.key is None or match.key == key):
        return False
    return limits is None or (limits[0] <= match.start <= limits[1] and limits[2] <= match.end <= limits[3])
