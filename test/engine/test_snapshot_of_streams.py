"""Operators on streams go on where an engine is restored: windows, shapes and absences."""

import random

import pytest

from retalis import Engine

KINDS = "[count, sum(X), avg(X), median(X), min(X), max(X), stddev(X), list(X), distinct(X)]"
OTHERS = "[count_distinct(X), quantile(0.9, X), first(X), last(X), rate]"
WINDOWS = (
    "last(3)",
    "last(4, events)",
    "every(2)",
    "every(2, first)",
    "every(3, events)",
    "last(3, every(1))",
    "running(every(2))",
    "running(every(2, first))",
    "running(every(3, events))",
)
PATTERNS = {
    **{f"many in {window}": f"w(K, R) <- aggregate({KINDS}, in(K, X), R, {window})." for window in WINDOWS},
    **{f"more in {window}": f"w(R) <- aggregate({OTHERS}, in(_, X), R, {window})." for window in WINDOWS},
    "throttle": "w(K, X) <- in(K, X) with throttle(2, K).",
    "burst": "w(K, X) <- in(K, X) with burst(1.5, K).",
    "debounce": "w(K, X) <- in(K, X) with debounce(1, K).",
    "change": "w(K, X) <- in(K, X) with change(X, K).",
    "absent": "w(K, X) <- in(K, X) seq absent(no(K), 2).",
    "absent of any": "w(K, X) <- in(K, X) seq absent(no(_) where X > 2, 2).",
    "a sequence with all of them": (
        "w(K, N) <- aggregate(count, (in(K, X) seq absent(no(K), 1)) with change(X), N, last(5)) seq end(K)."
    ),
}
FLAGS = {
    "plain": "",
    "revised": ":- set_etalis_flag(revision_flag, on).\n:- set_etalis_flag(out_of_order, on).\n",
}


def stream(seed, number=60):
    """Return events in an order in which some come late, in steps of a quarter of a second."""
    chance = random.Random(seed)
    found = []
    now = 8
    for _ in range(number):
        now += chance.choice((0, 1, 1, 2, 3, 6))
        start = max(now - chance.choice((0, 0, 0, 1, 5, 9)), 0)
        end = start + chance.choice((0, 0, 1, 2))
        event = f"in({chance.choice('abc')}, {chance.choice((1, 2, 2.5, 4))})"
        if chance.random() < 0.3:
            event = chance.choice(("no(a)", "no(b)", "end(a)", "end(c)", "no(c)"))
        found.append((event, start / 4, end / 4))
    return found


def listened(engine):
    """Have an engine note the events that it shows."""
    said = engine.said = []
    engine.on_event(lambda term, start, end: said.append((engine.show(term), int(start), int(end))))
    return engine


def feed(engine, events):
    """Give events to an engine."""
    for event, start, end in events:
        engine.event(event, start, end)


@pytest.mark.slow
@pytest.mark.parametrize("flags", FLAGS)
@pytest.mark.parametrize("name", PATTERNS)
def test_goes_on_as_if_nothing_had_been(name, flags):
    one = Engine()
    one.load(rules=FLAGS[flags] + PATTERNS[name])
    events = stream(name)
    if flags == "revised":
        events[45:45] = [(f"rev({term})", *events[44][1:]) for term, *_ in events[30:40:3]]
    feed(one, events[:35])
    other = Engine.restore(Engine.restore(one.snapshot()).snapshot())
    for engine in (one, other):
        feed(listened(engine), [*events[35:], ("tick", 90, 90)])
    assert any(text.startswith("w(") for text, _, _ in one.said)
    assert other.said == one.said
    assert other.status().rules == one.status().rules


def test_no_event_is_late_because_of_a_restoration():
    engine = Engine()
    engine.load(rules=PATTERNS["debounce"])
    feed(engine, [("in(a, 1)", 20, 20), ("in(a, 2)", 10, 10)])
    assert engine.status().rules[0].late == 1
    restored = Engine.restore(engine.snapshot())
    feed(restored, [("in(a, 3)", 21, 21)])
    assert restored.status().rules[0].late == 1
