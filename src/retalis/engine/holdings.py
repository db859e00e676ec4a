"""Memories and subscriptions of a running program, as services and others outside of it add and delete them."""

from typing import Sequence

from ..events.knowledge import DELETE_MEMORY, MEMORIZE, SUBSCRIBE
from ..foundation import UsageError
from ..prolog.terms import Term, make_list
from .core import EngineCore
from .ownfiles import REQUEST


class Holdings(EngineCore):
    """What an engine lets others do with memories and subscriptions; see `Engine`."""

    def has_memory(self, name: Term) -> bool:
        """Tell whether there is a memory with an id.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire, [], _, fires, 10)")
        >>> engine.has_memory(atom("fires"))
        True
        """
        return self._knowledge.memories.find(name) is not None

    def add_memory(
        self, event: Term, conditions: Sequence[Term], record: Term, name: Term, size: Term
    ) -> None:
        """Add a memory as goal ``memorize/5`` does: under its limits, and with the events that tell of it.

        >>> engine = Engine()
        >>> engine.add_memory(atom("fire"), [], atom("fire"), atom("fires"), 10)
        >>> engine.has_memory(atom("fires"))
        True

        Args:
            event: the pattern of the events that it keeps.
            conditions: goals, which share variables with the pattern.
            record: what it keeps of an event; a variable for the event itself.
            name: its id.
            size: how many records it keeps.

        Raises:
            PrologError: where there is one of this id, or these are not what a memory is made of.
        """
        self._achieve((MEMORIZE, event, make_list(conditions), record, name, size))

    def delete_memory(self, name: Term) -> bool:
        """Delete the memory with an id, as goal ``delete_memory/1`` does; return whether there was one.

        >>> Engine().delete_memory(atom("fires"))
        False
        """

        def work() -> bool:  # nobody deletes it in between
            found = self.has_memory(name)
            if found:
                self._achieve((DELETE_MEMORY, name))
            return found

        return self._runner.call(lambda: self._dispatcher.undisturbed(work), (REQUEST,))

    def has_subscription(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription with a topic and an id.

        >>> engine = Engine()
        >>> engine.load(goals="subscribe(fire, [], _, alarms, a)")
        >>> engine.has_subscription(atom("alarms"), atom("a"))
        True
        """
        return self._knowledge.subscriptions.has(topic, name)

    def add_subscription(
        self, event: Term, conditions: Sequence[Term], form: Term, topic: Term, name: Term
    ) -> None:
        """Add a subscription as goal ``subscribe/5`` does; see `add_memory`.

        >>> engine = Engine()
        >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
        >>> engine.add_subscription(atom("fire"), [], atom("burning"), atom("alarms"), atom("a"))
        >>> engine.event("fire", 1)
        alarms burning

        Args:
            event: the pattern of the events that go out.
            conditions: goals, which share variables with the pattern.
            form: what goes out for an event; a variable for the event itself.
            topic: where to.
            name: its id; together with the topic it is the only one.

        Raises:
            PrologError: where there is one of this topic and id, or these are not what a subscription is made of.
        """
        self._achieve((SUBSCRIBE, event, make_list(conditions), form, topic, name))

    def delete_subscription(self, topic: Term, name: Term) -> bool:
        """Delete the subscription with a topic and an id; return whether there was one.

        >>> Engine().delete_subscription(atom("alarms"), atom("a"))
        False
        """
        return self._runner.call(
            lambda: self._dispatcher.undisturbed(lambda: self._knowledge.subscriptions.delete(topic, name)),
            (REQUEST,),
        )

    def _achieve(self, goal: Term) -> None:
        """Call a goal that has to have a solution."""
        if not self._runner.call(lambda: self._call_undisturbed(goal), (goal,)):
            raise UsageError(f"{self._logic.brief(goal)} fails")
