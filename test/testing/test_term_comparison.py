"""Comparison of terms with patterns."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis.foundation.source_places import Place
from retalis.prolog.syntax.operators import Operators
from retalis.prolog.syntax.term_reader import read_term
from retalis.testing.case_definition import TermText, Tolerance
from retalis.testing.term_comparison import read_pattern
from retalis.testing.yaml_documents import CaseFileError

PLACE = Place("mine_test.yaml", 7, 3)
START = 1_000_000_000 * 10**9


def matches(pattern: str, term: str, tolerance: Tolerance = Tolerance()) -> bool:  # noqa: B008 - immutable
    operators = Operators.prolog()
    return read_pattern(TermText(pattern, PLACE), operators, tolerance, START).matches(
        read_term(term, operators).term
    )


@pytest.mark.parametrize(
    ("pattern", "term", "expected"),
    [
        ("fever(ann)", "fever(ann)", True),
        ("fever(ann)", "fever(bob)", False),
        ("fever(ann)", "fever(ann, 1)", False),
        ("fever(_)", "fever(f(x))", True),
        ("pair(X, X)", "pair(a, a)", True),
        ("pair(X, X)", "pair(a, b)", False),
        ("pair(_, _)", "pair(a, b)", True),
        ("pair(X, X)", "pair(f(1), f(1))", True),
        ("f(3)", "f(3.0)", True),
        ("f(3)", "f('3')", False),
        ("f([1, _ | _])", "f([1, 2, 3])", True),
        ('f("text")', 'f("text")', True),
        ('f("text")', 'f("test")', False),
        ("_", "anything(at, all)", True),
        ("a", "b", False),
    ],
)
def test_pattern_selects_terms(pattern: str, term: str, expected: bool) -> None:
    assert matches(pattern, term) is expected


def test_number_equals_timestamp_since_start() -> None:
    stamp = "datime(2001, 9, 9, 1, 46, 41, 500000000)"
    assert matches("f(1.5)", f"f({stamp})")
    assert not matches("f(1.500001)", f"f({stamp})")
    assert matches("f(1)", f"f({stamp})", Tolerance(absolute=0.5))
    assert matches(f"f({stamp})", f"f({stamp})")


def test_numbers_have_tolerance() -> None:
    assert matches("f(0.3)", "f(0.30000000000000004)")
    assert not matches("f(0.3)", "f(0.31)")
    assert matches("f(0.3)", "f(0.31)", Tolerance(absolute=0.02))
    assert matches("f(100)", "f(101)", Tolerance(relative=0.01))
    assert not matches("f(100)", "f(102)", Tolerance(relative=0.01))


def test_integers_are_compared_exactly() -> None:
    assert not matches("f(10000000000)", "f(10000000005)")
    assert not matches("f(1000000001.0)", "f(1000000001.9)")
    assert matches("f(10000000000)", "f(10000000005)", Tolerance(absolute=5))
    assert not matches(f"f({'9' * 400})", "f(1.0)")


@given(st.floats(allow_nan=True), st.floats(0, 1e300))
def test_tolerance_accepts_equal_numbers(number: float, absolute: float) -> None:
    assert Tolerance(absolute, 0).accepts(number, number)


def test_deep_terms_need_no_recursion() -> None:
    text = f"[{', '.join(map(str, range(50_000)))}]"
    assert matches(text, text)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("f a", "'f a': expected an operator or a full stop"),
        ("f(a", "YAML splits at commas: write a term with commas in quotes"),
    ],
)
def test_syntax_error_names_place_in_file(text: str, error: str) -> None:
    with pytest.raises(CaseFileError) as raised:
        matches(text, "a")
    assert raised.value.place == PLACE
    assert error in raised.value.message
