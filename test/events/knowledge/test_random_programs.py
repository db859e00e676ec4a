"""Programs made at random: what follows is the same whether all events are listened to or only those of a few kinds.

Where few listen, synchronized events of rules are not made and messages go by the short ways.
"""

import logging
import random
import re

import pytest

from retalis import Engine, Settings, Var, functor
from retalis.events.dispatch.listeners import ListenerPhase

KINDS = (("done", 2), ("ask", 3), ("v", 2), ("seen", 1))
GOALS = (
    "true",
    "T2 > 4",
    "prev(m0, P, _, _, T)",
    "next_inf(m0, P, _, _, T)",
    "member(P, [1, 2])",
    "fail",
    "new_event(v(0, T), T, 0)",
    "(new_event(seen(T2), T, 1), P = 3)",
    "P is T + foo",
    "memory_counter(M, P)",
    "undefined(P)",
)
TRIGGERED = ("done({0}, P)", "done({0}, T)", "done({0}, T2)", "v(1, T)", "seen(P)")
TIMES = ("T", "T", "T2", "7", "[T, 500000000]")
ACTIONS = ("", "", "do true ", "do g(K, T, T2) ", "do g(K) ")
PATTERNS = (
    "ask(K, T, T2)",
    "ask(K, T, T2)",
    "ask(1, T, T2)",
    "ask(K, T, T2) where T > 2",
    "(ask(K, T, _) seq v(_, T2))",
    "(ask(K, T, _) where T2 = T)",
)
FOLLOWING = ("seen(A)", "v(2, A)")


def memories(pick):
    """Return memories of values, some under conditions."""
    names = [f"m{at}" for at in range(pick.randint(1, 4))]
    lines = []
    for name in names:
        condition = pick.choice(["", "X > 2", f"memory_counter({name}, N), N < 6", "member(_, [X])"])
        definition = f"v({pick.choice('K012')}, X), [{condition}], {pick.choice(['w(X)', '_'])}"
        lines.append(f"memorize({definition}, {name}, {pick.choice([0, 1, 3, 50])})\n")
    return names, "".join(lines)


def rules(pick, names):
    """Return rules that ask, and rules that follow."""
    found = ["g(_)", "g(_, _, _)"]
    for number in range(pick.randint(1, 4)):
        pairs = [f"[{pick.choice(names)}, {pick.choice(TIMES)}]" for _ in range(pick.randint(0, 3))]
        event = pick.choice(TRIGGERED).format(number)
        name = pick.choice(["syncronized", "synchronized"])
        head = f"{name}({event}, {pick.choice(GOALS)}, [{', '.join(pairs)}])"
        found.append(f"{head} {pick.choice(ACTIONS)}<- {pick.choice(PATTERNS)}")
        if pick.random() < 0.3:
            found.append(f"{pick.choice(FOLLOWING)} <- done({number}, A)")
    return "".join(f"{rule}.\n" for rule in found)


def stream(pick):
    """Yield values and questions, with their instants."""
    for _ in range(25):
        second = pick.randint(0, 14)
        if pick.random() < 0.5:
            value = functor("v", 2)(pick.randint(0, 2), pick.randint(0, 5))
            yield value, second * 10**9 + pick.choice([0, 500_000_000])
        else:
            time = pick.choice([second, float(second), second + pick.randint(0, 4), second + 2.0])
            yield functor("ask", 3)(pick.randint(0, 2), time, pick.randint(0, 14)), second * 10**9


def outcome(seed, everything, caplog):
    """Return the events, what waits and the warnings of a program."""
    pick = random.Random(seed)
    names, goals = memories(pick)
    engine = Engine(settings=Settings(max_depth=6))  # what goes round is soon over
    got = []

    def note(term, values, start, end, frame):
        if not engine.show(term).startswith("sync"):
            got.append((re.sub(r"_G\d+", "_", engine.show(term)), int(start), int(end)))
        return frame

    kinds = [functor(name, arity)(*(Var() for _ in range(arity))) for name, arity in KINDS]
    for pattern in kinds:
        engine.dispatcher.listen(ListenerPhase.TRACE, pattern, note)
    if everything:
        engine.on_event(lambda term, start, end: None)
    engine.load(rules=rules(pick, names), goals=goals)
    caplog.clear()
    for term, instant in stream(pick):
        if pick.random() < 0.7:
            engine.post(term, instant)
        else:
            engine.event_at(term, instant, instant)
        if pick.random() < 0.02:
            engine.call("delete_memory(m0)")
    assert engine.dispatcher.current is None
    warnings = [re.sub(r" \(in \S+/\d+\)|(?<=_)G?\d+", "", record.message) for record in caplog.records]
    return (
        got,
        len(engine.knowledge.pending_queries),
        warnings,
    )  # without what calls a built-in of compiled code


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_short_ways_lead_where_long_ones_do(part, caplog):
    caplog.set_level(logging.WARNING, "retalis")
    for seed in range(part * 12, part * 12 + 12):
        assert outcome(seed, True, caplog) == outcome(seed, False, caplog), seed
