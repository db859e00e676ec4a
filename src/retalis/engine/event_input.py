"""Event input: timestamps, due alarms, and dispatch.

Topics whose messages become events because a goal says so: ``subscribe_to/2,3``.

Events that come as text, as other nodes send them.
"""

import logging
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional

from ..events.dispatch.dispatcher import Dispatcher
from ..events.language.event_declarations import event_fault
from ..events.program.program_folder import TopicEvent, Topics, TopicType
from ..events.rules.event_predicates import InputReader
from ..events.rules.event_types import EventTypes
from ..foundation.errors import RetalisError, UsageError, beginning
from ..foundation.ros_names import plain_type, topic_fault, type_fault
from ..messages.field_names import SlotNames
from ..prolog.machine.errors import domain_error, instantiation_error, permission_error, resource_error
from ..prolog.machine.machine import Machine
from ..prolog.syntax.operators import Operators
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.timestamps import WholeSeconds
from ..prolog.terms.types import Atom, String, Term, Var, deref
from .runtime.clock import Clock, StreamClock
from .runtime.problem_reports import Reports

log = logging.getLogger("retalis")


class EventInput:
    """Takes the events of an engine, one at a time.

    Args:
        logic: whose machine runs what events start.
        dispatcher: serves them.
        clock: what time it is.
        followed: the same clock where stamped events move it; None if only its owner moves it.
        start_anew: called where time went back.

    Attributes:
        taken: how many events came in.
        followed: the clock, where stamped events move it.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        followed: Optional[StreamClock],
        start_anew: Callable[[], None],
    ):
        self._logic = logic
        self._clock = clock
        self.followed = followed
        self._start_anew = start_anew
        self._serve = dispatcher.serve
        self.taken = 0

    def take(
        self, term: Term, start: Optional[int], end: Optional[int], ground: Optional[bool] = None
    ) -> None:
        """Dispatch an event; without a start it is stamped by the clock.

        Raises:
            UsageError: if it ends before it starts, or has no start and the clock is not set.
        """
        if start is None or end is None:
            start = self._clock.stamp_at_once()
            if start is None:
                start = self._stamp_after_alarms(term)
            end = start
        elif end < start:
            raise UsageError(f"{self._logic.brief(term)} ends before it starts")
        else:
            followed = self.followed
            if not (self._clock.is_quiet() if followed is None else followed.follow(end)):
                self._move_clock(end)
        self.taken += 1
        self._serve(term, start, end, ground)

    def take_message(self, term: Term, instant: Optional[int] = None) -> None:
        """Dispatch a message, now or of an instant: as `take`."""
        if instant is None:
            stamp = self._clock.stamp_at_once()
            if stamp is None:
                stamp = self._stamp_after_alarms(term)
        else:
            stamp = WholeSeconds(instant)  # the form in which the converter writes it
            followed = self.followed
            if not (self._clock.is_quiet() if followed is None else followed.follow(instant)):
                self._move_clock(instant)
        self.taken += 1
        self._serve(term, stamp, stamp, True)

    def _stamp_after_alarms(self, term: Term) -> int:
        """Return the time of an event that has none, after the alarms that are due.

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
        return clock.stamp(self._look_at_clock())

    def _move_clock(self, instant: int) -> None:
        """Move the clock to the instant of an event, and let alarms ring that are due."""
        followed = self.followed
        if followed is not None:
            followed.now()  # a clock that was set back is noticed first
            followed.move_to(instant)
        self._look_at_clock()

    def _look_at_clock(self) -> int:
        """Look what time it is, let alarms ring that are due, and return the time."""
        clock = self._clock
        now = clock.now()
        if clock.behind or clock.alarms:
            self.watch_clock()
        return now

    def watch_clock(self, move: Optional[Callable[[], object]] = None) -> None:
        """Start anew where time went back, and let alarms ring that are due; ``move`` moves the clock first."""
        if move is not None:
            move()
        clock = self._clock
        if clock.went_back():
            log.warning("time went back: memories, waiting queries and partial matches are cleared")
            self._start_anew()
        until = clock.reached()  # what comes due while alarms ring waits: events come in between
        while True:
            due = clock.due(until)
            if due is None:
                return
            instant, alarm = due
            clock.ringing = instant
            try:
                self._logic.machine.budget.apart(("an alarm", instant), lambda: alarm(instant))  # noqa: B023
            finally:
                clock.ringing = None


MAX_INPUT_TOPICS = 1000
"""Topics that goals may subscribe."""


class AskedTopic(NamedTuple):
    """A topic whose messages become events.

    Attributes:
        topic: its name, as written.
        kind: its message type.
        event: what the events are called; "" where they are called by the type.
    """

    topic: str
    kind: str
    event: str = ""

    def __str__(self) -> str:
        return f"{self.kind}, with events called {self.event}" if self.event else self.kind


Subscribe = Callable[[AskedTopic], object]
"""Has the messages of a topic become events; it must not wait for the engine."""


def by_name(topic: str) -> str:
    """Return a topic's name without the slash before it."""
    return topic.lstrip("/")


class InputTopics:
    """The topics that goals of a program subscribe.

    An engine has no topics: who feeds it does what the goals ask for, a node or a bag. Where nobody does, a goal
    succeeds with a warning, so that a program can be tried without topics.

    Args:
        logic: of the program.
        slots: are told what type the events of a name have.
        reports: takes the warning.
    """

    def __init__(self, logic: PrologSystem, slots: SlotNames, reports: Reports):
        self._logic = logic
        self._slots = slots
        self._reports = reports
        self._subscribe: Subscribe = self._nobody
        self._plain: Callable[[str], str] = by_name
        self._taken: Dict[str, AskedTopic] = {}
        self._asked: List[AskedTopic] = []
        for arity in (2, 3):
            logic.define("subscribe_to", arity, self._goal)

    def begin(
        self,
        subscribe: Subscribe,
        topics: Topics = Topics(),  # noqa: B008 - immutable
        direct: Iterable[TopicType] = (),
        plain: Callable[[str], str] = by_name,
    ) -> None:
        """Have somebody do what goals ask for from now on.

        Args:
            subscribe: does it; called once for each topic.
            topics: what ``pub_sub.xml`` says, which is done already.
            direct: further topics of which that is so.
            plain: gives the form of a name by which two are compared.
        """
        self._subscribe = subscribe
        self._plain = plain
        self._taken = {plain(one.topic): one for one in self._asked}  # of a program that was begun elsewhere
        # The direct ones come first: a node subscribes them as they are here.
        for topic, kind in (*direct, *topics.subscribed):
            try:
                self._taken.setdefault(plain(topic), AskedTopic(topic, kind, topics.event_of(topic, plain)))
            except UsageError:  # said by who subscribes it
                continue
        for wanted in self._asked:
            subscribe(wanted)

    def kept(self) -> List[AskedTopic]:
        """Return what goals have asked for; see `restore`."""
        return list(self._asked)

    def restore(self, asked: Iterable[AskedTopic]) -> None:
        """Have been asked for topics, which are subscribed when somebody begins to do so."""
        for wanted in asked:
            self._taken[self._plain(wanted.topic)] = wanted
            self._asked.append(wanted)

    def try_out(self, others: "InputTopics") -> None:
        """Be as the topics of another engine, whose program is tried in this one; subscribe nothing."""
        self._taken = dict(others._taken)  # noqa: SLF001 - its own kind
        self._asked = list(others._asked)  # noqa: SLF001
        self._plain = others._plain  # noqa: SLF001
        self._subscribe = lambda wanted: None

    def joined(self, topics: Topics) -> Topics:
        """Return what ``pub_sub.xml`` says together with what goals have asked for."""
        asked = list(self._asked)  # another thread may be at work
        events = [TopicEvent(one.topic, one.event) for one in asked if one.event]
        return topics._replace(
            subscribed=(*topics.subscribed, *(TopicType(one.topic, one.kind) for one in asked)),
            events=(*topics.events, *events),
        )

    def event_types(self) -> Dict[str, str]:
        """Return the message types of the events to which goals have given names."""
        return {one.event: one.kind for one in reversed(self._asked) if one.event}

    def _goal(self, machine: Machine, topic: Term, kind: Term, *event: Term) -> bool:
        wanted = AskedTopic(_text(topic), plain_type(_text(kind)), *map(_text, event))
        self._check("topic", topic, topic_fault(wanted.topic))
        self._check("message_type", kind, type_fault(wanted.kind))
        if event:
            self._check("event_name", event[0], event_fault(wanted.event))
        try:
            key = self._plain(wanted.topic)
        except UsageError as error:
            raise domain_error("topic", deref(topic), error.message) from error
        before = self._taken.get(key)
        if before is None:
            self._add(key, wanted)
        elif before[1:] != wanted[1:]:
            raise permission_error(
                "subscribe", "topic", deref(topic), f"it is subscribed already as {before}"
            )
        return True

    def _check(self, domain: str, term: Term, fault: object) -> None:
        if fault is not None:
            raise domain_error(domain, deref(term), str(fault))

    def _add(self, key: str, wanted: AskedTopic) -> None:
        if len(self._asked) >= MAX_INPUT_TOPICS:
            raise resource_error("topics", reason=f"goals subscribe {MAX_INPUT_TOPICS} topics at most")
        self._subscribe(wanted)
        self._taken[key] = wanted
        self._asked.append(wanted)
        if wanted.event:
            self._slots.events.setdefault(wanted.event, wanted.kind)

    def _nobody(self, wanted: AskedTopic) -> None:
        name = wanted.event or f"messages of {wanted.kind}"
        self._reports.warning(
            f"subscribe_to: topic {wanted.topic} is not subscribed: there are no topics here, as there are in a "
            f"node and with retalis bag; {name} come only as events that are given"
        )


def _text(term: Term) -> str:
    """Return an argument as text."""
    found: Any = deref(term)
    if found.__class__ is Var:
        raise instantiation_error()
    if isinstance(found, String):
        return found.text
    if not isinstance(found, Atom):
        raise domain_error("text", found, "names with a slash stand in quotes, as 'std_msgs/Bool'")
    return str(found.name)


MAX_EVENT_TEXT_CHARACTERS = 10_000_000
"""Characters of an event as text. Reading is not under the limits of what the event starts, so it has its own."""

Take = Callable[[Term, Optional[int], Optional[int], Optional[bool]], None]


class TextInput:
    """Reads events from text and refuses what is none; not for use by two threads at once.

    Args:
        operators: those that hold in the texts.
        take: takes an event, its interval, and whether it is ground, where somebody has looked.
        call: calls a goal once; None where only events are accepted.
        reports: takes a warning of what is refused.
        declared: the events that have been declared, which the others have to fit.
    """

    def __init__(
        self,
        operators: Operators,
        take: Take,
        call: Optional[Callable[[Term], bool]],
        reports: Reports,
        declared: EventTypes,
    ):
        self._reader = InputReader(operators)
        self._take = take
        self._call = call
        self._reports = reports
        self._declared = declared

    def take(self, text: str) -> None:
        """Take a text: ``event/1,2`` and ``new_event/2,3,5``, and any goal where goals are accepted."""
        if len(text) > MAX_EVENT_TEXT_CHARACTERS:
            self._refuse(
                f"{beginning(text)}: it has {len(text)} characters, at most {MAX_EVENT_TEXT_CHARACTERS} are allowed"
            )
            return
        try:
            made = self._reader.event(text)
        except RetalisError as error:
            self._refuse(error if error.place else f"{beginning(text)}: {error}")
            return
        if made is not None:
            wrong = self._declared.refusal(made.term) if self._declared.in_use else ""
            if wrong:
                self._refuse(f"{beginning(text)}: {wrong}")
            else:
                self._take(*made)
        elif self._call is not None:
            self._take_goal(text, self._call)
        else:
            self._refuse(f"{beginning(text)}: only event/1,2 and new_event/2,3,5 are accepted")

    def _take_goal(self, text: str, call: Callable[[Term], bool]) -> None:
        goal = self._reader.goal(text)
        try:
            if not call(goal):
                self._reports.warning(f"the goal {beginning(text)} fails")
        except RetalisError as error:
            self._reports.warning(f"the goal {beginning(text)} ends with an error: {error}")

    def _refuse(self, reason: object) -> None:
        self._reports.warning(f"event refused: {reason}", "refused", texts=20)
