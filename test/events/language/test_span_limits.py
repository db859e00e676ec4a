"""Spans of windows, rate operators, absence and ``within``."""

from typing import Any, List

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
    "aggregate(count, a(_), N, session({}))",
    "aggregate(last(X), a(X), N, held(last({})))",
    "a(N) with not_preceded(b, {})",
)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_state_with_longest_span_is_restored(pattern: str) -> None:
    engine = Engine(StreamClock())
    engine.load(f"w(N) <- {pattern.replace('{}', str(LONGEST_SECONDS))}.")
    engine.event("a(1)", 1)
    engine.event("a(2)", 2)
    restored = Engine.restore(engine.snapshot())
    assert events_after_third(restored) == events_after_third(engine)


def events_after_third(engine: Engine) -> List[Any]:
    """Return the events that a third event causes, with their intervals."""
    events: List[Any] = []
    engine.on_event(lambda *event: events.append(event))
    engine.event("a(3)", 3)
    return events


@pytest.mark.parametrize("pattern", PATTERNS)
def test_longer_span_is_an_error(pattern: str) -> None:
    with pytest.raises(ProgramErrors, match=r"needs at most 6\.0e\+14 seconds"):
        Engine().load(f"w(N) <- {pattern.replace('{}', str(LONGEST_SECONDS + 1))}.")


@pytest.mark.parametrize("pattern", [*PATTERNS, "a(N) seq absent(b, {})", "(a(N) seq b) within {}"])
def test_span_below_one_nanosecond_is_an_error(pattern: str) -> None:
    with pytest.raises(ProgramErrors, match="needs a positive number of seconds"):
        Engine().load(f"w(N) <- {pattern.replace('{}', '1.0e-12')}.")
