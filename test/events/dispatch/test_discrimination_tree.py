"""Discrimination trees: served listeners, their order, and skipped ones."""

import pytest

from retalis import Var, functor, make_list
from retalis.events.dispatch.discrimination_tree import make_plan, matches_all_events

P = functor("p", 2)


class Listener:
    """A listener that counts how often its pattern is looked at."""

    def __init__(self, order, pattern):
        self.order = order
        self.matcher = self.action = order
        self.looks = 0
        self._pattern = pattern

    @property
    def pattern(self):
        self.looks += 1
        return self._pattern


def served(plan, term):
    """Return the orders of the listeners that a plan leaves for an event."""
    while hasattr(plan, "branch"):
        plan = plan.branch(term)
    return [order for order, _ in plan]


def test_branches_hold_those_with_the_constant_and_those_with_a_variable_in_order():
    patterns = [(P, 1, 2), (P, Var(), 2), (P, 1, Var()), (P, 2, 2), (P, Var(), Var()), (P, 1, 2)]
    plan = make_plan([Listener(at, pattern) for at, pattern in enumerate(patterns)])
    assert served(plan, (P, 1, 2)) == [0, 1, 2, 4, 5]
    assert served(plan, (P, 2, 2)) == [1, 3, 4]
    assert served(plan, (P, 3, 2)) == [1, 4]
    assert served(plan, (P, 1, 9)) == [2, 4]
    assert served(plan, (P, Var(), 2)) == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("arity", range(1, 7))
def test_up_to_six_constants_choose_the_listeners(arity):
    """More would be tested by the matchers of all listeners that are left, however many they are."""
    key = functor("q", arity)
    constants = [5] * (arity - 1)
    plan = make_plan([Listener(at, (key, *constants, at)) for at in range(100)])
    assert served(plan, (key, *constants, 7)) == [7]
    assert served(plan, (key, *constants, 100)) == []
    nested = make_plan([Listener(at, (P, Var(), (P, 5, (P, 5, at)))) for at in range(100)])
    assert served(nested, (P, 1, (P, 5, (P, 5, 7)))) == [7]


def test_a_new_constant_looks_at_its_own_listeners_only():
    listeners = [Listener(at, (P, at, Var())) for at in range(100)]
    plan = make_plan(listeners)
    before = [listener.looks for listener in listeners]
    assert served(plan, (P, 7, 1)) == [7]
    assert [at for at, listener in enumerate(listeners) if listener.looks > before[at]] == [7]


def test_a_pattern_is_looked_at_however_deep_its_arguments_are():
    """The hash of a tuple that is 400,000 deep ended the process."""
    deep = make_list(list(range(400_000)))
    assert not matches_all_events(functor("ev", 1)(deep))
    one, other = Var(), Var()
    assert matches_all_events(functor("ev", 2)(one, other))
    assert not matches_all_events(functor("ev", 2)(one, one))
