"""Checks of terms with variables against message types."""

import pytest

from retalis import Definitions, Operators, Var, functor
from retalis.messages.validating_encoder import find_fault
from retalis.prolog.syntax.term_reader import read_term


def definition(text):
    definitions = Definitions()
    return definitions.decoder(definitions.add("my_robot/Thing", text)).definition


PARTS = """\
================================================================================
MSG: my_robot/Part
Nothing[2] n
int8 a
================================================================================
MSG: my_robot/Nothing
"""


@pytest.mark.parametrize(
    ("text", "term", "fault"),
    [
        ("uint8 a\nstring b", "my_robot__0__Thing(A, _)", None),
        ("uint8 a\nstring b", "my_robot__0__Thing(256, _)", "expected uint8 from 0 to 255, got 256"),
        ("float64[] a", "my_robot__0__Thing([1.0|_])", None),
        ("float64[2] a", "my_robot__0__Thing([_, x])", "expected float64, got the atom x"),
        ("float64[2] a", "my_robot__0__Thing([_])", "expected 2 elements"),
        ("float64[2] a", "my_robot__0__Thing([_|_])", None),
        ("time t\nduration[] d", "my_robot__0__Thing([_, 1], [[_, 2], _|_])", None),
        ("time t", "my_robot__0__Thing([-1, _])", "Sec from 0 to 4294967295, got -1"),
        (f"Part p\nPart[] q\n{PARTS}", "my_robot__0__Thing(_, [_, my_robot__0__Part(_, A)|_])", None),
        (f"Part p\n{PARTS}", "my_robot__0__Thing(my_robot__0__Part(_, x))", "expected int8, got the atom x"),
        (f"Part p\n{PARTS}", "my_robot__0__Thing(my_robot__0__Part(_))", "Part"),
        ("", "A", None),
        ("", "my_robot__0__Other", "Other"),
    ],
)
def test_what_no_values_of_the_variables_make_right(text, term, fault):
    found = find_fault(definition(text), read_term(term, Operators.prolog()).term)
    assert found is fault if fault is None else fault in found


def test_types_of_huge_messages_are_not_filled():
    huge = definition("uint8[4000000000] a\nuint8 b")
    assert find_fault(huge, (functor("my_robot__0__Thing", 2), Var(), 256)) is None


SLOTS = ("bool", "int8", "float32", "string", "time", "duration", "Part", "Nothing")
ARRAYS = ("", "[]", "[2]")


@pytest.mark.parametrize("slot", [f"{kind}{array}" for kind in SLOTS for array in ARRAYS])
def test_a_variable_may_be_any_slot_or_message(slot):
    found = definition(f"{slot} a\n{PARTS}")
    assert find_fault(found, Var()) is None
    assert find_fault(found, (functor("my_robot__0__Thing", 1), Var())) is None
    assert "Thing" in find_fault(found, (functor("my_robot__0__Thing", 2), Var(), Var()))
    assert "expected" in find_fault(found, (functor("my_robot__0__Thing", 1), (functor("f", 1), Var())))
