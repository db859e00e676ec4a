"""Memories, compared with a sorted list."""

from typing import Any, List, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import atom
from retalis.events.knowledge.memory import NO_POSITION, Memory

ENDS = st.lists(st.integers(0, 30), max_size=60)


class Model:
    """A sorted list of the newest records, with linear insertion."""

    def __init__(self, size: Any) -> None:
        self.size = size
        self.records: List[Any] = []

    def add(self, name: Any, end: Any) -> bool:
        if self.size and len(self.records) == self.size and end < self.records[0][1]:
            return False
        position = sum(1 for _, other in self.records if other <= end)
        self.records.insert(position, (name, end))
        del self.records[: max(0, len(self.records) - self.size)]
        return True


def memory_and_model(size: Any, ends: Any) -> Tuple[Any, ...]:
    memory, model = Memory(size), Model(size)
    for name, end in enumerate(ends):
        assert memory.add((name, end - 1, end)) == model.add(name, end)
    return memory, model


@given(st.integers(0, 8), ENDS)
def test_newest_records_are_kept_in_order_of_ends(size: int, ends: Any) -> None:
    memory, model = memory_and_model(size, ends)
    assert [(term, end) for term, _, end in memory.newest_first()] == model.records[::-1]
    assert len(memory) == len(model.records)


@given(st.integers(0, 8), ENDS, st.integers(-1, 31))
def test_lookups_by_time_equal_linear_search(size: int, ends: Any, instant: int) -> None:
    memory, model = memory_and_model(size, ends)
    before = [name for name, end in model.records if end <= instant]
    after = [name for name, end in model.records if end >= instant]
    record = memory.at_or_before(instant)
    assert (record and record[0]) == (before[-1] if before else None)
    record = memory.at_or_after(instant)
    assert (record and record[0]) == (after[0] if after else None)
    around = memory.around(instant)
    assert (around and [record[0] for record in around]) == (
        [before[-1], after[0]] if before and after else None
    )


def test_latest_end_is_known_without_records() -> None:
    memory = Memory(0)
    assert memory.latest_end is None
    assert memory.add((atom("a"), 1, 5))
    assert memory.add((atom("b"), 1, 3))
    assert memory.latest_end == 5
    assert len(memory) == 0


def test_added_and_late_records_are_counted() -> None:
    memory = Memory(2)
    for end in (10, 20, 5):
        memory.add((atom("x"), end, end))
    assert (memory.added_count, memory.late_count) == (2, 1)


def test_reader_ignores_later_records() -> None:
    memory = Memory(3)
    for end in range(3):
        memory.add((end, end, end))
    reader = memory.newest_first()
    assert next(reader)[0] == 2
    for end in (1, 5, 6, 7):
        memory.add((atom("late"), end, end))
    assert [term for term, _, _ in reader] == [1, 0]


def test_memory_stores_little_more_than_its_size() -> None:
    memory = Memory(10)
    for end in range(1000):
        memory.add((end, end, end))
    assert len(memory.records) <= 10 + 2 + 16
    assert [term for term, _, _ in memory.newest_first()] == list(range(999, 989, -1))


def test_clear_removes_records() -> None:
    memory = Memory(3)
    memory.add((atom("x"), 1, 1))
    memory.clear()
    assert len(memory) == 0
    assert memory.latest_end is None
    assert memory.at_or_before(99) is None


def test_wide_gaps_are_reported() -> None:
    gaps: List[Any] = []
    memory = Memory(100, lambda start, end: gaps.append((start, end)))
    for end in [*range(1000, 2000, 100), 4000, 4100]:
        memory.add((end, end, end))
    for look_up in (memory.around, memory.at_or_after):
        del gaps[:]
        for instant in (1150, 1850, 3000, 4050):
            look_up(instant)
        assert gaps == [(1900, 4000)]


@pytest.mark.parametrize("gap", [90, 99, 100, 110])
@pytest.mark.parametrize("steps_before", [1, 3])
def test_gap_is_wide_from_ten_times_the_mean(gap: int, steps_before: int) -> None:
    widths: List[Any] = []
    memory, end = Memory(100, lambda start, end: widths.append(end - start)), 0
    for step in [10] * steps_before + [gap] + [10] * 4:
        end += step
        memory.add((end, end, end))
    start = 10 * steps_before
    for look_up in (memory.around, memory.at_or_after):
        del widths[:]
        assert look_up(start + 5)
        assert widths == ([gap] if gap >= 100 else [])
    del widths[:]
    assert memory.around(start)
    assert memory.at_or_after(start)
    assert memory.at_or_after(start + gap + 1)
    assert widths == []


@given(st.integers(0, 8), ENDS, st.integers(-1, 31), st.integers(0, 61))
def test_positions_of_records(size: int, ends: Any, instant: int, sequence_number: int) -> None:
    memory, model = memory_and_model(size, ends)
    records = memory.records

    def names_of_records(matches: Any) -> List[Any]:
        return [name for name, end in model.records if matches(end)]

    assert [name for name, _, _ in records[memory.first_position :]] == names_of_records(lambda end: True)
    assert [
        name for name, _, _ in records[memory.first_position : memory.position_after(instant)]
    ] == names_of_records(lambda end: end <= instant)
    assert [name for name, _, _ in records[memory.position_reaching(instant) :]] == names_of_records(
        lambda end: end >= instant
    )
    stored_count = min(memory.added_count, max(size, 1))
    assert memory.oldest_number == memory.added_count - stored_count
    first, newer_records = memory.records_since(sequence_number)
    assert first == max(memory.oldest_number, min(sequence_number, memory.added_count))
    assert len(newer_records) == memory.added_count - first
    assert newer_records == records[len(records) - len(newer_records) :]
    assert memory.added_count + memory.late_count == len(ends)


@given(st.integers(0, 8), ENDS)
def test_changes_have_positions_and_versions(size: int, ends: Any) -> None:
    memory, versions = Memory(size), set()
    for name, end in enumerate(ends):
        before_first, before = memory.records_since(0)
        memory.first_changed_position = NO_POSITION
        is_added = memory.add((name, end - 1, end))
        assert (memory.version not in versions) == is_added
        versions.add(memory.version)
        first, records = memory.records_since(0)
        for position in range(first, min(memory.first_changed_position, before_first + len(before))):
            assert records[position - first] == before[position - before_first]
        if memory.first_changed_position != NO_POSITION:
            assert (
                first > memory.first_changed_position
                or records[memory.first_changed_position - first][0] == name
            )
    restored = Memory(size)
    restored.restore(memory.oldest_number, memory.late_count, list(memory.ends), list(memory.records))
    assert (len(restored), restored.late_count, restored.records) == (
        len(memory),
        memory.late_count,
        memory.records,
    )
    assert restored.version not in versions
    added = memory.added_count
    memory.clear()
    assert (memory.added_count, len(memory)) == (added, 0)
    assert memory.version not in versions
