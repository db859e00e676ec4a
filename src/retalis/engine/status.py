"""What an engine is doing and what it holds, as plain records that turn into JSON.

All of it is read without the engine's lock, so it is there also while a goal does not end: lists and dictionaries
are copied in one step of the interpreter, and counters may be those of the event that is at work.
"""

from typing import Any, Dict, List, NamedTuple, Optional, Tuple, Union

MOST = 100
"""How many rules, memories, subscriptions and queries are listed, if nothing else is said."""

MOST_AWAITED = 20
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
