"""Cost of an event in windows, row patterns, absences, timers and states: rows for ``bench/partial_matches.py``.

A row is a program with N items: items of a window, keys, partial matches, timers, open states. Steps of one second
are fed until there are N items, and then further steps, in which as many items are added as expire. The cost is that
of a step divided by its events, including the engine's queue, its clock and due timers.
"""

import logging
import time
from contextlib import contextmanager
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Tuple

from retalis import Engine, Term, Var, atom, functor, limit_gc_pauses, restore_gc
from retalis.events.dispatch.listeners import ListenerPhase
from retalis.events.rules import program_timers
from retalis.prolog.terms.timestamps import SECOND

MOST_STEPS = 100_000
"""Number of measured steps of a row without periods."""

BEGIN = 10**9
"""Time of the first step in seconds."""

P, Q, R, ONE = functor("p", 2), functor("q", 2), functor("r", 2), functor("e0", 1)
Steps = List[Tuple[int, List[Term]]]
"""Instants with their events."""
Step = Callable[[int, int], List[Term]]
"""Returns the events of a step, by its number and the size."""


def _always(at: int, size: int) -> List[Term]:
    return [P(at, at * 7919 % 10_007)]


def _few_values(at: int, size: int) -> List[Term]:
    return [P(at, at % 10)]


def _keys(at: int, size: int) -> List[Term]:
    return [P(at % size, at)]


def _pairs(at: int, size: int) -> List[Term]:
    return [P(at, at)] if at < size else [P(at, at), Q(at - size, at)]


def _one_and_many(at: int, size: int) -> List[Term]:
    return [P(0, 0)] if not at else [Q(at, at)]


def _at_first(at: int, size: int) -> List[Term]:
    return [P(at, at)] if at < size else []


def _with_last(at: int, size: int) -> List[Term]:
    return [P(at, at), Q(at - 1, at)] if at % size == size - 1 else [P(at, at)]


def _asked(at: int, size: int) -> List[Term]:
    return [P(at, at)] if at < size else [R(at * 7919 % size, at)]


def _opened_and_waited_for(at: int, size: int) -> List[Term]:
    return [P(at, at), R(at, at)] if at < size else [P(at, at), R(at, at), Q(at - size, at)]


def _ended_twice(at: int, size: int) -> List[Term]:
    return [P(at, at), Q(at, at)]


def _one_kind(at: int, size: int) -> List[Term]:
    return [ONE(at)]


class StreamRow(NamedTuple):
    """A row of the table.

    Attributes:
        about: description for the table; N is the number of items.
        rules: the program; ``#`` stands for N, ``#2`` for 2 N and ``#10`` for N / 10.
        step: returns the events of a step.
        goals: goals that are called before.
        filled: number of steps until there are N items, divided by N.
        periods: whether N steps are measured, because some work is done once in N steps.
        fires: whether the rules fire.
        most: largest meaningful N.
        is_limited: whether N is a limit, so that the oldest items are evicted.
        declares: whether N events are declared (e0, e1, ...).
        as_program: whether events are passed as by a Python program, which are validated first.
    """

    about: str
    rules: str
    step: Step
    goals: str = ""
    filled: int = 1
    periods: bool = False
    fires: bool = True
    most: int = 10**9
    is_limited: bool = False
    declares: bool = False
    as_program: bool = False


def _window(window: str, about: str, kind: str = "avg(K)", **more: Any) -> StreamRow:
    return StreamRow(about, f"out(A) <- aggregate({kind}, p(_, K), A, {window}).", _always, **more)


def _groups(window: str, about: str, **more: Any) -> StreamRow:
    return StreamRow(about, f"out(X, A) <- aggregate(avg(K), p(X, K), A, {window}).", _keys, **more)


def _rate_operator(operator: str, about: str, step: Step, **more: Any) -> StreamRow:
    return StreamRow(about, f"out(X) <- p(X, K) with {operator}.", step, **more)


def _states(about: str, step: Step, rule: str = "", option: str = "open(1000000)", **more: Any) -> StreamRow:
    declared = f":- state(s(X), from(p(X, _)), until(q(X, _)), [{option}]).\n"
    return StreamRow(about, declared + (rule or "out(X) <- s(X)."), step, **more)


def _own(policy: str) -> StreamRow:
    label = f"own([property(policy, {policy})]) : "
    return StreamRow(
        f"`seq` under `property(policy, {policy})`, N wait",
        f"{label}out(X) <- p(X, K) seq q(X, L).",
        _pairs,
        goals=f"set_etalis_flag(event_consumption_policy, {'recent' if policy != 'recent' else 'chronological'})",
    )


def _skipping(kind: str, step: Step, **more: Any) -> StreamRow:
    label = f"own([property(policy, unrestricted), property(after_match, {kind})]) : "
    return StreamRow(
        f"`seq` under `property(after_match, {kind})`, N wait",
        f"{label}out(X) <- p(X, K) seq q(X, L).",
        step,
        **more,
    )


STREAMS: Dict[str, StreamRow] = {
    # Windows, and what is measured of them.
    "last_count": _window("last(#)", "`last(N)`, N in it: `count`", "count"),
    "last_sum": _window("last(#)", "`sum`", "sum(K)"),
    "last_avg": _window("last(#)", "`avg`"),
    "last_stddev": _window("last(#)", "`stddev`", "stddev(K)"),
    "last_min": _window("last(#)", "`min`", "min(K)"),
    "last_max": _window("last(#)", "`max`", "max(K)"),
    "last_median": _window("last(#)", "`median`", "median(K)"),
    "last_count_distinct": _window("last(#)", "`count_distinct`", "count_distinct(K)"),
    "last_distinct": _window("last(#)", "`distinct` of ten values", "distinct(K)")._replace(step=_few_values),
    "last_list": _window("last(#)", "`list`", "list(K)", most=1000),
    "last_groups": _groups("last(#2)", "`last(N)`, N groups of two", filled=2),
    "newest": _window("last(#, events)", "`last(N, events)`"),
    "newest_rate": _window("last(#, events)", "`rate`", "rate"),
    "newest_groups": _groups("last(2, events)", "N groups of two", filled=2),
    "tumbling": _window("every(#)", "`every(N)`", periods=True),
    "tumbling_groups": _groups("every(#)", "N groups of one", periods=True),
    "first": _window("every(#, first)", "`every(N, first)`", periods=True),
    "first_groups": _groups("every(#, first)", "N groups of one", periods=True),
    "batch": _window("every(#, events)", "`every(N, events)`", periods=True),
    "batch_groups": _groups("every(2, events)", "N groups of one or two"),
    "hopping": _window("last(#, every(#10))", "`last(N, every(N/10))`", periods=True),
    "hopping_groups": _groups("last(#, every(#10))", "N groups of one", periods=True),
    "running": _window("running(every(#))", "`running(every(N))`", periods=True),
    "running_groups": _groups("running(every(#))", "N groups of one", periods=True),
    "last_full": _window("last(1000000000)", "a window with N, the most that may be stored", is_limited=True),
    "last_groups_full": StreamRow(
        "N groups, the most that may be stored",
        "out(X, A) <- aggregate(avg(K), p(X, K), A, last(1000000000)).",
        _always,
        is_limited=True,
    ),
    # Steps.
    "steps": _window("steps([one(#)])", "`steps([one(N)])`", periods=True),
    "steps_back": StreamRow(
        "`steps([up(N) where X > prev(X)])`",
        "out(A) <- aggregate(count, p(X, _), A, steps([up(#) where X > prev(X)])).",
        _always,
        periods=True,
    ),
    "steps_later": StreamRow(
        "`steps([one, later(last) where X >= first(one, X) + N])`: N passed over",
        "out(A) <- aggregate(count, p(X, _), A, steps([one, later(last) where X >= first(one, X) + #])).",
        _always,
        periods=True,
    ),
    "steps_many": StreamRow(
        "`steps([up(1, many) where G])`, matches of N",
        "out(A) <- aggregate(count, p(X, K), A, steps([up(1, many) where X mod # > prev(X) mod #])).",
        _always,
        periods=True,
    ),
    "steps_groups": _groups("steps([up(2) where K > prev(K)])", "N groups of one", filled=1),
    # Absence for some time.
    "absent": StreamRow(
        "`P seq absent(Q, N)`, N wait, one is due at each P",
        "out(X) <- p(X, K) seq absent(q(X, _), #).",
        _always,
    ),
    "absent_ended": StreamRow(
        "each Q rules out one of N",
        "out(X) <- p(X, K) seq absent(q(X, _), 100000000).",
        _pairs,
        fires=False,
    ),
    "absent_remembered": StreamRow(
        "with a condition, N of Q remembered",
        "out(X) <- p(X, K) seq absent(q(_, L) where (L > K), #).",
        _one_and_many,
        fires=False,
    ),
    "absent_full": StreamRow(
        "N wait, the most that may be stored",
        "out(X) <- p(X, K) seq absent(q(X, _), 100000000).",
        _always,
        fires=False,
        is_limited=True,
    ),
    # Rates and changes.
    "throttle": _rate_operator("throttle(#2, X)", "`throttle`, N keys", _keys),
    "throttle_new": _rate_operator("throttle(#, X)", "each of another key than before", _always),
    "burst": _rate_operator("burst(#2, X)", "`burst`, N keys", _keys, fires=False),
    "debounce": _rate_operator(
        "debounce(#, X)", "`debounce`, N keys wait, one is due at each event", _always
    ),
    "debounce_again": _rate_operator(
        "debounce(#2, X)", "N keys wait, one is set back by each", _keys, fires=False
    ),
    "change": _rate_operator("change(K, X)", "`change`, N keys", _keys),
    "change_full": _rate_operator(
        "change(K, X)", "N keys, the most that may be stored", _always, is_limited=True
    ),
    "throttle_full": _rate_operator(
        "throttle(1000000000, X)", "`throttle`, N keys, the most that may be stored", _always, is_limited=True
    ),
    # Timers.
    "timers": StreamRow(
        "`timer(E, every(...))`, N timers, one rings each time",
        "null do timer(out(X), every(#, from_now)) <- p(X, _).",
        _at_first,
        most=100_000,
    ),
    "timers_again": StreamRow(
        "`timer(E, after(...))`, set again by each event",
        "null do timer(out(X), after(#2)) <- p(X, _).",
        _keys,
        fires=False,
        most=100_000,
    ),
    "timers_cancelled": StreamRow(
        "set, and another of N cancelled",
        "null do timer(out(X), after(1000000)) <- p(X, _).\nnull do cancel_timer(out(X)) <- q(X, _).",
        _pairs,
        fires=False,
        most=100_000,
    ),
    # States.
    "states": _states("a state, N are open: one begins and one ends", _pairs),
    "states_asked": _states("`where holds(S)`", _asked, "out(X) <- r(X, _) where holds(s(X))."),
    "states_during": _states(
        "`P during S`, N of P wait", _opened_and_waited_for, "out(X) <- r(X, _) during s(X)."
    ),
    "states_within": _states(
        "`within(N)`: one begins, one ends by itself", _always, "", "open(1000000), within(#)"
    ),
    "states_full": _states(
        "N are open, the most that may be: the oldest goes", _always, "", "open(#)", fires=False
    ),
    "states_before": _states(
        "`where holds_at(S, T)`, N over",
        _ended_twice,
        "out(X) <- q(X, _) where (holds_at(s(X), 1000000000.5) ; true).",
        "past(#)",
        most=10_000,
    ),
    # How rules run, and declared events.
    **{
        f"own_{policy}": _own(policy)
        for policy in ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
    },
    "skip_past_last": _skipping("skip_past_last", _with_last, periods=True),
    "skip_to_next": _skipping("skip_to_next", _pairs),
    "declared": StreamRow(
        "`:- event p(x:integer, k:integer)`, N wait",
        ":- event p(x:integer, k:integer), q(x:integer, k:integer).\nout(X) <- p(X, K) seq q(X, L).",
        _pairs,
        as_program=True,
    ),
    "declarations": StreamRow(
        "N events are declared",
        "out(X) <- e0(X).",
        _one_kind,
        declares=True,
        as_program=True,
    ),
}


class StreamBench:
    """An engine with the program of a row and N items.

    Args:
        row: the row.
        size: number of items.
    """

    def __init__(self, row: StreamRow, size: int):
        self.row = row
        self.size = size
        self.engine = engine = Engine()
        engine.rules.network.limit_stored(size if row.is_limited else 10**8)
        program_timers.MAX_TIMERS = max(program_timers.MAX_TIMERS, size)
        for at in range(0, size if row.declares else 0, 1000):
            names = ", ".join(f"e{number}(x:integer)" for number in range(at, min(at + 1000, size)))
            engine.load(rules=f":- event {names}.")
        text = row.rules.replace("#10", str(max(1, size // 10))).replace("#2", str(2 * size))
        engine.load(rules=text.replace("#", str(size)) + "\n", goals=row.goals)
        self.results = 0
        engine.dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, atom("out"), self._count)
        engine.dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, functor("out", 1)(Var()), self._count)
        engine.dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, functor("out", 2)(Var(), Var()), self._count)
        self._steps = 0

    def _count(self, term: Term, values: Any, start: int, end: int, after: Any) -> Any:
        self.results += 1
        return after

    def feed(self, number: int) -> Tuple[float, int]:
        """Feed steps; return their CPU seconds and their number of events."""
        engine, step, size = self.engine, self.row.step, self.size
        enter = engine.event if self.row.as_program else None
        spent, events = 0.0, 0
        for first in range(self._steps, self._steps + number, 10_000):
            steps = [
                ((BEGIN + at) * SECOND, step(at, size))
                for at in range(first, min(first + 10_000, self._steps + number))
            ]
            events += sum(max(1, len(terms)) for _, terms in steps)
            spent += self._enter(steps) if enter is None else self._enter_as_program(steps)
        self._steps += number
        return spent, events

    def _enter(self, steps: Steps) -> float:
        post, advance, clock = self.engine.post, self.engine.advance, self.engine.clock
        began = time.thread_time()
        for instant, terms in steps:
            for term in terms:
                post(term, instant)
            if not terms:
                clock.move_to(instant)
                advance()
        return time.thread_time() - began

    def _enter_as_program(self, steps: Steps) -> float:
        event = self.engine.event
        began = time.thread_time()
        for instant, terms in steps:
            stamp = instant // SECOND
            for term in terms:
                event(term, stamp)
        return time.thread_time() - began


def _one(bench: StreamBench) -> Tuple[float, int, int]:
    """Return the CPU seconds, events and results of some steps with N items."""
    row, size = bench.row, bench.size
    bench.feed(row.filled * size)
    limit_gc_pauses()
    before = bench.results
    spent, events = 0.0, 0
    while spent < 0.01:
        more, number = bench.feed(size if row.periods else min(max(size, 100), MOST_STEPS))
        spent, events = spent + more, events + number
    restore_gc()
    return spent, events, bench.results - before


@contextmanager
def quiet() -> Iterator[None]:
    """Disable logging: some rows evict items on purpose."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def measure(name: str, least: int, most: int, seconds: float) -> Iterator[Dict[str, Any]]:
    """Yield the figures of a row for N = ``least``, ten times that, and so on."""
    row = STREAMS[name]
    size = least
    while size <= min(most, row.most):
        began = time.thread_time()
        with quiet():
            spent, events, results = _one(StreamBench(row, size))
        yield {
            "operator": name,
            "policy": "",
            "setting": "streams",
            "waiting": size,
            "us": spent / events * 1e6,
            "results": round(results / events),
            "fired": bool(results),
        }
        if (time.thread_time() - began) * 10 > seconds:
            return
        size *= 10
