"""Unobserved events of random programs: outputs are equal whether a listener observes all events or only a few types.

With few listeners, synchronized events of rules are not created, and messages use the fused paths.
"""

import logging
import random
import re
from typing import Any, Iterator, List, Tuple

import pytest
from nightly_round_numbers import round_numbers

from retalis import Engine, Settings, Var, functor
from retalis.events.dispatch.listeners import ListenerPhase

RECORDED_TYPES = (("done", 2), ("ask", 3), ("v", 2), ("seen", 1))
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


def memories(generator: Any) -> Tuple[Any, ...]:
    """Return memories of values, some with conditions."""
    names = [f"m{number}" for number in range(generator.randint(1, 4))]
    lines: List[Any] = []
    for name in names:
        condition = generator.choice(["", "X > 2", f"memory_counter({name}, N), N < 6", "member(_, [X])"])
        definition = f"v({generator.choice('K012')}, X), [{condition}], {generator.choice(['w(X)', '_'])}"
        lines.append(f"memorize({definition}, {name}, {generator.choice([0, 1, 3, 50])})\n")
    return names, "".join(lines)


def rules(generator: Any, names: Any) -> str:
    """Return rules with queries, and rules on their results."""
    rule_texts = ["g(_)", "g(_, _, _)"]
    for number in range(generator.randint(1, 4)):
        pairs = [
            f"[{generator.choice(names)}, {generator.choice(TIMES)}]" for _ in range(generator.randint(0, 3))
        ]
        event = generator.choice(TRIGGERED).format(number)
        name = generator.choice(["syncronized", "synchronized"])
        head = f"{name}({event}, {generator.choice(GOALS)}, [{', '.join(pairs)}])"
        rule_texts.append(f"{head} {generator.choice(ACTIONS)}<- {generator.choice(PATTERNS)}")
        if generator.random() < 0.3:
            rule_texts.append(f"{generator.choice(FOLLOWING)} <- done({number}, A)")
    return "".join(f"{rule}.\n" for rule in rule_texts)


def stream(generator: Any) -> Iterator[Any]:
    """Yield values and query events, with their instants."""
    for _ in range(25):
        second = generator.randint(0, 14)
        if generator.random() < 0.5:
            value = functor("v", 2)(generator.randint(0, 2), generator.randint(0, 5))
            yield value, second * 10**9 + generator.choice([0, 500_000_000])
        else:
            time = generator.choice([second, float(second), second + generator.randint(0, 4), second + 2.0])
            yield functor("ask", 3)(generator.randint(0, 2), time, generator.randint(0, 14)), second * 10**9


def results_of_program(
    seed: Any, has_listener_of_all: bool, caplog: pytest.LogCaptureFixture
) -> Tuple[Any, ...]:
    """Return the events, the number of pending queries, and the warnings of a program."""
    generator = random.Random(seed)
    names, goals = memories(generator)
    engine = Engine(settings=Settings(max_depth=6))  # endless chains end soon
    events: List[Any] = []

    def record(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        if not engine.show(term).startswith("sync"):
            events.append((re.sub(r"_G\d+", "_", engine.show(term)), int(start), int(end)))
        return frame

    patterns = [functor(name, arity)(*(Var() for _ in range(arity))) for name, arity in RECORDED_TYPES]
    for pattern in patterns:
        engine.dispatcher.listen(ListenerPhase.TRACE, pattern, record)
    if has_listener_of_all:
        engine.on_event(lambda term, start, end: None)
    engine.load(rules=rules(generator, names), goals=goals)
    caplog.clear()
    for term, instant in stream(generator):
        if generator.random() < 0.7:
            engine.post(term, instant)
        else:
            engine.event_at(term, instant, instant)
        if generator.random() < 0.02:
            engine.call("delete_memory(m0)")
    assert engine.dispatcher.current is None
    # Callers of built-ins and numbers of variables differ.
    warnings = [re.sub(r" \(in \S+/\d+\)|(?<=_)G?\d+", "", record.message) for record in caplog.records]
    return events, len(engine.knowledge.pending_queries), warnings


@pytest.mark.slow
@pytest.mark.parametrize("batch", round_numbers(1, 4))
def test_listener_of_all_events_keeps_results(batch: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "retalis")
    for seed in range(batch * 12, batch * 12 + 12):
        assert results_of_program(seed, True, caplog) == results_of_program(seed, False, caplog), seed
