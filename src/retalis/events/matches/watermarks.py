"""Watermarks: the time up to which the events of a pattern are assumed to have arrived.

A message is received later than its stamp says: the driver, the network and the queue take time. An alarm that ends a
pattern (``absent``, a window, ``debounce``, a state, a timeout) would run too early by that lag if it used the
receipt clock: an event with an earlier stamp may arrive later. As in stream processors with bounded
out-of-orderness, the *watermark* of a pattern is therefore the receipt clock minus a *delay*, and an alarm for an
instant runs when the watermark reaches it.

By default the delay of a pattern follows the lags of its topics. `TopicLag` is a decaying maximum of the lags of one
functor of input events, `Watermarks` finds the functors that a pattern depends on, through the rules whose heads it
names. The delay changes only if an event arrives, so equal events with equal receipt times give equal results, live
and from a bag. The flag ``watermark_delay`` and the property of that name set a fixed delay instead.
"""

from typing import Callable, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Set, Tuple
from weakref import WeakMethod, WeakSet

from ...foundation.errors import UsageError
from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import Atom, Functor, Term, deref, functor_of
from ...serialization.state_fields import StateFields, StateOwner, field, rows_of
from ...serialization.stored_field_types import CLOCK_INSTANT, COUNT, FUNCTOR
from ..language.pattern_tree import EventPattern, Pattern, RuleDefinition, walk
from ..language.rule_heads import event_raised_by

LAG_WINDOW = 10 * SECOND
"""Time in ns after which a maximum of lags begins to be forgotten; after twice that time it is forgotten."""

MAX_TOPICS = 1000
"""Maximum number of functors of input events whose lags are stored; the oldest is dropped."""

DelaySetting = Optional[int]
"""A fixed delay in ns, or None for a delay that follows the lags of the topics."""

Functors = FrozenSet[Optional[Functor]]
"""Functors of the events that a pattern names; None stands for an event that may have any functor."""


class StoredLag(NamedTuple):
    """Stored form of a `TopicLag`, with the functor of its events."""

    functor: Functor
    period_end: int
    period_max: int
    previous_max: int


def functors_of(pattern: Pattern) -> Functors:
    """Return the functors of the events that a pattern names, negated ones included."""
    nodes = walk(pattern, negated=True)
    return frozenset(functor_of(node.term) for node in nodes if isinstance(node, EventPattern))


class TopicLag:
    """Decaying maximum of the lags of input events of one functor: of the last one to two periods of `LAG_WINDOW`.

    The periods end with events only: the lag of a topic that is silent remains the last known one.

    Attributes:
        period_end: end of the present period in ns.
        period_max: largest lag of the present period in ns.
        previous_max: largest lag of the previous period in ns.
    """

    __slots__ = ("period_end", "period_max", "previous_max")

    def __init__(self, period_end: int = 0, period_max: int = 0, previous_max: int = 0):
        self.period_end = period_end
        self.period_max = period_max
        self.previous_max = previous_max

    @property
    def lag(self) -> int:
        """The lag in ns."""
        return max(self.period_max, self.previous_max)

    def observe(self, lag: int, now: int) -> bool:
        """Record the lag of an event that was received at ``now``; return whether `lag` may have changed."""
        if now < self.period_end:
            if lag <= self.period_max:
                return False
            self.period_max = lag
            return lag > self.previous_max
        self.previous_max, self.period_max = self.period_max, lag
        self.period_end = now + LAG_WINDOW
        return True


class PatternWatermark:
    """Watermark of one pattern.

    Attributes:
        functors: functors of the events that the pattern names.
        has_own_setting: whether ``setting`` replaces that of the flag.
        setting: the pattern's own setting.
        delay: delay of the watermark behind the receipt clock, in ns.
    """

    __slots__ = ("functors", "has_own_setting", "setting", "delay", "__weakref__")

    def __init__(self, functors: Functors = frozenset()):
        self.functors = functors
        self.has_own_setting = False
        self.setting: DelaySetting = None
        self.delay = 0


class Watermarks(StateOwner):
    """Lags of input events, and the watermarks of all patterns that alarms end.

    Attributes:
        is_observing: whether lags are recorded: only if a pattern or query needs them.
        setting: delay of patterns without a setting of their own.
        max_delay: upper bound in ns for delays that follow the lags.
    """

    STATE = StateFields(
        field(
            "stored_lags",
            rows_of(
                StoredLag,
                functor=FUNCTOR,
                period_end=CLOCK_INSTANT,
                period_max=COUNT,
                previous_max=COUNT,
            ),
        ),
    )

    def __init__(self, definitions: Callable[[], Iterable[RuleDefinition]]):
        self._definitions = definitions
        self._patterns: WeakSet[PatternWatermark] = WeakSet()
        self._lags: Dict[Functor, TopicLag] = {}
        self._is_outdated = False
        self._has_ended = False
        self.is_observing = False
        self.setting: DelaySetting = None
        self.max_delay = SECOND
        self._on_shorter: List[WeakMethod[Callable[[], None]]] = []

    def lags(self) -> List[Tuple[Functor, int]]:
        """Return the functors of input events with their lags in ns, by name; callable from any thread."""
        rows = [(functor, lag.lag) for functor, lag in list(self._lags.items())]
        return sorted(rows, key=lambda row: str(row[0]))

    def on_shorter_delay(self, callback: Callable[[], None]) -> None:
        """Call a method whenever delays have become shorter, which makes alarms due; its object is not kept alive."""
        self._on_shorter = [method for method in self._on_shorter if method() is not None]
        self._on_shorter.append(WeakMethod(callback))

    def watch(self, functors: Functors) -> PatternWatermark:
        """Return a new watermark for a pattern; it is kept up to date as long as the caller refers to it."""
        watermark = PatternWatermark(functors)
        self._patterns.add(watermark)
        self.start_observing()
        self._is_outdated = True
        return watermark

    def start_observing(self) -> None:
        """Start recording lags."""
        self.is_observing = True

    def configure(self, watermark: PatternWatermark, has_own_setting: bool, setting: DelaySetting) -> None:
        """Set the pattern's own setting, or none."""
        watermark.has_own_setting, watermark.setting = has_own_setting, setting
        self._is_outdated = True

    def set_default(self, setting: DelaySetting, max_delay: int) -> None:
        """Set the delay of patterns without a setting of their own, and the bound."""
        self.setting, self.max_delay = setting, max_delay
        self._is_outdated = True

    def note_changed_rules(self) -> None:
        """Note that rules were added or removed: patterns may depend on other topics."""
        self._is_outdated = True

    def observe(self, event: Term, stamp: Optional[int], now: int) -> None:
        """Record an input event.

        Args:
            event: the event.
            stamp: its end in ns; None for an event that gets the time of receipt as its stamp.
            now: time of receipt in ns.
        """
        functor = functor_of(event)
        if functor is None:
            return
        topic = self._lags.get(functor)
        if topic is None:
            topic = self._lags[functor] = TopicLag()
            self._is_outdated = True
            # Names of events come from other nodes, which may invent any number of them.
            if len(self._lags) > MAX_TOPICS:
                del self._lags[next(iter(self._lags))]
        lag = 0 if stamp is None or stamp >= now else int(now - stamp)
        # The bound also applies to old messages of latched topics and to publishers with another clock.
        if topic.observe(min(lag, self.max_delay), now):
            self._is_outdated = True
        if self._is_outdated:
            self.update()

    def update(self) -> None:
        """Compute the delays of all patterns again if lags, rules or settings have changed."""
        if not self._is_outdated:
            return
        self._is_outdated = False
        sources = self._event_sources()
        is_shorter = False
        for watermark in list(self._patterns):
            delay = self._delay_of(watermark, sources)
            is_shorter = is_shorter or delay < watermark.delay
            watermark.delay = delay
        if is_shorter:
            # In the order of registration, which is the order of alarms that are set for one instant.
            for method in self._on_shorter:
                callback = method()
                if callback is not None:
                    callback()

    def _event_sources(self) -> Dict[Functor, Set[Optional[Functor]]]:
        """Return the functors of the events from which rules derive the events of each functor."""
        sources: Dict[Functor, Set[Optional[Functor]]] = {}
        if self._lags:
            for definition in self._definitions():
                event = event_raised_by(definition.head)
                functor = None if event is None else functor_of(event)
                if functor is not None:
                    sources.setdefault(functor, set()).update(functors_of(definition.pattern))
        return sources

    def _delay_of(self, watermark: PatternWatermark, sources: Dict[Functor, Set[Optional[Functor]]]) -> int:
        if self._has_ended:
            return 0
        setting = watermark.setting if watermark.has_own_setting else self.setting
        if setting is not None:
            return setting
        return min(
            self.max_delay, max((lag.lag for lag in self._topics_of(watermark.functors, sources)), default=0)
        )

    def _topics_of(
        self, functors: Functors, sources: Dict[Functor, Set[Optional[Functor]]]
    ) -> Iterable[TopicLag]:
        """Return the lags of the topics that events of these functors come from."""
        topics: Dict[Functor, TopicLag] = {}
        visited = set(functors)
        remaining = list(functors)
        while remaining:
            functor = remaining.pop()
            is_known = False
            if functor is not None and functor in self._lags:
                topics[functor] = self._lags[functor]
                is_known = True
            if functor is not None and functor in sources:
                is_known = True
                remaining += sources[functor] - visited
                visited |= sources[functor]
            # A goal may emit the event, or its topic has sent nothing yet: any topic may be its source.
            if not is_known:
                return self._lags.values()
        return topics.values()

    def end_input(self, advance: Callable[[], object]) -> None:
        """Run the alarms that only wait for late events, because no more events will arrive."""
        self._has_ended = self._is_outdated = True
        try:
            self.update()
            advance()
        finally:
            self._has_ended, self._is_outdated = False, True

    def clear(self) -> None:
        """Forget all lags, because the clock went back."""
        self._lags.clear()
        self._is_outdated = True

    @property
    def stored_lags(self) -> List[StoredLag]:
        """The lags of all topics."""
        return [
            StoredLag(functor, lag.period_end, lag.period_max, lag.previous_max)
            for functor, lag in self._lags.items()
        ]

    @stored_lags.setter
    def stored_lags(self, lags: Iterable[StoredLag]) -> None:
        self._lags = {functor: TopicLag(*fields) for functor, *fields in lags}
        self._is_outdated = True
        self.update()


def delay_setting(value: Term) -> DelaySetting:
    """Return the setting that a value of a flag or property denotes: ``auto``, or a number of seconds.

    Raises:
        UsageError: for other values.
    """
    value = deref(value)
    if value.__class__ is Atom and value.name == "auto":
        return None
    if value.__class__ in (int, float) and 0 <= value < float("inf"):
        return round(value * SECOND)
    raise UsageError("expected auto or a number of seconds from 0")
