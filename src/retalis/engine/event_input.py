"""Event input: events of callers, of messages and of texts, and the topics that goals subscribe to.

`EventInput` moves the clock, runs the alarms that are due, and dispatches one event. An event with a timestamp moves
a clock that follows events (stream time); an event without one gets the clock's present time.
Alarms that are due come first, so that an event never overtakes a timeout that precedes it. If time goes back by more
than `clock.JUMP`, for example because a bag is played again, the state of the program is cleared first.

`TextInput` parses events from String topics. `InputTopics` implements the goal ``subscribe_to/2,3``: an engine has no
topics itself, so a node or a bag player registers a function that subscribes.
"""

import logging
from functools import partial
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Union

from ..events.clock.clock import Clock, StreamClock
from ..events.clock.stamp_jumps import JumpDecision, StampJumps
from ..events.dispatch.dispatcher import Dispatcher
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.language.event_declarations import DeclaredEvents, event_name_error
from ..events.program.topic_configuration import TopicEvent, Topics, TopicType
from ..events.rules.event_input_predicates import InputReader
from ..events.rules.rule_base import RuleBase
from ..foundation.displayed_text import shorten
from ..foundation.errors import RetalisError, UsageError
from ..foundation.interrupts import PENDING, is_interrupted
from ..foundation.ros_name_checks import ros1_type_name, strip_slashes, topic_fault, type_fault
from ..messages.message_slots import SlotNames
from ..messages.transform_messages import TransformMessage
from ..prolog.builtins.argument_checks import bound
from ..prolog.machine.errors import Halt, domain_error, permission_error, resource_error
from ..prolog.machine.machine import Machine
from ..prolog.syntax.operators import Operators
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.timestamps import format_distance
from ..prolog.terms.types import Atom, String, Term, deref, functor_of
from ..serialization.state_fields import StateFields, StateOwner, field, part
from ..serialization.stored_field_types import COUNT
from .redelivered_messages import IdentifiedMessage, ProcessedMessages
from .runtime.problem_reports import Reports

log = logging.getLogger("retalis")


class EventInput(StateOwner):
    """Dispatch of single events, in step with the clock.

    Args:
        logic: the Prolog system whose machine runs the consequences of an event.
        clock: the clock of the engine.
        rules: the rules, whose watermarks receive the lags of events behind a clock that they do not move.
        knowledge: memories, transforms, pending queries, subscriptions and states.
        report_alarm_error: reports an error of an alarm; the flag states whether no event is being dispatched and no
            goal runs.

    Attributes:
        event_count: number of events received.
        far_ahead_count: number of events whose times were too far ahead of the clock: those that did not move it, and
            those from which it returned.
        processed_messages: messages that the middleware may deliver again after a restart.
        stream_clock: the clock if timestamps of events move it.
    """

    STATE = StateFields(
        field("event_count", COUNT),
        field("far_ahead_count", COUNT),
        part("processed_messages"),
        part("stamp_jumps"),
    )

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        rules: RuleBase,
        knowledge: KnowledgeBase,
        report_alarm_error: Callable[[Exception, bool], None],
    ):
        self._logic = logic
        self._knowledge = knowledge
        self._store_transforms = knowledge.transforms.store_message
        self._clock = clock
        self.stream_clock = clock if isinstance(clock, StreamClock) and clock.follows_events else None
        self._rules = rules
        self._watermarks = rules.network.watermarks
        self._report_alarm_error = report_alarm_error
        self._dispatcher = dispatcher
        self._dispatch = dispatcher.dispatch_input
        self.event_count = self.far_ahead_count = 0
        self.processed_messages = ProcessedMessages()

    def dispatch_event(
        self, term: Term, start: Optional[int], end: Optional[int], ground: Optional[bool] = None
    ) -> None:
        """Dispatch an event.

        Args:
            term: the event.
            start: its start in ns.
            end: its end in ns; if start or end is None, both are the clock's present time.
            ground: whether the event is known to have no variables; None if unknown.

        Raises:
            UsageError: if the event ends before it starts, or has no complete interval and the clock is not set.
        """
        # Checked first: an event that is refused has no lag.
        if start is not None and end is not None and end < start:
            raise UsageError(f"{self._logic.brief(term)} ends before it starts")
        watermarks = self._watermarks
        # Before alarms run: the lag of this event delays those that it precedes by its stamp.
        if watermarks.is_observing and self.stream_clock is None:
            watermarks.observe(term, end, self._clock.present())
        if start is None or end is None:
            # The common case, in which no alarm is due and time did not go back, takes one call.
            start = self._clock.stamp_at_once()
            if start is None:
                start = self._run_alarms_and_make_stamp(term)
            end = start
        else:
            stream_clock = self.stream_clock
            is_quiet = self._clock.is_quiet() if stream_clock is None else stream_clock.follow(end)
            if not is_quiet and not self._move_clock_to(end, term):
                self._dispatch_far_ahead(term, start, end, ground)
                return
        self.event_count += 1
        self._dispatch(term, start, end, ground)

    def dispatch_message(self, term: Term, instant: Optional[int] = None) -> None:
        """Dispatch a message with a time in ns, by default the clock's present time; see `dispatch_event`."""
        watermarks = self._watermarks
        if watermarks.is_observing and self.stream_clock is None:
            watermarks.observe(term, instant, self._clock.present())
        if instant is None:
            stamp = self._clock.stamp_at_once()
            if stamp is None:
                stamp = self._run_alarms_and_make_stamp(term)
        else:
            stamp = instant if instant.__class__ is int else int(instant)
            stream_clock = self.stream_clock
            is_quiet = self._clock.is_quiet() if stream_clock is None else stream_clock.follow(instant)
            if not is_quiet and not self._move_clock_to(instant, term):
                self._dispatch_far_ahead(term, stamp, stamp, True)
                return
        self.event_count += 1
        # Messages contain no variables.
        self._dispatch(term, stamp, stamp, True)

    def dispatch_identified(self, message: IdentifiedMessage, instant: Optional[int] = None) -> None:
        """Dispatch a message as `dispatch_message` does, unless it was processed before a restart."""
        if message in self.processed_messages:
            log.info("topic %s: a message that was processed before the restart is ignored", message.topic)
            return
        try:
            self.dispatch_message(message.event, instant)
        finally:
            # Last: the clock may go back, and the messages before belong to the former time.
            self.processed_messages.add(message)

    def process_input(self, term: Union[Term, TransformMessage], instant: Optional[int] = None) -> None:
        """Dispatch a message as `dispatch_message` does, or store the transforms of a message."""
        if term.__class__ is not TransformMessage:
            self.dispatch_message(term, instant)
            return
        message: Any = term
        if not self._clock.is_quiet():
            # If time went back, the transforms of the time before must be dropped first.
            self._read_clock_and_run_alarms()
        self._store_transforms(message.transforms, message.is_static)

    def _run_alarms_and_make_stamp(self, term: Term) -> int:
        """Run the alarms that are due and return a timestamp for an event.

        Raises:
            UsageError: if the clock is not set.
        """
        clock = self._clock
        if not clock.is_set:
            raise UsageError(
                f"event '{self._logic.brief(term)}': it has no time, "
                "and the clock of the engine was never set: "
                "give the event a time, or the engine the computer's clock with Engine(clock=Clock())"
            )
        return clock.stamp(self._read_clock_and_run_alarms())

    def _move_clock_to(self, instant: int, term: Term) -> bool:
        """Move the clock to the time of an event and run the alarms that are due.

        Returns:
            False if the event is too far ahead of the clock to move it.
        """
        stream_clock = self.stream_clock
        decision = JumpDecision.FOLLOWED
        if stream_clock is not None:
            # Reading the clock first detects that its owner has set it back; moving it would hide that.
            stream_clock.now()
            decision = stream_clock.follow_checked(instant, functor_of(term))
            if decision is JumpDecision.RETURNED:
                # The clock had followed a wrong timestamp: the time of all operators is set back.
                self._knowledge.return_to(stream_clock.reached())
                self._rules.return_to(stream_clock.reached())
                self._report_return(stream_clock.jumps)
        self._read_clock_and_run_alarms()
        return decision is not JumpDecision.HELD

    def _report_return(self, jumps: StampJumps) -> None:
        """Report that the clock has followed a wrong timestamp, with the names of the events."""
        self.far_ahead_count += 1
        name = jumps.sources[0] or "a variable"
        other_count = len(jumps.sources) - 1
        others = f" and {other_count} more" if other_count else ""
        text = (
            f"event {name}{others}: its time was {format_distance(jumps.step)} ahead of the other events, which "
            f"have been late since then; the clock returns to their time; {self.far_ahead_count} so far"
        )
        self._rules.network.report_far_ahead(lambda: text)

    def _dispatch_far_ahead(self, term: Term, start: int, end: int, ground: Optional[bool]) -> None:
        """Dispatch an event whose time is too far ahead of the clock to move it, with one report for all rules."""
        self.event_count += 1
        self.far_ahead_count += 1

        def describe() -> str:
            return (
                f"event {self._logic.brief(term)}: its time is {format_distance(end - self._clock.reached())} ahead "
                "of the clock, which does not follow it while other events have the present time; time windows and "
                f"debounce ignore it; {self.far_ahead_count} so far"
            )

        self._rules.network.report_far_ahead(describe, lambda: self._dispatch(term, start, end, ground))

    def _read_clock_and_run_alarms(self) -> int:
        """Read the clock, clear the state if time went back, run the alarms that are due, and return the time."""
        clock = self._clock
        now = clock.now()
        if clock.behind or clock.alarms:
            self.process_clock_changes()
        return now

    def process_clock_changes(self, move: Optional[Callable[[], object]] = None) -> None:
        """Clear the state if time went back, and run the alarms that are due; ``move`` moves the clock first."""
        if move is not None:
            move()
        clock = self._clock
        if clock.went_back():
            log.warning("time went back: memories, waiting queries and partial matches are cleared")
            self._knowledge.clear()
            self._rules.clear()
            # Their events are lost.
            self.processed_messages.clear()
        # Rules that were added or removed may have changed the delays of alarms.
        self._watermarks.update()
        # Only alarms up to the present instant run here. An alarm that becomes due meanwhile runs before the next
        # event, so that events are processed even if alarms set new alarms.
        until = clock.reached()
        is_idle = self._dispatcher.current is None and not self._logic.machine.choices
        run_as_entry = self._logic.machine.budget.run_as_entry
        while True:
            # After an interrupt, the remaining alarms stay due.
            due_alarm = None if PENDING and is_interrupted() else clock.due(until)
            if due_alarm is None:
                return
            instant, alarm = due_alarm
            # Goals of the alarm see its own instant as the present time, even if the clock has moved further. Each
            # alarm has its own limits and errors, which affect neither the other alarms nor the event that moved the
            # clock.
            try:
                clock.ring(instant, partial(run_as_entry, ("an alarm", instant), partial(alarm, instant)))
            except Halt:
                raise
            except Exception as error:
                self._report_alarm_error(error, is_idle)

    @property
    def stamp_jumps(self) -> Optional[StampJumps]:
        """The checks of timestamps ahead; None if the clock does not follow events."""
        return None if self.stream_clock is None else self.stream_clock.jumps

    def end_input(self) -> None:
        """Run the alarms that the clock has reached and that only wait for late events: no more events will come."""
        self._watermarks.end_input(self.process_clock_changes)


MAX_INPUT_TOPICS = 1000
"""Maximum number of topics that goals subscribe to."""


class TopicRequest(NamedTuple):
    """A topic whose messages become events.

    Attributes:
        topic: name of the topic as written in the goal.
        event: name of the events; "" for the name of the message type.
    """

    topic: str
    message_type: str
    event: str = ""

    def __str__(self) -> str:
        return f"{self.message_type}, with events called {self.event}" if self.event else self.message_type


Subscribe = Callable[[TopicRequest], object]
"""A function that subscribes to a topic and makes its messages events; it must not wait for the engine."""


class InputTopics:
    """The topics that goals of a program subscribe to.

    A node or a bag player calls `set_subscriber` with a function that subscribes. Without it the goal succeeds with a
    warning, so that a program can be tested without topics.

    Args:
        slots: receives the message types of event names.
        reports: receives the warning.
    """

    def __init__(self, logic: PrologSystem, slots: SlotNames, reports: Reports):
        self._logic = logic
        self._slots = slots
        self._reports = reports
        self._subscribe: Subscribe = self._warn_unsubscribed
        self._resolve_name: Callable[[str], str] = strip_slashes
        self._subscribed: Dict[str, TopicRequest] = {}
        self._requests: List[TopicRequest] = []
        for arity in (2, 3):
            logic.define("subscribe_to", arity, self._subscribe_to)

    def set_subscriber(
        self,
        subscribe: Subscribe,
        topics: Topics = Topics(),  # noqa: B008 - immutable
        direct: Iterable[TopicType] = (),
        resolve_name: Callable[[str], str] = strip_slashes,
    ) -> None:
        """Set the function that subscribes from now on.

        Args:
            subscribe: called once for each topic.
            topics: contents of ``pub_sub.xml``; these topics are subscribed already.
            direct: further topics that are subscribed already.
            resolve_name: returns the canonical form of a topic name.
        """
        self._subscribe = subscribe
        self._resolve_name = resolve_name
        # If the program was loaded or restored before this call, its goals may already have requested topics.
        self._subscribed = {resolve_name(request.topic): request for request in self._requests}
        # Direct topics precede those of `pub_sub.xml`, because a node subscribes to them with these names.
        for topic, message_type in (*direct, *topics.subscribed):
            try:
                self._subscribed.setdefault(
                    resolve_name(topic),
                    TopicRequest(topic, message_type, topics.event_name_of(topic, resolve_name)),
                )
            except UsageError:
                # The function that subscribes to the topic reports the invalid name.
                continue
        for request in self._requests:
            subscribe(request)

    def snapshot(self) -> List[TopicRequest]:
        """Return the topics that goals have requested; see `restore`."""
        return list(self._requests)

    def restore(self, requests: Iterable[TopicRequest]) -> None:
        """Restore topics that goals have requested; `set_subscriber` subscribes to them."""
        for request in requests:
            self._subscribed[self._resolve_name(request.topic)] = request
            self._requests.append(request)

    def copy_for_trial(self, other_topics: "InputTopics") -> None:
        """Copy the topics of another engine for a trial of its program; subscribe to nothing."""
        self._subscribed = dict(other_topics._subscribed)  # noqa: SLF001 - the same class
        self._requests = list(other_topics._requests)  # noqa: SLF001
        self._resolve_name = other_topics._resolve_name  # noqa: SLF001
        self._subscribe = lambda request: None

    def merge_with(self, topics: Topics) -> Topics:
        """Return the topics of ``pub_sub.xml`` together with those that goals have requested."""
        # Copied, because the thread of the engine may append meanwhile.
        requests = list(self._requests)
        events = [TopicEvent(request.topic, request.event) for request in requests if request.event]
        return topics._replace(
            subscribed=(
                *topics.subscribed,
                *(TopicType(request.topic, request.message_type) for request in requests),
            ),
            events=(*topics.events, *events),
        )

    def event_types(self) -> Dict[str, str]:
        """Return the message types by the event names that goals have given."""
        return {request.event: request.message_type for request in reversed(self._requests) if request.event}

    def declare_topics(self, topics: Optional[Topics]) -> None:
        """Set the form of strings of a folder, and the types of event names: its own, and those of goals.

        Args:
            topics: the topics of the folder; None if it has no valid ``pub_sub.xml``.

        Raises:
            UsageError: if the program that is loaded has another form of strings.
        """
        if topics is not None:
            self._slots.fix_strings(topics.strings)
        folder_types = {} if topics is None else topics.event_types()
        self._slots.set_events({**self.event_types(), **folder_types})

    def _subscribe_to(self, machine: Machine, topic: Term, message_type: Term, *event: Term) -> bool:
        """Execute the goal ``subscribe_to(Topic, MessageType)``, or ``subscribe_to/3`` with a name for the events."""
        request = TopicRequest(get_text(topic), ros1_type_name(get_text(message_type)), *map(get_text, event))
        self._check_argument("topic", topic, topic_fault(request.topic))
        self._check_argument("message_type", message_type, type_fault(request.message_type))
        if event:
            self._check_argument("event_name", event[0], event_name_error(request.event))
        try:
            key = self._resolve_name(request.topic)
        except UsageError as error:
            raise domain_error("topic", deref(topic), error.message) from error
        # A second identical request is not an error: a reload calls the goals of a program again.
        earlier_request = self._subscribed.get(key)
        if earlier_request is None:
            self._subscribe_new(key, request)
        elif earlier_request[1:] != request[1:]:
            raise permission_error(
                "subscribe", "topic", deref(topic), f"it is subscribed already as {earlier_request}"
            )
        return True

    def _check_argument(self, domain: str, term: Term, fault: object) -> None:
        """Raise a domain error for an argument of ``subscribe_to`` unless its fault is None."""
        if fault is not None:
            raise domain_error(domain, deref(term), str(fault))

    def _subscribe_new(self, key: str, request: TopicRequest) -> None:
        if len(self._requests) >= MAX_INPUT_TOPICS:
            raise resource_error("topics", reason=f"goals subscribe to at most {MAX_INPUT_TOPICS} topics")
        # Subscribed first: if that raises, the goal fails and nothing is recorded.
        self._subscribe(request)
        self._subscribed[key] = request
        self._requests.append(request)
        if request.event:
            self._slots.events.setdefault(request.event, request.message_type)

    def _warn_unsubscribed(self, request: TopicRequest) -> None:
        name = request.event or f"messages of {request.message_type}"
        self._reports.warning(
            f"subscribe_to: topic {request.topic} is not subscribed: there are no topics here, as there are in a "
            f"node and with retalis bag; {name} are received only as posted events"
        )


def get_text(term: Term) -> str:
    """Return the text of an argument."""
    value: Any = bound(term)
    if isinstance(value, String):
        return value.text
    if not isinstance(value, Atom):
        raise domain_error("text", value, "names with a slash need quotes, as in 'std_msgs/Bool'")
    return str(value.name)


MAX_EVENT_TEXT_CHARACTERS = 10_000_000
"""Maximum length of an event as text. Parsing is not subject to the resource limits of goals, but to this limit."""

DispatchEvent = Callable[[Term, Optional[int], Optional[int], Optional[bool]], None]
"""Takes an event, its start and end in ns or None, and whether it is known to be ground (None if unknown)."""


class TextInput:
    """Reader of events from text; not thread-safe.

    Args:
        call: calls a goal once; None if only events are accepted.
        reports: receives warnings about rejected texts.
        declared: declarations that events must match.
    """

    def __init__(
        self,
        operators: Operators,
        dispatch: DispatchEvent,
        call: Optional[Callable[[Term], bool]],
        reports: Reports,
        declared: DeclaredEvents,
    ):
        self._reader = InputReader(operators)
        self._dispatch = dispatch
        self._call_goal = call
        self._reports = reports
        self._declared = declared

    def process_text(self, text: str) -> None:
        """Process a text: ``event/1,2``, ``new_event/2,3,5``, or any goal if goals are accepted."""
        if len(text) > MAX_EVENT_TEXT_CHARACTERS:
            self._reject(
                f"{shorten(text)}: it has {len(text)} characters, at most {MAX_EVENT_TEXT_CHARACTERS} are allowed"
            )
            return
        try:
            event = self._reader.parse_event(text)
        except RetalisError as error:
            self._reject(error if error.place else f"{shorten(text)}: {error}")
            return
        if event is not None:
            refusal_reason = self._declared.refusal(event.term) if self._declared.checks_events else ""
            if refusal_reason:
                self._reject(f"{shorten(text)}: {refusal_reason}")
            else:
                self._dispatch(*event)
        elif self._call_goal is not None:
            self._run_goal(text, self._call_goal)
        else:
            self._reject(f"{shorten(text)}: only event/1,2 and new_event/2,3,5 are accepted")

    def _run_goal(self, text: str, call: Callable[[Term], bool]) -> None:
        goal = self._reader.parse_goal(text)
        try:
            if not call(goal):
                self._reports.warning(f"the goal {shorten(text)} fails")
        except RetalisError as error:
            self._reports.warning(f"the goal {shorten(text)} ends with an error: {error}")

    def _reject(self, reason: object) -> None:
        self._reports.warning(f"event refused: {reason}", "refused", texts=20)
