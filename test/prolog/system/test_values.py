"""Terms as Python values, and back."""

import pytest

from retalis import Compound, Operators, String, UsageError, atom, to_python, to_term
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq


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
def test_to_python(text, value):
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
def test_to_term(value, text):
    assert writeq(to_term(value)) == text


def test_no_term():
    for value in (None, object()):
        with pytest.raises(UsageError):
            to_term(value)


@pytest.mark.slow
def test_numpy():
    numpy = pytest.importorskip("numpy")
    assert to_term(numpy.float64(1.5)) == 1.5
    assert type(to_term(numpy.int32(3))) is int
