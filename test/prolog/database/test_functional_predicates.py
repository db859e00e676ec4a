"""Predicates that are functions of some arguments, called by compiled clauses, terms and goals."""

from typing import Any, Iterator, List, Tuple

import pytest
from asserting_accessors import name_of
from asserting_accessors import number as number_of
from prolog.goal_answers import NEVER, answers, prolog

from retalis import PrologError, atom, deref, functor
from retalis.prolog.machine.errors import type_error
from retalis.prolog.system.prolog_system import PrologSystem

PROGRAM = """
half(X, Y) :- half_of(X, Y).
same(X) :- half_of(X, X).
known(X, Y) :- Y = 3, half_of(X, Y).
parts(X, A, B) :- split(A, X, f(B, _)).
unless(X, R) :- ( half_of(X, _) -> R = even ; R = odd ).
both(X, Y) :- split(Y, X, f(Y, Y)).
no(X) :- \\+ half_of(X, _).
last(X, Y) :- split(_, X, _), split(Y, X, _).
"""


def half_of(term: Any) -> Any:
    term = deref(term)
    if term.__class__ is not int:
        raise type_error("integer", term)
    return None if term % 2 else term // 2


def split(term: Any) -> Tuple[Any, ...]:
    value = number_of(term)
    return value, value * 10


@pytest.fixture(params=[0, NEVER], ids=["compiled", "interpreted"])
def logic(request: pytest.FixtureRequest) -> PrologSystem:
    system = prolog(PROGRAM, request.param)
    system.define_function("half_of", 2, half_of)
    shows = (None, lambda value: (functor("f", 2), value, atom("end")))
    system.define_function("split", 3, split, (0, 2), shows)
    return system


CASES = [
    ("half(6, Y)", [{"Y": "3"}]),
    ("half(6, 3)", [{}]),
    ("half(6, 4)", []),
    ("half(7, Y)", []),
    ("half(a, _)", ["type_error(integer,a)"]),
    ("same(0)", [{}]),
    ("same(4)", []),
    ("same(_)", ["type_error(integer,A)"]),
    ("known(6, Y)", [{"Y": "3"}]),
    ("known(8, _)", []),
    ("parts(2, A, B)", [{"A": "2", "B": "20"}]),
    ("parts(2, A, 21)", []),
    ("unless(2, R)", [{"R": "even"}]),
    ("unless(3, R)", [{"R": "odd"}]),
    ("both(0, Y)", []),
    ("no(3)", [{}]),
    ("no(4)", []),
    ("last(5, Y)", [{"Y": "5"}]),
    ("half_of(8, Y)", [{"Y": "4"}]),
    ("G = half_of(8, Y), G", [{"G": "half_of(8,4)", "Y": "4"}]),
    ("member(X, [1,2,3]), half_of(X, Y)", [{"X": "2", "Y": "1"}]),
    ("split(A, 1, f(B, end)), A < B", [{"A": "1", "B": "10"}]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("goal", "expected"), CASES)
def test_functions_have_answers_of_predicates(logic: PrologSystem, goal: str, expected: Any) -> None:
    for _ in range(2):
        assert answers(logic, goal) == expected
    assert logic.machine.trail == []


def test_clause_for_locked_function_is_refused() -> None:
    logic = prolog()
    logic.define_function("half_of", 2, half_of).is_locked = True
    with pytest.raises(PrologError, match="permission"):
        logic.add_clause((functor("half_of", 2), 1, 2))


def test_compiled_clause_calls_new_definition() -> None:
    logic = prolog("twice(X, Y) :- half_of(Y, X).")
    logic.define_function("half_of", 2, half_of)
    assert answers(logic, "twice(X, 8)") == [{"X": "4"}]
    logic.define("half_of", 2, lambda machine, left, right: machine.unify(left, atom("replaced")))
    assert answers(logic, "twice(X, Y)") == [{"X": "A", "Y": "replaced"}]


@pytest.mark.parametrize("compile_after", [0, NEVER], ids=["compiled", "interpreted"])
def test_function_is_used_if_first_argument_is_known(compile_after: Any) -> None:
    logic = prolog("one(Y) :- number_of(b, Y).\nall(X, Y) :- number_of(X, Y).\n", compile_after)
    numbers = {"a": 1, "b": 2}
    enumerated: List[Any] = []

    def enumerate_numbers(machine: Any, name: Any, value: Any) -> Iterator[bool]:
        enumerated.append(name)
        for key, number in numbers.items():
            if machine.unify_all((name, atom(key)), (value, number)):
                yield True

    logic.define_nondeterministic("number_of", 2, enumerate_numbers, lambda name: numbers.get(name_of(name)))
    assert answers(logic, "one(Y)") == [{"Y": "2"}]
    assert answers(logic, "X = a, number_of(X, Y)") == [{"X": "a", "Y": "1"}]
    assert answers(logic, "number_of(a, 2)") == []
    assert answers(logic, "number_of(c, _)") == []
    assert enumerated == []
    assert answers(logic, "all(X, Y)") == [{"X": "a", "Y": "1"}, {"X": "b", "Y": "2"}]
    assert answers(logic, "all(X, 2)") == [{"X": "b"}]
    assert len(enumerated) == 2
