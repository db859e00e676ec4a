"""Printing of terms by ``portray/1``, which a program defines."""

from typing import Any, List, Tuple

import pytest
from prolog.goal_answers import answers, prolog

PROGRAM = """
portray(secret(_)) :- write('***').
portray(X) :- X == 42, write(answer).
portray([a|_]) :- write('A-list').
portray(p(X)) :- write('<'), print(X), write('>').
portray(q(X)) :- write(no), X = 1, fail.
portray(r(X)) :- X = 1, write(one).
portray(wrong) :- throw(oops).
"""


def written(goal: str, program: Any = PROGRAM) -> Tuple[Any, ...]:
    logic = prolog(program)
    texts: List[Any] = []
    logic.output = texts.append
    solutions = answers(logic, goal)
    assert solutions
    return "".join(texts), solutions


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        ("print([b, secret(1), f(secret(2))])", "[b,***,f(***)]"),
        ("print(f([a, b], [c, a, b], [x|secret(1)]))", "f(A-list,[c,a,b],[x|***])"),
        ("print(p(p(42)))", "<<answer>>"),
        ("print(q(2))", "q(2)"),
        ("print(user_output, 'A b'-42)", "'A b'-answer"),
        ('format("~p ~w ~q", [secret(1), secret(1), 42])', "*** secret(1) 42"),
        ("write_term(secret(1), [portray(true)]), write_term(42, [portray(false)])", "***42"),
        ("writeq(secret(1))", "secret(1)"),
        ("print(r(X)), var(X)", "one"),
    ],
)
def test_portray_hook_prints_terms(goal: str, text: str) -> None:
    assert written(goal)[0] == text


def test_print_without_portray_writes_quoted() -> None:
    assert written("print('A b')", "")[0] == "'A b'"
    assert written("print(a)", ":- dynamic(portray/1).")[0] == "a"


def test_error_of_portray_is_error_of_print() -> None:
    assert written("catch(print(f(wrong)), E, true)")[1] == [{"E": "oops"}]
    (answer,) = written("catch(print(f(1)), error(E, _), true)", "portray(X) :- print(X).")[1]
    assert answer["E"].startswith("resource_error(")
