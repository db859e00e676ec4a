"""Which events of a subscription are sent: those that a shape lets through, as in rules, ``P with S``.

Subscriptions: which events go out, in which form, to which topic.
"""

from itertools import count
from typing import (
    TYPE_CHECKING,
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
)

from ...foundation.errors import UsageError
from ...prolog.machine.errors import domain_error, permission_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, term_key, variables
from ...prolog.terms.types import MINUS, Atom, EventAction, Frame, Term, Values, Var, deref
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import Listener, ListenerPhase
from ..language.pattern_tree import Shaped
from ..language.window_parser import subscribed_event, subscribed_shape
from ..matches.partial_matches import NetworkOptions
from ..network.stream_compiler import shaping
from ..streams.stream_elements import StreamElement, StreamOperator, StreamOutput
from .memory import Recording, Warn, itself, key_of, recording, unused_variables

if TYPE_CHECKING:
    from ..rules.rule_base import RuleBase


KeptRate = Tuple[Any, int, int]
"""What the shape knows, and how many events came too late or were too many."""


def looked_at(part: Shaped) -> Tuple[Term, ...]:
    """Return the terms that a shape looks at."""
    return part.by if part.value is None else (part.value, *part.by)


class OutputRateLimiter:
    """Sends what a shape lets through of the events that a subscription would send without it.

    It is woken as the nodes of rules are, before all of them: subscribers get an event first.

    Args:
        part: the shape.
        names: the variables of the pattern.
        name: of the subscription, for reports.
        clock: tells the time and rings.
        warn: takes a warning.
        place: its place among all subscriptions.

    Attributes:
        send: sends what an event has been made into.
        serial: its place among the rules.
        active: whether it may be woken.
        woken: the instant at which it is to be woken; None where it is not.
        late: how many events came too late to be taken.
        dropped: how many were dropped because there were too many.
        widths: how many values group its events, and how many are looked at.
    """

    serial = 0

    def __init__(
        self, part: Shaped, names: Sequence[Var], name: str, clock: "RuleBase", warn: Warn, place: int
    ):
        self._making = shaping(part, names)
        self.widths = (len(part.by), int(part.value is not None))
        self._name = name
        self._clock = clock
        self._warn = warn
        self.send: Callable[[Term], None] = lambda term: None
        self.place = place
        self.active = True
        self.woken: Optional[int] = None
        self.late = self.dropped = self._evicted = 0
        self._stream = self._begin()

    def _begin(self) -> StreamOperator:
        stream = self._making.stream(NetworkOptions())
        stream.allowed = self._clock.newest_allowed
        stream.set_bounds(self._clock.key_bounds)
        self._evicted = 0
        return stream

    def __len__(self) -> int:
        """Return how many events, or keys, are held."""
        return len(self._stream)

    @property
    def stream(self) -> StreamOperator:
        """The operator that lets events through."""
        return self._stream

    @property
    def rule(self) -> "OutputRateLimiter":
        """What it belongs to, see `Woken`."""
        return self

    def take(self, made: Term, values: Values, start: int, end: int) -> None:
        """Take an event that the subscription would send.

        Args:
            made: what it has been made into.
            values: of the variables of the pattern.
            start: where its interval starts.
            end: where it ends.
        """
        now = self._clock.time() if self._making.clocked else 0
        stream = self._stream
        before = stream.late
        if stream.bounds is not self._clock.key_bounds:
            stream.set_bounds(self._clock.key_bounds)
        outputs = stream.take(StreamElement(made, start, end, *self._making.item(values)), now, 0)
        if stream.late != before:
            self.late += 1
            self._warn(f"{self._name}: {self._making.past}; {self.late} so far", ("late", self._name))
        if len(stream) > self._clock.cap:
            outputs = [*outputs, *stream.drop_oldest()]
            self.dropped += 1
            what = (
                f"more than {self._clock.cap} events are held; {self.dropped} of the oldest have been dropped"
            )
            self._warn(f"{self._name}: {what} so far", ("dropped", self._name))
        if stream.evicted != self._evicted:
            self.dropped += stream.evicted - self._evicted
            self._evicted = stream.evicted
            what = f"more than {stream.bounds.keys} keys are held; {self.dropped} of the oldest have been dropped"
            self._warn(f"{self._name}: {what} so far", ("dropped", self._name))
        self._wake()
        self._send(outputs)

    def ring(self, instant: int, after: Frame) -> Frame:
        """Send what is due; see `Woken`."""
        self.woken = None
        outputs = self._stream.ring(instant)
        self._wake()
        self._send(outputs)
        return after

    def _send(self, outputs: List[StreamOutput]) -> None:
        for output in outputs:
            self.send(output.items[-1].match)

    def _wake(self) -> None:
        instant = self._stream.next
        if self.active and instant is not None and (self.woken is None or instant < self.woken):
            self.woken = instant
            self._clock.wake(self, instant)

    # ---- from outside --------------------------------------------------------------------------------

    def stop(self) -> None:
        """Ring no more."""
        self.active = False
        self.woken = None

    def clear(self) -> None:
        """Forget what has come: time went back, or the program asks for it."""
        self._stream = self._begin()
        self.woken = None

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        self.restore(self.kept())

    def kept(self) -> KeptRate:
        """Return what it knows; see `restore`."""
        return self._stream.kept(), self.late, self.dropped

    def restore(self, kept: KeptRate) -> None:
        """Know what another one did that was made in the same way."""
        known, self.late, self.dropped = kept
        self._stream = self._begin()
        self._stream.restore(known)
        self.woken = None
        self._wake()


Deliver = Callable[[Term, str, Term], None]


SubscriptionKey = Tuple[str, Hashable]
"""Topic and id."""


class Tally:
    """How many events a subscription has sent."""

    __slots__ = ("sent",)

    def __init__(self) -> None:
        self.sent = 0


class Subscription(NamedTuple):
    """What listens for a subscription, its id as it was given, what it has sent, and what it was made of.

    Where it has a shape, ``rate`` lets some of its events through only.
    """

    listener: Listener
    id: Term
    tally: Tally
    definition: Term
    rate: Optional[OutputRateLimiter] = None

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
        problem: takes a report about a condition that raised an error, and warnings.
        clock: rings for those that send later.
    """

    def __init__(
        self, logic: PrologSystem, dispatcher: Dispatcher, deliver: Deliver, problem: Warn, clock: "RuleBase"
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._deliver = deliver
        self._problem = problem
        self._clock = clock
        self._places = count()
        self._all: Dict[SubscriptionKey, Subscription] = {}
        self._aside: Dict[SubscriptionKey, Subscription] = {}

    def __iter__(self) -> Iterator[SubscriptionKey]:
        return iter(list(self._all))

    def patterns(self) -> Iterator[Tuple[Term, SubscriptionKey]]:
        """Yield the pattern of each subscription with topic and id."""
        return ((one.listener.pattern, key) for key, one in self.items())

    def items(self) -> List[Tuple[SubscriptionKey, Subscription]]:
        """Return all subscriptions, the oldest first."""
        return list(self._all.items())

    def create(self, definition: Term) -> None:
        """Add a subscription of ``Pattern, Conditions, Format, Topic, Id``.

        Raises:
            PrologError: for a taken key or arguments that are not a subscription.
        """
        copied: Any = copy(definition)
        whole, conditions, form, topic, name = (deref(part) for part in copied[1:])
        try:
            part = subscribed_shape(whole)
        except UsageError as error:
            raise domain_error("subscription", whole, error.message) from None
        pattern = subscribed_event(whole)
        topic_text = self._topic(topic)
        key = (topic_text, key_of(name))
        if key in self._all:
            raise permission_error("create", "subscription", (MINUS, topic, name), "one already exists")
        who = f"subscription {self._logic.brief(name)}"
        shape, _ = recording(self._logic, self._dispatcher, pattern, conditions, form, who, self._problem)
        before = self._aside.get(key)
        known = before if before is not None and before.key == term_key(copied) else None
        tally = Tally() if known is None else known.tally
        rate = None if part is None else self._rate(part, variables(pattern), who, known)
        listener = self._dispatcher.listen(
            ListenerPhase.SUBSCRIPTIONS,
            pattern,
            self._action(shape, tally, topic_text, name, rate),
            unused=unused_variables(pattern, conditions, form, () if part is None else looked_at(part)),
        )
        self._all[key] = Subscription(listener, name, tally, copied, rate)

    def _action(
        self, shape: Recording, tally: Tally, topic: str, name: Term, rate: Optional[OutputRateLimiter]
    ) -> EventAction:
        """Return what takes the events of a subscription."""
        deliver, ground = self._deliver, self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            tally.sent += 1
            deliver(term, topic, name)
            return after

        def send_shaped(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                tally.sent += 1
                deliver(shaped, topic, name)
            return after

        if rate is None:
            return send if shape is itself else send_shaped
        take = rate.take

        def send_one(made: Term) -> None:
            tally.sent += 1
            deliver(made, topic, name)

        def let_through(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            shaped = shape(term, values, ground())
            if shaped is not None:
                take(shaped, values, start, end)
            return after

        rate.send = send_one
        return let_through

    def _rate(
        self, part: Shaped, names: Sequence[Var], who: str, known: Optional[Subscription]
    ) -> OutputRateLimiter:
        """Return what lets some events through only; it goes on where the same subscription was there before."""
        rate = OutputRateLimiter(part, names, who, self._clock, self._problem, next(self._places))
        if known is not None and known.rate is not None:
            rate.restore(known.rate.kept())
        return rate

    def set_aside(self, keys: Iterable[SubscriptionKey]) -> None:
        """Take subscriptions out; those that are made again as they were go on counting what they have sent."""
        for key in keys:
            found = self._aside[key] = self._all.pop(key)
            self._end(found)

    def forget_aside(self) -> None:
        """Forget what was set aside."""
        self._aside.clear()

    def restore(self, before: Sequence[Tuple[SubscriptionKey, Subscription]]) -> None:
        """Have these subscriptions, which have been set aside meanwhile or not, and no others."""
        self.set_aside(list(self._all))
        self._aside = dict(before)
        for _, one in before:
            self.create(one.definition)
        self.forget_aside()

    def mend(self) -> None:
        """Have nothing delivered that no subscription asks for, which an interrupt may leave, and rates ring."""
        self._dispatcher.keep_only(ListenerPhase.SUBSCRIPTIONS, {one.listener for one in self._all.values()})
        for rate in self._rates():
            rate.mend()

    def has(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription of this topic and id."""
        return (self._topic(topic), key_of(name)) in self._all

    def delete(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; returns False where there is none of this topic and id."""
        found = self._all.pop((self._topic(topic), key_of(name)), None)
        if found is None:
            return False
        self._end(found)
        return True

    def _end(self, one: Subscription) -> None:
        self._dispatcher.remove(one.listener)
        if one.rate is not None:
            one.rate.stop()

    def clear(self) -> None:
        """Have shapes forget what has come: time went back, or the program asks for it."""
        for rate in self._rates():
            rate.clear()

    def kept(self) -> List[Optional[KeptRate]]:
        """Return what the shape of each subscription knows, None where it has none; see `restore_rates`."""
        return [None if one.rate is None else one.rate.kept() for one in self._all.values()]

    def restore_rates(self, kept: Sequence[Optional[KeptRate]]) -> None:
        """Have shapes know what those of others did that are made alike."""
        for one, known in zip(self._all.values(), kept):
            if one.rate is not None and known is not None:
                one.rate.restore(known)

    def _rates(self) -> List[OutputRateLimiter]:
        return [one.rate for one in self._all.values() if one.rate is not None]

    def _topic(self, topic: Term) -> str:
        """Return a topic as text; ``robot/marker1`` reads as a division, but is meant as a name."""
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
