"""Libraries, compared with recorded answers of SWI-Prolog 9.0.4."""

from pathlib import Path

import pytest
from prolog.support import show

from retalis import PrologError, atom, functor, make_list
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy

ROWS = [
    line.split("\t")
    for line in (Path(__file__).parent / "answers.tsv").read_text(encoding="utf-8").splitlines()
]
MOST = 5


@pytest.fixture(scope="module")
def logic():
    return PrologSystem(compile_after=1 << 60)  # what is asked once is not worth compiling


@pytest.mark.parametrize(("goal", "answer"), ROWS, ids=[goal for goal, _ in ROWS])
def test_answer(logic, goal, answer):
    assert answered(logic, goal) == answer


def answered(logic, goal):
    read = read_term(goal, logic.operators)
    names = [name for name in read.names if name[0] != "_"]
    found = []
    try:
        for _ in logic.solutions(read.term):
            bindings = [(functor("=", 2), atom(name), read.names[name]) for name in names]
            found.append(copy(make_list(bindings)))
            if len(found) == MOST:
                break
    except PrologError as error:
        return f"error({show(error.term[1])})"
    return show(make_list(found))
