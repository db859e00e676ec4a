"""Subscriptions: which events go out, in which form, to which topic."""

from typing import Any, Callable, Dict, Hashable, Iterator, Tuple

from ...prolog.logic import Logic
from ...prolog.machine import Frame, permission_error
from ...prolog.terms import MINUS, Atom, Term, Values, copy, deref
from ..dispatch import Dispatcher, Listener, Stage
from .recording import Warn, itself, key_of, recording

Deliver = Callable[[Term, str, Term], None]


Key = Tuple[str, Hashable]
"""Topic and id."""


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
        self._listeners: Dict[Key, Listener] = {}

    def __iter__(self) -> Iterator[Key]:
        return iter(list(self._listeners))

    def patterns(self) -> Iterator[Tuple[Term, Key]]:
        """Yield the pattern of each subscription with topic and id."""
        return ((listener.pattern, key) for key, listener in list(self._listeners.items()))

    def create(self, definition: Term) -> None:
        """Add a subscription of ``Pattern, Conditions, Format, Topic, Id``.

        Raises:
            PrologError: for a taken key or arguments that are not a subscription.
        """
        copied: Any = copy(definition)
        pattern, conditions, form, topic, name = (deref(part) for part in copied[1:])
        topic_text = self._topic(topic)
        key = (topic_text, key_of(name))
        if key in self._listeners:
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
        deliver = self._deliver
        ground = self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            deliver(term, topic_text, name)
            return after

        def action(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                deliver(shaped, topic_text, name)
            return after

        self._listeners[key] = self._dispatcher.listen(
            Stage.SUBSCRIPTIONS, pattern, send if shape is itself else action, looks_on=shape is itself
        )

    def mend(self) -> None:
        """Have nothing delivered that no subscription asks for, which an interrupt may leave."""
        self._dispatcher.keep_only(Stage.SUBSCRIPTIONS, set(self._listeners.values()))

    def has(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription of this topic and id."""
        return (self._topic(topic), key_of(name)) in self._listeners

    def delete(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; returns False where there is none of this topic and id."""
        listener = self._listeners.pop((self._topic(topic), key_of(name)), None)
        if listener is None:
            return False
        self._dispatcher.remove(listener)
        return True

    def _topic(self, topic: Term) -> str:
        """Return a topic as text; ``robot/marker1`` reads as a division, but is meant as a name."""
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
