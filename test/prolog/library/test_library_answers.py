"""Libraries, compared with recorded answers of SWI-Prolog 9.0.4."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import compound
from prolog.goal_answers import show

from retalis import PrologError, atom, functor, make_list
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy

ROWS = [
    line.split("\t")
    for line in (Path(__file__).parent / "answers.tsv").read_text(encoding="utf-8").splitlines()
]
MAX_SOLUTIONS = 5


@pytest.fixture(scope="module")
def logic() -> PrologSystem:
    return PrologSystem(compile_after=1 << 60)  # each goal is called once only


@pytest.mark.parametrize(("goal", "answer"), ROWS, ids=[goal for goal, _ in ROWS])
def test_library_goal_has_answer_of_swi_prolog(logic: PrologSystem, goal: Any, answer: Any) -> None:
    assert answered(logic, goal) == answer


def answered(logic: Any, goal: Any) -> str:
    read = read_term(goal, logic.operators)
    names = [name for name in read.names if name[0] != "_"]
    solutions: List[Any] = []
    try:
        for _ in logic.solutions(read.term):
            bindings = [(functor("=", 2), atom(name), read.names[name]) for name in names]
            solutions.append(copy(make_list(bindings)))
            if len(solutions) == MAX_SOLUTIONS:
                break
    except PrologError as error:
        return f"error({show(compound(error.term)[1])})"
    return show(make_list(solutions))
