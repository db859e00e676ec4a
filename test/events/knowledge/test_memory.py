"""A memory against a plain sorted list."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis.events.knowledge.memory import NO_POSITION, Memory

ENDS = st.lists(st.integers(0, 30), max_size=60)


class Model:
    """All records ever taken, kept the obvious way."""

    def __init__(self, size):
        self.size = size
        self.kept = []

    def add(self, name, end):
        if self.size and len(self.kept) == self.size and end < self.kept[0][1]:
            return False
        at = sum(1 for _, other in self.kept if other <= end)
        self.kept.insert(at, (name, end))
        del self.kept[: max(0, len(self.kept) - self.size)]
        return True


def filled(size, ends):
    memory, model = Memory(size), Model(size)
    for name, end in enumerate(ends):
        assert memory.add((name, end - 1, end)) == model.add(name, end)
    return memory, model


@given(st.integers(0, 8), ENDS)
def test_keeps_the_newest_in_order_of_their_ends(size, ends):
    memory, model = filled(size, ends)
    assert [(term, end) for term, _, end in memory.newest_first()] == model.kept[::-1]
    assert len(memory) == len(model.kept)


@given(st.integers(0, 8), ENDS, st.integers(-1, 31))
def test_look_ups_by_time(size, ends, instant):
    memory, model = filled(size, ends)
    before = [name for name, end in model.kept if end <= instant]
    after = [name for name, end in model.kept if end >= instant]
    found = memory.at_or_before(instant)
    assert (found and found[0]) == (before[-1] if before else None)
    found = memory.at_or_after(instant)
    assert (found and found[0]) == (after[0] if after else None)
    around = memory.around(instant)
    assert (around and [record[0] for record in around]) == (
        [before[-1], after[0]] if before and after else None
    )


def test_latest_is_the_newest_end_even_where_nothing_is_kept():
    memory = Memory(0)
    assert memory.latest_end is None
    assert memory.add(("a", 1, 5))
    assert memory.add(("b", 1, 3))
    assert memory.latest_end == 5
    assert len(memory) == 0


def test_counts_what_came_and_what_was_too_late():
    memory = Memory(2)
    for end in (10, 20, 5):
        memory.add(("x", end, end))
    assert (memory.added_count, memory.late_count) == (2, 1)


def test_a_reader_is_not_disturbed_by_what_is_added_meanwhile():
    memory = Memory(3)
    for end in range(3):
        memory.add((end, end, end))
    reader = memory.newest_first()
    assert next(reader)[0] == 2
    for end in (1, 5, 6, 7):
        memory.add(("late", end, end))
    assert [term for term, _, _ in reader] == [1, 0]


def test_holds_not_much_more_than_its_size():
    memory = Memory(10)
    for end in range(1000):
        memory.add((end, end, end))
    assert len(memory.records) <= 10 + 2 + 16
    assert [term for term, _, _ in memory.newest_first()] == list(range(999, 989, -1))


def test_clear_forgets_records():
    memory = Memory(3)
    memory.add(("x", 1, 1))
    memory.clear()
    assert len(memory) == 0
    assert memory.latest_end is None
    assert memory.at_or_before(99) is None


def test_steps_that_are_wider_than_the_others_are_told_of():
    memory = Memory(100)
    told = []
    memory.on_wide_gap = lambda start, end: told.append((start, end))
    for end in [*range(1000, 2000, 100), 4000, 4100]:
        memory.add((end, end, end))
    for look_up in (memory.around, memory.at_or_after):
        del told[:]
        for instant in (1150, 1850, 3000, 4050):
            look_up(instant)
        assert told == [(1900, 4000)]


@pytest.mark.parametrize("gap", [90, 99, 100, 110])
@pytest.mark.parametrize("before", [1, 3])
def test_a_step_is_wide_from_ten_times_the_mean_of_the_others_on(gap, before):
    memory, end = Memory(100), 0
    told = []
    memory.on_wide_gap = lambda start, end: told.append(end - start)
    for step in [10] * before + [gap] + [10] * 4:
        end += step
        memory.add((end, end, end))
    start = 10 * before
    for look_up in (memory.around, memory.at_or_after):
        del told[:]
        assert look_up(start + 5)
        assert told == ([gap] if gap >= 100 else [])
    del told[:]
    assert memory.around(start) and memory.at_or_after(start) and memory.at_or_after(start + gap + 1)
    assert told == []


@given(st.integers(0, 8), ENDS, st.integers(-1, 31), st.integers(0, 61))
def test_places_of_records(size, ends, instant, taken):
    memory, model = filled(size, ends)
    records = memory.records

    def kept(matches):
        return [name for name, end in model.kept if matches(end)]

    assert [name for name, _, _ in records[memory.first_position :]] == kept(lambda end: True)
    assert [name for name, _, _ in records[memory.first_position : memory.position_after(instant)]] == kept(
        lambda end: end <= instant
    )
    assert [name for name, _, _ in records[memory.position_reaching(instant) :]] == kept(
        lambda end: end >= instant
    )
    stay = min(memory.added_count, max(size, 1))
    assert memory.oldest_number == memory.added_count - stay
    first, found = memory.records_since(taken)
    assert first == max(memory.oldest_number, min(taken, memory.added_count))
    assert len(found) == memory.added_count - first and found == records[len(records) - len(found) :]
    assert memory.added_count + memory.late_count == len(ends)


@given(st.integers(0, 8), ENDS)
def test_what_has_changed_and_its_version(size, ends):
    memory, versions = Memory(size), set()
    for name, end in enumerate(ends):
        before_first, before = memory.records_since(0)
        memory.first_changed_position = NO_POSITION
        taken = memory.add((name, end - 1, end))
        assert (memory.version not in versions) == taken
        versions.add(memory.version)
        first, records = memory.records_since(0)
        for place in range(first, min(memory.first_changed_position, before_first + len(before))):
            assert records[place - first] == before[place - before_first]
        if memory.first_changed_position != NO_POSITION:
            assert (
                first > memory.first_changed_position
                or records[memory.first_changed_position - first][0] == name
            )
    other = Memory(size)
    other.restore(memory.oldest_number, memory.late_count, list(memory.ends), list(memory.records))
    assert (len(other), other.late_count, other.records) == (len(memory), memory.late_count, memory.records)
    assert other.version not in versions
    added = memory.added_count
    memory.clear()
    assert (memory.added_count, len(memory)) == (added, 0) and memory.version not in versions
