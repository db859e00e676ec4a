"""Random programs of everything that the clock moves: timers, alarms, states, windows, queries, and output rates.

Durations and instants are small multiples of half a second, so that many deadlines fall on the same instant. Most
programs also contain rules of `random_case`, over the same events.
"""

from random import Random
from typing import List, NamedTuple, Optional, Tuple

from .strategies import random_case

Step = Tuple[Optional[str], float]
"""An event and its instant in seconds, or None if the clock moves to the instant without an event."""

GOALS = (
    "state(s{n}(X), from(a(X)), until(b(X)), [within({d})])",
    "state(s{n}(X), from(b(X)), until(b(_)), [within({d})])",
    "state(s{n}, from(d), until(a(_)), [within({d}), open(2), past(2)])",
    "state(s{n}(Y), from(c(_, Y)), until(d), [within({d}), open(2)])",
    "state(s{n}(X), from(c(X, _)), until(c(_, X)))",
    "timer(u{n}, every({d}))",
    "timer(u{n}, every({d}, from_now))",
    "timer(u{n}, after({d}))",
    "timer(u{n}, at(0, 0, {i}))",
    "timer(u{n}, at(datime(1970, 1, 1, 0, 0, {i}, 0)))",
    "subscribe(a(_) with throttle({d}), [], _, t{n}, i)",
    "subscribe(a(X) with debounce({d}, X), [], _, t{n}, i)",
    "subscribe(c(X, _) with burst({d}, X), [], _, t{n}, i)",
    "subscribe(b(X) with change(X), [X > 0], _, t{n}, i)",
)
RULES = (
    "exceptionAlarm(o{n}(X), {d}) <- a(X).",
    "exceptionAlarm(o{n}(X, Y), {d}) <- a(X) seq b(Y).",
    "exceptionAlarmAbsoluteDatime(o{n}, datime(1970, 1, 1, 0, 0, {i}, 0)) <- d.",
    "null do timer(o{n}(X), after({d})) <- b(X).",
    "null do timer(o{n}, every({d}, from_now)) <- d.",
    "null do cancel_timer(u{m}) <- c(_, 1).",
    "synchronized(o{n}(X), true, [[m, T]], [timeout({d})]) <- a(X) timestamp (t2(S), T is S + {e}).",
    "synchronized(o{n}(X, P), prev(m, b(P), _, _, T), [[m, T], [k, T]], [timeout({d})]) <- "
    "c(X, _) timestamp (t2(S), T is S + {e}).",
    "synchronized(o{n}(X), true, [[k, T]]) <- b(X) timestamp (t1(S), T is S + {e}).",
    "o{n}(S) <- query_given_up(S, _, _).",
    "o{n}(X) <- a(X) seq absent(b(X), {d}).",
    "o{n}(X) <- c(X, _) seq absent(b(_) where X > 0, {d}).",
    "o{n}(X) <- a(X) with throttle({d}).",
    "o{n}(X, Y) <- c(X, Y) with throttle({d}, X).",
    "o{n}(X) <- a(X) with burst({d}).",
    "o{n}(X) <- a(X) with debounce({d}).",
    "o{n}(X, Y) <- c(X, Y) with debounce({d}, X).",
    "o{n}(X, Y) <- c(X, Y) with change(Y, X).",
    "o{n}(R) <- aggregate([count, sum(X), max(X)], a(X), R, last({d})).",
    "o{n}(X, R) <- aggregate([list(Y), first(Y), median(Y)], c(X, Y), R, last({w}, events)).",
    "o{n}(X, R) <- aggregate([avg(Y), stddev(Y)], c(X, Y), R, every({d})).",
    "o{n}(R) <- aggregate(count, b(_), R, every({d}, first)).",
    "o{n}(R) <- aggregate(list(X), a(X), R, every({w}, events)).",
    "o{n}(R) <- aggregate([count, quantile(0.5, X)], a(X), R, last({d}, every({e}))).",
    "o{n}(R) <- aggregate(max(X), b(X), R, running(every({d}))).",
    "o{n}(X, R) <- aggregate([avg(Y), min(Y)], c(X, Y), R, held(last({d}, every({e})), max({e}))).",
    "o{n}(R) <- aggregate(duration(X > 1), b(X), R, held(last({d}))).",
    "o{n}(X, R) <- aggregate(count, c(X, Y), R, steps([low(1, 3) where Y =< 1, high where Y > 1])).",
    "o{n}(R) <- aggregate(list(X), a(X), R, steps([p, later(q(2)) where X >= prev(X)])).",
    "o{n}(X, Y) <- (a(X) seq b(Y)) within {d}.",
    "o{n}(X) <- ((a(X) seq b(_)) cnot d) within {d}.",
    "o{n}(X, N) <- a(X) seq aggregate(sum(Y), c(X, Y), N).",
    "o{n}(X) <- a(X) where (holds_at(s{m}(_), 12) ; X > 0).",
    "o{n} <- u{m} seq a(_).",
    "o{n} <- s{m}(X) and b(X).",
    "o{n} <- o{m} seq absent(a(_), {d}).",
)
MEMORIES = "memorize(b(_), [], _, m, 3).\nmemorize(c(_, _), [], _, k, 2).\n"
EVENTS = ("a(0)", "a(1)", "a(2)", "b(0)", "b(1)", "b(2)", "c(0, 1)", "c(1, 1)", "c(1, 2)", "c(2, 0)", "d")
FLAGS = (
    "set_etalis_flag(revision_flag, on)",
    "set_etalis_flag(etalis_justification, on)",
    "set_etalis_flag(out_of_order, on)",
    "set_etalis_flag(event_consumption_policy, chronological)",
    "set_etalis_flag(event_consumption_policy, unrestricted)",
)


class ClockProgram(NamedTuple):
    """A program with the steps of a run.

    Attributes:
        goals: directives: memories, flags, states, timers and subscriptions.
        rules: event rules.
        steps: events and moves of the clock.
    """

    goals: str
    rules: str
    steps: Tuple[Step, ...]


def random_clock_program(seed: int) -> ClockProgram:
    """Return the program of a seed."""
    choose = Random(seed)

    def fill(template: str, number: int) -> str:
        return template.format(
            n=number,
            m=choose.randrange(4),
            d=choose.choice((0.5, 1, 1, 2, 2, 3)),
            e=choose.choice((0.5, 1, 2)),
            i=choose.randrange(11, 24),
            w=choose.choice((1, 2, 3)),
        )

    goals = [fill(choose.choice(GOALS), number) for number in range(choose.randrange(1, 6))]
    goals += [flag for flag in FLAGS if choose.random() < 0.15]
    rules = [fill(choose.choice(RULES), number) for number in range(choose.randrange(1, 7))]
    if choose.random() < 0.5:
        rules.append(random_case(seed, 3, streams=choose.random() < 0.5).text())
    text = MEMORIES + "".join(f"{goal}.\n" for goal in goals)
    return ClockProgram(text, "\n".join(rules), tuple(_random_steps(choose, "revision_flag" in text)))


def _random_steps(choose: Random, revises: bool) -> List[Step]:
    """Return events, some of them late or retractions, and moves of the clock."""
    steps: List[Step] = []
    now = 10.0
    for _ in range(choose.randrange(4, 26)):
        now += choose.choice((0, 0, 0.5, 0.5, 1, 1, 2, 4))
        event: Optional[str] = choose.choice(EVENTS)
        if choose.random() < 0.12:
            event = None
        elif revises and steps and choose.random() < 0.2:
            retracted = choose.choice(steps)[0]
            event = f"rev({retracted})" if retracted and not retracted.startswith("rev") else event
        is_late = event is not None and choose.random() < 0.1
        steps.append((event, now - choose.choice((0.5, 1, 3)) if is_late else now))
    # Everything that waits ends after the last event.
    return [*steps, (None, now + 5), (None, now + 30)]
