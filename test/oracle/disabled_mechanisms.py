# ruff: noqa: SLF001 - what is switched off is inside the engine
"""One mechanism after the other is switched off in the engine, and cases have to differ: else nothing would notice.

Operators on streams are compared with the oracle, states and replay with their own definitions, and timers with a
plain list. As a command: see README.md.
"""

import argparse
import heapq
import logging
import sys
import time
from contextlib import contextmanager
from itertools import count
from random import Random
from typing import Any, Callable, ContextManager, Dict, Iterator, List, NamedTuple, Optional, Tuple
from unittest.mock import patch

from events.knowledge.test_event_states import ALARM, ExpectedStates, load_engine
from events.network.test_stream_revision import RULES, random_events, remaining_outputs
from events.streams.test_row_pattern import VALUE, expected_outputs, outputs_of_rule, rule_of

from retalis import Clock, Engine, list_items, make_list
from retalis.events.knowledge.event_states import DeclaredState
from retalis.events.network import stream_compiler
from retalis.events.network.stream_node import StreamNode
from retalis.events.rules.rule_base import RuleBase
from retalis.events.rules.timer_service import NodeTimers
from retalis.events.streams import row_pattern
from retalis.events.streams.absence_timeout import AbsenceTimeout
from retalis.events.streams.rate_operators import RATE_OPERATORS, Debounce, DistinctUntilChanged, Throttle
from retalis.events.streams.row_pattern import RowPatternNFA, RowPatternWindow
from retalis.events.streams.stream_operators import StreamElement, StreamOutput
from retalis.events.streams.windows import (
    AnchoredTumblingWindow,
    HoppingWindow,
    SlidingCountWindow,
    SlidingTimeWindow,
    TumblingCountWindow,
)
from retalis.prolog.terms.timestamps import SECOND

from .comparison import difference
from .patterns import Awaited, Shaped, Windowed, pattern_variables, walk
from .strategies import Generator, random_case

Notices = Callable[[int], Optional[bool]]
"""Tells for a seed whether its case differs; None where it is not about that."""


class Mechanism(NamedTuple):
    """Mechanisms that can be disabled, and the cases that detect it."""

    off: Callable[[], ContextManager[Any]]
    notices: Notices


# ---- what notices ------------------------------------------------------------------------------------


def oracle_about(is_about: Callable[[Any], bool], times: int = 1) -> Notices:
    """Compare random programs that have a certain pattern, so many times, with the oracle."""

    def notices(seed: int) -> Optional[bool]:
        case = random_case(seed, 3, streams=True)
        if sum(is_about(node) for rule in case.rules for node in walk(rule.pattern)) < times:
            return None
        return difference(case) is not None

    return notices


def windows(*names: str) -> Notices:
    """Compare programs that have one of these windows."""
    return oracle_about(lambda node: isinstance(node, Windowed) and node.window in names)


def shapes(*names: str) -> Notices:
    """Compare programs that have one of these shapes."""
    return oracle_about(lambda node: isinstance(node, Shaped) and node.shape in names)


def has_key(node: Any) -> bool:
    """Tell whether an operator may have groups."""
    return isinstance(node, Windowed) or (isinstance(node, Shaped) and bool(list_items(node.by)))


def is_clocked(node: Any) -> bool:
    """Tell whether the clock ends something of an operator."""
    return (
        isinstance(node, Awaited)
        or (isinstance(node, Shaped) and node.shape == "debounce")
        or (isinstance(node, Windowed) and node.window in ("every", "first"))
    )


def shares(node: Any) -> bool:
    """Tell whether what must not happen for some time has to agree with what comes before."""
    if not isinstance(node, Awaited):
        return False
    return bool(set(pattern_variables(node.pattern)) & set(pattern_variables(node.absent)))


def replays(seed: int) -> bool:
    """Compare what stands when an event was taken back with what there is without it."""
    chance = Random(seed)
    rule = RULES[chance.choice([name for name in RULES if name not in ("joined", "change")])]
    events = random_events(chance, False)
    gone = chance.choice(events)[0]
    left = [event for event in events if event[0] != gone]
    return remaining_outputs(rule, [*events, (f"rev({gone})", events[-1][1])]) != remaining_outputs(
        rule, left
    )


def states(within: Optional[int]) -> Notices:
    """Compare states with their definition."""

    def notices(seed: int) -> bool:
        chance, now = Random(seed), 1
        events: List[Tuple[str, str, int, int]] = []
        for _ in range(15):
            now += chance.randrange(4)
            kind, key = chance.choice(["dock", "undock", "bump"]), chance.choice("ab")
            events.append((kind, key, now, now))
        option = "" if within is None else f", [within({within})]"
        engine = load_engine(f":- state(docked(R), from(dock(R)), until(undock(R)){option}).\n{ALARM}")
        for kind, key, start, end in events:
            engine.event(f"{kind}({key})", start, end)
        return bool(engine.events != ExpectedStates(events, within).expected_outputs())

    return notices


TIMES = {"every(2)": 2, "every(3)": 3, "every(2, from_now)": 2, "every(5, from_now)": 5, "after(4)": 0}
"""How timers are set, and their periods."""


def timers(seed: int) -> bool:
    """Compare timers with a list that is looked through for the next one; of several the one that was set first."""
    chance, orders = Random(seed), count()
    names = {f"t{number}": chance.choice(list(TIMES)) for number in range(4)}
    instants = [sum(chance.randrange(1, 5) for _ in range(at)) + 7 for at in range(6)]
    instants.sort()
    first = instants[0]
    waiting = [
        [first + 4 if when[0] == "a" else first + TIMES[when] - (0 if "now" in when else first % TIMES[when])]
        + [next(orders), name, TIMES[when]]
        for name, when in names.items()
    ]
    expected: List[Any] = []
    for instant in instants:
        while waiting and min(waiting)[0] <= instant:
            due = min(waiting)
            waiting.remove(due)
            expected.append((due[2], due[0]))
            if due[3]:
                waiting.append([due[0] + due[3], next(orders), due[2], due[3]])
        expected.append(("e", instant))
    engine, seen = Engine(), []
    engine.on_event(lambda term, start, end: seen.append((engine.show(term), end // SECOND)))
    engine.load(goals="\n".join(f"timer({name}, {when})" for name, when in names.items()))
    for instant in instants:
        engine.event("e", instant)
    return seen != expected


AHEAD = {
    "throttle": "out(X) <- a(X) with throttle(5).",
    "burst": "out(X) <- a(X) with burst(3).",
    "first": "out(X) <- aggregate(last(X), a(X), X, running(every(4, first))).",
    "running": "out(N, X) <- aggregate([count, last(X)], a(X), [N, X], running(every(4))).",
}


def ahead(seed: int) -> bool:
    """Compare a stream with and without a stamp that is further in the future than stamps may be."""
    chance = Random(seed)
    rule, places = AHEAD[chance.choice(list(AHEAD))], range(chance.randrange(3, 12))
    wrong = chance.choice(places)
    seen: List[List[str]] = []
    for with_it in (True, False):
        now, steps = [1000], Random(seed)
        engine = Engine(Clock(lambda now=now: now[0] * SECOND))
        engine.load(rules=rule)
        found: List[str] = []
        engine.on_event(lambda term, start, end, found=found, engine=engine: found.append(engine.show(term)))
        for number in places:
            now[0] += steps.randrange(4)
            if number != wrong:
                engine.event(f"a({number})", now[0])
            elif with_it:
                engine.event(f"a({number})", now[0] + 10_000)
        seen.append([one for one in found if not one.endswith((f"({wrong})", f",{wrong})"))])
    return seen[0] != seen[1]


def steps(seed: int) -> bool:
    """Compare windows of steps over readings with trying all ways in their order."""
    chance = Random(seed)
    drawn = make_list(Generator(chance.choice).steps([VALUE]))
    readings = [(chance.choice("aab"), chance.randrange(4)) for _ in range(14)]
    return bool(outputs_of_rule(rule_of(drawn), readings) != expected_outputs(drawn, readings))


# ---- what is switched off ----------------------------------------------------------------------------


def window(name: str, made: Callable[[Any, Any], Any]) -> Callable[[], ContextManager[Any]]:
    """Have another window in the place of one."""
    return lambda: patch.dict(stream_compiler._WINDOWS, {name: made})


def shape(name: str, made: Callable[[int], Any]) -> Callable[[], ContextManager[Any]]:
    """Replace a rate operator."""
    return lambda: patch.dict(RATE_OPERATORS, {name: RATE_OPERATORS[name]._replace(create=made)})


def method(owner: Any, name: str, made: Any) -> Callable[[], ContextManager[Any]]:
    """Have another method in the place of one."""
    return lambda: patch.object(owner, name, made)


def nothing(*_: Any) -> None:
    """Do nothing."""


class Unchanged(DistinctUntilChanged):
    """Lets everything through."""

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        return [StreamOutput((item,), item.start, item.end)]


class Unsettled(Debounce):
    """Has everything wait by itself."""

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        item.key = object()
        return super().process(item, now, channel)


@contextmanager
def one_key() -> Iterator[None]:
    """Have everything be of the same group."""
    begin = StreamElement.__init__

    def same(item: StreamElement, *arguments: Any) -> None:
        begin(item, *arguments)
        item.key = ()

    with patch.object(StreamElement, "__init__", same):
        yield


def later_first(clock: Clock, instant: int, alarm: Any) -> None:
    """Set an alarm that rings before those of the same instant which were set earlier."""
    heapq.heappush(clock.alarms, (instant, -next(clock._order), alarm))


def after_the_event(clock: Clock, until: Optional[int] = None) -> Any:
    """Have alarms ring only when their instant is over."""
    reached = clock.reached() if until is None else until
    if not clock.alarms or clock.alarms[0][0] >= reached:
        return None
    instant, _, alarm = heapq.heappop(clock.alarms)
    return instant, alarm


def younger_first(deadlines: NodeTimers, node: Any, instant: int) -> None:
    """Have nodes of younger rules, and those further right or above, ring first."""
    entry = (instant, -node.rule.serial, -node.position, next(deadlines._numbers), node)
    heapq.heappush(deadlines._heap, entry)
    deadlines._set_alarm()


takers = RowPatternWindow._accepting_steps
listed, planned = RowPatternNFA._transitions, RowPatternNFA.__init__


def never_later(plan: Any, own: Any, marks: Any) -> None:
    """Have no step wait for a later item."""
    planned(plan, [one._replace(skips_rows=False) for one in own], marks)


def later_steps_first(window: Any, way: Any, item: StreamElement) -> Any:
    """Have what is preferred least be tried first."""
    found, passing = takers(window, way, item)
    return found[::-1], passing


def never_reluctant(plan: Any, at: int, enough: bool, more: bool) -> Any:
    """Let all steps match the maximum number of events."""
    own = plan.steps
    plan.steps = tuple([one._replace(reluctant=False) for one in own])
    try:
        return listed(plan, at, enough, more)
    finally:
        plan.steps = own


def never_over(stream: Any, instant: int) -> List[StreamOutput]:
    """Have no window be over."""
    stream.next_deadline = None
    return []


LONG = 10**9
MECHANISMS: Dict[str, Mechanism] = {
    "a window by time lets go": Mechanism(
        method(SlidingTimeWindow, "_remove_before", nothing), windows("last")
    ),
    "a window by number lets go": Mechanism(
        window("newest", lambda make, form: SlidingCountWindow(make, LONG)), windows("newest")
    ),
    "a batch is full": Mechanism(
        window("batch", lambda make, form: TumblingCountWindow(make, LONG, form.running)),
        windows("batch", "running_batch"),
    ),
    "a hopping window lets go": Mechanism(method(HoppingWindow, "_remove_before", nothing), windows("every")),
    "a window from the first on is over": Mechanism(
        method(AnchoredTumblingWindow, "_close", never_over), windows("first", "running_first")
    ),
    "groups and keys": Mechanism(one_key, oracle_about(has_key)),
    "stamps too far ahead": Mechanism(
        method(RuleBase, "compute_max_timestamp", lambda rules: 1 << 64), ahead
    ),
    "the clock rings": Mechanism(method(NodeTimers, "_on_alarm", nothing), oracle_about(is_clocked)),
    "older rules and lower patterns ring first": Mechanism(
        method(NodeTimers, "add", younger_first), oracle_about(is_clocked, 2)
    ),
    "what must not happen ends a wait": Mechanism(
        method(AbsenceTimeout, "_cancel_pending", nothing),
        oracle_about(lambda node: isinstance(node, Awaited)),
    ),
    "only of the same key": Mechanism(
        lambda: patch.object(stream_compiler, "key_function", lambda places: lambda values: ()),
        oracle_about(shares),
    ),
    "throttle remembers": Mechanism(shape("throttle", lambda span: Throttle(0, False)), shapes("throttle")),
    "burst remembers": Mechanism(shape("burst", lambda span: Throttle(0, True)), shapes("burst")),
    "debounce starts anew": Mechanism(shape("debounce", Unsettled), shapes("debounce")),
    "change remembers": Mechanism(shape("change", lambda span: Unchanged()), shapes("change")),
    "operators run again without what is taken back": Mechanism(
        method(StreamNode, "invalid_results", lambda node: []), replays
    ),
    "an event ends a state": Mechanism(method(DeclaredState, "_end_state", nothing), states(None)),
    "time ends a state": Mechanism(method(DeclaredState, "_end_by_timeout", nothing), states(3)),
    "timers of one instant ring as they were set": Mechanism(method(Clock, "call_at", later_first), timers),
    "timers ring before an event of their instant": Mechanism(method(Clock, "due", after_the_event), timers),
    "later steps pass over": Mechanism(method(RowPatternNFA, "__init__", never_later), steps),
    "steps are tried in their order": Mechanism(
        method(RowPatternWindow, "_accepting_steps", later_steps_first), steps
    ),
    "reluctant steps take few": Mechanism(method(RowPatternNFA, "_transitions", never_reluctant), steps),
    "steps end": Mechanism(lambda: patch.object(row_pattern, "ends_step", lambda *_: False), steps),
    "conditions of steps look back": Mechanism(
        method(RowPatternNFA, "advance_navigations", lambda plan, marks, at, item: (item,) * len(marks)),
        steps,
    ),
}


def noticing(name: str, seeds: Iterator[int], cases: int, enough: int = 1 << 30) -> Tuple[int, int, int]:
    """Try cases with a mechanism switched off.

    Args:
        name: of the mechanism.
        seeds: numbers of cases.
        cases: how many that are about it, at most.
        enough: how many that differ are enough.

    Returns:
        How many were tried, how many differed, and how many of those differ also as the engine is.
    """
    mechanism = MECHANISMS[name]
    tried = differing = wrong = 0
    for seed in seeds:
        if tried == cases or differing == enough:
            break
        with mechanism.off():
            found = mechanism.notices(seed)
        if found is None:
            continue
        tried += 1
        if found:
            differing += 1
            wrong += bool(mechanism.notices(seed))
    return tried, differing, wrong


def main() -> int:
    """Switch each mechanism off and print how many cases notice it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mechanism", action="append", choices=list(MECHANISMS))
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    failed = False
    for name in options.mechanism or MECHANISMS:
        begin = time.process_time()
        tried, differing, wrong = noticing(name, count(options.seed), options.cases)
        failed = failed or not differing or bool(wrong)
        spent = time.process_time() - begin
        print(
            f"{name:<48} {tried:5} cases, {differing:5} differ, {wrong} also with it, {spent:.0f} s",
            flush=True,
        )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
