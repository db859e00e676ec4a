"""Subscriptions: events that are sent to topics, their form, and output rate limiting.

A subscription listens to an event pattern, tests its conditions, makes a term of its form, and delivers it to a
topic. With ``P with S`` as its pattern, an `OutputRateLimiter` forwards only some of the events, for example one per
second (``throttle``) or the last one of a burst (``debounce``). It uses the same stream operators as rules do, which
Esper calls output rate limiting.
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
from ..language.pattern_tree import RatePattern
from ..language.stream_parser import subscription_event, subscription_rate_operator
from ..matches.partial_matches import NetworkOptions
from ..network.stream_compiler import rate_node_spec
from ..streams.stream_operator import StreamElement, StreamOperator, StreamOutput
from .memory import Recording, Warn, compile_recording, key_of, record_event, unused_variables

if TYPE_CHECKING:
    from ..rules.rule_base import RuleBase


RateLimiterState = Tuple[Any, int, int]
"""State of the operator, number of late events, and number of dropped events."""


def rate_terms(part: RatePattern) -> Tuple[Term, ...]:
    """Return the terms of a pattern that a rate operator uses."""
    return part.by if part.value is None else (part.value, *part.by)


class OutputRateLimiter:
    """Forwards some of the events of a subscription.

    The clock calls it like the nodes of rules, but before them: subscribers receive an event first.

    Args:
        part: the rate operator.
        names: variables of the pattern.
        name: name of the subscription in reports.
        clock: the rules of the program, which call it at its deadlines.
        warn: receives warnings.
        position: position among all subscriptions.

    Attributes:
        send: sends the term of an event.
        serial: position among the rules.
        active: whether it may be called by the clock.
        wakeup_time: instant of its next alarm; None if no alarm is set.
        late: number of events that arrived too late.
        dropped: number of events that were dropped because there were too many.
        widths: number of values in its key, and number of other values that it uses.
    """

    serial = 0

    def __init__(
        self, part: RatePattern, names: Sequence[Var], name: str, clock: "RuleBase", warn: Warn, position: int
    ):
        self._spec = rate_node_spec(part, names)
        self.widths = (len(part.by), int(part.value is not None))
        self._name = name
        self._clock = clock
        self._warn = warn
        self.send: Callable[[Term], None] = lambda term: None
        self.place = position
        self.active = True
        self.wakeup_time: Optional[int] = None
        self.late = self.dropped = self._evicted_count = 0
        self._stream = self._create_stream()

    def _create_stream(self) -> StreamOperator:
        stream = self._spec.stream(NetworkOptions())
        stream.compute_max_timestamp = self._clock.compute_max_timestamp
        stream.set_bounds(self._clock.key_bounds)
        self._evicted_count = 0
        return stream

    def __len__(self) -> int:
        """Return the number of stored events, or keys."""
        return len(self._stream)

    @property
    def stream(self) -> StreamOperator:
        """The stream operator."""
        return self._stream

    @property
    def rule(self) -> "OutputRateLimiter":
        """The owner, see `TimedNode`."""
        return self

    def take(self, term: Term, values: Values, start: int, end: int) -> None:
        """Process an event of the subscription.

        Args:
            term: its term.
            values: values of the variables of the pattern.
            start: start of its interval.
            end: end of its interval.
        """
        now = self._clock.time() if self._spec.clocked else 0
        stream = self._stream
        previous_late = stream.late_count
        # A flag may have changed the bounds, which are replaced as a whole.
        if stream.bounds is not self._clock.key_bounds:
            stream.set_bounds(self._clock.key_bounds)
        # The element contains the term that is sent; the operator only reads its key, values and interval.
        outputs = stream.process(StreamElement(term, start, end, *self._spec.item(values)), now, 0)
        if stream.late_count != previous_late:
            self.late += 1
            self._warn(f"{self._name}: {self._spec.late_report}; {self.late} so far", ("late", self._name))
        if len(stream) > self._clock.cap:
            outputs = [*outputs, *stream.drop_oldest()]
            self.dropped += 1
            reason = (
                f"more than {self._clock.cap} events are held; {self.dropped} of the oldest have been dropped"
            )
            self._warn(f"{self._name}: {reason} so far", ("dropped", self._name))
        if stream.evicted_count != self._evicted_count:
            self.dropped += stream.evicted_count - self._evicted_count
            self._evicted_count = stream.evicted_count
            reason = f"more than {stream.bounds.keys} keys are held; {self.dropped} of the oldest have been dropped"
            self._warn(f"{self._name}: {reason} so far", ("dropped", self._name))
        self._set_alarm()
        self._send(outputs)

    def on_alarm(self, instant: int, frame: Frame) -> Frame:
        """Send the events that are due at an instant; see `TimedNode`."""
        self.wakeup_time = None
        outputs = self._stream.advance_to(instant)
        self._set_alarm()
        self._send(outputs)
        return frame

    def _send(self, outputs: List[StreamOutput]) -> None:
        for output in outputs:
            self.send(output.elements[-1].match)

    def _set_alarm(self) -> None:
        instant = self._stream.next_deadline
        if self.active and instant is not None and (self.wakeup_time is None or instant < self.wakeup_time):
            self.wakeup_time = instant
            self._clock.wake(self, instant)

    # ---- state ---------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Stop the operator; alarms have no effect any more."""
        self.active = False
        self.wakeup_time = None

    def clear(self) -> None:
        """Reset the operator, because the clock went back or the program requires it."""
        self._stream = self._create_stream()
        self.wakeup_time = None

    def repair(self) -> None:
        """Repair the operator after an interrupt."""
        self.restore(self.snapshot())

    def snapshot(self) -> RateLimiterState:
        """Return the state; see `restore`."""
        return self._stream.snapshot(), self.late, self.dropped

    def restore(self, saved: RateLimiterState) -> None:
        """Set the state of an equal rate limiter."""
        stream_state, self.late, self.dropped = saved
        self._stream = self._create_stream()
        self._stream.restore(stream_state)
        self.wakeup_time = None
        self._set_alarm()


Deliver = Callable[[Term, str, Term], None]


SubscriptionKey = Tuple[str, Hashable]
"""Topic and id."""


class SentCounter:
    """Number of events that a subscription has sent."""

    __slots__ = ("number",)

    def __init__(self) -> None:
        self.number = 0


class Subscription(NamedTuple):
    """A subscription: its listener, id as given, counter, definition, and rate limiter if it has a rate operator."""

    listener: Listener
    id: Term
    tally: SentCounter
    definition: Term
    rate: Optional[OutputRateLimiter] = None

    @property
    def key(self) -> Hashable:
        """Key that is equal for subscriptions that send the same of the same events, with the same topic and id."""
        return term_key(self.definition)


class Subscriptions:
    """All subscriptions of a program; topic and id together are the key.

    Args:
        logic: the system that compiles conditions.
        dispatcher: dispatcher of the events that are delivered.
        deliver: called with the term, the topic as text, and the id of the subscription.
        warn: receives warnings, and reports about conditions that raised an error.
        rules: rules of the program; they call the rate limiters at their deadlines.
    """

    def __init__(
        self, logic: PrologSystem, dispatcher: Dispatcher, deliver: Deliver, warn: Warn, rules: "RuleBase"
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._deliver = deliver
        self._warn = warn
        self._rules = rules
        self._positions = count()
        self._all: Dict[SubscriptionKey, Subscription] = {}
        self._detached: Dict[SubscriptionKey, Subscription] = {}

    def __iter__(self) -> Iterator[SubscriptionKey]:
        return iter(list(self._all))

    def patterns(self) -> Iterator[Tuple[Term, SubscriptionKey]]:
        """Yield the pattern of each subscription with topic and id."""
        return ((subscription.listener.pattern, key) for key, subscription in self.items())

    def items(self) -> List[Tuple[SubscriptionKey, Subscription]]:
        """Return all subscriptions, oldest first."""
        return list(self._all.items())

    def create(self, definition: Term) -> None:
        """Add a subscription of ``Pattern, Conditions, Format, Topic, Id``.

        Raises:
            PrologError: if the key is taken, or the arguments do not define a subscription.
        """
        copied: Any = copy(definition)
        full_pattern, conditions, form, topic, name = (deref(argument) for argument in copied[1:])
        try:
            rate_operator = subscription_rate_operator(full_pattern)
        except UsageError as error:
            raise domain_error("subscription", full_pattern, error.message) from None
        pattern = subscription_event(full_pattern)
        topic_text = self._topic_text(topic)
        key = (topic_text, key_of(name))
        if key in self._all:
            raise permission_error("create", "subscription", (MINUS, topic, name), "one already exists")
        title = f"subscription {self._logic.brief(name)}"
        recording, _ = compile_recording(
            self._logic, self._dispatcher, pattern, conditions, form, title, self._warn
        )
        detached_subscription = self._detached.get(key)
        # Detached by a reload and unchanged: the counter and the state of the rate limiter continue.
        unchanged = (
            detached_subscription
            if detached_subscription is not None and detached_subscription.key == term_key(copied)
            else None
        )
        tally = SentCounter() if unchanged is None else unchanged.tally
        rate = (
            None
            if rate_operator is None
            else self._create_rate_limiter(rate_operator, variables(pattern), title, unchanged)
        )
        listener = self._dispatcher.listen(
            ListenerPhase.SUBSCRIPTIONS,
            pattern,
            self._event_action(recording, tally, topic_text, name, rate),
            unused=unused_variables(
                pattern, conditions, form, () if rate_operator is None else rate_terms(rate_operator)
            ),
        )
        self._all[key] = Subscription(listener, name, tally, copied, rate)

    def _event_action(
        self,
        recording: Recording,
        tally: SentCounter,
        topic: str,
        name: Term,
        rate: Optional[OutputRateLimiter],
    ) -> EventAction:
        """Return the action for the events of a subscription."""
        deliver, ground = self._deliver, self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            # Counted before delivery: a callback that reads the counter sees its own event.
            tally.number += 1
            deliver(term, topic, name)
            return frame

        def send_record(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            record = recording(term, values, ground())
            if record is not None:
                tally.number += 1
                deliver(record, topic, name)
            return frame

        if rate is None:
            return send if recording is record_event else send_record
        limit_rate = rate.take

        def send_term(term: Term) -> None:
            tally.number += 1
            deliver(term, topic, name)

        def send_limited(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            record = recording(term, values, ground())
            if record is not None:
                limit_rate(record, values, start, end)
            return frame

        rate.send = send_term
        return send_limited

    def _create_rate_limiter(
        self, rate_operator: RatePattern, names: Sequence[Var], title: str, unchanged: Optional[Subscription]
    ) -> OutputRateLimiter:
        """Return the rate limiter, with the state of an unchanged subscription that was detached."""
        rate = OutputRateLimiter(rate_operator, names, title, self._rules, self._warn, next(self._positions))
        if unchanged is not None and unchanged.rate is not None:
            rate.restore(unchanged.rate.snapshot())
        return rate

    def detach(self, keys: Iterable[SubscriptionKey]) -> None:
        """Remove subscriptions; those that are created again without a change continue with their counters."""
        for key in keys:
            subscription = self._detached[key] = self._all.pop(key)
            self._remove(subscription)

    def discard_detached(self) -> None:
        """Forget the subscriptions that were detached."""
        self._detached.clear()

    def restore_all(self, before: Sequence[Tuple[SubscriptionKey, Subscription]]) -> None:
        """Restore exactly these subscriptions, whether or not they have been detached meanwhile."""
        self.detach(list(self._all))
        self._detached = dict(before)
        for _, subscription in before:
            self.create(subscription.definition)
        self.discard_detached()

    def repair(self) -> None:
        """Repair the subscriptions after an interrupt."""
        # An interrupt may leave a listener without a subscription, which would deliver events that nobody asked
        # for.
        self._dispatcher.remove_all_except(
            ListenerPhase.SUBSCRIPTIONS, {subscription.listener for subscription in self._all.values()}
        )
        for rate in self._rate_limiters():
            rate.repair()

    def has(self, topic: Term, name: Term) -> bool:
        """Return whether there is a subscription with this topic and id."""
        return (self._topic_text(topic), key_of(name)) in self._all

    def delete(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; return False if there is none with this topic and id."""
        subscription = self._all.pop((self._topic_text(topic), key_of(name)), None)
        if subscription is None:
            return False
        self._remove(subscription)
        return True

    def _remove(self, subscription: Subscription) -> None:
        self._dispatcher.remove(subscription.listener)
        if subscription.rate is not None:
            subscription.rate.stop()

    def clear(self) -> None:
        """Reset all rate operators, because the clock went back or the program requires it."""
        for rate in self._rate_limiters():
            rate.clear()

    def snapshot(self) -> List[Optional[RateLimiterState]]:
        """Return the state of each rate limiter, None for subscriptions without one; see `restore_rates`."""
        return [
            None if subscription.rate is None else subscription.rate.snapshot()
            for subscription in self._all.values()
        ]

    def restore_rates(self, saved: Sequence[Optional[RateLimiterState]]) -> None:
        """Set the states of the rate limiters of equal subscriptions."""
        for subscription, rate_state in zip(self._all.values(), saved):
            if subscription.rate is not None and rate_state is not None:
                subscription.rate.restore(rate_state)

    def _rate_limiters(self) -> List[OutputRateLimiter]:
        return [subscription.rate for subscription in self._all.values() if subscription.rate is not None]

    def _topic_text(self, topic: Term) -> str:
        """Return a topic as text.

        A topic such as ``robot/marker1`` is read as a division, but means a name.
        """
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
