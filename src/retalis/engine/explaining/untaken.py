"""Why a subscription did not take an event: another pattern, or a condition that was false."""

from contextlib import closing
from typing import Any, Callable, Iterator, List, Optional, Sequence, Tuple

from ...events.history import Occurrence
from ...events.knowledge import Subscription, SubscriptionKey
from ...events.language import subscribed_event
from ...foundation import RetalisError, look
from ...prolog.logic import Logic
from ...prolog.terms import Term, Trail, copy, deref, functor, list_items, undo, unify

_AND = functor(",", 2)
_MOST = 20
"""Subscriptions that are told of."""


class Untaken:
    """Looks why subscriptions did not take events that happened.

    Args:
        logic: calls conditions.
        subscriptions: of the program, with topic and id.
        show: returns a term as text.
    """

    def __init__(
        self,
        logic: Logic,
        subscriptions: Sequence[Tuple[SubscriptionKey, Subscription]],
        show: Callable[[Term], str],
    ):
        self._logic = logic
        self._all = subscriptions
        self._show = show

    def of(self, event: Term) -> Iterator[str]:
        """Yield for each subscription of an event's functor that does not take it why that is so."""
        told = 0
        for name, definition in self._definitions():
            if _key(definition[1]) != _key(event):
                continue
            why = self._why_not(definition, event)
            if why:
                told += 1
                yield f"{name} does not take it: {why}"
            if told == _MOST:
                return

    def sending(self, asked: Term) -> Iterator[Tuple[str, Any]]:
        """Yield the subscriptions that send such a message, in a form of their own: name and definition."""
        told = 0
        for name, definition in self._definitions():
            form = deref(definition[3])
            if _key(form) is None or _key(form) != _key(asked):
                continue
            trail: Trail = []
            fits = unify(form, copy(asked), trail)
            undo(trail, 0)
            if fits and told < _MOST:
                told += 1
                yield f"{name} sends it of {self._show(definition[1])}", definition

    def reasons(self, definition: Any, kept: Sequence[Occurrence]) -> Iterator[Tuple[Occurrence, str]]:
        """Yield the events of a subscription's functor, with why it does not take them; "" where it does."""
        for one in kept:
            if _key(one.term) == _key(definition[1]):
                yield one, self._why_not(definition, one.term)

    def _definitions(self) -> Iterator[Tuple[str, Any]]:
        for (topic, _), one in self._all:
            made: Any = copy(one.definition)
            event = subscribed_event(made[1])
            yield f"subscription {self._show(one.id)} of topic {topic}", (made[0], event, *made[2:])

    def _why_not(self, definition: Any, event: Term) -> str:
        """Return why a subscription does not take an event, "" where it does."""
        look(1)
        made: Any = copy(definition)
        trail: Trail = []
        try:
            if not unify(made[1], copy(event), trail):
                return f"it takes {self._show(made[1])}"
            goals = list_items(made[2]) or []
            shown = [self._show(goal) for goal in goals]
            for number in range(1, len(goals) + 1):
                problem = self._fails(goals[:number], goals[number:], shown)
                if problem is not None:
                    return f"its condition {shown[number - 1]} {problem}"
            return ""
        finally:
            undo(trail, 0)

    def _fails(self, goals: Sequence[Term], others: Sequence[Term], shown: List[str]) -> Optional[str]:
        """Return None where goals have a solution, and show the others with its values; else what became of them."""
        together = goals[-1]
        for goal in reversed(goals[:-1]):
            together = (_AND, goal, together)
        try:
            with closing(self._logic.solutions(together)) as solutions:
                for _ in solutions:
                    shown[len(goals) :] = [self._show(goal) for goal in others]
                    return None
        except RetalisError as error:
            return f"ends with an error: {error.message}"
        return "is false"


def _key(term: Any) -> Any:
    """Return the functor of a term, None for one that has none."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else getattr(term, "functor", None)
