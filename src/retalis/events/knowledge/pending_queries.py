"""What synchronized queries wait for: a list of ``[MemoryId, Time]``.

A query with the event that its first solution triggers.

Synchronized queries: goals that are called when the memories they read have the data.
"""

from itertools import count
from typing import Any, Callable, Dict, Hashable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.codegen import shared_function
from ...foundation.errors import Place, UsageError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import keep_back
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import copy, positions, variables
from ...prolog.terms.types import CONS, MINUS, TRUE, EventAction, Frame, Term, Values, Var, deref, functor
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import ListenerPhase
from ..dispatch.matcher_compiler import compile_builder
from ..fused.fused_actions import question_action
from ..network.event_rule import EventRule
from .memory import MemoryInstance, Warn, key_of
from .memory_instances import MemoryInstances
from .timeouts import AlarmClock, Timeouts, timeout_of

Behind = List[Tuple[MemoryInstance, int]]
"""Memories that have not got there, and the instants they have to reach."""


def behind(logic: PrologSystem, memories: MemoryInstances, conditions: Term) -> Behind:
    """Return what conditions given as a term wait for.

    Raises:
        UsageError: for an unknown memory or something that is no ``[Id, Time]``.
    """
    found: Dict[MemoryInstance, int] = {}
    time, instant = None, 0  # most often all wait for one time
    for name, its_time in _pairs(logic, conditions):
        instance = memories.find(name)
        if instance is None:
            raise UsageError(f"there is no memory {logic.brief(name)}")
        if its_time is not time:
            time, instant = its_time, reach(its_time)
        found[instance] = max(instant, found.get(instance, instant))
    return [(instance, instant) for instance, instant in found.items() if not instance.has(instant)]


def compile_conditions(
    logic: PrologSystem, memories: MemoryInstances, conditions: Term, names: Sequence[Var]
) -> Optional[Callable[[Values], Behind]]:
    """Return a function of the values of ``names`` that returns what these conditions wait for.

    It raises a `UsageError` as `after` does. None is returned where a value may decide which memories they are.
    """
    try:
        pairs = _pairs(logic, conditions)
        keys = [key_of(name) for name, _ in pairs]
    except (UsageError, PrologError):
        return None
    if not set(variables(conditions)) <= set(names):
        return None
    given: Dict[str, Any] = {
        "get": memories.instances.get,
        "reach": reach,
        "first_reaching": timestamps.first_reaching,
        "no_memory": lambda name: UsageError(f"there is no memory {logic.brief(name)}"),
    }
    places = positions(names)
    lines = ["    missing = []"]
    previous = None
    for at, (key, (name, time)) in enumerate(zip(keys, pairs)):
        given[f"key{at}"], given[f"name{at}"] = key, name
        lines += [
            f"    memory = get(key{at})",
            "    if memory is None:",
            f"        raise no_memory(name{at})",
        ]
        if time is not previous:
            lines += _time(time, names, places, at, given)
        previous = time
        lines += [
            "    ends = memory.memory.ends",
            "    if not ends or ends[-1] < instant:",
            "        missing.append((memory, instant))",
        ]
    source = "\n".join(["def made(values):", *lines, "    return missing", ""])
    found: Callable[[Values], Behind] = shared_function(source, given, "conditions of a synchronized query")
    return found


def _time(
    time: Term, names: Sequence[Var], places: Dict[Var, int], at: int, given: Dict[str, Any]
) -> List[str]:
    """Return the lines that find the instant of a time."""
    if time.__class__ is Var:
        lines = [f"    time = values[{places[time]}]"]
    else:
        given[f"build{at}"] = compile_builder(time, names, "time of a synchronized query")
        lines = [f"    time = build{at}(values)"]
    return [*lines, "    instant = first_reaching(time) if time.__class__ is float else reach(time)"]


def _pairs(logic: PrologSystem, conditions: Term) -> List[Tuple[Term, Term]]:
    """Return ids and times.

    Raises:
        UsageError: for something that is no ``[Id, Time]``.
    """
    items = list_items(conditions)
    if items is None:
        raise UsageError("expected a list of [MemoryId, Time]")
    pairs = []
    for item in items:
        parts = list_items(item)
        if parts is None or len(parts) != 2:
            raise UsageError(f"expected [MemoryId, Time], found {logic.brief(item)}")
        pairs.append((deref(parts[0]), deref(parts[1])))
    return pairs


def reach(time: Term) -> int:
    """Return the instant that a memory has to reach for a time condition.

    Raises:
        UsageError: for what is not a time.
    """
    time = deref(time)
    if time.__class__ is float:
        return timestamps.first_reaching(time)
    if time.__class__ is tuple and time[0] is CONS:
        return timestamps.from_any(time)
    return int(timestamps.from_term(time))


_CALL = functor("call", 1)
_NAME = "synchronized query"


class QueryContext(NamedTuple):
    """Where questions are asked: whose goals, where their events go, and who takes warnings."""

    logic: PrologSystem
    dispatcher: Dispatcher
    warn: Warn


class TriggeredQuery:
    """A query and the event that it triggers, compiled for values that are known when it is asked.

    Args:
        around: where it is asked.
        goal: the query; None where it has a solution always.
        inputs: places of the goal's inputs among the values.
        build: makes the event from the values and, after them, what the goal has given.
        unsolved: makes from the values alone what the event is before, for reports.

    Attributes:
        event: makes from the values alone what the event is before it is asked.
        terms: makes from the values event and query, as a question of any event takes them.
        ask: takes values, start, end and next frame; returns the frame that calls the query and triggers the
            event where it has a solution.
    """

    __slots__ = ("_around", "_dispatcher", "_dispatch", "_goal", "_inputs", "_build", "event", "ask", "terms")

    terms: Callable[[Values], Tuple[Term, Term]]

    ask: Callable[[Values, int, int, Frame], Frame]

    def __init__(
        self,
        around: QueryContext,
        goal: Optional[CompiledGoal],
        inputs: Tuple[int, ...],
        build: Callable[[Values], Term],
        unsolved: Callable[[Values], Term],
    ):
        self._around = around
        self._dispatcher = around.dispatcher
        self._dispatch = around.dispatcher.dispatch
        self._goal = goal
        self._inputs = inputs
        self._build = build
        self.event = unsolved
        self.ask = self._trigger if goal is None else self._call

    def _call(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        goal: Any = self._goal  # there is one: else nobody calls it
        given = tuple([values[at] for at in self._inputs])
        call = self._dispatcher.call
        return call(goal, given, self._failed, self._found, TRUE, values, start, end, after)

    def _found(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        return self._trigger(values, start, end, after)

    def _trigger(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        event = self._build(values)
        try:
            return self._dispatch(event, start, end, after)
        except UsageError as error:
            show = self._around.logic.brief
            self._around.warn(f"{show(event)} is dropped: {error}", ("dropped", kind_of(event)))
            return after

    def _failed(self, values: Values, error: PrologError) -> None:
        if not keep_back(error):
            return
        event = self.event(values)
        self._around.warn(
            f"{self._around.logic.brief(event)} is dropped, its query raised: {error}",
            ("raised", kind_of(event)),
        )


class QueryNotifier(TriggeredQuery):
    """What somebody outside waits for instead of a query: where it would be asked, somebody is told.

    Args:
        named: what it is called in reports.
        tell: called once.
    """

    __slots__ = ("_named", "_tell")

    def __init__(self, named: Term, tell: Callable[[], None]):
        self._named = named
        self._tell = tell
        self.event = self._name
        self.ask = self._ring

    def _name(self, values: Values) -> Term:
        return self._named

    def _ring(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        self._tell()
        return after


class Followed(TriggeredQuery):
    """A question that waits, where it is kept what events came from: its event follows from the one that asked.

    Args:
        dispatcher: of the events.
        asked: the question.
        token: of the event that is being served while it begins to wait.
    """

    __slots__ = ("_asked", "_token")

    def __init__(self, dispatcher: Dispatcher, asked: TriggeredQuery, token: object):
        self._dispatcher = dispatcher
        self._asked = asked
        self._token = token
        self.event = asked.event
        self.terms = asked.terms
        self.ask = self._ask

    @property
    def token(self) -> object:
        """The token of the event that its own follows from."""
        return self._token

    def _ask(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        return self._asked.ask(values, start, end, self._dispatcher.following(self._token, after))


def general_question(around: QueryContext) -> TriggeredQuery:
    """Return the question whose values are an event and a query, whatever they are.

    The query comes with an event, which anybody may have sent: it may not change flags.
    """
    event, query = Var(), Var()
    goal = around.logic.compile_goal((_CALL, query), [event, query], [event], name=_NAME, from_outside=True)
    made = TriggeredQuery(around, goal, (0, 1), lambda values: values[2], lambda values: values[0])
    made.terms = lambda values: (values[0], values[1])
    return made


def compile_question(
    around: QueryContext,
    event: Term,
    query: Term,
    names: Sequence[Var],
    place: Optional[Place],
    from_outside: bool,
) -> Optional[TriggeredQuery]:
    """Return the question for values of ``names`` without variables; None where only the values tell what it is.

    Args:
        around: where it is asked.
        event: what it triggers.
        query: its goal.
        names: the variables that are known.
        place: where it was read.
        from_outside: whether others than the program have given it.
    """
    event, query = deref(event), deref(query)
    mentioned = set(variables(query))
    known = set(names)
    if query.__class__ is Var:
        if query not in known:
            return None
        query = (_CALL, query)
    found = [var for var in variables(event) if var in mentioned and var not in known]
    build = compile_builder(event, [*names, *found], f"event of a {_NAME}")
    inputs = [at for at, name in enumerate(names) if name in mentioned]
    goal = None
    if query is not TRUE:
        try:
            goal = around.logic.compile_goal(
                query, [names[at] for at in inputs], found, place, _NAME, from_outside
            )
        except PrologError:  # reported for each event that asks it
            return None
    made = TriggeredQuery(
        around, goal, tuple(inputs), build, lambda values: build((*values, *[Var() for _ in found]))
    )
    made.terms = lambda values: copy((MINUS, event, query), dict(zip(names, values)))[1:]
    return made


def kind_of(event: Term) -> Hashable:
    """Return what events of one kind share: the functor, or the atom."""
    event = deref(event)
    return event[0] if event.__class__ is tuple else event


GIVEN_UP = functor("query_given_up", 3)
"""The event that tells of a query given up: its event, its goal, and what was missing, ``[[Id,Time],...]``."""

LIMIT = 200_000
"""How many queries may wait at once; past that the oldest is dropped with a warning."""


NAMED = 20
"""How many dropped queries one warning names."""

Waiting = Tuple[int, TriggeredQuery, Values, int, int, Behind]
"""A query that waits: its order, the question, its values, the interval, and where it has to wait: the last first."""


KeptQuery = Tuple[int, Term, Term, int, int, List[Tuple[Term, int]], object]
"""A query that waits, as data: its order, event and query, the interval, ids of memories with the instants that they
have to reach, and the token of the event that its own follows from, or None."""


class PendingQueries:
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
        logic: PrologSystem,
        dispatcher: Dispatcher,
        memories: MemoryInstances,
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
        self._around = QueryContext(logic, dispatcher, warn)
        self._general = general_question(self._around)
        memories.on_update = self._release
        memories.on_delete = self._drop_waiting_for
        for name in ("syncronized", "synchronized"):
            key = functor(name, 3)
            dispatcher.listen(ListenerPhase.QUERIES, key(Var(), Var(), Var()), self._arrive)
            # Without it `sync_now`, whose queries are due at once, takes 95 % more instructions.
            dispatcher.shortcuts[key] = self._shortcut
            key = functor(name, 4)
            dispatcher.listen(ListenerPhase.QUERIES, key(Var(), Var(), Var(), Var()), self._arrive_for_a_time)

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
        return self._wait(QueryNotifier(named, tell), (), now, now, missing)

    def kept(self) -> Tuple[int, List[KeptQuery]]:
        """Return how many have begun to wait, and those that wait; see `restore`. Who waits outside is not kept."""
        order = next(self._order)
        self._order = count(order)
        found: List[KeptQuery] = []
        for number, asked, values, start, end, missing in self._all.values():
            if isinstance(asked, QueryNotifier):
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

    def _followed(self) -> TriggeredQuery:
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

    def _shortcut(self, rule: EventRule, otherwise: EventAction) -> Optional[EventAction]:
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

    def _wait(self, asked: TriggeredQuery, values: Values, start: int, end: int, missing: Behind) -> int:
        """Have a question wait; return its order."""
        if len(self._all) >= self.limit:
            self._drop_oldest()
        order = next(self._order)
        waiting = self._all[order] = (order, asked, values, start, end, missing)
        instance, instant = missing[-1]
        instance.wait(instant, order, waiting)
        return order

    def _release(self, instance: MemoryInstance, end: int, after: Frame) -> Frame:
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

    def _drop_waiting_for(self, instance: MemoryInstance) -> None:
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
