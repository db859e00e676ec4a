"""Conversion of terms to Python values, from Python values, and to JSON."""

import json
from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import (
    Compound,
    Operators,
    String,
    Term,
    UsageError,
    Var,
    atom,
    functor,
    make_list,
    to_python,
    to_term,
)
from retalis.foundation.errors import TermTooLarge
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.system.value_conversion import to_json
from retalis.prolog.terms.types import CONS, MINUS


def texts_of(value: Any) -> List[str]:
    """Return all texts in a value."""
    if isinstance(value, list):
        return [text for item in value for text in texts_of(item)]
    return [value] if isinstance(value, str) else []


VALUES = st.recursive(
    st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner),
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("1.5", 1.5),
        ("abc", "abc"),
        ('"abc"', "abc"),
        ("true", True),
        ("[]", []),
        ("[1,[a]]", [1, ["a"]]),
        ("f(x,1)", Compound("f", ["x", 1])),
        ("[a|b]", Compound("[|]", ["a", "b"])),
    ],
)
def test_term_is_converted_to_python_value(text: str, value: Any) -> None:
    assert to_python(read_term(text, Operators.prolog()).term) == value


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        ("a b", "'a b'"),
        (String("a b"), '"a b"'),
        ((1, 2), "[1,2]"),
        ({"a": 1, "b": [2]}, "[a-1,b-[2]]"),
        ({1}, "[1]"),
        (Compound("f", [1]), "f(1)"),
        (Compound("f", []), "f"),
        (atom("x"), "x"),
        (range(2), "[0,1]"),
    ],
)
def test_python_value_is_converted_to_term(value: Any, text: str) -> None:
    assert writeq(to_term(value)) == text


def test_object_of_other_type_is_refused() -> None:
    for value in (None, object()):
        with pytest.raises(UsageError):
            to_term(value)


@pytest.mark.slow
def test_numpy_numbers_are_converted_to_terms() -> None:
    numpy = pytest.importorskip("numpy")
    assert to_term(numpy.float64(1.5)) == 1.5
    assert type(to_term(numpy.int32(3))) is int


def as_json(text: Any) -> str:
    return to_json(read_term(text, Operators.prolog(), "test").term, {}, 1000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1", 1),
        ("2.5", 2.5),
        ("a", "a"),
        ("'\"4x4_1\"'", '"4x4_1"'),
        ("true", True),
        ("[]", []),
        ("[1, [a], -0.5]", [1, ["a"], -0.5]),
        ("f(x, [])", {"functor": "f", "args": ["x", []]}),
        ("f(X, Y, X)", {"functor": "f", "args": [{"variable": name} for name in ("_1", "_2", "_1")]}),
        ("[a|T]", {"functor": "[|]", "args": ["a", {"variable": "_1"}]}),
    ],
)
def test_terms_are_converted_to_json(text: str, expected: Any) -> None:
    assert json.loads(as_json(text)) == expected


@pytest.mark.slow
@given(VALUES.filter(lambda value: not {"true", "false"} & set(texts_of(value))))  # these atoms are booleans
def test_json_of_python_value_is_equal(value: Any) -> None:
    assert json.loads(to_json(to_term(value), {}, 1_000_000)) == value


def test_non_finite_floats_are_strings_in_json() -> None:
    assert [to_json(float(name), {}, 100) for name in ("nan", "inf", "-inf")] == ['"nan"', '"inf"', '"-inf"']


def test_integer_of_any_size_is_converted_to_json() -> None:
    assert to_json(10**5000, {}, 10_000) == "1" + "0" * 5000


@pytest.mark.slow
def test_deep_term_is_converted_to_json() -> None:
    term: Term = Var()
    for _ in range(100_000):
        term = functor("f", 1)(term)
    assert to_json(term, {}, 10_000_000).count("functor") == 100_000


@pytest.mark.parametrize(
    "term", [make_list(range(1000)), functor("f", 1)(make_list([1] * 500)), 10**2000, to_term("x" * 2000)]
)
def test_json_beyond_length_limit_is_refused(term: Any) -> None:
    with pytest.raises(UsageError, match="more than 1000 characters"):
        to_json(term, {}, 1000)


def test_json_of_cyclic_term_is_refused() -> None:
    loop = Var()
    loop.ref = functor("f", 1)(loop)
    with pytest.raises(UsageError):
        to_json(loop, {}, 1000)


@pytest.mark.slow
def test_numpy_bool_is_converted_to_atom() -> None:
    numpy = pytest.importorskip("numpy")
    assert writeq(to_term([numpy.bool_(True), numpy.array([1.0]).max() > 2])) == "[true,false]"


def test_deep_value_is_converted_to_term() -> None:
    value: Any = "x"
    for number in range(10_000):
        value = {"k": value} if number % 3 == 0 else [value] if number % 3 == 1 else Compound("f", [value])
    term: Any = to_term(value)
    for _ in range(10_000):
        term = term[1][2] if is_key_value_list(term) else term[1]
    assert writeq(term) == "x"


def is_key_value_list(term: Any) -> bool:
    return term[0] is CONS and term[1].__class__ is tuple and term[1][0] is MINUS


@pytest.mark.slow
def test_list_that_contains_itself_is_too_large() -> None:
    value: List[Any] = []
    value.append(value)
    with pytest.raises(TermTooLarge):
        to_term(value)
