"""Where matches wait: order of arrival, partners by time, and changes under way."""

import pytest

from retalis.events.matches import Match, Place, places, reach_of
from retalis.prolog.terms import Var, atom


class Rule:
    """What a place wants of its rule."""

    order = 0
    waiting = 0

    def keep(self, match, span):
        """Count it."""
        self.waiting += 1


@pytest.fixture
def place():
    """Return a place of the left side of ``meets``, with one shared variable."""
    place = Place(Rule(), (0,))
    place.reach = reach_of("meets", None, False)
    return place


def wait(place, value, start, end):
    """Let a match wait."""
    match = Match((value,), start, end, None, atom("p"), None)
    place.add(match, place.key_of(match))
    return match


def ends(found):
    """Return the ends of matches."""
    return [match.end for match in found]


@pytest.mark.parametrize("number", [10, 500])
def test_partners_are_those_of_the_key_at_the_right_time(place, number):
    for at in range(number):
        wait(place, at % 2, at, at + 2)
    wanted = wait(place, 1, 4, 7)
    assert [match.start for match in place.partners(1, 7, 9, False)] == [5, 4]
    assert next(place.partners(1, 7, 9, True)) is wanted
    assert ends(place.partners(1, 8, 9, True)) == []
    assert ends(place.partners(2, 7, 9, True)) == []


def test_far_matches_are_found_by_time_once_many_are_not_in_time(place):
    for at in range(1000):
        wait(place, 0, at, at)
    assert ends(place.partners(0, 999, 999, True)) == [999] and 0 in place._indices
    assert ends(place.partners(0, 500, 500, False)) == [500]
    for match in place.all()[:999]:
        match.leave()
    assert ends(place.partners(0, 999, 999, True)) == [999]
    assert place.rule.waiting == 1


def test_an_index_goes_when_it_is_not_used(place):
    for at in range(100):
        wait(place, 0, at, at)
    assert ends(place.partners(0, 3, 3, True)) == [3]
    assert 0 in place._indices
    for at in range(200):
        wait(place, 0, at, at)
    assert 0 not in place._indices
    assert ends(place.partners(0, 3, 3, True)) == [3, 3]


def test_a_place_forgets_a_key_without_matches(place):
    matches = [wait(place, 0, at, at) for at in range(3)]
    for match in (matches[1], matches[0], matches[2]):
        match.leave()
    assert place.newest == {} and place.all() == []


@pytest.mark.parametrize("few", [0, 32])
@pytest.mark.parametrize("newest", [False, True])
def test_matches_may_come_and_go_while_partners_are_looked_at(place, monkeypatch, few, newest):
    monkeypatch.setattr(places, "_FEW", few)
    matches = [wait(place, 0, at, 50 if at % 3 else at) for at in range(30)]
    expected = [at for at in range(30) if at % 3]
    if newest:
        expected.reverse()
    found = []
    for match in place.partners(0, 50, 60, newest):
        found.append(match.start)
        if len(found) == 3:
            for gone in (found[2], expected[3], expected[5]):
                matches[gone].leave()
            wait(place, 0, 99, 50)
    assert found == [*expected[:3], expected[4], *expected[6:]]


def test_matches_with_variables_are_partners_of_every_key(place):
    wait(place, 1, 1, 5)
    wait(place, Var(), 2, 5)
    wait(place, 1, 3, 5)
    assert [match.start for match in place.partners(1, 5, 5, False)] == [1, 2, 3]
    assert [match.start for match in place.partners(1, 5, 5, True)] == [3, 2, 1]
    assert [match.start for match in place.partners(7, 5, 5, True)] == [2]
    assert [match.start for match in place.partners(None, 5, 5, True)] == [3, 2, 1]


def test_the_newest_of_a_name_replaces_the_older(place):
    place.identify(lambda match: match.term)
    wait(place, 2, 1, 5)
    wait(place, 2, 2, 5)
    assert [match.start for match in place.all()] == [2]
    assert list(place.newest) == [2]


@pytest.mark.parametrize("number", [2, 50])
def test_among_many_of_a_key_the_one_of_the_same_name_is_replaced(place, number):
    place.identify(lambda match: match.start % number)
    for at in range(number * 3):
        wait(place, 0, at, 5)
        assert len(place.all()) == min(at + 1, number)
    assert [match.start for match in place.all()] == list(range(number * 2, number * 3))
    place.identify(None)
    wait(place, 0, 0, 5)
    assert len(place.all()) == number + 1
