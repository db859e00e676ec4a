"""Subscriptions: events that are sent to topics, and output rate limiting.

A subscription listens to an event pattern, tests its conditions, creates a term from its template, and delivers it
to a topic. With ``P with S`` as its pattern, an `OutputRateLimiter` forwards only some of the events, for example one
per second (``throttle``) or the last one of a burst (``debounce``). It uses the stream operators of rules, which
Esper calls output rate limiting.
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
)

from ...foundation.errors import RetalisError, RuleError, TermTooLarge, UsageError
from ...prolog.machine.errors import domain_error, permission_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, term_key, variables
from ...prolog.terms.types import MINUS, Atom, EventAction, Frame, Term, Values, deref, functor_of
from ...serialization.state_fields import StateFields, StateOwner, constraint, field, part
from ...serialization.stored_field_types import COUNT, State, invalid_value, sequence_of
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import Listener, ListenerPhase
from ..language.pattern_tree import RatePattern
from ..language.stream_parser import subscription_event, subscription_rate_operator
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import EventMatch
from ..matches.watermarks import PatternWatermark
from ..network.network_context import NetworkContext
from ..network.stream_compiler import compile_rate_spec
from ..streams.stream_operators import StreamElement, StreamOperator, StreamOutput
from .memory import (
    Recording,
    Warn,
    check_recording_arguments,
    compile_recording,
    key_of,
    record_event,
    unused_variables,
)

_NOTATION = "subscribe(Pattern, Conditions, Template, Topic, Id)"


def terms_of_rate_operator(rate_pattern: RatePattern) -> Tuple[Term, ...]:
    """Return the terms of a pattern that a rate operator uses."""
    return rate_pattern.keys if rate_pattern.value is None else (rate_pattern.value, *rate_pattern.keys)


class OutputRateLimiter(StateOwner):
    """Rate operator of a subscription, which forwards some of the events.

    The clock calls it at its alarms as it calls the nodes of rules, but before these: subscribers receive an event
    first.

    Args:
        event: pattern of the events.
        title: name of the subscription in reports.
        network: sets the alarms and provides the limits.
        warn: receives warnings.
        position: position among all subscriptions.

    Attributes:
        serial: 0, so that alarms of subscriptions run before those of rules.
        active: whether it may be called by the clock.
        alarm_instant: instant of its next alarm; None if no alarm is set.
        late_count: number of events that arrived too late.
        dropped_count: number of events that were dropped because there were too many.
        ahead_count: number of events that were too far ahead of the clock to advance the time of the operator.
        value_counts: number of values in its key, and number of other values that it uses.
    """

    STATE = StateFields(
        part("_stream", "check_element"),
        field("late_count", COUNT),
        field("dropped_count", COUNT),
        field("ahead_count", COUNT),
    )

    serial = 0

    def __init__(
        self,
        rate_pattern: RatePattern,
        event: Term,
        title: str,
        network: NetworkContext,
        warn: Warn,
        position: int,
        send: Callable[[Term], None],
    ):
        self._spec = compile_rate_spec(rate_pattern, variables(event))
        self.value_counts = (len(rate_pattern.keys), int(rate_pattern.value is not None))
        self._title = title
        self._network = network
        self._warn = warn
        self._send_term = send
        self.position = position
        self.active = True
        self.alarm_instant: Optional[int] = None
        functors = frozenset((functor_of(event),))
        self.watermark = (
            network.watermarks.watch(functors) if self._spec.uses_clock else PatternWatermark(functors)
        )
        self.late_count = self.dropped_count = self.ahead_count = self._evicted_count = 0
        self._stream = self._create_stream()

    def _create_stream(self) -> StreamOperator:
        stream = self._spec.create_operator(NetworkOptions())
        stream.limit_time(self._network.compute_max_timestamp)
        stream.set_bounds(self._network.key_bounds)
        self._evicted_count = 0
        return stream

    def __len__(self) -> int:
        """Return the number of stored events, or keys."""
        return len(self._stream)

    @property
    def stream(self) -> StreamOperator:
        """The stream operator."""
        return self._stream

    def process(self, term: Term, values: Values, start: int, end: int) -> None:
        """Process an event of the subscription.

        Args:
            term: its term.
            values: values of the variables of the pattern.
            start: start of its interval.
            end: end of its interval.
        """
        now = self._network.alarm_time() - self.watermark.delay if self._spec.uses_clock else 0
        stream = self._stream
        previous_late_count, previous_ahead_count = stream.late_count, stream.ahead_count
        # A flag may have changed the bounds, which are replaced as a whole.
        if stream.bounds is not self._network.key_bounds:
            stream.set_bounds(self._network.key_bounds)
        # The element contains the term that is sent; the operator only reads its key, values and interval.
        try:
            element = StreamElement(term, start, end, *self._spec.key_and_values(values))
            outputs = stream.process(element, now, 0)
        except (RuleError, TermTooLarge) as error:
            self.report_alarm_error(error)
            return
        is_ahead = stream.ahead_count != previous_ahead_count
        if stream.late_count != previous_late_count:
            self.late_count += 1
            if not is_ahead:
                report = f"{self._spec.late_report}; {self.late_count} so far"
                self._warn(f"{self._title}: {report}", ("late", self._title))
        if is_ahead:
            self.ahead_count += 1
            self._warn(
                f"{self._title}: {self._network.describe_ahead(end)}: it does not advance the time of the rate "
                f"operator, and debounce ignores it; {self.ahead_count} so far",
                ("ahead", self._title),
            )
        outputs = [*outputs, *self._limit_size()]
        self._set_alarm()
        self._send(outputs)

    def _limit_size(self) -> List[StreamOutput]:
        """Drop the oldest event or key if there are too many, and report it; return the outputs that this causes."""
        stream = self._stream
        outputs: List[StreamOutput] = []
        if len(stream) > self._network.max_stored:
            outputs = stream.drop_oldest()
            self._report_dropped(1, f"more than {self._network.max_stored} events")
        if stream.evicted_count != self._evicted_count:
            new_evicted_count = stream.evicted_count - self._evicted_count
            self._evicted_count = stream.evicted_count
            self._report_dropped(new_evicted_count, f"more than {stream.bounds.max_keys} keys")
        return outputs

    def _report_dropped(self, count: int, excess: str) -> None:
        self.dropped_count += count
        reason = f"{excess} are held; {self.dropped_count} of the oldest have been dropped so far"
        self._warn(f"{self._title}: {reason}", ("dropped", self._title))

    def on_alarm(self, instant: int, frame: Frame) -> Frame:
        """Send the events that are due at an instant; see `TimedNode`."""
        self.alarm_instant = None
        outputs = self._stream.advance_to(instant)
        self._set_alarm()
        self._send(outputs)
        return frame

    def report_alarm_error(self, error: RetalisError) -> None:
        """Report an error of the rate operator; see `TimedNode.report_alarm_error`."""
        self._warn(f"{self._title}: {error.message}", ("error", self._title))

    def _send(self, outputs: List[StreamOutput]) -> None:
        for output in outputs:
            self._send_term(output.elements[-1].match)

    def _set_alarm(self) -> None:
        instant = self._stream.next_deadline
        if (
            self.active
            and instant is not None
            and (self.alarm_instant is None or instant < self.alarm_instant)
        ):
            self.alarm_instant = instant
            self._network.set_node_alarm(self, instant)

    # ---- state ---------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Stop the operator; alarms have no effect any more."""
        self.active = False
        self.alarm_instant = None

    def clear(self) -> None:
        """Reset the operator, because the clock went back or the program requires it."""
        self._stream = self._create_stream()
        self.alarm_instant = None

    def return_to(self, instant: int) -> None:
        """Set the time of the operator back; see `StreamOperator.return_to`."""
        self._stream.return_to(instant)
        self._set_alarm()

    def restore(self, saved: State) -> None:
        """Set the state of an equal rate limiter."""
        self._stream = self._create_stream()
        super().restore(saved)
        self.alarm_instant = None
        self._set_alarm()

    def check_element(self, element: StreamElement, channel: int) -> None:
        """Check an element of a restored state.

        Raises:
            UsageError: if it is not one of an event of the subscription.
        """
        key_count, value_count = self.value_counts
        if len(element.key_values) != key_count or len(element.values) != value_count:
            expected = f"an element with {key_count} key values and {value_count} measured values"
            raise invalid_value((element.key_values, element.values), expected)
        if isinstance(element.match, EventMatch):
            raise invalid_value(element.match, "an element with the event of a subscription")


def _parse_rate_operator(pattern: Term) -> Optional[RatePattern]:
    """Return the rate operator of the pattern of a subscription, or None.

    Raises:
        PrologError: if it is invalid.
    """
    try:
        return subscription_rate_operator(pattern)
    except UsageError as error:
        raise domain_error("subscription", pattern, error.message) from None


Deliver = Callable[[Term, str, Term], None]
"""Takes the term of an event, the topic as text, and the id of the subscription."""

SubscriptionKey = Tuple[str, Hashable]
"""Topic and id."""


class SentCounter:
    """Number of events that a subscription has sent."""

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0


class Subscription(NamedTuple):
    """A subscription: its listener, id as given, counter, definition, and rate limiter if it has a rate operator."""

    listener: Listener
    id: Term
    sent_counter: SentCounter
    definition: Term
    rate_limiter: Optional[OutputRateLimiter] = None

    @property
    def key(self) -> Hashable:
        """Key that is equal for subscriptions with identical definitions."""
        return term_key(self.definition)


class Subscriptions(StateOwner):
    """All subscriptions of a program; topic and id together are the key.

    Args:
        logic: the system that compiles conditions.
        dispatcher: dispatcher of the events that are delivered.
        deliver: receives the events that are sent.
        warn: receives warnings, and reports about conditions that raised an error.
        network: sets the alarms of the rate limiters and provides their limits.
    """

    STATE = StateFields(
        field("sent_counts", sequence_of(COUNT)),
        constraint(
            "a count of outputs for each subscription",
            lambda subscriptions, state: len(state["sent_counts"]) == len(subscriptions.items()),
        ),
    )

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        deliver: Deliver,
        warn: Warn,
        network: NetworkContext,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._deliver = deliver
        self._warn = warn
        self._network = network
        self._next_position = count()
        self._all: Dict[SubscriptionKey, Subscription] = {}
        self._detached: Dict[SubscriptionKey, Subscription] = {}

    def __iter__(self) -> Iterator[SubscriptionKey]:
        return iter(list(self._all))

    @property
    def sent_counts(self) -> List[int]:
        """Number of events that each subscription has sent."""
        return [subscription.sent_counter.count for subscription in self._all.values()]

    @sent_counts.setter
    def sent_counts(self, counts: Sequence[int]) -> None:
        for subscription, sent_count in zip(self._all.values(), counts):
            subscription.sent_counter.count = sent_count

    def patterns(self) -> Iterator[Tuple[Term, SubscriptionKey]]:
        """Yield the pattern of each subscription with topic and id."""
        return ((subscription.listener.pattern, key) for key, subscription in self.items())

    def items(self) -> List[Tuple[SubscriptionKey, Subscription]]:
        """Return all subscriptions, oldest first."""
        return list(self._all.items())

    def create(self, definition: Term) -> None:
        """Add a subscription of ``(Functor, Pattern, Conditions, Template, Topic, Id)``.

        Raises:
            PrologError: if the key is taken, or the arguments do not define a subscription.
        """
        copied: Any = copy(definition)
        full_pattern, conditions, template, topic, subscription_id = (
            deref(argument) for argument in copied[1:]
        )
        check_recording_arguments(conditions, subscription_id, _NOTATION)
        rate_operator = _parse_rate_operator(full_pattern)
        pattern = subscription_event(full_pattern)
        topic_text = self._topic_text(topic)
        key = (topic_text, key_of(subscription_id))
        if key in self._all:
            raise permission_error(
                "create",
                "subscription",
                (MINUS, topic, subscription_id),
                "one already exists: write another id",
            )
        title = f"subscription {self._logic.brief(subscription_id)}"
        recording, _ = compile_recording(
            self._logic, self._dispatcher, pattern, conditions, template, title, self._warn
        )
        unchanged = self._find_detached(key, copied)
        sent_counter = SentCounter() if unchanged is None else unchanged.sent_counter
        rate_limiter = None
        rate_terms: Tuple[Term, ...] = ()
        if rate_operator is not None:
            send = self._create_sender(sent_counter, topic_text, subscription_id)
            rate_limiter = self._create_rate_limiter(rate_operator, pattern, title, unchanged, send)
            rate_terms = terms_of_rate_operator(rate_operator)
        listener = self._dispatcher.listen(
            ListenerPhase.SUBSCRIPTIONS,
            pattern,
            self._create_event_action(recording, sent_counter, topic_text, subscription_id, rate_limiter),
            unread_variables=unused_variables(pattern, conditions, template, rate_terms),
        )
        self._all[key] = Subscription(listener, subscription_id, sent_counter, copied, rate_limiter)

    def _find_detached(self, key: SubscriptionKey, definition: Term) -> Optional[Subscription]:
        """Return the subscription that a reload has detached, if it has this definition.

        Its counter and the state of its rate limiter continue.
        """
        subscription = self._detached.get(key)
        return None if subscription is None or subscription.key != term_key(definition) else subscription

    def _create_event_action(
        self,
        recording: Recording,
        sent_counter: SentCounter,
        topic: str,
        subscription_id: Term,
        rate_limiter: Optional[OutputRateLimiter],
    ) -> EventAction:
        deliver, is_ground_context = self._deliver, self._dispatcher.ground

        def send(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            # Counted before delivery: a callback that reads the counter sees its own event.
            sent_counter.count += 1
            deliver(term, topic, subscription_id)
            return frame

        def send_record(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            output_term = recording(term, values, is_ground_context())
            if output_term is not None:
                sent_counter.count += 1
                deliver(output_term, topic, subscription_id)
            return frame

        if rate_limiter is None:
            return send if recording is record_event else send_record
        limit_rate = rate_limiter.process

        def send_limited(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            output_term = recording(term, values, is_ground_context())
            if output_term is not None:
                limit_rate(output_term, values, start, end)
            return frame

        return send_limited

    def _create_sender(
        self, sent_counter: SentCounter, topic: str, subscription_id: Term
    ) -> Callable[[Term], None]:
        """Return the function that sends the terms of a rate limiter."""
        deliver = self._deliver

        def send(term: Term) -> None:
            sent_counter.count += 1
            deliver(term, topic, subscription_id)

        return send

    def _create_rate_limiter(
        self,
        rate_operator: RatePattern,
        event: Term,
        title: str,
        unchanged: Optional[Subscription],
        send: Callable[[Term], None],
    ) -> OutputRateLimiter:
        """Return the rate limiter, with the state of an unchanged subscription that was detached."""
        rate_limiter = OutputRateLimiter(
            rate_operator, event, title, self._network, self._warn, next(self._next_position), send
        )
        if unchanged is not None and unchanged.rate_limiter is not None:
            rate_limiter.restore(unchanged.rate_limiter.snapshot())
        return rate_limiter

    def detach(self, keys: Iterable[SubscriptionKey]) -> None:
        """Remove subscriptions; those that are created again without a change continue with their counters."""
        for key in keys:
            subscription = self._detached[key] = self._all.pop(key)
            self._remove(subscription)

    def discard_detached(self) -> None:
        """Discard the subscriptions that were detached."""
        self._detached.clear()

    def restore_all(self, saved_subscriptions: Sequence[Tuple[SubscriptionKey, Subscription]]) -> None:
        """Restore exactly these subscriptions, whether or not they have been detached meanwhile."""
        self.detach(list(self._all))
        self._detached = dict(saved_subscriptions)
        for _, subscription in saved_subscriptions:
            self.create(subscription.definition)
        self.discard_detached()

    def has(self, topic: Term, subscription_id: Term) -> bool:
        """Return whether there is a subscription with this topic and id."""
        return (self._topic_text(topic), key_of(subscription_id)) in self._all

    def delete(self, topic: Term, subscription_id: Term) -> bool:
        """Delete a subscription; return False if there is none with this topic and id."""
        subscription = self._all.pop((self._topic_text(topic), key_of(subscription_id)), None)
        if subscription is None:
            return False
        self._remove(subscription)
        return True

    def _remove(self, subscription: Subscription) -> None:
        self._dispatcher.remove(subscription.listener)
        if subscription.rate_limiter is not None:
            subscription.rate_limiter.stop()

    def clear(self) -> None:
        """Reset all rate operators, because the clock went back or the program requires it."""
        for rate_limiter in self.rate_limiters():
            rate_limiter.clear()

    def return_to(self, instant: int) -> None:
        """Set the time of all rate operators back."""
        for rate_limiter in self.rate_limiters():
            rate_limiter.return_to(instant)

    def rate_limiters(self) -> List[OutputRateLimiter]:
        """Return the rate limiters of the subscriptions that have one, in order."""
        return [
            subscription.rate_limiter
            for subscription in self._all.values()
            if subscription.rate_limiter is not None
        ]

    def _topic_text(self, topic: Term) -> str:
        """Return a topic as text.

        A topic such as ``robot/marker1`` is parsed as a division; its text is the name of the topic.
        """
        key_of(topic)
        topic = deref(topic)
        return topic.name if topic.__class__ is Atom else self._logic.show(topic, quoted=False)
