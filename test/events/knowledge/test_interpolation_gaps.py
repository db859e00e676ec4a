"""Gaps in memories: widths, refused interpolations, and reports."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, Reports, Settings, StreamClock
from retalis.events.knowledge.memory_gaps_and_pose_chains import MAX_NOTED_GAPS
from retalis.prolog.terms.timestamps import SECOND

BETWEEN = """
between(Id, Sec, NSec, W) :-
    convert_to_datime([Sec, NSec], T),
    prev(Id, _, T1, _, T), next_inf(Id, _, T2, _, T), datime_interpolate(T1, T2, T, W).
gap(Id, Sec, NSec, G) :- convert_to_datime([Sec, NSec], T), memory_gap(Id, T, G).
"""


def engine_with(*stamps, settings=None, size=100, memories=("m",)):
    """Return an engine whose memories have a record at each of some stamps in milliseconds."""
    engine = Engine(StreamClock(1000 * SECOND), settings, Reports())
    engine.load(rules=BETWEEN)
    for name in memories:
        engine.call(f"memorize(v(_), [], _, {name}, {size})")
    for stamp in stamps:
        engine.event("v(1)", stamp / 1000)
    return engine


def weights(engine, milliseconds, name="m"):
    seconds, rest = divmod(milliseconds, 1000)
    return [found["W"] for found in engine.query(f"between({name}, {seconds}, {rest * 10**6}, W)")]


STEADY = tuple(range(1000, 2000, 100))
HOLE = (*STEADY, 4000, 4100)


@pytest.mark.parametrize("most", ["2.0", "0.15", "0.1"])
def test_no_value_over_a_gap_that_is_too_wide(most):
    engine = engine_with(*HOLE)
    assert engine.call(f"set_etalis_flag(max_gap, {most})")
    assert weights(engine, 1250) == [0.5]
    assert weights(engine, 3000) == []
    assert weights(engine, 4000) == [1]
    assert engine.reports.warnings == 0


def test_a_gap_as_wide_as_is_allowed():
    engine = engine_with(1000, 1500)
    assert engine.call("set_etalis_flag(max_gap, 0.5)")
    assert weights(engine, 1125) == [0.75]
    assert engine.call("set_etalis_flag(max_gap, 0.499999)")
    assert weights(engine, 1125) == []


def test_stamps_in_either_order():
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


@pytest.mark.parametrize("most", [-1, 0, "1.0e300"])
def test_any_gap(most):
    engine = engine_with(0, 10**9)
    assert engine.call("set_etalis_flag(max_gap, 1)")
    assert weights(engine, 5 * 10**8) == []
    assert engine.call(f"set_etalis_flag(max_gap, {most})")
    assert weights(engine, 5 * 10**8) == [0.5]


def test_what_the_engine_was_set_up_with_comes_back():
    engine = engine_with(settings=Settings(max_gap=0.5))
    assert engine.query("get_etalis_flag(max_gap, M)") == [{"M": 0.5}]
    assert engine.call("set_etalis_flag(max_gap, 3)")
    assert engine.call("reset_etalis")
    assert engine.query("get_etalis_flag(max_gap, M)") == [{"M": 0.5}]
    assert not engine.call("datime_interpolate(1.0, 2.0, 1.0, _)")


def test_an_unusual_gap_is_told_of_once_for_each_memory(caplog):
    engine = engine_with(*HOLE, memories=("m", "n(1)"))
    for instant in (3000, 3100, 3200):
        assert weights(engine, instant)
        assert weights(engine, instant, "n(1)")
    texts = [record.message for record in caplog.records]
    assert [text.split(":")[0] for text in texts] == ["memory m", "memory n(1)"]
    assert "over a gap of 2.1 s; its records are usually 0.1 s apart" in texts[0]
    assert engine.reports.warnings == 6


def test_several_look_ups_of_one_gap_before_the_first_interpolation(caplog):
    engine = engine_with(*HOLE, memories=("m", "n"))
    goal = (
        "convert_to_datime([3,0], T), next_inf(m, _, _, _, T), next_inf(n, _, T2, _, T), prev(n, _, T1, _, T), "
        "datime_interpolate(T1, T2, T, _)"
    )
    assert engine.call(goal)
    assert [record.message.split(":")[0] for record in caplog.records] == ["memory m", "memory n"]


@pytest.mark.parametrize(
    "stamps",
    [
        STEADY,
        (*STEADY, 2850),  # 9.5 times
        (1000, 1100, 1200, 1300, 1400, 5400),  # too few to know what is usual
        tuple(stamp for stamp in (*STEADY, 2700) for _ in range(10)),  # of several publishers at once
    ],
)
def test_a_usual_gap_is_not(stamps):
    engine = engine_with(*stamps, size=200)
    for instant in range(1050, max(stamps), 100):
        assert weights(engine, instant)
    assert engine.reports.warnings == 0


def test_nobody_is_told_of_a_gap_that_is_only_looked_up():
    engine = engine_with(*HOLE)
    assert engine.call("next_inf(m, _, _, _, 3.0)")
    assert engine.call("memory_gap(m, 3.0, _)")
    assert weights(engine, 1250) == [0.5]
    assert engine.reports.warnings == 0


@pytest.mark.slow
def test_what_is_noted_is_bounded():
    engine = engine_with(size=10_000)
    for start in range(MAX_NOTED_GAPS * 3):
        for step in range(100):
            engine.event("v(1)", start * 10 + step / 1000)
    for start in range(MAX_NOTED_GAPS * 3 - 1):
        assert engine.call(f"next_inf(m, _, _, _, {start * 10 + 5}.0)")
    noted = engine.knowledge.gaps.noted_gaps
    assert len(noted) == MAX_NOTED_GAPS
    assert weights(engine, 1_905_000) == [pytest.approx(0.505, abs=0.01)]
    engine.knowledge.clear()
    assert noted == {}


@pytest.mark.slow
@given(st.lists(st.integers(0, 40), max_size=20), st.integers(0, 40))
def test_memory_gap_is_the_distance_of_its_neighbours(stamps, at):
    engine = engine_with(*stamps)
    before = [stamp for stamp in stamps if stamp <= at]
    after = [stamp for stamp in stamps if stamp >= at]
    expected = [(min(after) - max(before)) / 1000] if before and after else []
    assert [found["G"] for found in engine.query(f"gap(m, 0, {at * 10**6}, G)")] == expected
    assert engine.query(f"gap(other, 0, {at * 10**6}, G)") == []
