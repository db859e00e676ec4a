"""Gaps in memories: widths, refused interpolations, and reports."""

from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, Reports, Settings, StreamClock
from retalis.events.knowledge.memory_interpolation import MAX_NOTED_GAPS
from retalis.prolog.terms.timestamps import SECOND

BETWEEN = """
between(Id, Sec, NSec, W) :-
    convert_to_datime([Sec, NSec], T),
    prev(Id, _, T1, _, T), next_inf(Id, _, T2, _, T), datime_interpolate(T1, T2, T, W).
gap(Id, Sec, NSec, G) :- convert_to_datime([Sec, NSec], T), memory_gap(Id, T, G).
"""


def engine_with(*timestamps: Any, settings: Any = None, size: int = 100, memories: Any = ("m",)) -> Engine:
    """Return an engine whose memories have a record at each timestamp in milliseconds."""
    engine = Engine(StreamClock(1000 * SECOND), settings, Reports())
    engine.load(rules=BETWEEN)
    for name in memories:
        engine.call(f"memorize(v(_), [], _, {name}, {size})")
    for timestamp in timestamps:
        engine.event("v(1)", timestamp / 1000)
    return engine


def weights(engine: Engine, milliseconds: int, name: str = "m") -> List[Any]:
    seconds, remainder = divmod(milliseconds, 1000)
    return [answer["W"] for answer in engine.query(f"between({name}, {seconds}, {remainder * 10**6}, W)")]


REGULAR_TIMESTAMPS = tuple(range(1000, 2000, 100))
TIMESTAMPS_WITH_GAP = (*REGULAR_TIMESTAMPS, 4000, 4100)


@pytest.mark.parametrize("max_gap", ["2.0", "0.15", "0.1"])
def test_wide_gap_has_no_interpolation(max_gap: str) -> None:
    engine = engine_with(*TIMESTAMPS_WITH_GAP)
    assert engine.call(f"set_etalis_flag(max_gap, {max_gap})")
    assert weights(engine, 1250) == [0.5]
    assert weights(engine, 3000) == []
    assert weights(engine, 4000) == [1]
    assert engine.reports.warnings == 0


def test_gap_of_maximum_width_is_interpolated() -> None:
    engine = engine_with(1000, 1500)
    assert engine.call("set_etalis_flag(max_gap, 0.5)")
    assert weights(engine, 1125) == [0.75]
    assert engine.call("set_etalis_flag(max_gap, 0.499999)")
    assert weights(engine, 1125) == []


def test_timestamps_may_be_in_either_order() -> None:
    engine = engine_with()
    late, early = "datime(2001,1,1,0,0,4,0)", "datime(2001,1,1,0,0,0,0)"
    for goal in (
        f"datime_interpolate({late}, {early}, {early}, _)",
        f"datime_interpolate({early}, {late}, {late}, _)",
    ):
        assert engine.call(goal)
        assert engine.call("set_etalis_flag(max_gap, 3)")
        assert not engine.call(goal)
        assert engine.call("set_etalis_flag(max_gap, 4)")


@pytest.mark.parametrize("max_gap", [-1, 0, "1.0e300"])
def test_unlimited_gap_is_interpolated(max_gap: Any) -> None:
    engine = engine_with(0, 10**9)
    assert engine.call("set_etalis_flag(max_gap, 1)")
    assert weights(engine, 5 * 10**8) == []
    assert engine.call(f"set_etalis_flag(max_gap, {max_gap})")
    assert weights(engine, 5 * 10**8) == [0.5]


def test_reset_restores_setting_of_gap() -> None:
    engine = engine_with(settings=Settings(max_gap=0.5))
    assert engine.query("get_etalis_flag(max_gap, M)") == [{"M": 0.5}]
    assert engine.call("set_etalis_flag(max_gap, 3)")
    assert engine.call("reset_etalis")
    assert engine.query("get_etalis_flag(max_gap, M)") == [{"M": 0.5}]
    assert not engine.call("datime_interpolate(1.0, 2.0, 1.0, _)")


def test_unusual_gap_is_reported_once_for_memory(caplog: pytest.LogCaptureFixture) -> None:
    engine = engine_with(*TIMESTAMPS_WITH_GAP, memories=("m", "n(1)"))
    for instant in (3000, 3100, 3200):
        assert weights(engine, instant)
        assert weights(engine, instant, "n(1)")
    texts = [record.message for record in caplog.records]
    assert [text.split(":")[0] for text in texts] == ["memory m", "memory n(1)"]
    assert "over a gap of 2.1 s; its records are usually 0.1 s apart" in texts[0]
    assert engine.reports.warnings == 6


def test_gap_of_several_lookups_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = engine_with(*TIMESTAMPS_WITH_GAP, memories=("m", "n"))
    goal = (
        "convert_to_datime([3,0], T), next_inf(m, _, _, _, T), next_inf(n, _, T2, _, T), prev(n, _, T1, _, T), "
        "datime_interpolate(T1, T2, T, _)"
    )
    assert engine.call(goal)
    assert [record.message.split(":")[0] for record in caplog.records] == ["memory m", "memory n"]


@pytest.mark.parametrize(
    "timestamps",
    [
        REGULAR_TIMESTAMPS,
        (*REGULAR_TIMESTAMPS, 2850),  # 9.5 times
        (1000, 1100, 1200, 1300, 1400, 5400),  # too few records for a usual gap
        tuple(
            timestamp for timestamp in (*REGULAR_TIMESTAMPS, 2700) for _ in range(10)
        ),  # of several publishers at once
    ],
)
def test_usual_gap_is_not_reported(timestamps: Any) -> None:
    engine = engine_with(*timestamps, size=200)
    for instant in range(1050, max(timestamps), 100):
        assert weights(engine, instant)
    assert engine.reports.warnings == 0


def test_lookup_without_interpolation_reports_no_gap() -> None:
    engine = engine_with(*TIMESTAMPS_WITH_GAP)
    assert engine.call("next_inf(m, _, _, _, 3.0)")
    assert engine.call("memory_gap(m, 3.0, _)")
    assert weights(engine, 1250) == [0.5]
    assert engine.reports.warnings == 0


@pytest.mark.slow
def test_stored_gaps_are_limited() -> None:
    engine = engine_with(size=10_000)
    for start in range(MAX_NOTED_GAPS * 3):
        for step in range(100):
            engine.event("v(1)", start * 10 + step / 1000)
    for start in range(MAX_NOTED_GAPS * 3 - 1):
        assert engine.call(f"next_inf(m, _, _, _, {start * 10 + 5}.0)")
    gaps = engine.knowledge.gaps.noted_gaps
    assert len(gaps) == MAX_NOTED_GAPS
    assert weights(engine, 1_905_000) == [pytest.approx(0.505, abs=0.01)]
    engine.knowledge.clear()
    assert gaps == {}


@pytest.mark.slow
@given(st.lists(st.integers(0, 40), max_size=20), st.integers(0, 40))
def test_memory_gap_is_distance_of_neighbours(timestamps: List[Any], instant: int) -> None:
    engine = engine_with(*timestamps)
    before = [timestamp for timestamp in timestamps if timestamp <= instant]
    after = [timestamp for timestamp in timestamps if timestamp >= instant]
    expected = [(min(after) - max(before)) / 1000] if before and after else []
    assert [answer["G"] for answer in engine.query(f"gap(m, 0, {instant * 10**6}, G)")] == expected
    assert engine.query(f"gap(other, 0, {instant * 10**6}, G)") == []
