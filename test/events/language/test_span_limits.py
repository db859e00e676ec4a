"""Spans of windows and rate operators."""

import pytest

from retalis import Engine, ProgramErrors, StreamClock

LONGEST_SECONDS = (1 << 79) // 10**9
"""The longest span, that of the largest timestamp."""

PATTERNS = (
    "aggregate(count, a(_), N, last({}))",
    "aggregate(count, a(_), N, every({}))",
    "aggregate(count, a(_), N, every({}, first))",
    "aggregate(count, a(_), N, last({}, every({})))",
    "a(N) with debounce({})",
    "a(N) with throttle({})",
)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_state_with_longest_span_is_restored(pattern: str) -> None:
    engine = Engine(StreamClock())
    engine.load(f"w(N) <- {pattern.replace('{}', str(LONGEST_SECONDS))}.")
    engine.event("a(1)", 1)
    engine.event("a(2)", 2)
    assert Engine.restore(engine.snapshot()).snapshot()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_longer_span_is_an_error(pattern: str) -> None:
    with pytest.raises(ProgramErrors, match=r"needs at most 6\.0e\+14 seconds"):
        Engine().load(f"w(N) <- {pattern.replace('{}', str(1 << 70))}.")
