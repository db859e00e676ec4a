"""Synchronized queries: goals that are called when the memories they read have the data."""

from itertools import count
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

from ...foundation import UsageError
from ...prolog.logic import Logic
from ...prolog.machine import Frame
from ...prolog.terms import Term, Values, Var, functor, make_list, timestamps
from ..dispatch import Dispatcher, EventAction, Stage
from ..fused import question_action
from ..network import Rule
from .conditions import Behind, behind, compile_conditions
from .memories import Memories
from .question import Bell, Followed, Question, Surroundings, compile_question, general_question, kind_of
from .recorder import Instance
from .recording import Warn
from .timeouts import AlarmClock, Timeouts, timeout_of

GIVEN_UP = functor("query_given_up", 3)
"""The event that tells of a query given up: its event, its goal, and what was missing, ``[[Id,Time],...]``."""

LIMIT = 200_000
"""How many queries may wait at once; past that the oldest is dropped with a warning."""


NAMED = 20
"""How many dropped queries one warning names."""

Waiting = Tuple[int, Question, Values, int, int, Behind]
"""A query that waits: its order, the question, its values, the interval, and where it has to wait: the last first."""


KeptQuery = Tuple[int, Term, Term, int, int, List[Tuple[Term, int]], object]
"""A query that waits, as data: its order, event and query, the interval, ids of memories with the instants that they
have to reach, and the token of the event that its own follows from, or None."""


class WaitingQueries:
    """All synchronized queries of a program.

    ``syncronized(Event, Query, [[Id, Time], ...])`` (also spelt ``synchronized``) calls Query as soon as each
    memory named has taken an event that ends at or after its time, and triggers Event with the interval of
    the synchronized event, once, for the first solution.

    With ``[timeout(Seconds)]`` as a fourth argument it is given up after that time, and an event tells of it.

    A query waits for one memory at a time, in a heap by time, so an event costs one comparison however many wait.
    Where a rule makes the synchronized event and nobody else listens to it, the event itself is not made.

    Attributes:
        limit: how many may wait at once.
    """

    def __init__(
        self,
        logic: Logic,
        dispatcher: Dispatcher,
        memories: Memories,
        warn: Warn,
        clock: AlarmClock,
        limit: int = LIMIT,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._memories = memories
        self._warn = warn
        self.limit = limit
        self._order = count()
        self._all: Dict[int, Waiting] = {}
        self._oldest = 0
        self.timeouts = Timeouts(clock, self._all, self._give_up)
        self._around = Surroundings(logic, dispatcher, warn)
        self._general = general_question(self._around)
        memories.on_update = self._release
        memories.on_delete = self._drop_waiting_for
        for name in ("syncronized", "synchronized"):
            key = functor(name, 3)
            dispatcher.listen(Stage.QUERIES, key(Var(), Var(), Var()), self._arrive)
            # Without it `sync_now`, whose queries are due at once, takes 95 % more instructions.
            dispatcher.shortcuts[key] = self._shortcut
            key = functor(name, 4)
            dispatcher.listen(Stage.QUERIES, key(Var(), Var(), Var(), Var()), self._arrive_for_a_time)

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Waiting]:
        """Yield those that wait, the oldest first."""
        return iter(self._all.values())

    def all(self) -> List[Waiting]:
        """Return those that wait, the oldest first; also from a thread that is not at work here."""
        return list(self._all.values())

    def clear(self) -> None:
        """Drop all that wait (the clock went back)."""
        self._all.clear()
        self.timeouts.clear()
        for instance in self._memories:
            instance.forget_waiting()

    def await_all(self, missing: Behind, named: Term, now: int, tell: Callable[[], None]) -> int:
        """Tell somebody outside when memories that are behind have got there; return the order, for `waits`.

        Args:
            missing: the memories that have not got there, at least one.
            named: what the one who waits is called in warnings.
            now: since when.
            tell: called once, in the midst of the event that was missing last.
        """
        return self._wait(Bell(named, tell), (), now, now, missing)

    def kept(self) -> Tuple[int, List[KeptQuery]]:
        """Return how many have begun to wait, and those that wait; see `restore`. Who waits outside is not kept."""
        order = next(self._order)
        self._order = count(order)
        found: List[KeptQuery] = []
        for number, asked, values, start, end, missing in self._all.values():
            if isinstance(asked, Bell):
                continue
            event, query = asked.terms(values)
            token = asked.token if isinstance(asked, Followed) else None
            awaited = [(one.id, instant) for one, instant in missing if not one.has(instant)]
            found.append((number, event, query, start, end, awaited, token))
        return order, found

    def restore(self, order: int, found: Sequence[KeptQuery]) -> None:
        """Have queries wait as they did."""
        self._order = count(order)
        self._oldest = found[0][0] if found else order
        for number, event, query, start, end, awaited, token in found:
            missing: Any = [(self._memories.find(name), instant) for name, instant in awaited]
            asked = self._general if token is None else Followed(self._dispatcher, self._general, token)
            waiting = self._all[number] = (number, asked, (event, query), start, end, missing)
            instance, instant = missing[-1]
            instance.wait(instant, number, waiting)

    def waits(self, order: int) -> bool:
        """Tell whether one who waits still does, and was neither told nor dropped."""
        return order in self._all

    def withdraw(self, order: int) -> None:
        """Have one who waits do so no more, if he still does."""
        if order in self._all:
            self._forget(order)

    def _arrive(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        event, query, conditions = values
        try:
            missing = behind(self._logic, self._memories, conditions)
        except UsageError as error:
            self._drop(event, error)
            return after
        if missing:
            self._wait(self._followed(), (event, query), start, end, missing)
            return after
        return self._general.ask((event, query), start, end, after)

    def _arrive_for_a_time(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        """Take ``synchronized(Event, Query, Conditions, [timeout(Seconds)])``."""
        event, query, conditions, options = values
        try:
            wait = timeout_of(options, self._logic.brief)
            missing = behind(self._logic, self._memories, conditions)
        except UsageError as error:
            self._drop(event, error)
            return after
        if not missing:
            return self._general.ask((event, query), start, end, after)
        order = self._wait(self._followed(), (event, query), start, end, missing)
        self.timeouts.add(order, end, wait)
        return after

    def _followed(self) -> Question:
        """Return the question of any event, whose answer follows from the event that is served if that is kept."""
        dispatcher = self._dispatcher
        return (
            Followed(dispatcher, self._general, dispatcher.token()) if dispatcher.tracked else self._general
        )

    def _give_up(self, order: int, instant: int) -> None:
        """Have a query wait no more, and an event tell of it."""
        _, _, (event, query), _, _, missing = self._all[order]
        pairs = [
            make_list([instance.id, timestamps.to_term(wanted)])
            for instance, wanted in missing
            if not instance.has(wanted)
        ]
        self._forget(order)
        machine = self._logic.machine
        told = GIVEN_UP(event, query, make_list(pairs))
        self._dispatcher.apart(
            lambda: machine.run(self._dispatcher.dispatch(told, instant, instant, machine.done))
        )

    def _shortcut(self, rule: Rule, otherwise: EventAction) -> Optional[EventAction]:
        """Return what takes the values of a rule's match in place of its head; see `Dispatcher.shortcuts`."""
        head: Any = rule.definition.head  # it has the functor that this is the shortcut of
        key, event, query, conditions = head
        names, firings = rule.vars, rule.firings
        find = compile_conditions(self._logic, self._memories, conditions, names)
        asked = compile_question(self._around, event, query, names, rule.place, rule.from_outside)
        if find is None or asked is None:
            return None

        def ask_or_wait(values: Values, start: int, end: int, after: Frame) -> Frame:
            firings.number += 1
            firings.last = end
            try:
                missing = find(values)
            except UsageError as error:
                self._drop(asked.event(values), error)
                return after
            if missing:
                self._wait(asked, values, start, end, missing)
                return after
            return asked.ask(values, start, end, after)

        known = rule.ground_with_event
        return question_action(self._dispatcher, key, known, ask_or_wait, otherwise, rule.meter)

    def _drop(self, event: Term, error: UsageError) -> None:
        self._warn(f"{self._logic.brief(event)} is dropped: {error}", ("dropped", kind_of(event)))

    def _wait(self, asked: Question, values: Values, start: int, end: int, missing: Behind) -> int:
        """Have a question wait; return its order."""
        if len(self._all) >= self.limit:
            self._drop_oldest()
        order = next(self._order)
        waiting = self._all[order] = (order, asked, values, start, end, missing)
        instance, instant = missing[-1]
        instance.wait(instant, order, waiting)
        return order

    def _release(self, instance: Instance, end: int, after: Frame) -> Frame:
        """Return the frame that asks what has waited for this memory alone, in order of registration."""
        ready: List[Waiting] = []
        for waiting in instance.reached(end):
            if len(waiting[5]) == 1 or not self._waits_on(waiting):
                del self._all[waiting[0]]
                ready.append(waiting)
        if len(ready) > 1:
            ready.sort()
        elif not ready:
            return after
        return self._ask((self, iter(ready), after))

    @staticmethod
    def _waits_on(waiting: Waiting) -> bool:
        """Have a query wait for the next memory that has not got there, and tell whether there is one."""
        missing = waiting[5]
        missing.pop()
        while missing:
            instance, instant = missing[-1]
            if not instance.has(instant):
                instance.wait(instant, waiting[0], waiting)
                return True
            missing.pop()
        return False

    def run(self, frame: Frame) -> Frame:
        """Ask the queries that are left, as code of a frame: one is done with before the next is asked."""
        return self._ask(frame)

    @staticmethod
    def _ask(frame: Frame) -> Frame:
        ready: Iterator[Waiting] = frame[1]
        for _, asked, values, start, end, _ in ready:
            result = asked.ask(values, start, end, frame)
            if result is not frame:
                return result
        return frame[2]  # type: ignore[no-any-return]

    def mend(self) -> None:
        """Have all that wait do so where they have to, after an interrupt; what is ready is asked at the next."""
        there = set(self._memories)
        for order in sorted(self._all):
            waiting = self._all[order]
            missing = waiting[5]
            if any(instance not in there for instance, _ in missing):
                self._all.pop(order)
                event = waiting[1].event(waiting[2])
                self._warn(
                    f"{self._logic.brief(event)} is dropped: its memory was deleted", ("deleted", None)
                )
                continue
            while len(missing) > 1 and missing[-1][0].has(missing[-1][1]):
                missing.pop()
            if missing:
                missing[-1][0].wait(missing[-1][1], order, waiting)
            else:
                del self._all[order]

    def _drop_oldest(self) -> None:
        oldest = self._oldest
        while oldest not in self._all:
            oldest += 1
        self._oldest = oldest
        event = self._forget(oldest)
        self._warn(
            f"more than {self.limit} queries wait; the oldest is dropped: {self._logic.brief(event)}",
            "waiting",
        )

    def _forget(self, order: int) -> Term:
        """Have a query wait no more; return its event."""
        _, asked, values, _, _, missing = self._all.pop(order)
        instance, instant = missing[-1]
        instance.forget(instant, order)
        return asked.event(values)

    def _drop_waiting_for(self, instance: Instance) -> None:
        """Drop the queries that wait for a memory that is deleted, with one warning that names them."""
        orders = [
            waiting[0]
            for waiting in self._all.values()
            if any(one is instance and not one.has(instant) for one, instant in waiting[5])
        ]
        dropped = [self._forget(order) for order in orders]
        if dropped:
            show = self._logic.brief
            named = ", ".join(show(event) for event in dropped[:NAMED])
            more = f" and {len(dropped) - NAMED} more" if len(dropped) > NAMED else ""
            self._warn(
                f"the memory {show(instance.id)} was deleted; "
                f"dropped are the events that waited for it: {named}{more}",
                ("deleted", instance),
            )
