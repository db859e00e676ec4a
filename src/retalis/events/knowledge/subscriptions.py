"""Subscriptions: which events go out, in which form, to which topic."""

from itertools import count
from typing import (
    Any,
    Callable,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation import UsageError
from ...prolog.logic import Logic
from ...prolog.machine import Frame, domain_error, permission_error
from ...prolog.terms import MINUS, Atom, Term, Values, Var, copy, deref, term_key, variables
from ..dispatch import Dispatcher, EventAction, Listener, Stage
from ..language import Shaped, subscribed_event, subscribed_shape
from .rates import KeptRate, RateClock, SubscriptionRate, looked_at
from .recording import Recording, Warn, itself, key_of, recording, unused_variables

Deliver = Callable[[Term, str, Term], None]


Key = Tuple[str, Hashable]
"""Topic and id."""


class Tally:
    """How many events a subscription has sent."""

    __slots__ = ("sent",)

    def __init__(self) -> None:
        self.sent = 0


class Subscription(NamedTuple):
    """What listens for a subscription, its id as it was given, what it has sent, and what it was made of.

    Where it has a shape, ``rate`` lets some of its events through only.
    """

    listener: Listener
    id: Term
    tally: Tally
    definition: Term
    rate: Optional[SubscriptionRate] = None

    @property
    def key(self) -> Hashable:
        """Equal for subscriptions that send the same of the same events, with the same topic and id."""
        return term_key(self.definition)


class Subscriptions:
    """All subscriptions of a program; topic and id together are the key of one.

    Args:
        logic: where conditions are compiled.
        dispatcher: whose events are delivered.
        deliver: called with the term, the topic as text and the id of the subscription.
        problem: takes a report about a condition that raised an error, and warnings.
        clock: rings for those that send later.
    """

    def __init__(
        self, logic: Logic, dispatcher: Dispatcher, deliver: Deliver, problem: Warn, clock: RateClock
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._deliver = deliver
        self._problem = problem
        self._clock = clock
        self._places = count()
        self._all: Dict[Key, Subscription] = {}
        self._aside: Dict[Key, Subscription] = {}

    def __iter__(self) -> Iterator[Key]:
        return iter(list(self._all))

    def patterns(self) -> Iterator[Tuple[Term, Key]]:
        """Yield the pattern of each subscription with topic and id."""
        return ((one.listener.pattern, key) for key, one in self.items())

    def items(self) -> List[Tuple[Key, Subscription]]:
        """Return all subscriptions, the oldest first."""
        return list(self._all.items())

    def create(self, definition: Term) -> None:
        """Add a subscription of ``Pattern, Conditions, Format, Topic, Id``.

        Raises:
            PrologError: for a taken key or arguments that are not a subscription.
        """
        copied: Any = copy(definition)
        whole, conditions, form, topic, name = (deref(part) for part in copied[1:])
        try:
            part = subscribed_shape(whole)
        except UsageError as error:
            raise domain_error("subscription", whole, error.message) from None
        pattern = subscribed_event(whole)
        topic_text = self._topic(topic)
        key = (topic_text, key_of(name))
        if key in self._all:
            raise permission_error("create", "subscription", (MINUS, topic, name), "one already exists")
        who = f"subscription {self._logic.brief(name)}"
        shape, _ = recording(self._logic, self._dispatcher, pattern, conditions, form, who, self._problem)
        before = self._aside.get(key)
        known = before if before is not None and before.key == term_key(copied) else None
        tally = Tally() if known is None else known.tally
        rate = None if part is None else self._rate(part, variables(pattern), who, known)
        listener = self._dispatcher.listen(
            Stage.SUBSCRIPTIONS,
            pattern,
            self._action(shape, tally, topic_text, name, rate),
            unused=unused_variables(pattern, conditions, form, () if part is None else looked_at(part)),
        )
        self._all[key] = Subscription(listener, name, tally, copied, rate)

    def _action(
        self, shape: Recording, tally: Tally, topic: str, name: Term, rate: Optional[SubscriptionRate]
    ) -> EventAction:
        """Return what takes the events of a subscription."""
        deliver, ground = self._deliver, self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            tally.sent += 1
            deliver(term, topic, name)
            return after

        def send_shaped(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                tally.sent += 1
                deliver(shaped, topic, name)
            return after

        if rate is None:
            return send if shape is itself else send_shaped
        take = rate.take

        def send_one(made: Term) -> None:
            tally.sent += 1
            deliver(made, topic, name)

        def let_through(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                take(shaped, values, start, end)
            return after

        rate.send = send_one
        return let_through

    def _rate(
        self, part: Shaped, names: Sequence[Var], who: str, known: Optional[Subscription]
    ) -> SubscriptionRate:
        """Return what lets some events through only; it goes on where the same subscription was there before."""
        rate = SubscriptionRate(part, names, who, self._clock, self._problem, next(self._places))
        if known is not None and known.rate is not None:
            rate.restore(known.rate.kept())
        return rate

    def set_aside(self, keys: Iterable[Key]) -> None:
        """Take subscriptions out; those that are made again as they were go on counting what they have sent."""
        for key in keys:
            found = self._aside[key] = self._all.pop(key)
            self._end(found)

    def forget_aside(self) -> None:
        """Forget what was set aside."""
        self._aside.clear()

    def restore(self, before: Sequence[Tuple[Key, Subscription]]) -> None:
        """Have these subscriptions, which have been set aside meanwhile or not, and no others."""
        self.set_aside(list(self._all))
        self._aside = dict(before)
        for _, one in before:
            self.create(one.definition)
        self.forget_aside()

    def mend(self) -> None:
        """Have nothing delivered that no subscription asks for, which an interrupt may leave, and rates ring."""
        self._dispatcher.keep_only(Stage.SUBSCRIPTIONS, {one.listener for one in self._all.values()})
        for rate in self._rates():
            rate.mend()

    def has(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription of this topic and id."""
        return (self._topic(topic), key_of(name)) in self._all

    def delete(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; returns False where there is none of this topic and id."""
        found = self._all.pop((self._topic(topic), key_of(name)), None)
        if found is None:
            return False
        self._end(found)
        return True

    def _end(self, one: Subscription) -> None:
        self._dispatcher.remove(one.listener)
        if one.rate is not None:
            one.rate.stop()

    def clear(self) -> None:
        """Have shapes forget what has come: time went back, or the program asks for it."""
        for rate in self._rates():
            rate.clear()

    def kept(self) -> List[Optional[KeptRate]]:
        """Return what the shape of each subscription knows, None where it has none; see `restore_rates`."""
        return [None if one.rate is None else one.rate.kept() for one in self._all.values()]

    def restore_rates(self, kept: Sequence[Optional[KeptRate]]) -> None:
        """Have shapes know what those of others did that are made alike."""
        for one, known in zip(self._all.values(), kept):
            if one.rate is not None and known is not None:
                one.rate.restore(known)

    def _rates(self) -> List[SubscriptionRate]:
        return [one.rate for one in self._all.values() if one.rate is not None]

    def _topic(self, topic: Term) -> str:
        """Return a topic as text; ``robot/marker1`` reads as a division, but is meant as a name."""
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
