# ruff: noqa: SLF001 - the disabled mechanisms are private parts of the engine
"""Mutants of the engine with one disabled mechanism. Their results have to differ in some cases, or no case tests it.

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
from events.network.test_stream_retraction import RULES, random_events, remaining_outputs
from events.streams.test_row_pattern_against_oracle import (
    VALUE,
    expected_outputs,
    expected_timeouts,
    outputs_of_rule,
    rule_of,
    timeout_rule_of,
    timeouts_of_rule,
)

from retalis import Clock, Engine, list_items
from retalis.events.knowledge.event_states import DeclaredState
from retalis.events.network import stream_compiler
from retalis.events.network.network_context import NetworkContext
from retalis.events.network.node_timers import NodeTimers
from retalis.events.network.stream_node import StreamNode
from retalis.events.streams import row_pattern
from retalis.events.streams.absence_timeout import AbsenceTimeout
from retalis.events.streams.held_value_windows import HeldSignal
from retalis.events.streams.rate_operators import RATE_OPERATORS, Debounce, DistinctUntilChanged, Throttle
from retalis.events.streams.row_pattern import RowPatternWindow
from retalis.events.streams.row_pattern_automaton import RowPatternNFA
from retalis.events.streams.row_pattern_timeouts import RowPatternTimeouts
from retalis.events.streams.session_window import SessionWindow
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
from .pattern_classes import Awaited, Shaped, Windowed, pattern_variables, walk
from .strategies import Generator, random_case

Detection = Callable[[int], Optional[bool]]
"""Returns whether the case of a seed differs; None if it does not concern the mechanism."""


class Mechanism(NamedTuple):
    """Mechanisms that can be disabled, and the cases that detect it."""

    off: Callable[[], ContextManager[Any]]
    detects: Detection


# ---- detection ---------------------------------------------------------------------------------------


def oracle_about(is_about: Callable[[Any], bool], times: int = 1) -> Detection:
    """Compare random programs that contain a pattern a minimum number of times with the oracle."""

    def detects(seed: int) -> Optional[bool]:
        case = random_case(seed, 3, streams=True)
        if sum(is_about(node) for rule in case.rules for node in walk(rule.pattern)) < times:
            return None
        return difference(case) is not None

    return detects


def windows(*names: str) -> Detection:
    """Compare programs that have one of these windows."""
    return oracle_about(lambda node: isinstance(node, Windowed) and node.window in names)


def shapes(*names: str) -> Detection:
    """Compare programs that have one of these rate operators."""
    return oracle_about(lambda node: isinstance(node, Shaped) and node.shape in names)


def has_key(node: Any) -> bool:
    """Return whether an operator may have groups."""
    return isinstance(node, Windowed) or (isinstance(node, Shaped) and bool(list_items(node.by)))


def is_clocked(node: Any) -> bool:
    """Return whether an operator has deadlines."""
    return (
        isinstance(node, Awaited)
        or (isinstance(node, Shaped) and node.shape == "debounce")
        or (isinstance(node, Windowed) and node.window in ("every", "first"))
    )


def shares(node: Any) -> bool:
    """Return whether an absent pattern shares variables with the pattern before it."""
    if not isinstance(node, Awaited):
        return False
    return bool(set(pattern_variables(node.pattern)) & set(pattern_variables(node.absent)))


def replays(seed: int) -> bool:
    """Compare the events that remain after a retraction with those of a stream without the event."""
    chance = Random(seed)
    rule = RULES[chance.choice([name for name in RULES if name not in ("joined", "change")])]
    events = random_events(chance, False)
    retracted = chance.choice(events)[0]
    remaining = [event for event in events if event[0] != retracted]
    return remaining_outputs(rule, [*events, (f"rev({retracted})", events[-1][1])]) != remaining_outputs(
        rule, remaining
    )


def states(within: Optional[int]) -> Detection:
    """Compare states with their definition."""

    def detects(seed: int) -> bool:
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

    return detects


TIMES = {"every(2)": 2, "every(3)": 3, "every(2, from_now)": 2, "every(5, from_now)": 5, "after(4)": 0}
"""Schedules of timers, and their periods in seconds."""


def timers(seed: int) -> bool:
    """Compare timers with a list that is searched for the next one; of several, the oldest."""
    chance, orders = Random(seed), count()
    names = {f"t{number}": chance.choice(list(TIMES)) for number in range(4)}
    instants = [sum(chance.randrange(1, 5) for _ in range(position)) + 7 for position in range(6)]
    instants.sort()
    first = instants[0]
    waiting: List[List[Any]] = [
        [
            first + 4
            if setting[0] == "a"
            else first + TIMES[setting] - (0 if "now" in setting else first % TIMES[setting]),
            next(orders),
            name,
            TIMES[setting],
        ]
        for name, setting in names.items()
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
    engine, outputs = Engine(), []
    engine.on_event(lambda term, start, end: outputs.append((engine.show(term), end // SECOND)))
    engine.load(goals="\n".join(f"timer({name}, {setting})" for name, setting in names.items()))
    for instant in instants:
        engine.event("e", instant)
    return outputs != expected


AHEAD = {
    "throttle": "out(X) <- a(X) with throttle(5).",
    "burst": "out(X) <- a(X) with burst(3).",
    "first": "out(X) <- aggregate(last(X), a(X), X, running(every(4, first))).",
    "running": "out(N, X) <- aggregate([count, last(X)], a(X), [N, X], running(every(4))).",
}


def ahead(seed: int) -> bool:
    """Compare a stream with and without a timestamp too far in the future."""
    chance = Random(seed)
    rule, places = AHEAD[chance.choice(list(AHEAD))], range(chance.randrange(3, 12))
    ahead_number = chance.choice(places)
    runs: List[List[str]] = []
    for has_event in (True, False):
        now, steps = [1000], Random(seed)

        def read_time(now: List[int] = now) -> int:
            return now[0] * SECOND

        engine = Engine(Clock(read_time))
        engine.load(rules=rule)
        outputs: List[str] = []
        engine.on_event(
            lambda term, start, end, outputs=outputs, engine=engine: outputs.append(engine.show(term))
        )
        for number in places:
            now[0] += steps.randrange(4)
            if number != ahead_number:
                engine.event(f"a({number})", now[0])
            elif has_event:
                engine.event(f"a({number})", now[0] + 10_000)
        runs.append(
            [output for output in outputs if not output.endswith((f"({ahead_number})", f",{ahead_number})"))]
        )
    return runs[0] != runs[1]


def steps(seed: int) -> bool:
    """Compare row patterns over readings with an exhaustive search."""
    chance = Random(seed)
    generator = Generator(chance.choice)
    drawn = generator.steps([VALUE], are_numbers=True)
    steps, skip = generator.grouped(drawn), generator.skip(drawn)
    readings = [(chance.choice("aab"), chance.randrange(4)) for _ in range(14)]
    return bool(outputs_of_rule(rule_of(steps, skip), readings) != expected_outputs(steps, readings, skip))


def timeouts(seed: int) -> bool:
    """Compare matches of row patterns that time out with an exhaustive search."""
    chance = Random(seed)
    generator = Generator(chance.choice)
    drawn = generator.grouped(generator.steps([VALUE], are_numbers=True))
    span = chance.choice([2, 3, 4, 6])
    readings = [(chance.choice("aab"), chance.randrange(4)) for _ in range(14)]
    outputs = timeouts_of_rule(timeout_rule_of(drawn, span), readings)
    return bool(outputs != expected_timeouts(drawn, readings, span))


# ---- disabled mechanisms -----------------------------------------------------------------------------


def window(name: str, replacement: Callable[[Any, Any], Any]) -> Callable[[], ContextManager[Any]]:
    """Replace a window."""
    return lambda: patch.dict(stream_compiler._WINDOWS, {name: replacement})


def shape(name: str, replacement: Callable[[int], Any]) -> Callable[[], ContextManager[Any]]:
    """Replace a rate operator."""
    return lambda: patch.dict(RATE_OPERATORS, {name: RATE_OPERATORS[name]._replace(create=replacement)})


def method(owner: Any, name: str, replacement: Any) -> Callable[[], ContextManager[Any]]:
    """Replace a method."""
    return lambda: patch.object(owner, name, replacement)


def nothing(*_: Any) -> None:
    """Do nothing."""


class Unchanged(DistinctUntilChanged):
    """Passes all elements."""

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        return [StreamOutput((item,), item.start, item.end)]


class Unsettled(Debounce):
    """Gives each element a key of its own."""

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        item.key = object()
        return super().process(item, now, channel)


@contextmanager
def one_key() -> Iterator[None]:
    """Put all elements into one group."""
    begin = StreamElement.__init__

    def same(item: StreamElement, *arguments: Any) -> None:
        begin(item, *arguments)
        item.key = ()

    with patch.object(StreamElement, "__init__", same):
        yield


def later_first(clock: Clock, instant: int, alarm: Any) -> None:
    """Set an alarm that fires before earlier alarms of the same instant."""
    heapq.heappush(clock.alarms, (instant, -next(clock._order), alarm))


def after_the_event(clock: Clock, until: Optional[int] = None) -> Any:
    """Fire alarms only after their instant."""
    reached = clock.reached() if until is None else until
    if not clock.alarms or clock.alarms[0][0] >= reached:
        return None
    instant, _, alarm = heapq.heappop(clock.alarms)
    return instant, alarm


def younger_first(deadlines: NodeTimers, node: Any, instant: int) -> None:
    """Fire the deadlines of younger rules, and of nodes further right or above, first."""
    due_time, number = instant + node.watermark.delay, next(deadlines._next_number)
    entry = (due_time, -node.rule.serial, -node.position, number, instant, node)
    heapq.heappush(deadlines._heap, entry)
    deadlines._set_alarm()


takers = RowPatternWindow._accepting_steps
listed, planned = RowPatternNFA._transitions, RowPatternNFA.__init__


def never_later(plan: Any, steps: Any, *others: Any) -> None:
    """Let no step skip rows."""
    planned(plan, [step._replace(skips_rows=False) for step in steps], *others)


def later_steps_first(window: Any, run: Any, item: StreamElement) -> Any:
    """Try the accepting steps in reverse order."""
    accepting, passing = takers(window, run, item)
    return accepting[::-1], passing


def never_reluctant(plan: Any, position: int, may_end: bool, may_continue: bool) -> Any:
    """Let all steps match the maximum number of events."""
    steps = plan.steps
    plan.steps = tuple([step._replace(reluctant=False) for step in steps])
    try:
        return listed(plan, position, may_end, may_continue)
    finally:
        plan.steps = steps


def never_over(stream: Any, instant: int) -> List[StreamOutput]:
    """Let no window end."""
    stream.next_deadline = None
    return []


def unmerged(stream: Any, key: Any, sessions: Any, position: int) -> None:
    """Leave the elements of a session alone."""
    stream._schedule(key, sessions[position])


LONG = 10**9
MECHANISMS: Dict[str, Mechanism] = {
    "time window removes elements": Mechanism(
        method(SlidingTimeWindow, "_remove_before", nothing), windows("last")
    ),
    "count window removes elements": Mechanism(
        window("newest", lambda make, form: SlidingCountWindow(make, LONG)), windows("newest")
    ),
    "batch has a maximum size": Mechanism(
        window("batch", lambda make, form: TumblingCountWindow(make, LONG, form.running)),
        windows("batch", "running_batch"),
    ),
    "hopping window removes elements": Mechanism(
        method(HoppingWindow, "_remove_before", nothing), windows("every")
    ),
    "anchored window ends": Mechanism(
        method(AnchoredTumblingWindow, "_close", never_over), windows("first", "running_first")
    ),
    "sessions are merged": Mechanism(
        method(SessionWindow, "_merge_following", unmerged), windows("session", "bounded_session")
    ),
    "maximum length of sessions": Mechanism(
        window("session", lambda make, form: SessionWindow(make, form.gap, None)), windows("bounded_session")
    ),
    "held values end": Mechanism(
        method(HeldSignal, "remove_before", nothing), windows("bounded_held", "bounded_held_last")
    ),
    "held values replace each other": Mechanism(
        method(HeldSignal, "_add_time_of", nothing), windows("held", "held_last")
    ),
    "groups and keys": Mechanism(one_key, oracle_about(has_key)),
    "timestamps too far ahead": Mechanism(
        method(NetworkContext, "compute_max_timestamp", lambda network: 1 << 64), ahead
    ),
    "alarms of the clock": Mechanism(method(NodeTimers, "_on_alarm", nothing), oracle_about(is_clocked)),
    "order of deadlines": Mechanism(method(NodeTimers, "add", younger_first), oracle_about(is_clocked, 2)),
    "absence is canceled by its event": Mechanism(
        method(AbsenceTimeout, "_cancel_pending", nothing),
        oracle_about(lambda node: isinstance(node, Awaited)),
    ),
    "absence compares keys": Mechanism(
        lambda: patch.object(stream_compiler, "key_function", lambda places: lambda values: ()),
        oracle_about(shares),
    ),
    "state of throttle": Mechanism(shape("throttle", lambda span: Throttle(0, False)), shapes("throttle")),
    "state of burst": Mechanism(shape("burst", lambda span: Throttle(0, True)), shapes("burst")),
    "debounce is restarted": Mechanism(shape("debounce", Unsettled), shapes("debounce")),
    "state of change": Mechanism(shape("change", lambda span: Unchanged()), shapes("change")),
    "replay after retraction": Mechanism(method(StreamNode, "invalid_results", lambda node: []), replays),
    "state ends by an event": Mechanism(method(DeclaredState, "_end_state", nothing), states(None)),
    "state ends by a timeout": Mechanism(method(DeclaredState, "_end_by_timeout", nothing), states(3)),
    "order of timers": Mechanism(method(Clock, "call_at", later_first), timers),
    "timers before events": Mechanism(method(Clock, "due", after_the_event), timers),
    "later steps skip rows": Mechanism(method(RowPatternNFA, "__init__", never_later), steps),
    "order of steps": Mechanism(method(RowPatternWindow, "_accepting_steps", later_steps_first), steps),
    "reluctant steps": Mechanism(method(RowPatternNFA, "_transitions", never_reluctant), steps),
    "end of steps": Mechanism(lambda: patch.object(row_pattern, "ends_step", lambda *_: False), steps),
    "next match of steps": Mechanism(
        method(RowPatternWindow, "_next_start", lambda window, match: match.start_order + 1), steps
    ),
    "conditions on past rows": Mechanism(
        method(RowPatternNFA, "advance_navigations", lambda plan, marks, at, item: (item,) * len(marks)),
        steps,
    ),
    "steps in time do not time out": Mechanism(
        method(RowPatternTimeouts, "_waiting_states", staticmethod(lambda partition: partition.states[:-1])),
        timeouts,
    ),
    "aggregates of steps": Mechanism(
        method(RowPatternNFA, "advance_totals", lambda plan, totals, step, item: totals), steps
    ),
}


def count_detections(
    name: str, seeds: Iterator[int], cases: int, max_differing: int = 1 << 30
) -> Tuple[int, int, int]:
    """Compare cases with a mechanism switched off.

    Args:
        name: name of the mechanism.
        seeds: numbers of cases.
        cases: maximum number of cases that concern the mechanism.
        max_differing: number of differing cases after which no more are compared.

    Returns:
        The numbers of compared cases, of cases that differ, and of those that differ with the mechanism too.
    """
    mechanism = MECHANISMS[name]
    compared = differing = failing = 0
    for seed in seeds:
        if compared == cases or differing == max_differing:
            break
        with mechanism.off():
            differs = mechanism.detects(seed)
        if differs is None:
            continue
        compared += 1
        if differs:
            differing += 1
            failing += bool(mechanism.detects(seed))
    return compared, differing, failing


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
        compared, differing, failing = count_detections(name, count(options.seed), options.cases)
        failed = failed or not differing or bool(failing)
        spent = time.process_time() - begin
        print(
            f"{name:<48} {compared:5} cases, {differing:5} differ, {failing} also with it, {spent:.0f} s",
            flush=True,
        )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
