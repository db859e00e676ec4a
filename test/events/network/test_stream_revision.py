"""Revision of stream operators: after a retraction, results are as without the event."""

import random
from collections import Counter

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
    "running": "out(M, A) <- aggregate(count, t(M, T), A, running(every(4))).",
    "steps": "out(M, A) <- aggregate(list(T), t(M, T), A, steps([a(1, 2), later(b) where T > prev(T)])).",
    "greedy": "out(M, A) <- aggregate(list(T), t(M, T), A, steps([a(1, many) where T >= prev(T)])).",
    "throttle": "out(M, T) <- t(M, T) with throttle(4, M).",
    "burst": "out(M, T) <- t(M, T) with burst(2, M).",
    "debounce": "out(M, T) <- t(M, T) with debounce(2, M).",
    "change": "out(M, T) <- t(M, T) with change(T, M).",
    "absent": "out(M, T) <- t(M, T) seq absent(t(M, _), 3).",
    "joined": "out(M, N) <- (t(M, T) with throttle(3)) and (aggregate(count, t(M, _), N, last(3))).",
}
CASES = 8


def stream(chance, few):
    """Return events with their instants; with ``few`` values, so that some are the same."""
    now, found = 10, []
    for number in range(12):
        now += chance.choice([0, 1, 1, 2, 3])
        found.append((f"t({chance.choice('ab')},{chance.choice([1, 2]) if few else number})", now))
    return found


def standing(rule, events):
    """Return how often each result happened and was not taken back, when all time is over."""
    engine = Engine()
    found = Counter()

    def note(term, start, end):
        text = engine.show(term)
        if text.startswith("out"):
            found[text] += 1
        elif text.startswith("rev(out"):
            found[text[4:-1]] -= 1

    engine.on_event(note)
    engine.load(goals="set_etalis_flag(revision_flag,on).", rules=rule)
    for term, instant in events:
        engine.event(term, instant)
    engine.event("end", events[-1][1] + 100)
    assert min(found.values(), default=0) >= 0
    return +found


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in RULES if name != "joined"])
def test_what_stands_is_what_would_be_there_without_the_event(name):
    for seed in range(CASES):
        chance = random.Random(seed)
        events = stream(chance, name == "change")
        gone = chance.choice(events)[0]
        last = max(at for at, (term, _) in enumerate(events) if term == gone)
        at = chance.randint(last + 1, len(events))
        taken_back = [*events[:at], (f"rev({gone})", events[at - 1][1]), *events[at:]]
        left = [event for event in events if event[0] != gone]
        assert standing(RULES[name], taken_back) == standing(RULES[name], left), (seed, taken_back)


def test_what_is_joined_further_up_goes_with_it():
    found = standing(RULES["joined"], [("t(a,1)", 10), ("t(a,2)", 11)])
    assert found == {"out(a,1)": 1}
    assert not standing(RULES["joined"], [("t(a,1)", 10), ("rev(t(a,1))", 10)])


def test_long_streams_are_settled_and_go_on(monkeypatch):
    monkeypatch.setattr(stream_node, "MAX_REPLAYED_ELEMENTS", 5)
    events = [(f"t(a,{number})", 10 + number) for number in range(30)]
    for name in ("last", "newest", "batch", "every", "hopping", "running"):
        taken_back = [*events, ("rev(t(a,28))", 40)]
        left = [event for event in events if event[0] != "t(a,28)"]
        assert standing(RULES[name], taken_back) == standing(RULES[name], left), name


def test_results_of_long_windows_name_no_more_than_a_hundred():
    engine = Engine()
    engine.load(
        goals="set_etalis_flag(etalis_justification,on).",
        rules=f"out(N) <- aggregate(count, t, N, last({10**6})).",
    )
    for number in range(300):
        engine.event("t", number + 1)
    known = [
        one for one in engine.rules.tracker.remembered_events() if engine.show(one.term).startswith("out")
    ]
    assert len(known) == 300 and max(len(one.sources()) for one in known) == 100
