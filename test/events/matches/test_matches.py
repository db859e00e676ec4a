"""Identities of matches: equal for the same event terms only."""

import pytest

from retalis.events.matches.matches import Identity


@pytest.mark.parametrize(
    "other",
    [
        Identity((1, Identity((2, "b")))),
        Identity((1, Identity((2, "a", 3)))),
        Identity((1, 2)),
        Identity((1,)),
        1,
    ],
)
def test_identities_of_other_parts_differ(other):
    nested = Identity((1, Identity((2, "a"))))
    assert nested != other
    assert Identity((other, 1)) != Identity((nested, 1))


def test_identities_of_the_same_parts_are_equal():
    first, second = (Identity((1, Identity((2, "a")))) for _ in range(2))
    assert first == second
    assert hash(first) == hash(second)
