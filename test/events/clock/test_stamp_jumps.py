"""Steps of timestamps ahead: which the clock follows, and from which it returns."""

from typing import Any, List

import pytest

from retalis.events.clock.stamp_jumps import StampJumps
from retalis.prolog.terms.timestamps import SECOND

HOUR = 3600
YEAR = 365 * 86_400


def times_after(stamps: Any, jumps: Any = None) -> Any:
    """Return the time of a clock after each timestamp or pair of name and timestamp, in seconds."""
    jumps = StampJumps() if jumps is None else jumps
    time, times = 0, []
    for stamp in stamps:
        source, second = stamp if isinstance(stamp, tuple) else ("a", stamp)
        _, time = jumps.check(second * SECOND, time, source)
        times.append(time // SECOND)
    return times


@pytest.mark.parametrize(
    ("stamps", "times"),
    [
        ([1, 5, 4, 14, 24], [1, 5, 5, 14, 24]),
        # One wrong stamp, in the middle and at the beginning.
        ([1, 9, 12, HOUR, 13, 14, 15, 16], [1, 9, 12, HOUR, HOUR, HOUR, 15, 16]),
        ([HOUR, 1, 2, 3, 4], [HOUR, HOUR, HOUR, 3, 4]),
        # A pause, and an event that is late after it.
        ([1, 9, 12, HOUR, 11, HOUR + 1, HOUR + 2], [1, 9, 12, HOUR, HOUR, HOUR + 1, HOUR + 2]),
        # Two wrong stamps with different errors.
        ([1, HOUR, 2 * HOUR, 2, 3, 4], [1, HOUR, 2 * HOUR, 2 * HOUR, 2 * HOUR, 4]),
        # A wrong stamp soon after a pause.
        (
            [1, HOUR, HOUR + 5, 3 * HOUR, HOUR + 6, HOUR + 7, HOUR + 8],
            [1, HOUR, HOUR + 5, 3 * HOUR, 3 * HOUR, 3 * HOUR, HOUR + 8],
        ),
        # Rare events: each step is longer than all before.
        ([1, HOUR, 2 * HOUR, 3 * HOUR, 4 * HOUR], [1, HOUR, 2 * HOUR, 3 * HOUR, 4 * HOUR]),
        # After ten seconds, events with the time before a step are late.
        ([1, HOUR, HOUR + 8, HOUR + 11, 2, 3, 4, 5], [1, HOUR, HOUR + 8] + [HOUR + 11] * 5),
    ],
)
def test_clock_follows_or_returns(stamps: List[int], times: Any) -> None:
    assert times_after(stamps) == times


def test_only_stamp_years_ahead_moves_clock() -> None:
    assert times_after([1, YEAR, 2, YEAR + 1, 3]) == [1, 1, 2, 2, 3]
    steady = [YEAR + second for second in range(0, 16, 5)]
    assert times_after([1, *steady]) == [1, 1, 1, 1, YEAR + 15]


def test_suspect_does_not_move_clock_and_others_do() -> None:
    jumps = StampJumps()
    wrong = [("bad", HOUR + second) for second in range(10, 60, 10)]
    right = [("good", second) for second in range(11, 61, 10)]
    mixed = [event for pair in zip(wrong, right) for event in pair]
    times = times_after([("good", 1), ("good", 5), *mixed], jumps)
    assert times[-1] == 51
    assert jumps.sources == ["bad"]


def test_suspicion_ends_after_ten_minutes() -> None:
    stamps = [("a", 1), ("b", HOUR), ("a", 2), ("a", 3), ("a", 4)]
    stamps += [("a", second) for second in range(10, 620, 10)]
    assert times_after([*stamps, ("b", 2 * HOUR)])[-1] == 2 * HOUR
    assert times_after([*stamps[:30], ("b", 2 * HOUR)])[-1] < HOUR


@pytest.mark.parametrize("stop", range(8))
def test_restored_checks_have_same_decisions(stop: int) -> None:
    stamps = [1, HOUR, ("b", HOUR + 1), 2, ("b", YEAR), 3, 4, ("b", HOUR)]
    expected = times_after(stamps)
    jumps = StampJumps()
    times = times_after(stamps[:stop], jumps)
    restored = StampJumps()
    restored.restore(jumps.snapshot())
    time = times[-1] * SECOND if times else 0
    for stamp in stamps[stop:]:
        source, second = stamp if isinstance(stamp, tuple) else ("a", stamp)
        _, time = restored.check(second * SECOND, time, source)
        times.append(time // SECOND)
    assert times == expected
