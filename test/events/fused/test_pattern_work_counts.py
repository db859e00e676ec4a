"""Equal counts of pattern work by fused and plain nodes, so that limits apply equally."""

from typing import Any, List

import pytest
from events.fused.fused_path_plugin import PATHS

from retalis import Engine, Limits, Settings

RULES = {
    "windows": "o(K, N, A) <- aggregate([count, avg(X)], e(K, X), [N, A], last(10)).",
    "questions": "syncronized(done(K, X), true, []) <- e(K, X).",
    "sides": "o(K) <- (e(K, X) seq f(K, Y)) within 10. f(K, X) <- e(K, X).",
    "goals": "o(K) do atom_length(K, X) <- e(K, X).",
}


def steps_per_event(rules: Any) -> Any:
    """Return the number of pattern steps of each of eight events."""
    engine = Engine(settings=Settings(limits=Limits(inferences=1_000_000)))
    engine.load(rules=rules)
    budget = engine.logic.machine.budget
    counts: List[Any] = []
    for number in range(8):
        steps_before = budget.pattern_steps[0]
        engine.event(f"e({number % 2}, {number}.5)", number)
        counts.append(steps_before - budget.pattern_steps[0])
    return counts


@pytest.mark.parametrize("path", RULES)
def test_fused_path_counts_steps_of_plain_nodes(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fused = steps_per_event(RULES[path])
    monkeypatch.setattr(*PATHS[path])
    assert fused == steps_per_event(RULES[path])
