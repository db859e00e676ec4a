"""Comparison of outputs and events with expectations."""

from itertools import permutations
from typing import List, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testing.case_texts import fever_file, parse_case

from retalis.prolog.syntax.operators import Operators
from retalis.prolog.syntax.term_reader import read_term
from retalis.testing import expectation_checks
from retalis.testing.expectation_checks import RunItem, SequenceCheck

SECOND = 10**9


def make_items(texts: Sequence[str]) -> List[RunItem]:
    """Return outputs of topic ``t``, one a second from 1 s on."""
    operators = Operators.prolog()
    return [
        RunItem(read_term(text, operators).term, time * SECOND, time * SECOND, "t")
        for time, text in enumerate(texts, 1)
    ]


def list_differences(expect: str, texts: Sequence[str]) -> List[str]:
    """Return the summary of a failure and its listing; nothing if the expectation holds."""
    (sequence,) = parse_case(fever_file(expect)).expectations.sequences
    failure = SequenceCheck(sequence, Operators.prolog(), 0).find_failure(make_items(texts))
    if failure is None:
        return []
    lines = [f"{each.mark} {' '.join(each.text.split())} {each.note}".strip() for each in failure.differences]
    return [failure.summary, *lines]


@pytest.mark.parametrize(
    "expect",
    [
        "outputs: [a, b, c]",
        "outputs: [{term: a, at: 1}, {topic: /t, term: _}, {term: c, at: 3.0005}]",
        "outputs: {contains: [c, a]}",
        "outputs: {contains: [_, _, a]}",
        "outputs: {contains: [{term: _, count: 3}, {term: d, count: 0}]}",
        "outputs: {in_order: [a, c]}",
        "outputs: {none: [d, {term: a, at: 2}]}",
        "outputs: {count: 3}",
        "outputs: {count: {min: 1}}",
    ],
)
def test_expectation_holds(expect: str) -> None:
    assert list_differences(expect, ["a", "b", "c"]) == []


@pytest.mark.parametrize(
    ("expect", "differences"),
    [
        ("outputs: none", ["outputs: 0 expected, 3 found", "+ 1.000 s t a", "+ 2.000 s t b", "+ 3.000 s t c"]),
        ("outputs: [a, c]", ["outputs: 2 expected, 3 found", "1.000 s t a", "+ 2.000 s t b", "3.000 s t c"]),
        ("outputs: [a, b, d, c]",
         ["outputs: 4 expected, 3 found", "1.000 s t a", "2.000 s t b", "- d", "3.000 s t c"]),
        ("outputs: [a, {term: b, at: 5}, c]",
         ["outputs: all found, but at other times", "1.000 s t a", "- 5.000 s b found at 2.000 s", "+ 2.000 s t b",
          "3.000 s t c"]),
        ("outputs: [b, a, c]",
         ["outputs: all found, but in another order", "- b found at 2.000 s", "1.000 s t a", "+ 2.000 s t b",
          "3.000 s t c"]),
        ("outputs: [{term: b, at: 5}, a, c]",
         ["outputs: all found, but in another order and at other times", "- 5.000 s b found at 2.000 s",
          "1.000 s t a", "+ 2.000 s t b", "3.000 s t c"]),
        ("outputs: {contains: [{term: b, at: 5}, a]}",
         ["outputs: all found, but 1 at other times", "- 5.000 s b found at 2.000 s"]),
        ("outputs: [{term: a, topic: u}, b, c]",
         ["outputs: 3 expected, 3 found", "- u a", "+ 1.000 s t a", "2.000 s t b", "3.000 s t c"]),
        ("outputs: {contains: [d, a]}", ["outputs: 1 not found as expected", "- d"]),
        ("outputs: {contains: [a, a]}", ["outputs: 1 not found as expected", "- a found at 1.000 s"]),
        ("outputs: {contains: [{term: _, count: {max: 2}}]}",
         ["outputs: 1 not found as expected", "- _ 0 to 2 expected, 3 found"]),
        ("outputs: {in_order: [c, a]}",
         ["outputs: all found, but in another order: number 2 of the list not found after those before it",
          "- a found at 1.000 s"]),
        ("outputs: {in_order: [a, d]}",
         ["outputs: number 2 of the list not found after those before it", "- d"]),
        ("outputs: {none: [b]}", ["outputs: 1 found that must not occur", "+ 2.000 s t b"]),
        ("outputs: {count: 2}", ["outputs: 2 expected, 3 found"]),
    ],
)  # fmt: skip
def test_difference_is_listed(expect: str, differences: List[str]) -> None:
    assert list_differences(expect, ["a", "b", "c"]) == differences


def test_exact_list_of_events_concerns_its_names() -> None:
    assert list_differences("events: [f(1), f(2)]", ["f(1)", "g(1)", "f(2)"]) == []
    assert list_differences("events: [f(1)]", ["f(1)", "g(1)", "f(2)"])[0] == "events: 1 expected, 2 found"


def test_specific_pattern_gets_its_item_before_general_one() -> None:
    assert list_differences("outputs: {contains: [f(_), f(1), f(_)]}", ["f(1)", "f(2)", "f(3)"]) == []
    assert (
        list_differences(
            "outputs: {contains: ['f(X, X)', 'f(1, _)', 'f(_, 2)']}", ["f(1,2)", "f(1,1)", "f(4,2)"]
        )
        == []
    )


def test_equal_items_far_from_differences_are_not_listed() -> None:
    texts = [f"n({number})" for number in range(30)]
    expect = f"outputs: [{', '.join(texts[:15] + texts[16:])}]"
    lines = list_differences(expect, texts)
    assert lines[1] == "..."
    assert "+ 16.000 s t n(15)" in lines
    assert len(lines) < 10


def test_long_sequences_are_compared_by_position(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expectation_checks, "MAX_COMPARED_PAIRS", 0)
    assert list_differences("outputs: [b, a]", ["a", "b"])[1:] == [
        "- b",
        "+ 1.000 s t a",
        "- a",
        "+ 2.000 s t b",
    ]


TEXTS = st.lists(st.sampled_from("abc"), max_size=6)
SOME_TEXTS = st.lists(st.sampled_from("abc"), min_size=1, max_size=6)


@given(TEXTS, TEXTS)
def test_listing_turns_expected_into_actual_outputs(expected: List[str], actual: List[str]) -> None:
    lines = list_differences(f"outputs: [{', '.join(expected)}]", actual)[1:]
    if expected == actual:
        assert lines == []
        return
    # Context is only omitted around more than two equal lines.
    if "..." in lines:
        return
    words = [(line[0] if line[0] in "+-" else " ", line.split(" found at")[0].split()[-1]) for line in lines]
    tail = len(actual) - sum(mark != "-" for mark, _ in words)
    assert [word for mark, word in words if mark != "-"] == actual[: len(actual) - tail]
    assert [word for mark, word in words if mark != "+"] == expected[: len(expected) - tail]
    assert expected[len(expected) - tail :] == actual[len(actual) - tail :] or tail == 0


@given(SOME_TEXTS, TEXTS)
def test_order_is_that_of_a_subsequence(expected: List[str], actual: List[str]) -> None:
    remaining = iter(actual)
    is_subsequence = all(text in remaining for text in expected)
    assert (
        list_differences(f"outputs: {{in_order: [{', '.join(expected)}]}}", actual) == []
    ) is is_subsequence


@given(SOME_TEXTS, TEXTS)
def test_contained_items_are_distinct(expected: List[str], actual: List[str]) -> None:
    is_contained = all(actual.count(text) >= expected.count(text) for text in expected)
    assert (list_differences(f"outputs: {{contains: [{', '.join(expected)}]}}", actual) == []) is is_contained


@given(st.lists(st.sampled_from("ab_"), max_size=6), st.lists(st.sampled_from("ab"), max_size=6))
def test_contained_items_are_assigned_as_by_exhaustive_search(expected: List[str], actual: List[str]) -> None:
    if not expected:
        return
    is_possible = any(
        all(pattern in ("_", text) for pattern, text in zip(expected, chosen))
        for chosen in permutations(actual, len(expected))
    )
    assert (list_differences(f"outputs: {{contains: {expected}}}", actual) == []) == is_possible


def test_contained_items_with_times_are_found_in_events_out_of_order() -> None:
    (sequence,) = parse_case(
        fever_file("outputs: {contains: [{term: b, at: 2}, {term: c, at: 3}]}")
    ).expectations.sequences
    items = sorted(make_items(["a", "b", "c"]), key=lambda item: -item.time)
    assert SequenceCheck(sequence, Operators.prolog(), 0).find_failure(items) is None
