#!/usr/bin/env python3
"""Cost of an event that completes one of many partial matches, for each operator and consumption policy.

    bench/partial_matches.py [--operator NAME ...] [--policy NAME ...] [--setting NAME ...] [--least N] [--most N]
                    [--seconds S] [--json FILE] [--from FILE ...] [--markdown]

The settings determine how the partial matches differ:

    values   a shared variable: the completing event fits one of N partial matches
    alike    no difference: it fits all of them, and the policy chooses
    times    their intervals only: it fits one of them, in the middle
    shuffled as ``times``, but they did not arrive in the order of their times

Setting ``streams`` has its own rows: windows, row patterns, absences, timers, states and execution of rules, each
with N items (``bench/event_streams.py``).

Operator ``rules`` has N rules; an event fits one that has fired before or, for ``rules_first``, one that has not. For
``expiry``, one of N partial matches expires at each event. The size of a cell grows from --least by factors of ten to
--most, or until the next size would take longer than --seconds. The figures are the CPU time of processing terms,
without parsing.
"""

import argparse
import gc
import json
import math
import random
import statistics
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import event_streams  # noqa: E402
from arguments import above_zero, existing, positive, target  # noqa: E402
from curves import exponent  # noqa: E402

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
        rule: its rule; the partners may differ in X, and not in K.
        waiting: interval of the partial matches in seconds.
        completing: interval of the completing event.
        by_times: returns, for a number, the interval of a partial match and that of the event that fits only it.
        functors: functors of the waiting and of the completing events.
        alike: whether several waiting events can fit the same event.
        later: whether each completing event has to be later than the one before.
        stays: whether a partner is not consumed.
        takes_all: whether all fitting partners are taken under every policy.
        fresh: whether nothing waits for the completing event.
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
    "without": Case("(p(X, K) seq q(X, L)) without r(X, _)", (10, 20), (30, 40)),
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
    """An engine with one rule and its partial matches.

    Args:
        name: the operator.
        policy: the consumption policy.
        setting: difference between the partial matches.
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
        """Add partial matches up to ``size``."""
        numbers = list(range(self._size, size))
        if self.setting == "shuffled":
            self._random.shuffle(numbers)
        for at in range(0, len(numbers), 10_000):
            dispatch(self.engine, [self._waiting(number) for number in numbers[at : at + 10_000]])
        self._size = size

    def batch(self, length: int) -> Tuple[float, int]:
        """Process completing events; return the seconds and the number of results of each.

        Consumed partners are added again afterwards.
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
    """An engine with N rules; an event fits one of them. It has the interface of `Bench`.

    Args:
        policy: the consumption policy.
        first: whether each event is the first of its rule; otherwise the rules have fired before.
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
        """Process pairs of events that make a rule fire; return the seconds and the results of each event."""
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
    """An engine in which one of N partial matches expires at each event. It has the interface of `Bench`."""

    def __init__(self, policy: str):
        self._policy = policy

    def grow(self, size: int) -> None:
        """Create an engine with ``size`` partial matches."""
        self.clock = StreamClock(10**9 * SECOND)
        self.engine = engine_with(self._policy, self.clock)
        self.engine.load(rules=f"out <- (p(X, K) seq q(X, L)) within {size}.\n")
        self._next = 0
        self._dispatch(size)

    def batch(self, length: int) -> Tuple[float, int]:
        """Add events, each of which makes an older partial match expire."""
        before = self.engine.rules.match_count
        seconds = self._dispatch(length)
        assert self.engine.rules.match_count <= before + 1
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
    """Counter of a rule's firings."""

    def __init__(self, engine: Engine):
        self.number = 0
        listen = engine.dispatcher.listen
        listen(ListenerPhase.SUBSCRIPTIONS, atom("out"), self._count)

    def _count(self, term: Term, values: Any, start: int, end: int, after: Any) -> Any:
        self.number += 1
        return after


def engine_with(policy: str, clock: Optional[StreamClock] = None) -> Engine:
    """Return an engine with a consumption policy; by default its clock stands still, so that nothing expires."""
    engine = Engine(clock or StreamClock())
    engine.load(goals=f"set_etalis_flag(event_consumption_policy, {policy})")
    engine.rules.network.limit_stored(10**8)
    return engine


def dispatch(engine: Engine, events: Sequence[Event]) -> float:
    """Process events; return the CPU seconds of each."""
    dispatch_event = engine.event_input.dispatch_event

    def all_of_them() -> float:
        began = time.thread_time()
        for term, start, end in events:
            dispatch_event(term, start, end, True)
        return time.thread_time() - began

    return float(engine.do(all_of_them)) / max(1, len(events))


def bench_for(name: str, policy: str, setting: str) -> Any:
    """Return the engine that measures a cell."""
    if name in ("rules", "rules_first"):
        return ManyRules(policy, name == "rules_first")
    return Expiring(policy) if name == "expiry" else Bench(name, policy, setting)


def measure(
    name: str, policy: str, setting: str, most: int, seconds: float, least: int = 10
) -> Iterator[Dict[str, Any]]:
    """Yield the figures of a table cell for 10, 100, ... partial matches."""
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
    """Yield the selected operators, policies and settings."""
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
    """Measure the selected cells."""
    rows: List[Dict[str, Any]] = []
    for name, policy, setting in cells(options):
        found = list(measure(name, policy, setting, options.most, options.seconds, options.least))
        rows += found
        figures = " ".join(f"{row['waiting']}:{per_result(row):.1f}" for row in found)
        print(f"{setting} {name} {policy} {figures}", file=sys.stderr, flush=True)
    return {"python": sys.version.split()[0], "rows": rows}


Rows = Sequence[Dict[str, Any]]


def joined(files: Sequence[Path]) -> Dict[str, Any]:
    """Return the combined figures of several files."""
    figures: Dict[str, Any] = {"rows": []}
    for file in files:
        try:
            found = json.loads(file.read_text())
            figures["rows"] += found["rows"]
            figures["python"] = found["python"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SystemExit(f"{file} has not the figures that --json writes: {error!r}") from error
    return figures


def plain(rows: Rows) -> Iterator[str]:
    """Yield the lines of a table: microseconds per completing event, or per result if an event has many."""
    sizes = sorted({row["waiting"] for row in rows})
    yield f"{'setting':<8} {'operator':<19} {'policy':<15} " + " ".join(f"{size:>9}" for size in sizes)
    for (setting, name, policy), found in _cells(rows).items():
        figures = [f"{per_result(found[size]):9.1f}" if size in found else " " * 9 for size in sizes]
        each = " a result" if any(row["results"] > 1 for row in found.values()) else ""
        yield f"{setting:<8} {name:<19} {policy:<15} " + " ".join(figures) + f"  {_power(found)}{each}"


def markdown(rows: Rows) -> Iterator[str]:
    """Yield the lines of one table for each setting, in Markdown."""
    for setting in dict.fromkeys(row["setting"] for row in rows):
        mine = [row for row in rows if row["setting"] == setting]
        if setting == "streams":
            yield from _streams(mine)
            continue
        sizes = sorted({row["waiting"] for row in mine})
        yield ""
        yield "| operator | policy | " + " | ".join(f"{size:,}" for size in sizes) + " |"
        yield "| --- | --- |" + " ---: |" * len(sizes)
        for (_, name, policy), found in sorted(_cells(mine).items(), key=lambda item: _place(mine, item[0])):
            figures = [_rounded(per_result(found[size])) if size in found else "" for size in sizes]
            yield f"| `{name}` | `{policy}` | " + " | ".join(figures) + " |"


def _streams(rows: Rows) -> Iterator[str]:
    """Yield the lines of the table of windows, rate operators, timers, states and the like."""
    sizes = sorted({row["waiting"] for row in rows})
    yield ""
    yield "| row | what | " + " | ".join(f"{size:,}" for size in sizes) + " | exponent |"
    yield "| --- | --- |" + " ---: |" * (len(sizes) + 1)
    cells = {name: found for (_, name, _), found in _cells(rows).items()}
    for name in [one for one in event_streams.STREAMS if one in cells]:
        found = cells[name]
        figures = [_rounded(per_result(found[size])) if size in found else "" for size in sizes]
        yield (
            f"| `{name}` | {event_streams.STREAMS[name].about} | "
            + " | ".join(figures)
            + f" | {_power(found)} |"
        )


def _power(found: Dict[int, Dict[str, Any]]) -> str:
    """Return the exponent of a cost's growth from N = 100 on as text; empty if unknown."""
    power = exponent([(size, per_result(row)) for size, row in found.items() if size >= 100])
    return "" if math.isnan(power) else f"{power:.2f}"


def keys(row: Dict[str, Any]) -> Tuple[str, str, str]:
    """Return the key of a row."""
    return row["setting"], row["operator"], row["policy"]


def per_result(row: Dict[str, Any]) -> float:
    """Return the microseconds per event, divided by its results if it has many."""
    return float(row["us"]) / max(1, int(row["results"]))


def _cells(rows: Rows) -> Dict[Tuple[str, str, str], Dict[int, Dict[str, Any]]]:
    """Return the rows by key and by number of partial matches."""
    found: Dict[Tuple[str, str, str], Dict[int, Dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(keys(row), {})[row["waiting"]] = row
    return found


def _place(rows: Rows, cell: Tuple[str, str, str]) -> Tuple[int, int]:
    """Return the sort key of a cell: operators in order of measurement, policies from the newest to all."""
    names: List[str] = list(dict.fromkeys(row["operator"] for row in rows))
    policies = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
    return names.index(cell[1]), policies.index(cell[2])


def _rounded(figure: float) -> str:
    return f"{figure:.1f}" if figure < 100 else f"{figure:,.0f}"


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
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
    add("--markdown", action="store_true", help="print the tables as they stand in the documentation")
    add("--json", type=target, help="write the figures there")
    add(
        "--from",
        dest="sources",
        type=existing,
        nargs="+",
        help="take the figures from there instead of measuring",
    )
    options = parser.parse_args(arguments)
    figures = joined(options.sources) if options.sources else run(options)
    table = markdown if options.markdown else plain
    for line in table(figures["rows"]):
        print(line)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
