"""A memory against a plain sorted list."""

from hypothesis import given
from hypothesis import strategies as st

from retalis.events.knowledge.memory import Memory

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
    assert memory.latest is None
    assert memory.add(("a", 1, 5))
    assert memory.add(("b", 1, 3))
    assert memory.latest == 5
    assert len(memory) == 0


def test_counts_what_came_and_what_was_too_late():
    memory = Memory(2)
    for end in (10, 20, 5):
        memory.add(("x", end, end))
    assert (memory.added, memory.late) == (2, 1)


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
    assert memory.latest is None
    assert memory.at_or_before(99) is None


def test_steps_that_are_wider_than_the_others_are_told_of():
    memory = Memory(100)
    told = []
    memory.on_wide = lambda start, end: told.append((start, end))
    for end in [*range(1000, 2000, 100), 4000, 4100]:
        memory.add((end, end, end))
    for look_up in (memory.around, memory.at_or_after):
        del told[:]
        for instant in (1150, 1850, 3000, 4050):
            look_up(instant)
        assert told == [(1900, 4000)]
