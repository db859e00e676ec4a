"""Shared run buffers: equality is independent of their division."""

import pytest

from retalis import atom
from retalis.events.matches.match_types import PartialMatch
from retalis.events.matches.shared_run_buffer import BufferSlice, SharedLog, repetitions


def events(names):
    """Return a match for each of some event names."""
    return [PartialMatch((), at, at, at, atom(name), None) for at, name in enumerate(names)]


def chain(*pieces):
    """Return a chain of pieces, each ``(names, begin, end)``."""
    return BufferSlice(tuple((SharedLog(events(names)), begin, end) for names, begin, end in pieces))


@pytest.mark.parametrize(
    "pieces", [[("ab", 0, 2)], [("xab", 1, 3)], [("abx", 0, 2)], [("xax", 1, 2), ("b", 0, 1)]]
)
def test_chains_of_the_same_terms_are_equal_in_any_pieces(pieces):
    assert chain(*pieces) == chain(("ab", 0, 2))
    assert hash(chain(*pieces)) == hash(chain(("ab", 0, 2)))


@pytest.mark.parametrize("pieces", [[("ba", 0, 2)], [("ab", 0, 1)], [("abc", 1, 3)]])
def test_chains_of_other_terms_differ(pieces):
    assert chain(*pieces) != chain(("ab", 0, 2))


def test_the_hash_of_a_log_that_has_grown_is_that_of_its_repetitions():
    log = SharedLog(events("a"))
    assert hash(BufferSlice(((log, 0, 1),))) == hash(chain(("a", 0, 1)))
    log.items += events("bc")
    assert BufferSlice(((log, 1, 3),)) == chain(("bc", 0, 2))


@pytest.mark.parametrize("number", [1, 2, 5])
def test_the_repetitions_of_a_match_that_was_joined_one_by_one(number):
    made = events("abcde")[:number]
    match = made[0]
    for last in made[1:]:
        match = PartialMatch((), 0, last.end, None, None, (match, last))
    assert repetitions(match, number) == made


@pytest.mark.parametrize("number", [2, 5])
def test_the_repetitions_of_a_match_that_has_a_chain(number):
    made, (last,) = events("abcde")[:number], events("x")
    match = PartialMatch((), 0, number, None, None, (BufferSlice(((SharedLog(made), 0, number),)),))
    assert repetitions(match, number) == made
    assert repetitions(PartialMatch((), 0, 9, None, None, (match, last)), number + 1) == [*made, last]
