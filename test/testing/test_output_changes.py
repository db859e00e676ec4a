"""Differences between the outputs of two versions of a program."""

from collections import Counter
from typing import Callable, List, Optional

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis.prolog.terms.timestamps import SECOND
from retalis.testing.output_changes import ChangeType, OutputChange, PlainOutput, find_changes

LOST, GAINED, MOVED, CHANGED = ChangeType.LOST, ChangeType.GAINED, ChangeType.MOVED, ChangeType.CHANGED


def output(time: int, term: str, topic: str = "t") -> PlainOutput:
    return PlainOutput(time, topic, term)


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ([output(1, "a")], [output(1, "a")], []),
        ([output(1, "a")], [], [(LOST, output(1, "a"), None)]),
        ([], [output(1, "a")], [(GAINED, None, output(1, "a"))]),
        ([output(1, "a")], [output(2, "a")], [(MOVED, output(1, "a"), output(2, "a"))]),
        ([output(1, "f(1)")], [output(1, "f(2)")], [(CHANGED, output(1, "f(1)"), output(1, "f(2)"))]),
        (
            [output(1, "f(1)")],
            [output(1, "f(1)", "u")],
            [(LOST, output(1, "f(1)"), None), (GAINED, None, output(1, "f(1)", "u"))],
        ),
        ([output(1, "a"), output(2, "a")], [output(2, "a")], [(LOST, output(1, "a"), None)]),
        (
            [output(1, "a"), output(100, "a")],
            [output(101, "a")],
            [(LOST, output(1, "a"), None), (MOVED, output(100, "a"), output(101, "a"))],
        ),
        (
            [output(50, "a"), output(100, "a")],
            [output(90, "a"), output(101, "a")],
            [(MOVED, output(50, "a"), output(90, "a")), (MOVED, output(100, "a"), output(101, "a"))],
        ),
        # Of partners in another order than that of times.
        (
            [output(40, "a"), output(50, "a")],
            [output(30, "a"), output(45, "a")],
            [(MOVED, output(40, "a"), output(30, "a")), (MOVED, output(50, "a"), output(45, "a"))],
        ),
        (
            [output(5 * SECOND, "a")],
            [output(3600 * SECOND, "a")],
            [(LOST, output(5 * SECOND, "a"), None), (GAINED, None, output(3600 * SECOND, "a"))],
        ),
        (
            [output(1, "a"), output(5, "b")],
            [output(3, "c"), output(5, "b")],
            [(LOST, output(1, "a"), None), (GAINED, None, output(3, "c"))],
        ),
    ],
)
def test_change_types(old: List[PlainOutput], new: List[PlainOutput], changes: List[object]) -> None:
    assert [change[:3] for change in find_changes(old, new)] == changes


@pytest.mark.parametrize(("limit", "types"), [(2.0, [MOVED]), (1.9, [LOST, GAINED])])
def test_output_moves_by_at_most_the_limit(limit: float, types: List[ChangeType]) -> None:
    changes = find_changes([output(SECOND, "a")], [output(3 * SECOND, "a")], limit)
    assert [change.type for change in changes] == types


@given(
    st.lists(st.integers(0, 60), max_size=12), st.lists(st.integers(0, 60), max_size=12), st.integers(0, 20)
)
def test_nearest_outputs_are_paired(old: List[int], new: List[int], limit: int) -> None:
    changes = find_changes(
        [output(time * SECOND, "a") for time in old],
        [output(time * SECOND, "a") for time in new],
        float(limit),
    )
    pairs = [
        (change.old.time, change.new.time)
        for change in changes
        if change.old is not None and change.new is not None
    ]
    assert all(abs(left - right) <= limit * SECOND for left, right in pairs)
    by_old_time = sorted(pairs)
    assert [right for _, right in by_old_time] == sorted(right for _, right in pairs)
    # Those without partner are further apart than the limit.
    lost = [change.old.time for change in changes if change.type is LOST and change.old is not None]
    gained = [change.new.time for change in changes if change.type is GAINED and change.new is not None]
    assert all(abs(left - right) > limit * SECOND for left in lost for right in gained)


OutputOf = Callable[[OutputChange], Optional[PlainOutput]]

OUTPUTS = st.lists(
    st.builds(PlainOutput, st.integers(0, 4), st.sampled_from("tu"), st.sampled_from(["a", "f(1)", "f(2)"])),
    max_size=8,
)


@given(OUTPUTS, OUTPUTS)
def test_each_output_is_equal_or_in_one_change(old: List[PlainOutput], new: List[PlainOutput]) -> None:
    changes = find_changes(old, new)

    def count(outputs: List[PlainOutput], side: OutputOf) -> "Counter[PlainOutput]":
        return Counter(outputs) - Counter(filter(None, map(side, changes)))

    # What is in no change is equal on both sides.
    assert count(old, lambda change: change.old) == count(new, lambda change: change.new)
    assert [change.time for change in changes] == sorted(change.time for change in changes)


@given(OUTPUTS)
def test_equal_outputs_have_no_changes(outputs: List[PlainOutput]) -> None:
    assert find_changes(outputs, list(reversed(outputs))) == []
