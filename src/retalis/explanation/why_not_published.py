"""Why-not provenance of subscriptions: why they did not publish a message, or did not select an event."""

from contextlib import closing
from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.stream_parser import subscription_event
from ..events.network.lineage_graph import Occurrence
from ..foundation.errors import RetalisError
from ..foundation.limit_checks import check_limits
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Term, Trail, deref, functor, functor_of
from ..prolog.terms.unification import may_unify, undo, unify

_COMMA_FUNCTOR = functor(",", 2)
_MAX_SUBSCRIPTIONS = 20
"""Maximum number of subscriptions in an explanation."""


class SubscriptionCopy(NamedTuple):
    """A subscription with variables of its own.

    Attributes:
        description: id and topic, for the explanation.
        event: pattern of the events that it selects.
        conditions: list of goals.
        template: the message that it publishes.
    """

    description: str
    event: Term
    conditions: Term
    template: Term


class WhyNotPublished:
    """Evaluation of subscriptions: which one publishes a message, and why one did not select an event.

    Args:
        logic: evaluates conditions.
        subscriptions: subscriptions of the program, with their topics and ids.
        show: returns the text of a term.
    """

    def __init__(
        self,
        logic: PrologSystem,
        subscriptions: Sequence[Tuple[SubscriptionKey, Subscription]],
        show: Callable[[Term], str],
    ):
        self._logic = logic
        self._subscriptions = subscriptions
        self._show = show

    def explain_rejections(self, event: Term) -> Iterator[str]:
        """Yield a reason for each subscription that has the functor of an event and does not select it.

        At most `_MAX_SUBSCRIPTIONS` reasons are yielded.
        """
        count = 0
        for subscription in self._copy_subscriptions():
            if functor_of(subscription.event) != functor_of(event):
                continue
            reason = self._explain_rejection(subscription, event)
            if reason:
                count += 1
                yield f"{subscription.description} does not select it: {reason}"
            if count == _MAX_SUBSCRIPTIONS:
                return

    def find_publishing(self, message: Term) -> Iterator[Tuple[str, SubscriptionCopy]]:
        """Yield the subscriptions whose template unifies with a message, each with a text about it."""
        count = 0
        for subscription in self._copy_subscriptions():
            template = deref(subscription.template)
            if functor_of(template) is None or functor_of(template) != functor_of(message):
                continue
            # Only tested, not bound: the subscription is used with its own variables afterwards.
            if may_unify(template, message) and count < _MAX_SUBSCRIPTIONS:
                count += 1
                yield (
                    f"{subscription.description} publishes it for {self._show(subscription.event)}",
                    subscription,
                )

    def explain_events(
        self, subscription: SubscriptionCopy, occurrences: Sequence[Occurrence]
    ) -> Iterator[Tuple[Occurrence, str]]:
        """Yield the events with the functor of a subscription, and the reason if it did not select them, or ""."""
        for occurrence in occurrences:
            if functor_of(occurrence.term) == functor_of(subscription.event):
                yield occurrence, self._explain_rejection(subscription, occurrence.term)

    def _copy_subscriptions(self) -> Iterator[SubscriptionCopy]:
        for (topic, _), subscription in self._subscriptions:
            definition: Any = copy(subscription.definition)
            _, event, conditions, template, *_ = definition
            description = f"subscription {self._show(subscription.id)} of topic {topic}"
            yield SubscriptionCopy(description, subscription_event(event), conditions, template)

    def _explain_rejection(self, subscription: SubscriptionCopy, event: Term) -> str:
        """Return the reason why a subscription does not select an event, or "" if it does."""
        check_limits(1)
        # Copied together, so that both share variables. Bindings of one event must not affect the next one.
        pair: Any = copy((_COMMA_FUNCTOR, subscription.event, subscription.conditions))
        _, pattern, conditions = pair
        trail: Trail = []
        try:
            if not unify(pattern, copy(event), trail):
                return f"it selects {self._show(pattern)}"
            goals = list_items(conditions) or []
            goal_texts = [self._show(goal) for goal in goals]
            # The first condition without a solution is the reason: conditions are tested with all those before it.
            for count in range(1, len(goals) + 1):
                reason = self._test_conditions(goals[:count], goals[count:], goal_texts)
                if reason is not None:
                    return f"its condition {goal_texts[count - 1]} {reason}"
            return ""
        finally:
            undo(trail, 0)

    def _test_conditions(
        self, goals: Sequence[Term], later_goals: Sequence[Term], goal_texts: List[str]
    ) -> Optional[str]:
        """Return None if the goals have a solution, otherwise the reason why not.

        With a solution, the texts of ``later_goals``, the last ones of ``goal_texts``, are replaced by texts with the
        values of the solution.
        """
        conjunction = goals[-1]
        for goal in reversed(goals[:-1]):
            conjunction = (_COMMA_FUNCTOR, goal, conjunction)
        try:
            # Closed after the first solution, which undoes its bindings and runs cleanup goals.
            with closing(self._logic.solutions(conjunction)) as solutions:
                for _ in solutions:
                    goal_texts[len(goals) :] = [self._show(goal) for goal in later_goals]
                    return None
        except RetalisError as error:
            return f"ends with an error: {error.message}"
        return "is false"
