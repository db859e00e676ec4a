"""Discrimination trees: chosen listeners, their order, and skipped ones."""

from typing import Any, List, Tuple

import pytest

from retalis import Var, functor, make_list
from retalis.events.dispatch.discrimination_tree import make_plan, matches_all_events

P = functor("p", 2)


class Listener:
    """A listener that counts the reads of its pattern."""

    def __init__(self, order: Any, pattern: Any) -> None:
        self.order = order
        self.matcher = self.action = order
        self.read_count = 0
        self._pattern = pattern

    @property
    def pattern(self) -> Any:
        self.read_count += 1
        return self._pattern


def plan_of(listeners: List[Any]) -> Any:
    """Return the plan of objects of `Listener`."""
    return make_plan(listeners)


def chosen_listeners(plan: Any, term: Tuple[Any, ...]) -> List[Any]:
    """Return the orders of the listeners that a plan chooses for an event."""
    while hasattr(plan, "branch"):
        plan = plan.branch(term)
    return [order for order, _ in plan]


def test_branches_keep_order_of_listeners() -> None:
    patterns = [(P, 1, 2), (P, Var(), 2), (P, 1, Var()), (P, 2, 2), (P, Var(), Var()), (P, 1, 2)]
    plan = plan_of([Listener(order, pattern) for order, pattern in enumerate(patterns)])
    assert chosen_listeners(plan, (P, 1, 2)) == [0, 1, 2, 4, 5]
    assert chosen_listeners(plan, (P, 2, 2)) == [1, 3, 4]
    assert chosen_listeners(plan, (P, 3, 2)) == [1, 4]
    assert chosen_listeners(plan, (P, 1, 9)) == [2, 4]
    assert chosen_listeners(plan, (P, Var(), 2)) == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("arity", range(1, 7))
def test_up_to_six_constants_choose_listeners(arity: int) -> None:
    """Further constants would be tested by the matchers of all remaining listeners."""
    key = functor("q", arity)
    constants = [5] * (arity - 1)
    plan = plan_of([Listener(order, (key, *constants, order)) for order in range(100)])
    assert chosen_listeners(plan, (key, *constants, 7)) == [7]
    assert chosen_listeners(plan, (key, *constants, 100)) == []
    nested = plan_of([Listener(order, (P, Var(), (P, 5, (P, 5, order)))) for order in range(100)])
    assert chosen_listeners(nested, (P, 1, (P, 5, (P, 5, 7)))) == [7]


def test_new_constant_reads_its_listeners_only() -> None:
    listeners = [Listener(order, (P, order, Var())) for order in range(100)]
    plan = plan_of(listeners)
    counts_before = [listener.read_count for listener in listeners]
    assert chosen_listeners(plan, (P, 7, 1)) == [7]
    assert [
        order for order, listener in enumerate(listeners) if listener.read_count > counts_before[order]
    ] == [7]


def test_deep_pattern_is_classified() -> None:
    """The hash of a tuple that is nested 400,000 deep would end the process."""
    deep = make_list(list(range(400_000)))
    assert not matches_all_events(functor("ev", 1)(deep))
    first, second = Var(), Var()
    assert matches_all_events(functor("ev", 2)(first, second))
    assert not matches_all_events(functor("ev", 2)(first, first))
