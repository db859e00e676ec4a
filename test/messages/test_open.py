"""Terms with variables against message types."""

import pytest

from retalis.messages import Definitions, fault_of
from retalis.prolog.syntax import Operators, read_term
from retalis.prolog.terms import Var, functor


def definition(text):
    definitions = Definitions()
    return definitions.decoder(definitions.add("my_robot/Thing", text)).definition


@pytest.mark.parametrize(
    ("text", "term", "fault"),
    [
        ("uint8 a\nstring b", "my_robot__0__Thing(A, _)", None),
        ("uint8 a\nstring b", "my_robot__0__Thing(256, _)", "expected uint8 from 0 to 255, got 256"),
        ("float64[] a", "my_robot__0__Thing([1.0|_])", None),
        ("float64[2] a", "my_robot__0__Thing([_, x])", "expected float64, got the atom x"),
    ],
)
def test_what_no_values_of_the_variables_make_right(text, term, fault):
    found = fault_of(definition(text), read_term(term, Operators.prolog()).term)
    assert found is fault if fault is None else fault in found


def test_types_of_huge_messages_are_not_filled():
    huge = definition("uint8[4000000000] a\nuint8 b")
    assert fault_of(huge, (functor("my_robot__0__Thing", 2), Var(), 256)) is None
