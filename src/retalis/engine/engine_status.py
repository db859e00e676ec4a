"""What an engine is doing and what it holds, as plain records that turn into JSON.

All of it is read without the engine's lock, so it is there also while a goal does not end: lists and dictionaries
are copied in one step of the interpreter, and counters may be those of the event that is at work.

Looking at an engine from outside: what `Status` tells, read without its lock.
"""

import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, TypeVar, Union

from ..events.dispatch.dispatcher import Dispatcher
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.rules.rule_base import RuleBase
from ..events.rules.timer_service import BEGIN
from ..foundation.errors import beginning
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Term, Var, deref
from .runtime.clock import Clock
from .runtime.problem_reports import Reports
from .runtime.serial_executor import SerialExecutor
from .runtime.watchdog import Watchdog, at_work

DEFAULT_LISTED = 100
"""How many rules, memories, subscriptions and queries are listed, if nothing else is said."""

MAX_AWAITED_LISTED = 20
"""How many memories are listed for a query that waits."""

Json = Union[None, bool, int, float, str, List[Any], Dict[str, Any]]


class Work(NamedTuple):
    """What an engine is busy with.

    >>> Engine().status().work is None
    True

    Attributes:
        what: what came in: the functor of an event or goal, or the beginning of a text.
        seconds: how long it has been at work; seen by looking every now and then, so up to half a second less.
        goal: the goal that runs, with its rule; empty where none does.
        event: the functor of the event that is being served; empty where none is.
        place: where the goal stands, as file, line and column; empty where that is not known.
    """

    what: str
    seconds: float
    goal: str
    event: str
    place: str


class RuleStatus(NamedTuple):
    """A rule that takes events.

    >>> engine = Engine()
    >>> engine.load(rules="hot : alarm(X) <- smoke(X) where X > 1.", source="mine")
    >>> engine.event("smoke(2)", 5)
    >>> rule = engine.status().rules[0]
    >>> rule.label, rule.text, rule.place
    ('hot', 'alarm(X)<-smoke(X)where X>1', 'mine:1:1')
    >>> rule.fired, rule.last_fired
    (1, 5000000000)

    Attributes:
        label: its label; empty where it has none.
        text: the beginning of the rule.
        place: where it stands, as file, line and column; empty for one that was made at run time.
        fired: how often its pattern was matched as a whole, whether or not anybody wanted the event.
        last_fired: the end of the last of these matches, in nanoseconds; None before the first.
        errors: how many errors stopped it.
        waiting: how many partial matches it has, with the items of windows and other operators on streams.
        dropped: how many of them, or of keys, were dropped because there were too many.
        keys: number of keys that have a state: values that partial matches share, or that group what windows hold.
        bytes: estimate of the memory of all that: the numbers of items and keys, times constants that were measured.
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


class MemoryStatus(NamedTuple):
    """A memory.

    >>> engine = Engine()
    >>> engine.load(goals="memorize(fire(_), [], _, fires, 2)")
    >>> for second in (1, 2, 3):
    ...     engine.event("fire(hall)", second)
    >>> engine.status().memories[0]
    MemoryStatus(id='fires', event='fire(_)', size=2, records=2, added=3, oldest=2000000000, newest=3000000000)

    Attributes:
        id: its id.
        event: the pattern of the events that it takes.
        size: how many records it keeps.
        records: how many it has.
        added: how many it ever took.
        oldest: the end of the oldest record, in nanoseconds; None where there is none.
        newest: the end of the newest event that it took; None before the first.
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
    SubscriptionStatus(topic='alarms', id='a', event='fire(_)', sent=1, late=0, dropped=0)

    Attributes:
        topic: where its events go.
        id: its id.
        event: their pattern.
        sent: how many have gone.
        late: how many came too late for its shape, ``P with S``, to look at.
        dropped: how many events or keys its shape had to forget because there were too many.
    """

    topic: str
    id: str
    event: str
    sent: int
    late: int
    dropped: int


class AwaitedMemory(NamedTuple):
    """A memory that a synchronized query waits for; see `WaitingStatus`.

    >>> AwaitedMemory("odom", 5_000_000_000, 1_000_000_000).behind
    1000000000

    Attributes:
        id: its id.
        instant: the instant that it has to reach, in nanoseconds.
        behind: how many nanoseconds it is short of that; None where it has taken no event.
    """

    id: str
    instant: int
    behind: Optional[int]


class WaitingStatus(NamedTuple):
    """A synchronized query that waits for memories.

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
        event: what it triggers.
        since: the end of the event that asked, in nanoseconds.
        memories: those that have not got there.
        left_out: how many more of them there are.
    """

    event: str
    since: int
    memories: Tuple[AwaitedMemory, ...]
    left_out: int


class LeftOut(NamedTuple):
    """How many more there are than a `Status` lists.

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
    """What an engine is doing and what it holds; made by `Engine.status`.

    Instants are nanoseconds since the epoch, by the engine's clock.

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
        now: what time it is by the engine's clock, in nanoseconds.
        taken: how many events came in.
        fired: how often rules fired, and so derived an event where they have a head.
        queued: how many events wait for their turn.
        queue: how many may wait.
        callers: how many queries and other calls wait for their turn.
        dropped: how many events were dropped because the queue was full.
        errors: how many errors were reported.
        warnings: the same of warnings.
        matches: how many partial matches all rules have.
        alarms: how many alarms are set.
        next_alarm: the instant of the next one; None where there is none.
        work: what the engine is busy with; None while it is idle.
        rules: the rules, the oldest first; where not all are listed, those that had most errors are.
        memories: the memories, the oldest first.
        subscriptions: the subscriptions, the oldest first.
        waiting: the queries that wait, the oldest first.
        left_out: how many more there are of these four.
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

    def json(self) -> Dict[str, Any]:
        """Return the same as dictionaries and lists, for ``json.dumps``.

        >>> Engine().status().json()["left_out"]
        {'rules': 0, 'memories': 0, 'subscriptions': 0, 'waiting': 0}
        """
        return {name: as_json(value) for name, value in self._asdict().items()}


def as_json(value: Any) -> Json:
    """Return a record of this file, or a part of one, as dictionaries, lists and plain values."""
    if hasattr(value, "_asdict"):
        return {name: as_json(part) for name, part in value._asdict().items()}
    if isinstance(value, (tuple, list)):
        return [as_json(part) for part in value]
    return value  # type: ignore[no-any-return]


_Item = TypeVar("_Item")
_Told = TypeVar("_Told")

_Text = Callable[[Term, Optional[Mapping[Var, str]]], str]
"""Gives the beginning of a term's text, by the names of its variables if they are known."""

_ShownTexts = Dict[int, Tuple[Term, str]]


class EngineView(NamedTuple):
    """The parts of an engine that are looked at.

    Attributes:
        taken: tells how many events came in.
        queue: how many may wait.
    """

    logic: PrologSystem
    dispatcher: Dispatcher
    rules: RuleBase
    knowledge: KnowledgeBase
    clock: Clock
    reports: Reports
    runner: SerialExecutor
    watchdog: Watchdog
    taken: Callable[[], int]
    queue: int


class StatusReader:
    """Reads what an engine is doing and what it holds, from any thread.

    The texts of rules and patterns are kept from one look to the next, as long as these are listed.
    """

    def __init__(self, seen: EngineView):
        self._seen = seen
        self._texts: _ShownTexts = {}

    def read(self, most: int) -> Status:
        """Return the status; at most so many of each kind are listed."""
        seen = self._seen
        texts: _ShownTexts = {}
        text = self._writer(texts)
        show = seen.logic.brief
        rules, more_rules = _rules(seen.rules, text, show, most)
        memories, more_memories = _memories(seen.knowledge, text, show, most)
        subscriptions, more_subscriptions = _subscriptions(seen.knowledge, text, show, most)
        waiting, more_waiting = _waiting(seen.knowledge, show, most)
        self._texts = texts
        return Status(
            now=int(seen.clock.present()),
            taken=seen.taken(),
            fired=seen.rules.fired,
            queued=len(seen.runner),
            queue=seen.queue,
            callers=seen.runner.callers,
            dropped=seen.runner.dropped,
            errors=seen.reports.errors,
            warnings=seen.reports.warnings,
            matches=seen.rules.waiting,
            alarms=len(seen.clock.alarms),
            next_alarm=_next_alarm(seen.clock),
            work=self._work(),
            rules=rules,
            memories=memories,
            subscriptions=subscriptions,
            waiting=waiting,
            left_out=LeftOut(more_rules, more_memories, more_subscriptions, more_waiting),
        )

    def held_records(self) -> int:
        """Return the number of partial matches and of records in memories, in little time."""
        memories = [instance.memory for instance in list(self._seen.knowledge.memories)]
        return self._seen.rules.waiting + sum(min(len(memory.ends), memory.size) for memory in memories)

    def _work(self) -> Optional[Work]:
        held = self._seen.watchdog.held(time.monotonic())
        if held is None:
            return None
        entry, seconds = held
        found = at_work(self._seen.logic, self._seen.dispatcher, entry)
        place = "" if found.place is None else str(found.place)
        return Work(found.entry, round(seconds, 3), found.goal, found.event, place)

    def _writer(self, texts: _ShownTexts) -> _Text:
        """Return what gives texts, and notes in ``texts`` those that it has given."""
        known, show = self._texts, self._seen.logic.brief

        def write(term: Term, names: Optional[Mapping[Var, str]] = None) -> str:
            key = id(term)  # the term is kept beside its text, so nothing else has its id
            found = known.get(key)
            if found is None:
                found = term, show(term, {**_letters(term), **(names or {})})
            texts[key] = found
            return found[1]

        return write


def _next_alarm(clock: Clock) -> Optional[int]:
    """Return the instant of the next alarm; None where there is none, or no time yet that it could be of."""
    instant = clock.next_alarm()
    return None if instant is None or instant <= BEGIN else instant


def _letters(term: Term) -> Dict[Var, str]:
    """Return names for variables, which have none of their own at run time: ``_`` for those that stand there once."""
    times: Dict[Var, int] = {}
    left: List[Any] = [term]
    while left:
        part = deref(left.pop())
        if part.__class__ is Var:
            times[part] = times.get(part, 0) + 1
        elif part.__class__ is tuple:
            left.extend(reversed(part[1:]))
    shared = [var for var, number in times.items() if number > 1]
    return {**dict.fromkeys(times, "_"), **{var: f"X{at}" for at, var in enumerate(shared, 1)}}


def _rules(
    rules: RuleBase, text: _Text, show: Callable[[Term], str], most: int
) -> Tuple[Tuple[RuleStatus, ...], int]:
    """Return what is to be told of rules, and how many are left out: those with the fewest errors first."""
    found = rules.rules
    if len(found) > most:
        chosen = set(sorted(found, key=lambda rule: -rule.firings.errors)[: max(0, most)])
        found = [rule for rule in found if rule in chosen]

    def told(rule: Any) -> RuleStatus:
        firings = rule.firings
        return RuleStatus(
            "" if rule.label is None else show(rule.label),
            text(rule.definition.term, rule.definition.names),
            "" if rule.place is None else str(rule.place),
            firings.number,
            None if firings.last is None else int(firings.last),
            firings.errors,
            rule.held,
            rule.dropped,
            rule.keys,
            rule.bytes,
        )

    return tuple([told(rule) for rule in found]), len(rules.rules) - len(found)


def _memories(
    knowledge: KnowledgeBase, text: _Text, show: Callable[[Term], str], most: int
) -> Tuple[Tuple[MemoryStatus, ...], int]:
    """Return what is to be told of memories, and how many are left out."""

    def told(instance: Any) -> MemoryStatus:
        memory = instance.memory
        ends = memory.ends  # this list only grows: where records go, another one takes its place
        number = len(ends)
        records = min(number, memory.size)
        return MemoryStatus(
            show(instance.id),
            text(instance.recorder.pattern, None),
            memory.size,
            records,
            memory.added,
            ends[number - records] if records else None,
            ends[number - 1] if number else None,
        )

    return _some(list(knowledge.memories), told, most)


def _subscriptions(
    knowledge: KnowledgeBase, text: _Text, show: Callable[[Term], str], most: int
) -> Tuple[Tuple[SubscriptionStatus, ...], int]:
    """Return what is to be told of subscriptions, and how many are left out."""

    def told(item: Any) -> SubscriptionStatus:
        (topic, _), one = item
        pattern, rate = one.definition[1], one.rate
        late, dropped = (0, 0) if rate is None else (rate.late, rate.dropped)
        return SubscriptionStatus(
            beginning(topic), show(one.id), text(pattern, None), one.tally.sent, late, dropped
        )

    return _some(knowledge.subscriptions.items(), told, most)


def _waiting(
    knowledge: KnowledgeBase, show: Callable[[Term], str], most: int
) -> Tuple[Tuple[WaitingStatus, ...], int]:
    """Return what is to be told of queries that wait, and how many are left out."""

    def told(one: Any) -> WaitingStatus:
        _, asked, values, _, end, missing = one
        awaited = [
            AwaitedMemory(show(instance.id), int(instant), _behind(instance, instant))
            for instance, instant in tuple(missing)
            if not instance.has(instant)
        ]
        listed = tuple(awaited[:MAX_AWAITED_LISTED])
        return WaitingStatus(show(asked.event(values)), int(end), listed, len(awaited) - len(listed))

    return _some(knowledge.waiting.all(), told, most)


def _behind(instance: Any, instant: int) -> Optional[int]:
    newest = instance.memory.latest
    return None if newest is None else max(0, int(instant) - newest)


def _some(found: Sequence[_Item], told: Callable[[_Item], _Told], most: int) -> Tuple[Tuple[_Told, ...], int]:
    """Return what is told of the first ones, and how many are left out."""
    chosen = found[: max(0, most)]
    return tuple([told(one) for one in chosen]), len(found) - len(chosen)
