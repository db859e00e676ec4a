"""Subscriptions: which events go out, in which form, to which topic."""

from typing import Any, Callable, Dict, Hashable, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from ...prolog.logic import Logic
from ...prolog.machine import Frame, permission_error
from ...prolog.terms import MINUS, Atom, Term, Values, copy, deref, term_key
from ..dispatch import Dispatcher, Listener, Stage
from .recording import Warn, itself, key_of, recording, unused_variables

Deliver = Callable[[Term, str, Term], None]


Key = Tuple[str, Hashable]
"""Topic and id."""


class Tally:
    """How many events a subscription has sent."""

    __slots__ = ("sent",)

    def __init__(self) -> None:
        self.sent = 0


class Subscription(NamedTuple):
    """What listens for a subscription, its id as it was given, what it has sent, and what it was made of."""

    listener: Listener
    id: Term
    tally: Tally
    definition: Term

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
        problem: takes a report about a condition that raised an error.
    """

    def __init__(self, logic: Logic, dispatcher: Dispatcher, deliver: Deliver, problem: Warn):
        self._logic = logic
        self._dispatcher = dispatcher
        self._deliver = deliver
        self._problem = problem
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
        pattern, conditions, form, topic, name = (deref(part) for part in copied[1:])
        topic_text = self._topic(topic)
        key = (topic_text, key_of(name))
        if key in self._all:
            raise permission_error("create", "subscription", (MINUS, topic, name), "one already exists")
        shape, _ = recording(
            self._logic,
            self._dispatcher,
            pattern,
            conditions,
            form,
            f"subscription {self._logic.brief(name)}",
            self._problem,
        )
        before = self._aside.get(key)
        tally = before.tally if before is not None and before.key == term_key(copied) else Tally()
        deliver = self._deliver
        ground = self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            tally.sent += 1
            deliver(term, topic_text, name)
            return after

        def action(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                tally.sent += 1
                deliver(shaped, topic_text, name)
            return after

        listener = self._dispatcher.listen(
            Stage.SUBSCRIPTIONS,
            pattern,
            send if shape is itself else action,
            looks_on=shape is itself,
            unused=unused_variables(pattern, conditions, form),
        )
        self._all[key] = Subscription(listener, name, tally, copied)

    def set_aside(self, keys: Iterable[Key]) -> None:
        """Take subscriptions out; those that are made again as they were go on counting what they have sent."""
        for key in keys:
            found = self._aside[key] = self._all.pop(key)
            self._dispatcher.remove(found.listener)

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
        """Have nothing delivered that no subscription asks for, which an interrupt may leave."""
        self._dispatcher.keep_only(Stage.SUBSCRIPTIONS, {one.listener for one in self._all.values()})

    def has(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription of this topic and id."""
        return (self._topic(topic), key_of(name)) in self._all

    def delete(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; returns False where there is none of this topic and id."""
        found = self._all.pop((self._topic(topic), key_of(name)), None)
        if found is None:
            return False
        self._dispatcher.remove(found.listener)
        return True

    def _topic(self, topic: Term) -> str:
        """Return a topic as text; ``robot/marker1`` reads as a division, but is meant as a name."""
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
