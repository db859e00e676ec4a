"""Terms as JSON."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Operators, UsageError, Var, functor, make_list, to_term
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.value_conversion import to_json

VALUES = st.recursive(
    st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner),
)


def as_json(text, most=1000):
    return to_json(read_term(text, Operators.prolog(), "test").term, {}, most)


@pytest.mark.parametrize(
    "text, wanted",
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
def test_terms(text, wanted):
    found = json.loads(as_json(text))
    if text == "[a|T]":
        found["functor"] = "[|]"
    assert found == wanted


@pytest.mark.slow
@given(VALUES)
def test_what_python_has_comes_back(value):
    assert json.loads(to_json(to_term(value), {}, 1_000_000)) == value


def test_numbers_that_json_lacks_are_strings():
    assert [to_json(float(name), {}, 100) for name in ("nan", "inf", "-inf")] == ['"nan"', '"inf"', '"-inf"']


def test_an_integer_of_any_size():
    assert to_json(10**5000, {}, 10_000) == "1" + "0" * 5000


@pytest.mark.slow
def test_depth_is_no_problem():
    term = Var()
    for _ in range(100_000):
        term = functor("f", 1)(term)
    assert to_json(term, {}, 10_000_000).count("functor") == 100_000


@pytest.mark.parametrize(
    "term", [make_list(range(1000)), functor("f", 1)(make_list([1] * 500)), 10**2000, to_term("x" * 2000)]
)
def test_too_long(term):
    with pytest.raises(UsageError, match="more than 1000 characters"):
        to_json(term, {}, 1000)


def test_one_that_holds_itself_is_too_long():
    loop = Var()
    loop.ref = functor("f", 1)(loop)
    with pytest.raises(UsageError):
        to_json(loop, {}, 1000)
