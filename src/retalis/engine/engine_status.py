"""Status of an engine: activity, counters and contents as records that can be converted to JSON.

The status is read from other threads without the engine's lock, so it is available even if a goal does not terminate.
Lists and dictionaries are copied in one step of the interpreter, so they are consistent; counters may already include
the event that is being processed.
"""

import time
from typing import (
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
    Union,
    cast,
)

from ..events.clock.clock import Clock
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.memory import MemoryInstance
from ..events.knowledge.pending_queries import AwaitedSource, PendingQuery
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.knowledge.transform_predicates import AwaitedTransform, Transforms
from ..events.network.event_rule import EventRule
from ..events.rules.program_timers import FIRST_INSTANT
from ..events.rules.rule_base import RuleBase
from ..foundation.displayed_text import shorten
from ..prolog.terms.types import CompoundTerm, Term, Var, deref
from .event_input import EventInput
from .loaded_items import LoadedProgram
from .runtime.problem_reports import Reports
from .runtime.serial_executor import SerialExecutor
from .runtime.watchdog import Watchdog, describe_work
from .service_calls import ServiceCalls

DEFAULT_LISTING_LIMIT = 100
"""Default limit for the listed rules, memories, subscriptions and queries."""

MAX_LISTED_AWAITED = 20
"""Maximum number of memories listed for a pending query."""

Json = Union[None, bool, int, float, str, List[Any], Dict[str, Any]]


class Work(NamedTuple):
    """The work in progress.

    >>> Engine().status().work is None
    True

    Attributes:
        what: functor of the event or goal that was received, or the beginning of a text.
        seconds: duration so far, sampled by the watchdog and therefore up to half a second too short.
        goal: the running goal and its rule; empty if none is running.
        event: functor of the event that is being processed; empty if there is none.
        place: position of the goal as file, line and column; empty if unknown.
    """

    what: str
    seconds: float
    goal: str
    event: str
    place: str


class RuleStatus(NamedTuple):
    """An event rule.

    >>> engine = Engine()
    >>> engine.load(rules="hot : alarm(X) <- smoke(X) where X > 1.", source="mine")
    >>> engine.event("smoke(2)", 5)
    >>> rule = engine.status().rules[0]
    >>> rule.name, rule.label, rule.text, rule.place
    ('hot', 'hot', 'alarm(X)<-smoke(X)where X>1', 'mine:1:1')
    >>> rule.fired, rule.last_fired
    (1, 5000000000)

    Attributes:
        label: label of the rule; empty if it has none.
        text: beginning of the rule.
        place: position as file, line and column; empty for a rule that was added at run time.
        fired: number of complete matches, including those whose event had no listener.
        last_fired: end of the last match in nanoseconds; None if there was none.
        errors: number of errors in its goals.
        waiting: number of partial matches and of elements in its windows and other stream operators.
        dropped: number of these, and of keys, that were dropped because of a limit.
        keys: number of keys with a state: values that partial matches share, or by which windows are grouped.
        bytes: estimated memory of these: numbers of elements and keys times measured constants.
        delay: nanoseconds by which its alarms wait for events that are received late; see `LagStatus`.
        late: number of events that arrived too late for its windows and other stream operators.
        ahead: number of times that an event was too far ahead of the clock to advance the time of the rule or of one
            of its operators.
        name: its label, or else its event or goal, shortened.
    """

    label: str
    text: str
    place: str
    fired: int
    last_fired: Optional[int]
    errors: int
    waiting: int
    dropped: int
    keys: int
    bytes: int
    delay: int = 0
    late: int = 0
    ahead: int = 0
    name: str = ""


class MemoryStatus(NamedTuple):
    """A memory.

    >>> engine = Engine()
    >>> engine.load(goals="memorize(fire(_), [], _, fires, 2)")
    >>> for second in (1, 2, 3):
    ...     engine.event("fire(hall)", second)
    >>> engine.status().memories[0]
    MemoryStatus(id='fires', event='fire(_)', size=2, records=2, added=3, oldest=2000000000, newest=3000000000)

    Attributes:
        id: id of the memory.
        event: pattern of the events to store.
        size: maximum number of records.
        records: present number of records.
        added: number of records ever stored.
        oldest: end of the oldest record in nanoseconds; None if empty.
        newest: end of the newest event that was stored; None if there was none.
    """

    id: str
    event: str
    size: int
    records: int
    added: int
    oldest: Optional[int]
    newest: Optional[int]


class SubscriptionStatus(NamedTuple):
    """A subscription.

    >>> engine = Engine()
    >>> engine.load(goals="subscribe(fire(_), [], _, alarms, a)")
    >>> engine.event("fire(hall)", 1)
    >>> engine.status().subscriptions[0]
    SubscriptionStatus(topic='alarms', id='a', event='fire(_)', sent=1, late=0, dropped=0, ahead=0)

    Attributes:
        topic: topic of the outputs.
        id: id of the subscription.
        event: pattern of the events.
        sent: number of outputs.
        late: number of events that arrived too late for the stream operator of ``P with S``.
        dropped: number of events or keys that the stream operator dropped because of a limit.
        ahead: number of events that were too far ahead of the clock to advance the time of that operator.
    """

    topic: str
    id: str
    event: str
    sent: int
    late: int
    dropped: int
    ahead: int = 0


class AwaitedMemory(NamedTuple):
    """A memory that a synchronized query waits for; see `WaitingStatus`.

    >>> AwaitedMemory("odom", 5_000_000_000, 1_000_000_000).behind
    1000000000

    Attributes:
        id: id of the memory.
        instant: the time that the memory has to reach, in nanoseconds.
        behind: the missing time in nanoseconds; None if the memory has stored no event.
    """

    id: str
    instant: int
    behind: Optional[int]


class WaitingStatus(NamedTuple):
    """A synchronized query that is pending until memories have reached a time.

    >>> engine = Engine()
    >>> engine.load(rules="synchronized(seen(X), true, [[odom, 7]]) <- marker(X).")
    >>> engine.load(goals="memorize(pose, [], _, odom, 10)")
    >>> engine.event("pose", 2)
    >>> engine.event("marker(1)", 5)
    >>> engine.status().waiting[0]  # doctest: +ELLIPSIS
    WaitingStatus(event='seen(1)', since=5000000000, memories=(AwaitedMemory(...),), left_out=0)
    >>> engine.status().waiting[0].memories[0]
    AwaitedMemory(id='odom', instant=7000000000, behind=5000000000)

    Attributes:
        event: event that the query triggers.
        since: end of the event that started the query, in nanoseconds.
        memories: memories that have not reached the time. A transform that the query waits for is listed as
            ``tf(Target,Source)`` with the frame that is behind.
        left_out: number of such memories that are not listed.
    """

    event: str
    since: int
    memories: Tuple[AwaitedMemory, ...]
    left_out: int


class TransformStatus(NamedTuple):
    """The transforms of an engine; see `Status`.

    >>> engine = Engine()
    >>> engine.call("tf_add(map, base, 5, [[1, 0, 0], [0, 0, 0, 1]]), tf_lookup(map, base, 5, P)")
    True
    >>> engine.status().transforms
    TransformStatus(frames=2, samples=1, refused=0)

    Attributes:
        frames: number of frames.
        samples: number of transforms in the history of all frames.
        refused: number of transforms that were refused, because they are invalid, too old or too many.
    """

    frames: int
    samples: int
    refused: int


class ServiceStatus(NamedTuple):
    """The calls of services by goals; see `Status`.

    >>> engine = Engine(Clock())
    >>> engine.on_service_call(lambda call: None)
    >>> engine.call("ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)")
    True
    >>> engine.status().services
    ServiceStatus(calls=1, under_way=1, failed=0, refused=0)

    Attributes:
        calls: number of calls.
        under_way: number of calls that wait for a reply.
        failed: number of calls without a reply, including those that were refused.
        refused: number of calls that were refused because too many were under way.
    """

    calls: int
    under_way: int
    failed: int
    refused: int


class LagStatus(NamedTuple):
    """The lag of the messages of a topic, if alarms of the program wait for it; see `Status`.

    >>> clock = StreamClock(10_000_000_000)
    >>> engine = Engine(clock)
    >>> engine.load(rules="lost <- beat seq absent(beat, 2).")
    >>> engine.event("beat", 9.75)
    >>> engine.status().lags, engine.status().rules[0].delay
    ((LagStatus(event='beat/0', lag=250000000),), 250000000)

    Attributes:
        event: functor of the topic's events.
        lag: recent maximum of the time of receipt minus the stamp, in nanoseconds, at most flag
            ``max_watermark_delay``.
    """

    event: str
    lag: int


class LeftOut(NamedTuple):
    """Numbers of items that a `Status` does not list.

    >>> engine = Engine()
    >>> engine.load(rules="a <- b. c <- d.")
    >>> engine.status(most=1).left_out
    LeftOut(rules=1, memories=0, subscriptions=0, waiting=0)
    """

    rules: int
    memories: int
    subscriptions: int
    waiting: int


class Status(NamedTuple):
    """Activity and contents of an engine; created by `Engine.status`.

    Times are nanoseconds since the epoch by the engine's clock.

    >>> engine = Engine()
    >>> engine.load(rules="alarm <- fire. evacuate <- alarm.")
    >>> engine.event("fire", 1)
    >>> status = engine.status()
    >>> status.taken, status.fired, status.queued
    (1, 2, 0)
    >>> import json
    >>> json.loads(json.dumps(status.json()))["rules"][0]["text"]
    'alarm<-fire'

    Attributes:
        now: present time.
        taken: number of events received.
        fired: number of complete matches of all rules.
        queued: number of queued events.
        queue: maximum number of queued events.
        callers: number of threads whose query or other call waits.
        dropped: number of events dropped because the queue was full.
        errors: number of reported errors.
        warnings: number of reported warnings.
        matches: number of partial matches of all rules.
        alarms: number of alarms that are set.
        next_alarm: time of the next alarm; None if there is none.
        work: the work in progress; None if the engine is idle.
        rules: rules, oldest first; if not all are listed, those with the most errors.
        memories: memories, oldest first.
        subscriptions: subscriptions, oldest first.
        waiting: pending queries, oldest first.
        left_out: numbers of items of these four kinds that are not listed.
        transforms: transforms; None if the program does not read any.
        lags: lags of topics that alarms of the program wait for, by name.
        ahead: number of events whose timestamps were too far ahead of a clock that follows events: it did not move,
            or has returned.
        services: calls of services; None if there was none.
    """

    now: int
    taken: int
    fired: int
    queued: int
    queue: int
    callers: int
    dropped: int
    errors: int
    warnings: int
    matches: int
    alarms: int
    next_alarm: Optional[int]
    work: Optional[Work]
    rules: Tuple[RuleStatus, ...]
    memories: Tuple[MemoryStatus, ...]
    subscriptions: Tuple[SubscriptionStatus, ...]
    waiting: Tuple[WaitingStatus, ...]
    left_out: LeftOut
    transforms: Optional[TransformStatus] = None
    lags: Tuple[LagStatus, ...] = ()
    ahead: int = 0
    services: Optional[ServiceStatus] = None

    def json(self) -> Dict[str, Any]:
        """Return the status as dictionaries and lists, for ``json.dumps``.

        >>> Engine().status().json()["left_out"]
        {'rules': 0, 'memories': 0, 'subscriptions': 0, 'waiting': 0}
        """
        return {name: as_json(value) for name, value in self._asdict().items()}


def as_json(value: Any) -> Json:
    """Convert a record of this module, or a part of one, to dictionaries, lists and plain values."""
    if hasattr(value, "_asdict"):
        return {name: as_json(part) for name, part in value._asdict().items()}
    if isinstance(value, (tuple, list)):
        return [as_json(part) for part in value]
    return value  # type: ignore[no-any-return]


_Item = TypeVar("_Item")
_ItemStatus = TypeVar("_ItemStatus")

_FormatTerm = Callable[[Term, Optional[Mapping[Var, str]]], str]
"""A function that returns the beginning of a term's text, given names of its variables if they are known."""

_CachedTexts = Dict[int, Tuple[Term, str]]
"""Texts of terms by the id of the term; the entry keeps the term, so that its id is not reused."""


class StatusReader:
    """Reads the status of an engine from any thread.

    Texts of rules and patterns are cached between calls, as long as their items are listed.

    Args:
        executor: executor of the engine, with its queue.
        event_input: counts the events.
        service_calls: counts the calls of services.
        reports: counts errors and warnings.
        watchdog: knows since when the present work runs.
        max_queued: maximum length of the queue.
    """

    def __init__(
        self,
        program: LoadedProgram,
        executor: SerialExecutor,
        event_input: EventInput,
        service_calls: ServiceCalls,
        reports: Reports,
        watchdog: Watchdog,
        max_queued: int,
    ):
        self._program = program
        self._executor = executor
        self._event_input = event_input
        self._service_calls = service_calls
        self._reports = reports
        self._watchdog = watchdog
        self._max_queued = max_queued
        self._texts: _CachedTexts = {}

    def read(self, limit: int) -> Status:
        """Return the status, with up to ``limit`` listed items of each kind."""
        rules_of_program, knowledge = self._program.rules, self._program.knowledge
        executor, clock = self._executor, rules_of_program.clock
        texts: _CachedTexts = {}
        format_term = self._make_term_formatter(texts)
        format_brief = self._program.logic.brief
        rules, omitted_rules = _list_rules(rules_of_program, format_term, format_brief, limit)
        memories, omitted_memories = _list_memories(knowledge, format_term, format_brief, limit)
        subscriptions, omitted_subscriptions = _list_subscriptions(
            knowledge, format_term, format_brief, limit
        )
        waiting, omitted_queries = _list_queries(knowledge, format_brief, limit)
        # Replaced and not extended, so that texts of deleted rules are not kept.
        self._texts = texts
        return Status(
            now=int(clock.present()),
            taken=self._event_input.event_count,
            fired=rules_of_program.fired,
            queued=len(executor),
            queue=self._max_queued,
            callers=executor.caller_count,
            dropped=executor.dropped,
            errors=self._reports.errors,
            warnings=self._reports.warnings,
            matches=rules_of_program.match_count,
            alarms=len(clock.alarms),
            next_alarm=_find_next_alarm(clock),
            work=self._read_work(),
            rules=rules,
            memories=memories,
            subscriptions=subscriptions,
            waiting=waiting,
            left_out=LeftOut(omitted_rules, omitted_memories, omitted_subscriptions, omitted_queries),
            transforms=_read_transforms(knowledge.transforms),
            lags=tuple(
                [LagStatus(str(functor), lag) for functor, lag in rules_of_program.network.watermarks.lags()][
                    :limit
                ]
            ),
            ahead=self._event_input.far_ahead_count,
            services=_read_services(self._service_calls),
        )

    def count_records(self) -> int:
        """Return the number of partial matches and of records in memories."""
        # Called regularly, so it adds up counters and does not visit records. A memory removes old records in blocks,
        # so `ends` can be longer than `size`.
        memories = [instance.memory for instance in list(self._program.knowledge.memories)]
        return self._program.rules.match_count + sum(
            min(len(memory.ends), memory.size) for memory in memories
        )

    def _read_work(self) -> Optional[Work]:
        # The watchdog keeps the start time of the entry, which the engine itself does not record.
        running = self._watchdog.find_running_entry(time.monotonic())
        if running is None:
            return None
        entry, seconds = running
        work = describe_work(self._program.logic, self._program.rules.dispatcher, entry)
        place = "" if work.place is None else str(work.place)
        return Work(work.entry, round(seconds, 3), work.goal, work.event, place)

    def _make_term_formatter(self, texts: _CachedTexts) -> _FormatTerm:
        """Return a function that converts terms to text with a cache, and stores the used texts in ``texts``."""
        cached_texts, format_brief = self._texts, self._program.logic.brief

        def format_term(term: Term, names: Optional[Mapping[Var, str]] = None) -> str:
            key = id(term)
            entry = cached_texts.get(key)
            if entry is None:
                entry = term, format_brief(term, {**_name_variables(term), **(names or {})})
            texts[key] = entry
            _, text = entry
            return text

        return format_term


def _find_next_alarm(clock: Clock) -> Optional[int]:
    """Return the time of the next alarm; None if there is none, or only alarms for the start of the clock."""
    instant = clock.next_alarm()
    return None if instant is None or instant <= FIRST_INSTANT else instant


def _name_variables(term: Term) -> Dict[Var, str]:
    """Return names for the variables of a term: ``_`` for those that occur once, else ``X1``, ``X2`` and so on."""
    counts: Dict[Var, int] = {}
    # An explicit stack, because a term that is built at run time can be deeper than Python's recursion limit.
    pending: List[Any] = [term]
    while pending:
        part = deref(pending.pop())
        if part.__class__ is Var:
            counts[part] = counts.get(part, 0) + 1
        elif part.__class__ is tuple:
            pending.extend(reversed(part[1:]))
    shared = [var for var, count in counts.items() if count > 1]
    return {**dict.fromkeys(counts, "_"), **{var: f"X{position}" for position, var in enumerate(shared, 1)}}


def _list_rules(
    rules: RuleBase, format_term: _FormatTerm, format_brief: Callable[[Term], str], limit: int
) -> Tuple[Tuple[RuleStatus, ...], int]:
    """Return the status of rules, and the number of rules that are not listed: those with the fewest errors."""
    # Read once, because the engine may add or delete rules meanwhile.
    all_rules = listed = rules.rules
    if len(listed) > limit:
        # The sort is stable, so rules without errors keep their order, and the result is in order of the rules again.
        chosen = set(sorted(listed, key=lambda rule: -rule.metrics.error_count)[: max(0, limit)])
        listed = [rule for rule in listed if rule in chosen]

    def read_status(rule: EventRule) -> RuleStatus:
        metrics = rule.metrics
        return RuleStatus(
            label="" if rule.label is None else format_brief(rule.label),
            text=format_term(rule.definition.term, rule.definition.names),
            place="" if rule.place is None else str(rule.place),
            fired=metrics.firing_count,
            last_fired=None if metrics.last_end is None else int(metrics.last_end),
            errors=metrics.error_count,
            waiting=rule.match_count,
            dropped=rule.dropped_count,
            keys=rule.keys,
            bytes=rule.bytes,
            delay=rule.watermark_delay,
            late=rule.late_count,
            ahead=rule.ahead_count,
            name=rule.name,
        )

    return tuple([read_status(rule) for rule in listed]), len(all_rules) - len(listed)


def _list_memories(
    knowledge: KnowledgeBase, format_term: _FormatTerm, format_brief: Callable[[Term], str], limit: int
) -> Tuple[Tuple[MemoryStatus, ...], int]:
    """Return the status of memories, and the number of memories that are not listed."""

    def read_status(instance: MemoryInstance) -> MemoryStatus:
        memory = instance.memory
        # The list only grows; removal of records replaces it. So `ends` and the length read here belong together even
        # while the engine adds records.
        ends = memory.ends
        end_count = len(ends)
        records = min(end_count, memory.size)
        return MemoryStatus(
            format_brief(instance.id),
            format_term(instance.recorder.pattern, None),
            memory.size,
            records,
            memory.added_count,
            ends[end_count - records] if records else None,
            ends[end_count - 1] if end_count else None,
        )

    return _read_first(list(knowledge.memories), read_status, limit)


def _list_subscriptions(
    knowledge: KnowledgeBase, format_term: _FormatTerm, format_brief: Callable[[Term], str], limit: int
) -> Tuple[Tuple[SubscriptionStatus, ...], int]:
    """Return the status of subscriptions, and the number of subscriptions that are not listed."""

    def read_status(item: Tuple[SubscriptionKey, Subscription]) -> SubscriptionStatus:
        (topic, _), subscription = item
        _, pattern, *_ = cast("CompoundTerm", subscription.definition)
        rate_limiter = subscription.rate_limiter
        late, dropped, ahead = (
            (0, 0, 0)
            if rate_limiter is None
            else (rate_limiter.late_count, rate_limiter.dropped_count, rate_limiter.ahead_count)
        )
        return SubscriptionStatus(
            shorten(topic),
            format_brief(subscription.id),
            format_term(pattern, None),
            subscription.sent_counter.count,
            late,
            dropped,
            ahead,
        )

    return _read_first(knowledge.subscriptions.items(), read_status, limit)


def _list_queries(
    knowledge: KnowledgeBase, format_brief: Callable[[Term], str], limit: int
) -> Tuple[Tuple[WaitingStatus, ...], int]:
    """Return the status of pending queries, and the number of queries that are not listed."""

    def read_status(query: PendingQuery) -> WaitingStatus:
        _, triggered_query, values, _, end, missing = query
        statuses = [_read_awaited(source, instant, format_brief) for source, instant in tuple(missing)]
        awaited = [status for status in statuses if status is not None]
        listed = tuple(awaited[:MAX_LISTED_AWAITED])
        return WaitingStatus(
            format_brief(triggered_query.create_event(values)), int(end), listed, len(awaited) - len(listed)
        )

    return _read_first(knowledge.pending_queries.copy_all(), read_status, limit)


def _read_transforms(transforms: Transforms) -> Optional[TransformStatus]:
    buffer = transforms.buffer
    if not transforms.is_required:
        return None
    return TransformStatus(len(buffer), buffer.sample_count, buffer.refused)


def _read_services(calls: ServiceCalls) -> Optional[ServiceStatus]:
    if not calls.count:
        return None
    return ServiceStatus(calls.count, calls.under_way_count, calls.failed_count, calls.refused_count)


def _read_awaited(
    source: AwaitedSource, instant: int, format_brief: Callable[[Term], str]
) -> Optional[AwaitedMemory]:
    """Return the status of a memory or transform; None if it has reached the instant."""
    try:
        if source.has_reached(instant):
            return None
        return AwaitedMemory(
            _format_awaited(source, instant, format_brief), int(instant), _compute_lag(source, instant)
        )
    except IndexError:
        # The engine, which runs in another thread, has just cut the history of a frame. The frame and the lag are
        # omitted.
        return AwaitedMemory(format_brief(source.id), int(instant), None)


def _format_awaited(source: AwaitedSource, instant: int, format_brief: Callable[[Term], str]) -> str:
    """Return the id of a memory, or a transform with the frame that is behind."""
    if not isinstance(source, AwaitedTransform):
        return format_brief(source.id)
    frame = source.blocking_frame(instant)
    return f"{format_brief(source.id)}: {f'frame {frame[:80]}' if frame else 'not connected'}"


def _compute_lag(source: AwaitedSource, instant: int) -> Optional[int]:
    newest = source.latest_end
    return None if newest is None else max(0, int(instant) - newest)


def _read_first(
    items: Sequence[_Item], read_status: Callable[[_Item], _ItemStatus], limit: int
) -> Tuple[Tuple[_ItemStatus, ...], int]:
    """Return the status of the first items, and the number of items that are not listed."""
    chosen = items[: max(0, limit)]
    return tuple([read_status(item) for item in chosen]), len(items) - len(chosen)
