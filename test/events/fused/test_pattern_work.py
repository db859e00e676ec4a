"""Fused paths count the same pattern work as the plain way, so that limits end both alike."""

import pytest
from events.fused.switching import plain_action

from retalis.engine import Engine, Settings, parts_of
from retalis.events.knowledge import waiting
from retalis.events.network import conditions, joining, streaming
from retalis.prolog.machine import Limits

OFF = {
    "window": (streaming, "fused_window", lambda window, limit, node, plain, *rest: plain),
    "question": (waiting, "question_action", lambda *arguments: None),
    "side": (
        joining,
        "fused_side",
        lambda side, pair, choice, rule, plain, emit: (plain_action(plain), None),
    ),
    "goal": (conditions, "goal_action", lambda goal, inputs, rule, failed, plain, done: plain_action(plain)),
}
RULES = {
    "window": "o(K, N, A) <- aggregate([count, avg(X)], e(K, X), [N, A], last(10)).",
    "question": "syncronized(done(K, X), true, []) <- e(K, X).",
    "side": "o(K) <- (e(K, X) seq f(K, Y)) within 10. f(K, X) <- e(K, X).",
    "goal": "o(K) do atom_length(K, X) <- e(K, X).",
}


def steps(rules):
    """Return the steps of pattern work that each of some events takes."""
    engine = Engine(settings=Settings(limits=Limits(inferences=1_000_000)))
    engine.load(rules=rules)
    budget = parts_of(engine).logic.machine.budget
    found = []
    for at in range(8):
        before = budget.pattern_steps[0]
        engine.event(f"e({at % 2}, {at}.5)", at)
        found.append(before - budget.pattern_steps[0])
    return found


@pytest.mark.parametrize("path", OFF)
def test_a_fused_path_counts_what_the_plain_way_counts(path, monkeypatch):
    fused = steps(RULES[path])
    monkeypatch.setattr(*OFF[path])
    assert fused == steps(RULES[path])
