"""Pending queries: synchronized queries, which run when the memories that they read have the data.

Sensor data arrive with different delays, so a query about an instant may run before the data of that instant have
been recorded. ``synchronized(Event, Query, [[Id, Time], ...])`` delays it: the query runs as soon as the *watermark*
of each named memory, the end of its newest event, has reached the given time. Its first solution triggers Event,
once, with the interval of the synchronized event. A timeout and a limit bound how long and how many queries wait; an
event or a warning reports the queries that are dropped.

A query is registered with one of its memories at a time. `MemoryInstance` keeps these in a heap by instant, so an
event costs one comparison for any number of pending queries. When the memory reaches the instant, the query is
registered with the next memory that has not reached its instant, or called if there is none. Queries that become
ready with one event are called in order of their registration.

A condition ``[tf(Target, Source), Time]`` names a transform instead of a memory, see `transform_predicates`. A memory
with that id takes precedence.

If a rule makes the synchronized event and it has no other listener, the event is not created: conditions, query
and event are compiled for the variables of the rule (`compile_conditions`, `compile_query`).
"""

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
    Union,
)

from ...foundation.codegen import shared_function
from ...foundation.errors import UsageError
from ...foundation.source_places import Place
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import record_caught_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import copy, positions, variables
from ...prolog.terms.types import (
    CONS,
    MINUS,
    TRUE,
    EventAction,
    Frame,
    Term,
    Values,
    Var,
    deref,
    functor,
    functor_of,
)
from ...serialization.state_fields import (
    NextNumber,
    StateFields,
    StateOwner,
    constraint,
    field,
    part,
    rows_of,
)
from ...serialization.stored_field_types import CALLABLE_TERM, COUNT, INSTANT, TERM, sequence_of, tuple_of
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import ListenerPhase
from ..dispatch.matcher_compiler import compile_builder
from ..fused.fused_single_event import compile_query_action
from ..matches.match_types import TOKEN
from ..matches.watermarks import PatternWatermark, Watermarks
from ..network.event_rule import EventRule
from .memory import MemoryInstance, Warn, key_of
from .memory_registry import MemoryInstances
from .timeout_queue import Timeouts, are_increasing_orders, timeout_of
from .transform_predicates import AwaitedTransform, ReachedTransforms, Transforms

AwaitedSource = Union[MemoryInstance, AwaitedTransform]
"""A memory or transform that queries wait for."""

MissingSources = List[Tuple[AwaitedSource, int]]
"""Memories and transforms that have not reached an instant, each with this instant."""


def find_missing_sources(
    logic: PrologSystem, memories: MemoryInstances, transforms: Transforms, conditions: Term
) -> MissingSources:
    """Return the memories and transforms that a query must wait for, given its conditions as a term.

    Raises:
        UsageError: if there is no such memory, or a condition is not ``[Id, Time]``.
    """
    required_instants: Dict[AwaitedSource, int] = {}
    # Conditions usually share one time, so it is converted once.
    time, instant = None, 0
    for source_id, condition_time in _parse_conditions(logic, conditions):
        source: Optional[AwaitedSource] = memories.find(source_id)
        if source is None:
            source = transforms.awaited_transform(source_id)
            if source is None:
                raise UsageError(f"there is no memory {logic.brief(source_id)}")
            instant_of_transform = transform_instant(condition_time)
            required_instants[source] = max(
                instant_of_transform, required_instants.get(source, instant_of_transform)
            )
            continue
        if condition_time is not time:
            time, instant = condition_time, required_instant(condition_time)
        required_instants[source] = max(instant, required_instants.get(source, instant))
    return [
        (source, instant) for source, instant in required_instants.items() if not source.has_reached(instant)
    ]


def compile_conditions(
    logic: PrologSystem,
    memories: MemoryInstances,
    transforms: Transforms,
    conditions: Term,
    rule_variables: Sequence[Var],
) -> Optional[Callable[[Values], MissingSources]]:
    """Return a function from the values of ``rule_variables`` to the memories and transforms to wait for.

    The function raises a `UsageError` as `find_missing_sources` does. Return None instead of a function if the ids
    of the memories depend on the values.
    """
    try:
        pairs = _parse_conditions(logic, conditions)
        keys = [key_of(name) for name, _ in pairs]
        awaited_transforms = [transforms.awaited_transform(name) for name, _ in pairs]
    except (UsageError, PrologError):
        return None
    if not set(variables(conditions)) <= set(rule_variables):
        return None
    namespace: Dict[str, Any] = {
        "get": memories.instances.get,
        "required_instant": required_instant,
        "first_reaching": timestamps.first_reaching,
        "no_memory": lambda name: UsageError(f"there is no memory {logic.brief(name)}"),
    }
    variable_positions = positions(rule_variables)
    lines = ["    missing = []"]
    previous = None
    for index, (key, (name, time)) in enumerate(zip(keys, pairs)):
        namespace[f"key{index}"], namespace[f"name{index}"] = key, name
        if awaited_transforms[index] is not None:
            namespace[f"transform{index}"] = awaited_transforms[index]
            namespace["transform_instant"] = transform_instant
            lines += [
                f"    awaited = get(key{index}, transform{index})",
                *_generate_instant_lines(
                    time, rule_variables, variable_positions, index, namespace, "transform_instant(time)"
                ),
                "    if not awaited.has_reached(instant):",
                "        missing.append((awaited, instant))",
            ]
            previous = None
            continue
        lines += [
            f"    memory = get(key{index})",
            "    if memory is None:",
            f"        raise no_memory(name{index})",
        ]
        # Conditions of a query usually share one time, which is converted once.
        if time is not previous:
            lines += _generate_instant_lines(time, rule_variables, variable_positions, index, namespace)
        previous = time
        lines += [
            "    ends = memory.memory.ends",
            "    if not ends or ends[-1] < instant:",
            "        missing.append((memory, instant))",
        ]
    code = "\n".join(["def generated(values):", *lines, "    return missing", ""])
    function: Callable[[Values], MissingSources] = shared_function(
        code, namespace, "conditions of a synchronized query"
    )
    return function


def _generate_instant_lines(
    time: Term,
    rule_variables: Sequence[Var],
    variable_positions: Dict[Var, int],
    index: int,
    namespace: Dict[str, Any],
    conversion: str = "first_reaching(time) if time.__class__ is float else required_instant(time)",
) -> List[str]:
    """Return the lines of code that compute the instant of a condition.

    Args:
        time: the time of the condition.
        rule_variables: variables of the rule, in the order of ``values``.
        variable_positions: their positions.
        index: number of the condition, for the names of constants.
        namespace: receives the constants of the code.
        conversion: expression that converts ``time``.
    """
    if time.__class__ is Var:
        lines = [f"    time = values[{variable_positions[time]}]"]
    else:
        namespace[f"build{index}"] = compile_builder(time, rule_variables, "time of a synchronized query")
        lines = [f"    time = build{index}(values)"]
    return [*lines, f"    instant = {conversion}"]


def _parse_conditions(logic: PrologSystem, conditions: Term) -> List[Tuple[Term, Term]]:
    """Return the pairs of id and time of a list of conditions.

    Raises:
        UsageError: if an element is not ``[Id, Time]``.
    """
    items = list_items(conditions)
    if items is None:
        raise UsageError("expected a list of [MemoryId, Time]")
    id_time_pairs = []
    for item in items:
        id_and_time = list_items(item)
        if id_and_time is None or len(id_and_time) != 2:
            raise UsageError(f"expected [MemoryId, Time], found {logic.brief(item)}")
        id_time_pairs.append((deref(id_and_time[0]), deref(id_and_time[1])))
    return id_time_pairs


def required_instant(time: Term) -> int:
    """Return the instant that a memory has to reach for a time condition.

    Raises:
        UsageError: if the term is not a time.
    """
    time = deref(time)
    if time.__class__ is float:
        return timestamps.first_reaching(time)
    if time.__class__ is tuple and time[0] is CONS:
        return timestamps.from_any(time)
    return int(timestamps.from_term(time))


def transform_instant(time: Term) -> int:
    """Return the instant that a transform has to reach: the one that a look-up uses for the same time.

    Raises:
        UsageError: if the term is not a time.
    """
    return int(timestamps.from_any(time))


_CALL = functor("call", 1)
_REPORT_NAME = "synchronized query"


class QueryContext(NamedTuple):
    """Prolog system, dispatcher and warning callback that all queries share."""

    logic: PrologSystem
    dispatcher: Dispatcher
    warn: Warn


class ReleasableQuery:
    """Base class of the actions for which `PendingQueries` waits. Subclasses set the attributes.

    Attributes:
        create_event: creates the event from the values, without a solution of the query, for reports.
        create_terms: creates event and query from the values, in the form of `compile_general_query`.
        execute: takes values, start, end and next frame; returns the frame that calls the query and triggers the
            event if it has a solution.
    """

    __slots__ = ("create_event", "create_terms", "execute")

    create_event: Callable[[Values], Term]

    create_terms: Callable[[Values], Tuple[Term, Term]]

    execute: Callable[[Values, int, int, Frame], Frame]


class TriggeredQuery(ReleasableQuery):
    """A query and the event that it triggers, compiled for values that are known when it is called.

    Args:
        context: Prolog system, dispatcher and warning callback.
        goal: the query; None if it is always true.
        inputs: positions of the goal's inputs in the values.
        build_event: creates the event from the values followed by the results of the goal.
        build_event_unsolved: creates the event from the values, with new variables for results of the goal.
    """

    __slots__ = ("_context", "_dispatcher", "_dispatch", "_goal", "_inputs", "_build_event")

    def __init__(
        self,
        context: QueryContext,
        goal: Optional[CompiledGoal],
        inputs: Tuple[int, ...],
        build_event: Callable[[Values], Term],
        build_event_unsolved: Callable[[Values], Term],
    ):
        self._context = context
        self._dispatcher = context.dispatcher
        self._dispatch = context.dispatcher.dispatch
        self._goal = goal
        self._inputs = inputs
        self._build_event = build_event
        self.create_event = build_event_unsolved
        self.execute = self._trigger if goal is None else self._call_goal

    def _call_goal(self, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
        # Not None: else `execute` is `_trigger`.
        goal: Any = self._goal
        goal_inputs = tuple([values[position] for position in self._inputs])
        call = self._dispatcher.call
        return call(
            goal, goal_inputs, self._warn_of_error, self._trigger_solved, TRUE, values, start, end, next_frame
        )

    def _trigger_solved(self, term: Term, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
        return self._trigger(values, start, end, next_frame)

    def _trigger(self, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
        event = self._build_event(values)
        try:
            return self._dispatch(event, start, end, next_frame)
        except UsageError as error:
            show = self._context.logic.brief
            self._context.warn(f"{show(event)} is dropped: {error}", ("dropped", event_functor(event)))
            return next_frame

    def _warn_of_error(self, values: Values, error: PrologError) -> None:
        if not record_caught_error(error):
            return
        event = self.create_event(values)
        self._context.warn(
            f"{self._context.logic.brief(event)} is dropped, its query raised: {error}",
            ("raised", event_functor(event)),
        )


class QueryNotifier(ReleasableQuery):
    """A client outside of the program that waits for memories; it is notified instead of calling a query.

    Args:
        client_name: its name in reports.
        notify: called once.
    """

    __slots__ = ("_client_name", "_notify")

    def __init__(self, client_name: Term, notify: Callable[[], None]):
        self._client_name = client_name
        self._notify = notify
        self.create_event = self._create_event
        self.execute = self._notify_client

    def _create_event(self, values: Values) -> Term:
        return self._client_name

    def _notify_client(self, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
        self._notify()
        return next_frame


class DerivedQuery(ReleasableQuery):
    """A pending query that records the event that caused it; used if lineage is tracked.

    Args:
        cause: identity of the event that is being dispatched when the query is registered; the triggered event is
            derived from it.
    """

    __slots__ = ("_dispatcher", "_query", "_cause")

    def __init__(self, dispatcher: Dispatcher, query: TriggeredQuery, cause: object):
        self._dispatcher = dispatcher
        self._query = query
        self._cause = cause
        self.create_event = query.create_event
        self.create_terms = query.create_terms
        self.execute = self._execute_derived

    @property
    def cause(self) -> object:
        """Identity of the event that the triggered event is derived from."""
        return self._cause

    def _execute_derived(self, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
        return self._query.execute(values, start, end, self._dispatcher.set_cause(self._cause, next_frame))


def compile_general_query(context: QueryContext) -> TriggeredQuery:
    """Return the query for synchronized events, whose values are the event to trigger and the query as terms.

    A synchronized event may come from any client, so its query must not change flags.
    """
    event, query = Var(), Var()
    goal = context.logic.compile_goal(
        (_CALL, query), [event, query], [event], name=_REPORT_NAME, is_from_client=True
    )
    compiled_query = TriggeredQuery(context, goal, (0, 1), lambda values: values[2], lambda values: values[0])
    compiled_query.create_terms = lambda values: (values[0], values[1])
    return compiled_query


def compile_query(
    context: QueryContext,
    event: Term,
    query: Term,
    rule_variables: Sequence[Var],
    place: Optional[Place],
    from_outside: bool,
) -> Optional[TriggeredQuery]:
    """Compile a query and its event for rule variables with ground values.

    Args:
        context: Prolog system, dispatcher and warning callback.
        event: the event that it triggers.
        query: its goal.
        rule_variables: variables of the rule, whose values the query gets.
        place: place in the source.
        from_outside: whether the rule comes from a service or topic instead of the program.

    Returns:
        The query, or None if the goal itself is a value, so that it cannot be compiled.
    """
    event, query = deref(event), deref(query)
    query_variables = set(variables(query))
    known_variables = set(rule_variables)
    # A query that is a variable of the rule is called through ``call/1``. A variable that gets its value elsewhere
    # cannot be compiled.
    if query.__class__ is Var:
        if query not in known_variables:
            return None
        query = (_CALL, query)
    outputs = [var for var in variables(event) if var in query_variables and var not in known_variables]
    build_event = compile_builder(event, [*rule_variables, *outputs], f"event of a {_REPORT_NAME}")
    inputs = [position for position, var in enumerate(rule_variables) if var in query_variables]
    goal = None
    if query is not TRUE:
        try:
            goal = context.logic.compile_goal(
                query,
                [rule_variables[position] for position in inputs],
                outputs,
                place,
                _REPORT_NAME,
                from_outside,
            )
        except PrologError:  # the general form reports the error for each event
            return None
    compiled_query = TriggeredQuery(
        context,
        goal,
        tuple(inputs),
        build_event,
        lambda values: build_event((*values, *[Var() for _ in outputs])),
    )
    compiled_query.create_terms = lambda values: copy(
        (MINUS, event, query), dict(zip(rule_variables, values))
    )[1:]
    return compiled_query


def event_functor(event: Term) -> Hashable:
    """Return the functor or atom of an event."""
    event = deref(event)
    return event[0] if event.__class__ is tuple else event


TIMEOUT_EVENT = functor("query_given_up", 3)
"""Event that reports a query whose timeout expired: its event, goal, and missing conditions ``[[Id,Time],...]``."""

MAX_PENDING_QUERIES = 200_000
"""Maximum number of pending queries; beyond it, the oldest is dropped with a warning."""


MAX_QUERIES_IN_WARNING = 20
"""Maximum number of dropped queries that one warning names."""

PendingQuery = Tuple[int, ReleasableQuery, Values, int, int, MissingSources]
"""A pending query: order, query, values, start, end, and the memories that it waits for, the next one last.

The unique order comes first, so that sorted queries are in order of registration.
"""


class StoredQuery(NamedTuple):
    """Stored form of a pending query.

    Attributes:
        order: its order.
        start: start of the event in ns.
        end: end of the event in ns.
        awaited: ids of memories, with the instants that they have to reach.
        cause: the occurrence that its event is derived from, or None.
    """

    order: int
    event: Term
    query: Term
    start: int
    end: int
    awaited: List[Tuple[Term, int]]
    cause: object


class PendingQueries(StateOwner):
    """All pending synchronized queries of a program.

    Two spellings are accepted: ``synchronized`` and ``syncronized``. With ``[timeout(Seconds)]`` as a fourth
    argument, a query is dropped after that time, which the event `TIMEOUT_EVENT` reports.

    Attributes:
        limit: maximum number of pending queries.
        timeouts: deadlines of the queries with a timeout.
    """

    STATE = StateFields(
        field("next_order", COUNT),
        field(
            "stored_queries",
            rows_of(
                StoredQuery,
                order=COUNT,
                event=CALLABLE_TERM,
                query=TERM,
                start=INSTANT,
                end=INSTANT,
                awaited=sequence_of(tuple_of(TERM, INSTANT), min_count=1),
                cause=TOKEN,
            ),
        ),
        part("timeouts"),
        constraint(
            "queries with increasing orders",
            lambda queries, state: are_increasing_orders(
                [query.order for query in state["stored_queries"]], state["next_order"]
            ),
        ),
        constraint(
            "queries that wait for memories of the program",
            lambda queries, state: all(map(queries.is_pending, state["stored_queries"])),
        ),
    )

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        memories: MemoryInstances,
        transforms: Transforms,
        warn: Warn,
        clock: Clock,
        watermarks: Watermarks,
        limit: int = MAX_PENDING_QUERIES,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._memories = memories
        self._transforms = transforms
        self._warn = warn
        self.limit = limit
        self._next_order = count()
        self._queries_by_order: Dict[int, PendingQuery] = {}
        self._oldest_order = 0
        self._watermarks = watermarks
        self.timeouts = Timeouts(
            clock, self._queries_by_order, self._drop_timed_out, watermarks, PatternWatermark()
        )
        self._context = QueryContext(logic, dispatcher, warn)
        self._general_query = compile_general_query(self._context)
        memories.on_update.add(self._on_memory_update)
        transforms.on_reached.add(self._on_transforms_reached)
        memories.on_delete.add(self._drop_queries_of_deleted)
        for name in ("syncronized", "synchronized"):
            key = functor(name, 3)
            dispatcher.listen(ListenerPhase.QUERIES, key(Var(), Var(), Var()), self._process_synchronized)
            # Without this shortcut, the benchmark `sync_now`, whose queries run immediately, takes 95 % more
            # instructions.
            dispatcher.shortcuts[key] = self._compile_rule_action
            key = functor(name, 4)
            dispatcher.listen(
                ListenerPhase.QUERIES,
                key(Var(), Var(), Var(), Var()),
                self._process_synchronized_with_timeout,
            )

    def __len__(self) -> int:
        return len(self._queries_by_order)

    def __iter__(self) -> Iterator[PendingQuery]:
        """Yield the pending queries, oldest first."""
        return iter(self._queries_by_order.values())

    def copy_all(self) -> List[PendingQuery]:
        """Return the pending queries, oldest first; callable from other threads."""
        return list(self._queries_by_order.values())

    def clear(self) -> None:
        """Drop all pending queries, because the clock went back."""
        self._queries_by_order.clear()
        self.timeouts.clear()
        for instance in self._memories:
            instance.clear_queries()
        self._transforms.clear_queries()

    def notify_when_reached(
        self, missing: MissingSources, client_name: Term, now: int, notify: Callable[[], None]
    ) -> int:
        """Notify a client when memories have reached their instants; return the order of its entry, for `is_waiting`.

        Args:
            missing: the memories to wait for, at least one.
            client_name: name of the client in warnings.
            now: present instant.
            notify: called once, during the dispatch of the event that completes the data.
        """
        return self._register(QueryNotifier(client_name, notify), (), now, now, missing)

    next_order = NextNumber("_next_order", "The order of the next query.")

    @property
    def stored_queries(self) -> List[StoredQuery]:
        """The pending queries; waiting clients are not included."""
        queries: List[StoredQuery] = []
        for query_order, compiled_query, values, start, end, missing in self._queries_by_order.values():
            if isinstance(compiled_query, QueryNotifier):
                continue
            event, query = compiled_query.create_terms(values)
            cause = compiled_query.cause if isinstance(compiled_query, DerivedQuery) else None
            # A transform may have become available by a change of the tree since it was registered.
            awaited = [
                (source.id, instant)
                for source, instant in missing
                if isinstance(source, AwaitedTransform) or not source.has_reached(instant)
            ]
            queries.append(StoredQuery(query_order, event, query, start, end, awaited, cause))
        return queries

    @stored_queries.setter
    def stored_queries(self, queries: Sequence[StoredQuery]) -> None:
        self._watch_sources()
        self._oldest_order = queries[0].order if queries else self.next_order
        for query_order, event, query, start, end, awaited, cause in queries:
            missing: Any = [
                (self._memories.find(source_id) or self._transforms.awaited_transform(source_id), instant)
                for source_id, instant in awaited
            ]
            compiled_query = (
                self._general_query
                if cause is None
                else DerivedQuery(self._dispatcher, self._general_query, cause)
            )
            pending = self._queries_by_order[query_order] = (
                query_order,
                compiled_query,
                (event, query),
                start,
                end,
                missing,
            )
            # Queries are registered with the last memory that is missing, as in `_register`.
            source, instant = missing[-1]
            source.add_query(instant, query_order, pending)

    def is_pending(self, query: StoredQuery) -> bool:
        """Return whether a restored query waits for memories of the program that have not reached its instants.

        Otherwise it would never be run.
        """
        for name, instant in query.awaited:
            memory = self._memories.find(name)
            # The transform buffer is not saved, so a restored query may wait for any transform.
            if (
                self._transforms.awaited_transform(name) is None
                if memory is None
                else memory.has_reached(instant)
            ):
                return False
        return True

    def is_waiting(self, order: int) -> bool:
        """Return whether a client is still waiting: neither notified nor dropped."""
        return order in self._queries_by_order

    def withdraw(self, order: int) -> None:
        """Remove the entry of a client that is still waiting."""
        if order in self._queries_by_order:
            self._remove_query(order)

    def _process_synchronized(
        self, term: Term, values: Values, start: int, end: int, next_frame: Frame
    ) -> Frame:
        event, query, conditions = values
        try:
            missing = find_missing_sources(self._logic, self._memories, self._transforms, conditions)
        except UsageError as error:
            self._warn_of_invalid_conditions(event, error)
            return next_frame
        # Without missing data, the query runs within the dispatch of the synchronized event.
        if missing:
            self._register(self._general_query_with_cause(), (event, query), start, end, missing)
            return next_frame
        return self._general_query.execute((event, query), start, end, next_frame)

    def _process_synchronized_with_timeout(
        self, term: Term, values: Values, start: int, end: int, next_frame: Frame
    ) -> Frame:
        """Process ``synchronized(Event, Query, Conditions, [timeout(Seconds)])``."""
        event, query, conditions, options = values
        try:
            wait = timeout_of(options, self._logic.brief)
            missing = find_missing_sources(self._logic, self._memories, self._transforms, conditions)
        except UsageError as error:
            self._warn_of_invalid_conditions(event, error)
            return next_frame
        if not missing:
            return self._general_query.execute((event, query), start, end, next_frame)
        order = self._register(self._general_query_with_cause(), (event, query), start, end, missing)
        self._watch_sources()
        self.timeouts.add(order, end, wait)
        return next_frame

    def _watch_sources(self) -> None:
        """Let timeouts wait for late events of the memories."""
        # Of all memories: a single watermark for all queries, which follows from the program alone, is the same after
        # a restore. Transforms come from topics without events, so their watermark is that of any topic.
        functors = frozenset(
            [functor_of(instance.recorder.pattern) for instance in self._memories]
            + ([None] if self._transforms.is_required else [])
        )
        if functors != self.timeouts.watermark.functors:
            self.timeouts.watermark = self._watermarks.watch(functors)
            self._watermarks.update()

    def _general_query_with_cause(self) -> ReleasableQuery:
        """Return the general query; with tracked lineage, its event is derived from the event being dispatched."""
        dispatcher = self._dispatcher
        return (
            DerivedQuery(dispatcher, self._general_query, dispatcher.token())
            if dispatcher.tracks_lineage
            else self._general_query
        )

    def _drop_timed_out(self, order: int, instant: int) -> None:
        """Drop a query whose timeout has expired, and dispatch an event that reports it."""
        # Only the general form of a query has a timeout, and its values are the event and the query.
        _, _, (event, query), _, _, missing = self._queries_by_order[order]
        pairs = [
            make_list([source.id, timestamps.to_term(timestamps.FloatSeconds(awaited_instant))])
            for source, awaited_instant in missing
            if not source.has_reached(awaited_instant)
        ]
        self._remove_query(order)
        machine = self._logic.machine
        report = TIMEOUT_EVENT(event, query, make_list(pairs))
        # The alarm may be called while another event is dispatched; the report does not depend on it.
        self._dispatcher.run_without_context(
            lambda: machine.run(self._dispatcher.dispatch(report, instant, instant, machine.done))
        )

    def _compile_rule_action(self, rule: EventRule, default_action: EventAction) -> Optional[EventAction]:
        """Return the action that runs when a rule matches, instead of dispatching its head.

        See `Dispatcher.shortcuts`. Return None if the query cannot be compiled.
        """
        # `Dispatcher.shortcuts` calls this only for rules whose head is ``synchronized/3``.
        head: Any = rule.definition.head
        key, event, query, conditions = head
        rule_variables, metrics = rule.vars, rule.metrics
        find_missing = compile_conditions(
            self._logic, self._memories, self._transforms, conditions, rule_variables
        )
        compiled_query = compile_query(
            self._context, event, query, rule_variables, rule.place, rule.from_outside
        )
        if find_missing is None or compiled_query is None:
            return None

        def execute_or_register(values: Values, start: int, end: int, next_frame: Frame) -> Frame:
            # The rule counts as fired although its head is not dispatched.
            metrics.firing_count += 1
            metrics.last_end = end
            try:
                missing = find_missing(values)
            except UsageError as error:
                self._warn_of_invalid_conditions(compiled_query.create_event(values), error)
                return next_frame
            if missing:
                self._register(compiled_query, values, start, end, missing)
                return next_frame
            return compiled_query.execute(values, start, end, next_frame)

        ground_count = rule.ground_value_count
        return compile_query_action(
            self._dispatcher, key, ground_count, execute_or_register, default_action, rule.meter
        )

    def _warn_of_invalid_conditions(self, event: Term, error: UsageError) -> None:
        self._warn(f"{self._logic.brief(event)} is dropped: {error}", ("dropped", event_functor(event)))

    def _register(
        self, compiled_query: ReleasableQuery, values: Values, start: int, end: int, missing: MissingSources
    ) -> int:
        """Register a query; return its order."""
        if len(self._queries_by_order) >= self.limit:
            self._drop_oldest()
        order = next(self._next_order)
        pending = self._queries_by_order[order] = (order, compiled_query, values, start, end, missing)
        source, instant = missing[-1]
        source.add_query(instant, order, pending)
        return order

    def _on_memory_update(self, instance: MemoryInstance, end: int, next_frame: Frame) -> Frame:
        """Return the frame that calls the queries that wait for no other memory, in order of registration."""
        return self._execute_ready(instance.pop_reached(end), next_frame)

    def _on_transforms_reached(self, reached: ReachedTransforms, next_frame: Frame) -> Frame:
        """Return the frame that calls the queries that wait for no other source than these transforms."""
        return self._execute_ready(
            [pending for awaited, instant in reached for pending in awaited.pop_queries(instant)], next_frame
        )

    def _execute_ready(self, released: Iterable[Any], next_frame: Frame) -> Frame:
        """Return the frame that calls the queries whose conditions are all fulfilled, in order of registration."""
        ready: List[PendingQuery] = []
        for pending in released:
            order, _, _, _, _, missing = pending
            if len(missing) == 1 or not self._register_with_next_source(pending):
                del self._queries_by_order[order]
                ready.append(pending)
        # The memory has released them in the order of their instants; the order comes first in a pending query.
        if len(ready) > 1:
            ready.sort()
        elif not ready:
            return next_frame
        return self._execute_in_order((self, iter(ready), next_frame))

    @staticmethod
    def _register_with_next_source(pending: PendingQuery) -> bool:
        """Register a query with the next source that has not reached its instant; return whether there is one."""
        order, _, _, _, _, missing = pending
        missing.pop()
        while missing:
            source, instant = missing[-1]
            if not source.has_reached(instant):
                source.add_query(instant, order, pending)
                return True
            missing.pop()
        return False

    def run(self, frame: Frame) -> Frame:
        """Call the remaining queries, as code of the frame ``(self, queries, next frame)``, one after the other."""
        return self._execute_in_order(frame)

    @staticmethod
    def _execute_in_order(frame: Frame) -> Frame:
        ready: Iterator[PendingQuery] = frame[1]
        for _, compiled_query, values, start, end, _ in ready:
            result = compiled_query.execute(values, start, end, frame)
            # The query has created frames; the machine returns to this one when they are finished.
            if result is not frame:
                return result
        return frame[2]  # type: ignore[no-any-return]

    def _drop_oldest(self) -> None:
        oldest = self._oldest_order
        # Orders only increase, so the search continues where it ended before.
        while oldest not in self._queries_by_order:
            oldest += 1
        self._oldest_order = oldest
        event = self._remove_query(oldest)
        self._warn(
            f"more than {self.limit} queries wait; the oldest is dropped: {self._logic.brief(event)}",
            "waiting",
        )

    def _remove_query(self, order: int) -> Term:
        """Remove a query; return its event."""
        _, compiled_query, values, _, _, missing = self._queries_by_order.pop(order)
        source, instant = missing[-1]
        source.remove_query(instant, order)
        return compiled_query.create_event(values)

    def _drop_queries_of_deleted(self, instance: MemoryInstance) -> None:
        """Drop the queries that wait for a deleted memory, with one warning that names them."""
        orders = [
            order
            for order, _, _, _, _, missing in self._queries_by_order.values()
            if any(source is instance and not source.has_reached(instant) for source, instant in missing)
        ]
        dropped = [self._remove_query(order) for order in orders]
        if dropped:
            show = self._logic.brief
            event_names = ", ".join(show(event) for event in dropped[:MAX_QUERIES_IN_WARNING])
            omitted_text = (
                f" and {len(dropped) - MAX_QUERIES_IN_WARNING} more"
                if len(dropped) > MAX_QUERIES_IN_WARNING
                else ""
            )
            self._warn(
                f"the memory {show(instance.id)} was deleted; "
                f"dropped are the events that waited for it: {event_names}{omitted_text}",
                ("deleted", instance),
            )
