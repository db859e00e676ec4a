"""Looking at an engine from outside: what `Status` tells, read without its lock."""

import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, TypeVar

from ..events.dispatch import Dispatcher
from ..events.knowledge import Knowledge
from ..events.rules import BEGIN, Rules
from ..foundation import beginning
from ..prolog.logic import Logic
from ..prolog.terms import Term, Var, deref
from .runtime import Clock, Reports, Runner, Watchdog, at_work
from .status import (
    MOST_AWAITED,
    AwaitedMemory,
    LeftOut,
    MemoryStatus,
    RuleStatus,
    Status,
    SubscriptionStatus,
    WaitingStatus,
    Work,
)

_Item = TypeVar("_Item")
_Told = TypeVar("_Told")

_Text = Callable[[Term, Optional[Mapping[Var, str]]], str]
"""Gives the beginning of a term's text, by the names of its variables if they are known."""

_ShownTexts = Dict[int, Tuple[Term, str]]


class Seen(NamedTuple):
    """The parts of an engine that are looked at.

    Attributes:
        taken: tells how many events came in.
        queue: how many may wait.
    """

    logic: Logic
    dispatcher: Dispatcher
    rules: Rules
    knowledge: Knowledge
    clock: Clock
    reports: Reports
    runner: Runner
    watchdog: Watchdog
    taken: Callable[[], int]
    queue: int


class StatusReader:
    """Reads what an engine is doing and what it holds, from any thread.

    The texts of rules and patterns are kept from one look to the next, as long as these are listed.
    """

    def __init__(self, seen: Seen):
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
    rules: Rules, text: _Text, show: Callable[[Term], str], most: int
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
    knowledge: Knowledge, text: _Text, show: Callable[[Term], str], most: int
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
    knowledge: Knowledge, text: _Text, show: Callable[[Term], str], most: int
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
    knowledge: Knowledge, show: Callable[[Term], str], most: int
) -> Tuple[Tuple[WaitingStatus, ...], int]:
    """Return what is to be told of queries that wait, and how many are left out."""

    def told(one: Any) -> WaitingStatus:
        _, asked, values, _, end, missing = one
        awaited = [
            AwaitedMemory(show(instance.id), int(instant), _behind(instance, instant))
            for instance, instant in tuple(missing)
            if not instance.has(instant)
        ]
        listed = tuple(awaited[:MOST_AWAITED])
        return WaitingStatus(show(asked.event(values)), int(end), listed, len(awaited) - len(listed))

    return _some(knowledge.waiting.all(), told, most)


def _behind(instance: Any, instant: int) -> Optional[int]:
    newest = instance.memory.latest
    return None if newest is None else max(0, int(instant) - newest)


def _some(found: Sequence[_Item], told: Callable[[_Item], _Told], most: int) -> Tuple[Tuple[_Told, ...], int]:
    """Return what is told of the first ones, and how many are left out."""
    chosen = found[: max(0, most)]
    return tuple([told(one) for one in chosen]), len(found) - len(chosen)
