"""Stream operators of a restored engine: windows, rate operators and absences."""

import random
from typing import Any, List

import pytest

from retalis import Engine
from retalis.events.streams.aggregates import AGGREGATES as AGGREGATES_BY_NAME

from .emissions import record_emissions

AGGREGATES = "[count, sum(X), avg(X), median(X), min(X), max(X), stddev(X), list(X), distinct(X)]"
MORE_AGGREGATES = "[count_distinct(X), quantile(0.9, X), first(X), last(X), changes(X), rate]"
NOTATIONS = [
    function.notation.replace("P, ", "0.9, ").replace("Init, Step, Result", "none, longer, same")
    for function in AGGREGATES_BY_NAME.values()
]
FOLDED = "none(0).\nlonger(X, S0, S) :- S is max(X, S0).\nsame(S, S)."
HELD_AGGREGATES = "[avg(X), duration(X > 2), min(X), max(X), first(X), last(X)]"
HELD_WINDOWS = ("held(last(3))", "held(last(3), max(2))", "held(every(2))", "held(last(3, every(1)), max(2))")
WINDOWS = (
    "last(3)",
    "last(4, events)",
    "every(2)",
    "every(2, first)",
    "every(3, events)",
    "last(3, every(1))",
    "session(1.5)",
    "session(1.5, max(4))",
    "running(every(2))",
    "running(every(2, first))",
    "running(every(3, events))",
)
PATTERNS = {
    **{
        f"aggregates in {window}": f"w(K, R) <- aggregate({AGGREGATES}, in(K, X), R, {window})."
        for window in WINDOWS
    },
    **{
        f"more aggregates in {window}": f"w(R) <- aggregate({MORE_AGGREGATES}, in(_, X), R, {window})."
        for window in WINDOWS
    },
    **{
        f"held values in {window}": f"w(K, R) <- aggregate({HELD_AGGREGATES}, in(K, X), R, {window})."
        for window in HELD_WINDOWS
    },
    **{
        f"repetitions with {notation}": f"w(K, R) <- end(K) seq aggregate({notation}, in(_, X), R).\n{FOLDED}"
        for notation in NOTATIONS
    },
    "throttle": "w(K, X) <- in(K, X) with throttle(2, K).",
    "burst": "w(K, X) <- in(K, X) with burst(1.5, K).",
    "debounce": "w(K, X) <- in(K, X) with debounce(1, K).",
    "change": "w(K, X) <- in(K, X) with change(X, K).",
    "change after first": "w(K, X) <- in(K, X) with change_after_first(X, K).",
    "absent": "w(K, X) <- in(K, X) seq absent(no(K), 2).",
    "absent of own time": "w(K, X) <- in(K, X) seq absent(no(K), X).",
    "not preceded": "w(K, X) <- in(K, X) with not_preceded(no(K), 2).",
    "not preceded by any": "w(K, X) <- in(K, X) with not_preceded((no(_) where X > 2), 2).",
    "absent of any": "w(K, X) <- in(K, X) seq absent(no(_) where X > 2, 2).",
    "a sequence with all of them": (
        "w(K, N) <- aggregate(count, (in(K, X) seq absent(no(K), 1)) with change(X), N, last(5)) seq end(K)."
    ),
}
FLAGS = {
    "plain": "",
    "revised": ":- set_etalis_flag(revision_flag, on).\n:- set_etalis_flag(out_of_order, on).\n",
}


def stream(seed: Any, number: int = 60) -> Any:
    """Return events with times in steps of 0.25 s, except some late ones."""
    generator = random.Random(seed)
    events: List[Any] = []
    now = 8
    for _ in range(number):
        now += generator.choice((0, 1, 1, 2, 3, 6))
        start = max(now - generator.choice((0, 0, 0, 1, 5, 9)), 0)
        end = start + generator.choice((0, 0, 1, 2))
        event = f"in({generator.choice('abc')}, {generator.choice((1, 2, 2.5, 4))})"
        if generator.random() < 0.3:
            event = generator.choice(("no(a)", "no(b)", "end(a)", "end(c)", "no(c)"))
        events.append((event, start / 4, end / 4))
    return events


def feed(engine: Engine, events: Any) -> None:
    """Feed events to an engine."""
    for event, start, end in events:
        engine.event(event, start, end)


def emissions_of(engine: Engine, events: Any) -> List[Any]:
    """Feed events to an engine; return the events that it emits for them."""
    emissions = record_emissions(engine)
    feed(engine, events)
    return emissions


@pytest.mark.slow
@pytest.mark.parametrize("flags", FLAGS)
@pytest.mark.parametrize("name", PATTERNS)
def test_restored_stream_operator_emits_same_events(name: Any, flags: str) -> None:
    original = Engine()
    original.load(rules=FLAGS[flags] + PATTERNS[name])
    events = stream(name)
    if flags == "revised":
        events[45:45] = [(f"rev({term})", *events[44][1:]) for term, *_ in events[30:40:3]]
    feed(original, events[:35])
    restored = Engine.restore(Engine.restore(original.snapshot()).snapshot())
    remaining = [*events[35:], ("tick", 90, 90)]
    expected = emissions_of(original, remaining)
    assert any(text.startswith("w(") for text, _, _ in expected)
    assert emissions_of(restored, remaining) == expected
    assert restored.status().rules == original.status().rules


def test_restoration_makes_no_event_late() -> None:
    engine = Engine()
    engine.load(rules=PATTERNS["debounce"])
    feed(engine, [("in(a, 1)", 20, 20), ("in(a, 2)", 10, 10)])
    assert engine.status().rules[0].late == 1
    restored = Engine.restore(engine.snapshot())
    feed(restored, [("in(a, 3)", 21, 21)])
    assert restored.status().rules[0].late == 1
