"""Interface of the Prolog system to Python: predicates that Python functions define."""

from typing import Any, Iterator

import pytest
from asserting_accessors import required
from prolog.goal_answers import answers, prolog

from retalis import deref
from retalis.prolog.machine.errors import type_error
from retalis.prolog.machine.machine import LAST
from retalis.prolog.system.prolog_system import PrologSystem


def test_loaded_library_predicates_are_listed_once() -> None:
    logic = PrologSystem()
    assert answers(logic, "append([1], [2], S)") == [{"S": "[1,2]"}]
    names = [key.name for key in logic.names() if (key.name, key.arity) == ("append", 3)]
    assert names == ["append"]


def test_predicates_are_defined_in_python() -> None:
    logic = PrologSystem()

    def double(machine: Any, number: Any, result: Any) -> Any:
        value = deref(number)
        if value.__class__ is not int:
            raise type_error("integer", value)
        return machine.unify(result, value * 2)

    def divisors(machine: Any, number: Any, result: Any) -> Iterator[Any]:
        dividend = deref(number)
        assert isinstance(dividend, int)
        for value in range(1, dividend + 1):
            if dividend % value == 0 and machine.unify(result, value):
                yield LAST if value == dividend else None

    def twice(machine: Any, args: Any, frame: Any) -> Any:
        return logic.control.call(args[0], required(logic.control.call(args[0], frame)))

    logic.define("double", 2, double)
    logic.define_nondeterministic("divisor", 2, divisors)
    logic.define_control("twice", 1, twice)
    assert answers(logic, "double(4, X)") == [{"X": "8"}]
    assert answers(logic, "double(a, X)") == ["type_error(integer,a)"]
    assert [answer["X"] for answer in answers(logic, "divisor(6, X)")] == ["1", "2", "3", "6"]
    assert answers(logic, "divisor(6, X), X > 2, !") == [{"X": "3"}]
    assert logic.machine.choices == []
    assert answers(logic, "twice(nb_setval(n, 1)), nb_getval(n, X)") == [{"X": "1"}]


@pytest.mark.parametrize("after", ["", ", X = 1", ", twice"])
def test_generator_without_arguments_is_backtracked(after: str) -> None:
    logic = prolog(f"p(X) :- X = 1, twice{after}.\n", 0)

    def twice(machine: Any) -> Iterator[Any]:
        yield None
        yield LAST

    logic.define_nondeterministic("twice", 0, twice)
    assert len(answers(logic, "p(X)")) == (4 if "twice" in after else 2)
