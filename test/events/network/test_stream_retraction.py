"""Retraction in stream operators: after a retraction, results equal those without the event."""

import random
from collections import Counter
from typing import Any

import pytest

from retalis import Engine
from retalis.events.network import stream_node

RULES = {
    "last": "out(M, A) <- aggregate(list(T), t(M, T), A, last(5)).",
    "newest": "out(M, A) <- aggregate(sum(T), t(M, T), A, last(3, events)).",
    "batch": "out(M, A) <- aggregate(list(T), t(M, T), A, every(3, events)).",
    "every": "out(M, A) <- aggregate(list(T), t(M, T), A, every(4)).",
    "hopping": "out(M, A) <- aggregate(count, t(M, T), A, last(6, every(2))).",
    "first": "out(M, A) <- aggregate(list(T), t(M, T), A, every(4, first)).",
    "session": "out(M, A) <- aggregate(list(T), t(M, T), A, session(2)).",
    "bounded session": "out(M, A) <- aggregate(count, t(M, T), A, session(2, max(4))).",
    "held": "out(M, A) <- aggregate([avg(T), max(T)], t(M, T), A, held(last(6, every(2)), max(4))).",
    "held last": "out(M, A) <- aggregate([avg(T), duration(T > 1)], t(M, T), A, held(last(6))).",
    "running": "out(M, A) <- aggregate(count, t(M, T), A, running(every(4))).",
    "steps": "out(M, A) <- aggregate(list(T), t(M, T), A, steps([a(1, 2), later(b) where T > prev(T)])).",
    "greedy": "out(M, A) <- aggregate(list(T), t(M, T), A, steps([a(1, many) where T >= prev(T)])).",
    "throttle": "out(M, T) <- t(M, T) with throttle(4, M).",
    "burst": "out(M, T) <- t(M, T) with burst(2, M).",
    "debounce": "out(M, T) <- t(M, T) with debounce(2, M).",
    "change": "out(M, T) <- t(M, T) with change(T, M).",
    "absent": "out(M, T) <- t(M, T) seq absent(t(M, _), 3).",
    "absent by variable": "out(M, T) <- t(M, T) seq absent(t(M, _), T).",
    "not preceded": "out(M, T) <- t(M, T) with not_preceded(t(M, _), 2).",
    "joined": "out(M, N) <- (t(M, T) with throttle(3)) and (aggregate(count, t(M, _), N, last(3))).",
}
SEED_COUNT = 8


def random_events(generator: Any, few_values: bool) -> Any:
    """Return events with their instants; with ``few_values``, so that some values are equal."""
    now, events = 10, []
    for number in range(12):
        now += generator.choice([0, 1, 1, 2, 3])
        events.append(
            (f"t({generator.choice('ab')},{generator.choice([1, 2]) if few_values else number})", now)
        )
    return events


def remaining_outputs(rule: Any, events: Any) -> Any:
    """Return the count of each output that is not retracted, after all deadlines."""
    engine = Engine()
    counts: Counter[Any] = Counter()

    def record(term: Any, start: Any, end: Any) -> None:
        text = engine.show(term)
        if text.startswith("out"):
            counts[text] += 1
        elif text.startswith("rev(out"):
            counts[text[4:-1]] -= 1

    engine.on_event(record)
    engine.load(goals="set_etalis_flag(revision_flag,on).", rules=rule)
    for term, instant in events:
        engine.event(term, instant)
    engine.event("end", events[-1][1] + 100)
    assert min(counts.values(), default=0) >= 0
    return +counts


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in RULES if name != "joined"])
def test_retraction_equals_missing_event(name: Any) -> None:
    for seed in range(SEED_COUNT):
        generator = random.Random(seed)
        events = random_events(generator, name == "change")
        retracted = generator.choice(events)[0]
        last = max(number for number, (term, _) in enumerate(events) if term == retracted)
        position = generator.randint(last + 1, len(events))
        with_retraction = [
            *events[:position],
            (f"rev({retracted})", events[position - 1][1]),
            *events[position:],
        ]
        without_event = [event for event in events if event[0] != retracted]
        assert remaining_outputs(RULES[name], with_retraction) == remaining_outputs(
            RULES[name], without_event
        ), (seed, with_retraction)


def test_retraction_removes_joined_output() -> None:
    outputs = remaining_outputs(RULES["joined"], [("t(a,1)", 10), ("t(a,2)", 11)])
    assert outputs == {"out(a,1)": 1}
    assert not remaining_outputs(RULES["joined"], [("t(a,1)", 10), ("rev(t(a,1))", 10)])


def test_retraction_in_long_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_node, "MAX_REPLAYED_ELEMENTS", 5)
    events = [(f"t(a,{number})", 10 + number) for number in range(30)]
    for name in ("last", "newest", "batch", "every", "hopping", "running", "session", "held", "held last"):
        with_retraction = [*events, ("rev(t(a,28))", 40)]
        without_event = [event for event in events if event[0] != "t(a,28)"]
        assert remaining_outputs(RULES[name], with_retraction) == remaining_outputs(
            RULES[name], without_event
        ), name


def test_output_of_long_window_has_limited_sources() -> None:
    engine = Engine()
    engine.load(
        goals="set_etalis_flag(etalis_justification,on).",
        rules=f"out(N) <- aggregate(count, t, N, last({10**6})).",
    )
    for number in range(300):
        engine.event("t", number + 1)
    outputs = [
        event
        for event in engine.rules.network.tracker.remembered_events()
        if engine.show(event.term).startswith("out")
    ]
    assert len(outputs) == 300
    assert max(len(event.sources()) for event in outputs) == 100
