"""Lookup of matching records."""

import random
from typing import Any, List, Optional

import pytest
from recording_engine import RecordingEngine

from retalis import Limits, PrologError, atom, deref, functor


def memory_of(engine: Any) -> Any:
    return engine.knowledge.memories.find(atom("m")).memory


@pytest.fixture
def objects() -> RecordingEngine:
    engine = RecordingEngine(goals="memorize(seen(Name, Place), [], o(Name, Place), objects, 5)")
    for time, name in ((1, "cup"), (2, "cup"), (3, "cup"), (4, "pen"), (5, "pen"), (6, "box"), (7, "pen")):
        engine.event(f"seen({name}, p({time}))", time)
    return engine  # the records of 1 s and 2 s exceed the size


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("prev(objects, o(cup, _), _, T, 9)", None),
        ("prev_matching(objects, o(cup, _), _, T, 9)", 3),
        ("prev_matching(objects, o(cup, _), _, T, 3)", 3),
        ("prev_matching(objects, o(cup, _), _, T, 2.9)", None),
        ("prev_matching(objects, o(cup, _), _, T, [3,0])", 3),
        ("prev_matching(objects, o(pen, _), _, T, datime(1970,1,1,0,0,6,0))", 5),
        ("prev_matching(objects, o(pen, p(4)), _, T, 9)", 4),
        ("prev_matching(objects, o(pen, p(1)), _, T, 9)", None),
        ("prev_matching(objects, o(pen, _), 4, T, 9)", 4),
        ("prev_matching(objects, _, _, T, 6)", 6),
        ("prev_matching(objects, o(_), _, T, 9)", None),
        ("prev_matching(objects, o, _, T, 9)", None),
        ("newest_matching(objects, o(cup, _), _, T)", 3),
        ("newest_matching(objects, o(_, p(4)), _, T)", 4),
        ("newest_matching(objects, o(book, _), _, T)", None),
        ("next_inf_matching(objects, o(pen, _), _, T, 0)", 4),
        ("next_inf_matching(objects, o(pen, _), _, T, 5.5)", 7),
        ("next_inf_matching(objects, o(cup, _), _, T, 4)", None),
        ("next_matching(objects, o(box, _), _, T, 4, 6)", 6),
        ("next_matching(objects, o(box, _), _, T, 4, 5)", None),
        ("next_matching(objects, o(box, _), _, T, 7, 4)", None),
        ("newest_matching(nothing, o(cup, _), _, T)", None),
        ("prev_matching(nothing, o(cup, _), _, T, 1)", None),
        ("next_inf_matching(nothing, o(cup, _), _, T, 1)", None),
        ("next_matching(nothing, o(cup, _), _, T, 1, 2)", None),
    ],
)
def test_lookup_returns_matching_record(objects: RecordingEngine, goal: str, expected: Optional[int]) -> None:
    assert [deref(answer["T"]) for answer in objects.query(goal)] == ([] if expected is None else [expected])


@pytest.mark.parametrize("instant", ["_", "foo", "[a,0]"])
def test_invalid_timestamp_is_refused(objects: RecordingEngine, instant: str) -> None:
    for goal in (
        f"prev_matching(objects, _, _, _, {instant})",
        f"next_matching(nothing, _, _, _, 1, {instant})",
    ):
        with pytest.raises(PrologError):
            objects.query(goal)


def test_lookup_has_one_solution() -> None:
    engine = RecordingEngine(goals="memorize(v(_, _), [], _, m, 9)")
    engine.event("v(X, X)", 1)
    engine.event("v(1, 2)", 2)
    engine.event("v(3, _)", 3)
    assert [engine.show(answer["A"]) for answer in engine.query("newest_matching(m, v(A, A), _, _)")] == ["3"]
    assert engine.query("newest_matching(m, v(B, B), _, 1), B = x, newest_matching(m, v(y, y), _, 1)") != []
    assert engine.query("newest_matching(m, v(1, A), _, _), A == 2") != []


def linear_search(records: Any, name: Any, low: int, high: int, newest_first: bool) -> Any:
    order = reversed(records) if newest_first else records
    return next(
        (time for time, record_name in order if low <= time <= high and name in (record_name, "_")), None
    )


@pytest.mark.parametrize("seed", range(6))
def test_lookup_equals_linear_search(seed: int) -> None:
    generator = random.Random(seed)
    size = generator.choice([1, 3, 20, 60])
    engine = RecordingEngine(goals=f"memorize(v(_, _), [], _, m, {size})")
    names = ["a", "b", "1", "1.0", '"a"', "f(a)"]
    records: List[Any] = []
    for step in range(150):
        name, time = generator.choice(names), step if generator.random() < 0.9 else generator.randint(0, step)
        engine.event(f"v(x, {name})", time)
        position = next((number for number, (end, _) in enumerate(records) if end > time), len(records))
        if position or len(records) < size or not records:
            records.insert(position, (time, name))
            records = records[-size:]
        if step % 3:
            continue
        name_pattern, low, high = (
            generator.choice([*names, "_"]),
            generator.randint(0, step),
            generator.randint(0, step + 1),
        )
        pattern = f"v({generator.choice('x_')}, {name_pattern})"
        for goal, expected in (
            (f"newest_matching(m, {pattern}, _, T)", linear_search(records, name_pattern, 0, 999, True)),
            (
                f"prev_matching(m, {pattern}, _, T, {high})",
                linear_search(records, name_pattern, 0, high, True),
            ),
            (
                f"next_inf_matching(m, {pattern}, _, T, {low})",
                linear_search(records, name_pattern, low, 999, False),
            ),
            (
                f"next_matching(m, {pattern}, _, T, {low}, {high})",
                linear_search(records, name_pattern, low, high, False),
            ),
        ):
            assert [deref(answer["T"]) for answer in engine.query(goal)] == (
                [] if expected is None else [expected]
            )


def test_bound_argument_is_indexed() -> None:
    engine = RecordingEngine(goals="memorize(v(_, _), [], _, m, 900)")
    for time in range(400):
        engine.event(f"v({'rare' if time == 7 else 'often'}, {time})", time)
    memory = memory_of(engine)
    assert engine.query("newest_matching(m, v(rare, 7), _, _)") != []
    positions: List[Any] = []

    class RecordingList(list):
        def __getitem__(self, position: Any) -> Any:
            positions.append(position)
            return super().__getitem__(position)

    memory.records = RecordingList(memory.records)
    assert engine.query("newest_matching(m, v(rare, _), _, _)") != []
    assert engine.query("newest_matching(m, v(never, _), _, _)") == []
    assert positions == [7]


def test_search_counts_for_inference_limit() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3000)")
    engine.logic.limits = Limits(inferences=2000)
    term = functor("v", 1)(functor("f", 1)(0))
    for time in range(3000):
        memory_of(engine).add((term, time, time))
    with pytest.raises(PrologError):
        engine.query("newest_matching(m, v(f(1)), _, _)")


def test_index_is_dropped_with_compacted_records() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 3)")
    memory = memory_of(engine)
    dropped_count = 0
    for time in range(100):
        records_before = memory.records
        engine.event(f"v(a{time})", time)
        dropped_count += memory.records is not records_before and not memory.indices
        assert engine.query(f"newest_matching(m, v(a{time}), _, _)") != []
        assert set(memory.indices) == {1}
    assert dropped_count > 3
    memory.clear()
    assert memory.indices == {}


def test_indexed_lookup_is_within_inference_limit() -> None:
    engine = RecordingEngine(goals="memorize(v(_), [], _, m, 5000)")
    for time in range(5000):
        memory_of(engine).add((functor("v", 1)(time), time, time))
    engine.logic.limits = Limits(inferences=10_000)
    assert engine.query("newest_matching(m, v(7), _, _)") != []
