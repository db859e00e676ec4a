#!/usr/bin/env python3
"""What a completing event costs when many partial matches wait: each operator under each policy.

    bench/events.py [--operator NAME ...] [--policy NAME ...] [--setting NAME ...] [--least N] [--most N]
                    [--seconds S] [--half N] [--json FILE] [--plot PREFIX] [--from FILE ...] [--markdown]

The settings say what tells the waiting partners apart:

    values   a shared variable: the completing event fits one of the N that wait
    alike    nothing: it fits all of them, and the policy says which it takes
    times    their intervals only: it fits one of them, somewhere in the middle
    shuffled the same, but they have not arrived in the order of their times

Setting ``streams`` has rows of its own: windows, shapes, absences for some time, timers, states and how rules
run, each with N that are held (event_streams.py).

Operator ``rules`` has N rules of which an event fits one that has fired before or, as ``rules_first``, one that has
not; with ``expiry`` one of N matches that wait expires at each event. A cell grows from --least to ten times that
and so on, until --most, or until the next size would take longer than --seconds. The figures are CPU time of
taking terms in, without reading text. Last, --half N half matches go into rules with and without bounds, and
what the process holds is measured; 0 leaves that out.
"""

import argparse
import gc
import json
import random
import statistics
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import event_memory  # noqa: E402
import event_streams  # noqa: E402
import event_tables  # noqa: E402
from arguments import above_zero, existing, positive, target  # noqa: E402

from retalis import Engine, StreamClock, Term, atom, functor  # noqa: E402
from retalis.events.dispatch.listeners import ListenerPhase  # noqa: E402
from retalis.prolog.terms.timestamps import SECOND  # noqa: E402

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
Interval = Tuple[int, int]
Event = Tuple[Term, int, int]
P, Q, R = functor("p", 2), functor("q", 2), functor("r", 2)


class Case(NamedTuple):
    """An operator.

    Attributes:
        rule: its rule, with X for what may tell partners apart and K for what does not.
        waiting: the interval of those that wait, in seconds.
        completing: the interval of the completing event.
        by_times: from a number to the interval of one that waits, and to that of the event that fits only it.
        functors: of what waits and of what completes.
        alike: whether any number can wait that all fit.
        later: whether each completing event has to come after the one before.
        stays: whether a partner is not used up.
        takes_all: whether all that fit are taken under every policy.
        fresh: whether the completing event is one for which nothing waits.
    """

    rule: str
    waiting: Interval
    completing: Interval
    by_times: Optional[Tuple[Callable[[int], Interval], Callable[[int], Interval]]] = None
    functors: Tuple[Any, Any] = (P, Q)
    alike: bool = True
    later: bool = False
    stays: bool = False
    takes_all: bool = False
    fresh: bool = False


def _apart(start: int, end: int) -> Callable[[int], Interval]:
    return lambda number: (100 * number + start, 100 * number + end)


CASES = {
    "seq": Case("p(X, K) seq q(X, L)", (10, 20), (30, 40)),
    "and": Case("p(X, K) and q(X, L)", (10, 20), (30, 40)),
    "par": Case("p(X, K) par q(X, L)", (10, 20), (15, 40), (_apart(10, 20), _apart(15, 40))),
    "equals": Case("p(X, K) equals q(X, L)", (10, 20), (10, 20), (_apart(10, 20), _apart(10, 20))),
    "meets": Case("p(X, K) meets q(X, L)", (10, 20), (20, 40), (_apart(10, 20), _apart(20, 40))),
    "during": Case("p(X, K) during q(X, L)", (10, 20), (5, 40), (_apart(10, 20), _apart(5, 40))),
    "starts": Case("p(X, K) starts q(X, L)", (10, 20), (10, 40), (_apart(10, 20), _apart(10, 40))),
    "finishes": Case("p(X, K) finishes q(X, L)", (10, 20), (5, 20), (_apart(10, 20), _apart(5, 20))),
    "forall_seq": Case("p(X, K) forall_seq q(X, L)", (10, 20), (30, 40), takes_all=True),
    "cnot": Case("(p(X, K) seq q(X, L)) cnot r(X, _)", (10, 20), (30, 40)),
    "fnot": Case(
        "p(X, K) fnot r(X, _)", (10, 20), (30, 40), functors=(R, P), alike=False, fresh=True, stays=True
    ),
    "star_times": Case("p(X, K) seq (q(X, L) star_times)", (10, 20), (30, 40), later=True, stays=True),
    "aggregate": Case("p(X, K) seq aggregate(count, q(X, L), N)", (10, 20), (30, 40), later=True, stays=True),
    "ntimes": Case("p(X, K) ntimes 2", (10, 20), (30, 40), functors=(P, P), alike=False, later=True),
    "where": Case("p(X, K) seq q(X, L) where (L >= 0)", (10, 20), (30, 40)),
    "within": Case("(p(X, K) seq q(X, L)) within 40", (10, 20), (30, 40), (_apart(10, 20), _apart(30, 40))),
}
SETTINGS = ("values", "alike", "times", "shuffled", "streams")
MORE = ("rules", "rules_first", "expiry")


class Bench:
    """An engine with one rule, in which matches wait.

    Args:
        name: the operator.
        policy: the consumption policy.
        setting: what tells those that wait apart.
    """

    def __init__(self, name: str, policy: str, setting: str):
        self.case = case = CASES[name]
        self.setting = setting
        self.by_times = case.by_times if setting in ("times", "shuffled") else None
        self.consuming = policy != "unrestricted"
        self.all_at_once = setting == "alike" and (case.takes_all or not self.consuming)
        self.engine = engine_with(policy)
        pattern = case.rule if setting == "values" else case.rule.replace("(X, ", "(_, ")
        self.engine.load(rules=f"out <- {pattern}.\n")
        self.results = Counter(self.engine)
        self._random = random.Random(1)
        self._size = 0
        self._now = 30
        self._completed = 0

    def grow(self, size: int) -> None:
        """Have ``size`` matches wait."""
        numbers = list(range(self._size, size))
        if self.setting == "shuffled":
            self._random.shuffle(numbers)
        for at in range(0, len(numbers), 10_000):
            dispatch(self.engine, [self._waiting(number) for number in numbers[at : at + 10_000]])
        self._size = size

    def batch(self, length: int) -> Tuple[float, int]:
        """Let some events complete; return the seconds of each, and how many results each had.

        Partners that were used up wait again afterwards.
        """
        length = 1 if self.all_at_once else length
        # Not among the first to have come or the last: that would be too easy to find.
        among = range(self._size // 4, self._size - self._size // 4)
        numbers = self._random.sample(among, min(length, len(among)))
        before = self.results.number
        seconds = dispatch(self.engine, [self._completing(number) for number in numbers])
        results = self.results.number - before
        if (self.consuming or self.case.takes_all) and not self.case.stays:
            self._refill(numbers, results)
        return seconds, round(results / len(numbers))

    def _waiting(self, number: int) -> Event:
        start, end = self.case.waiting
        if self.by_times is not None:
            start, end = self.by_times[0](number)
        return ((self.case.functors[0], number, number), start * SECOND, end * SECOND)

    def _completing(self, number: int) -> Event:
        case = self.case
        start, end = case.completing
        if self.by_times is not None:
            start, end = self.by_times[1](number)
        elif case.later:
            self._now += 20
            start, end = self._now, self._now + 10
        self._completed += 1
        if case.fresh:
            number = self._size + self._completed
        return ((case.functors[1], number, number), start * SECOND, end * SECOND)

    def _refill(self, numbers: Sequence[int], results: int) -> None:
        if self.setting == "alike":
            first = 10**9 + self._completed * 10**7
            numbers = range(first, first + results)
        dispatch(self.engine, [self._waiting(number) for number in numbers])


class ManyRules:
    """An engine with N rules, of which an event fits one; the interface of `Bench`.

    Args:
        policy: the consumption policy.
        first: whether each event is the first that its rule gets; else rules are used that have fired before.
    """

    def __init__(self, policy: str, first: bool):
        self.engine = engine_with(policy)
        self.results = Counter(self.engine)
        self._first = first
        self._pair = 0
        self._random = random.Random(1)
        self._size = 0

    def grow(self, size: int) -> None:
        """Load rules up to ``size``."""
        rules = (f"out <- p({number}, X) seq q({number}, X)." for number in range(self._size, size))
        self.engine.load(rules="\n".join(rules))
        self._size = size
        self._numbers = self._random.sample(range(size), min(size, 150))
        if not self._first:
            del self._numbers[10:]
            self._pairs(self._numbers)

    def batch(self, length: int) -> Tuple[float, int]:
        """Let events come in pairs that make a rule fire; return the seconds of each event, and its results."""
        numbers = self._numbers[:length]
        if self._first:
            self._numbers = self._numbers[length:] or self._numbers
        before = self.results.number
        seconds = self._pairs(numbers)
        return seconds, round((self.results.number - before) / len(numbers))

    def _pairs(self, numbers: Sequence[int]) -> float:
        events: List[Event] = []
        for number in numbers:
            self._pair += 1
            events.append(((P, number, self._pair), SECOND, SECOND))
            events.append(((Q, number, self._pair), 2 * SECOND, 2 * SECOND))
        return dispatch(self.engine, events)


class Expiring:
    """An engine in which one of N partial matches expires at each event; the interface of `Bench`."""

    def __init__(self, policy: str):
        self._policy = policy

    def grow(self, size: int) -> None:
        """Have ``size`` matches wait in an engine of their own."""
        self.clock = StreamClock(10**9 * SECOND)
        self.engine = engine_with(self._policy, self.clock)
        self.engine.load(rules=f"out <- (p(X, K) seq q(X, L)) within {size}.\n")
        self._next = 0
        self._dispatch(size)

    def batch(self, length: int) -> Tuple[float, int]:
        """Let further events wait, at each of which an older one expires."""
        before = self.engine.rules.waiting
        seconds = self._dispatch(length)
        assert self.engine.rules.waiting <= before + 1
        return seconds, 0

    def _dispatch(self, number: int) -> float:
        first = self._next
        self._next += number
        spent = 0.0
        for one in range(first, self._next, 5):  # rules do not believe stamps that are far ahead of the clock
            events = []
            for at in range(one, min(one + 5, self._next)):
                instant = self.clock.now() + (at - one + 1) * SECOND
                events.append(((P, at, at), instant, instant))
            spent += dispatch(self.engine, events) * len(events)
            self.clock.move_to(instant)
        return spent / number


class Counter:
    """Counts how often a rule fires."""

    def __init__(self, engine: Engine):
        self.number = 0
        listen = engine.dispatcher.listen
        listen(ListenerPhase.SUBSCRIPTIONS, atom("out"), self._count)

    def _count(self, term: Term, values: Any, start: int, end: int, after: Any) -> Any:
        self.number += 1
        return after


def engine_with(policy: str, clock: Optional[StreamClock] = None) -> Engine:
    """Return an engine with a consumption policy; by default its clock stands still, and nothing expires."""
    engine = Engine(clock or StreamClock())
    engine.load(goals=f"set_etalis_flag(event_consumption_policy, {policy})")
    engine.rules.cap = 10**8
    return engine


def dispatch(engine: Engine, events: Sequence[Event]) -> float:
    """Have events taken in; return the CPU seconds of each."""
    take = engine.event_input.take

    def all_of_them() -> float:
        began = time.thread_time()
        for term, start, end in events:
            take(term, start, end, True)
        return time.thread_time() - began

    return float(engine.do(all_of_them)) / max(1, len(events))


def bench_for(name: str, policy: str, setting: str) -> Any:
    """Return what measures a cell."""
    if name in ("rules", "rules_first"):
        return ManyRules(policy, name == "rules_first")
    return Expiring(policy) if name == "expiry" else Bench(name, policy, setting)


def measure(
    name: str, policy: str, setting: str, most: int, seconds: float, least: int = 10
) -> Iterator[Dict[str, Any]]:
    """Yield what a cell of the table takes, for 10, 100, ... that wait."""
    gc.collect()  # what is left of the cell before
    if setting == "streams":
        yield from event_streams.measure(name, least, most, seconds)
        return
    bench = bench_for(name, policy, setting)
    size = least
    while size <= most:
        began = time.thread_time()
        gc.disable()  # while it grows; the figures are taken with it
        bench.grow(size)
        gc.enable()
        figures: List[float] = []
        results: List[int] = []
        while len(figures) < 3 or len(figures) < 15 and sum(figures) < 0.01:
            each, number = bench.batch(10)
            figures.append(each)
            results.append(number)
        yield {
            "operator": name,
            "policy": policy,
            "setting": setting,
            "waiting": size,
            "us": statistics.median(figures) * 1e6,
            "results": statistics.median_low(results),
        }
        if (time.thread_time() - began) * 10 > seconds:
            return
        size *= 10


def cells(options: argparse.Namespace) -> Iterator[Tuple[str, str, str]]:
    """Yield operator, policy and setting of what is asked for."""
    for setting in options.setting or SETTINGS:
        for name in options.operator or [*CASES, *MORE, *event_streams.STREAMS]:
            if setting == "streams" or name in event_streams.STREAMS:
                if setting == "streams" and name in event_streams.STREAMS:
                    yield name, "", setting
                continue
            if name in MORE:
                possible = setting == "values"
            else:
                case = CASES[name]
                possible = setting == "values" or (
                    case.alike if setting == "alike" else case.by_times is not None
                )
            if possible:
                for policy in options.policy or POLICIES:
                    yield name, policy, setting


def run(options: argparse.Namespace) -> Dict[str, Any]:
    """Measure what is asked for."""
    rows: List[Dict[str, Any]] = []
    for name, policy, setting in cells(options):
        found = list(measure(name, policy, setting, options.most, options.seconds, options.least))
        rows += found
        figures = " ".join(f"{row['waiting']}:{event_tables.per_result(row):.1f}" for row in found)
        print(f"{setting} {name} {policy} {figures}", file=sys.stderr, flush=True)
    memory = event_memory.measure_all(options.half) if options.half else {}
    return {"python": sys.version.split()[0], "rows": rows, "memory": memory}


def main(arguments: Optional[List[str]] = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--operator", action="append", choices=[*CASES, *MORE, *event_streams.STREAMS])
    add("--policy", action="append", choices=POLICIES)
    add("--setting", action="append", choices=SETTINGS)
    add("--least", type=positive, default=10, help="the smallest number that waits")
    add("--most", type=positive, default=10**5, help="the largest number that waits")
    add("--seconds", type=above_zero, default=2.0, help="how long the next size of a cell may take")
    add("--half", type=int, default=10**6, help="how many half matches the memory is measured with")
    add("--markdown", action="store_true", help="print the tables as they stand in the documentation")
    add("--json", type=target, help="write the figures there")
    add(
        "--from",
        dest="sources",
        type=existing,
        nargs="+",
        help="take the figures from there instead of measuring",
    )
    add("--plot", type=target, help="draw plots into files whose names start so")
    options = parser.parse_args(arguments)
    figures = event_tables.joined(options.sources) if options.sources else run(options)
    table = event_tables.markdown if options.markdown else event_tables.plain
    for line in table(figures["rows"]):
        print(line)
    for line in event_memory.lines(figures["memory"]):
        print(line)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    if options.plot:
        import event_plots

        event_plots.draw(figures, str(options.plot))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
