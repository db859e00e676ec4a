"""Equal counts of pattern work by fused and plain nodes, so that limits apply equally."""

import pytest
from events.fused.fused_path_plugin import PATHS

from retalis import Engine, Limits, Settings

RULES = {
    "windows": "o(K, N, A) <- aggregate([count, avg(X)], e(K, X), [N, A], last(10)).",
    "questions": "syncronized(done(K, X), true, []) <- e(K, X).",
    "sides": "o(K) <- (e(K, X) seq f(K, Y)) within 10. f(K, X) <- e(K, X).",
    "goals": "o(K) do atom_length(K, X) <- e(K, X).",
}


def steps(rules):
    """Return the steps of pattern work that each of some events takes."""
    engine = Engine(settings=Settings(limits=Limits(inferences=1_000_000)))
    engine.load(rules=rules)
    budget = engine.logic.machine.budget
    found = []
    for at in range(8):
        before = budget.pattern_steps[0]
        engine.event(f"e({at % 2}, {at}.5)", at)
        found.append(before - budget.pattern_steps[0])
    return found


@pytest.mark.parametrize("path", RULES)
def test_a_fused_path_counts_what_the_plain_way_counts(path, monkeypatch):
    fused = steps(RULES[path])
    monkeypatch.setattr(*PATHS[path])
    assert fused == steps(RULES[path])
