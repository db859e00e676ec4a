"""Topics whose messages become events because a goal says so: ``subscribe_to/2,3``."""

from typing import Any, Callable, Dict, Iterable, List, NamedTuple

from ..events.language import event_fault
from ..events.program import TopicEvent, Topics, TopicType
from ..foundation import UsageError, plain_type, topic_fault, type_fault
from ..messages import SlotNames
from ..prolog.logic import Logic
from ..prolog.machine import (
    Machine,
    domain_error,
    instantiation_error,
    permission_error,
    resource_error,
)
from ..prolog.terms import Atom, String, Term, Var, deref
from .runtime import Reports

MOST_TOPICS = 1000
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

    def __init__(self, logic: Logic, slots: SlotNames, reports: Reports):
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
        if len(self._asked) >= MOST_TOPICS:
            raise resource_error("topics", reason=f"goals subscribe {MOST_TOPICS} topics at most")
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
