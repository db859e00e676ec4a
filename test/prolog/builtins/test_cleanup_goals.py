"""Execution of cleanup goals."""

from typing import Any, List

import pytest
from prolog.support import answers, prolog

from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem

MEMBER = "member(X, [1,2,3])"


@pytest.fixture
def written() -> List[Any]:
    return []


@pytest.fixture
def logic(written: List[Any]) -> PrologSystem:
    system = prolog("""
        cut(G) :- setup_call_cleanup(write(s), G, write(c)), write(g), !, write(e).
        first(G) :- setup_call_cleanup(true, G, write(c)), !.
        both(G) :- setup_call_cleanup(true, setup_call_cleanup(true, G, write(i)), write(o)), !.
    """)
    system.output = system.error_output = written.append
    return system


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        (f"setup_call_cleanup(write(s), {MEMBER}, write(c)), write(g), !, write(e)", "sgce"),
        (f"cut({MEMBER})", "sgce"),
        (f"both({MEMBER})", "io"),
        (f"(call_cleanup({MEMBER}, write(c)) -> write(t) ; true)", "ct"),
        (f"once(call_cleanup({MEMBER}, write(c))), write(e)", "ce"),
        (f"\\+ \\+ call_cleanup({MEMBER}, write(c)), write(e)", "ce"),
        (f"forall(call_cleanup({MEMBER}, write(c)), write(X))", "12c3"),
        (f"call_cleanup({MEMBER}, write(c)), write(X), X == 3, write(e)", "12c3e"),
        (f"\\+ (call_cleanup({MEMBER}, write(c)), write(X), fail)", "12c3"),
        (f"catch((call_cleanup({MEMBER}, write(c)), throw(t)), t, write(e))", "ce"),
        ("catch(call_cleanup(throw(t), write(c)), t, write(e))", "ce"),
        ("call_cleanup(true, write(c)), write(e)", "ce"),
        ("\\+ call_cleanup(fail, write(c)), write(e)", "ce"),
        (f"first({MEMBER}), first({MEMBER})", "cc"),
        (f"call_cleanup({MEMBER}, (write(c), fail)), !, write(e)", "ce"),
        (f"call_cleanup({MEMBER}, throw(t)), !, write(e)", "Warning: cleanup: Unhandled exception: te"),
        (f"call_cleanup({MEMBER}, (member(_, [1,2]), write(c))), !, write(e)", "ce"),
        (f"limit(1, call_cleanup({MEMBER}, write(c))), write(e)", "ce"),
        (f"findall(X, limit(2, call_cleanup({MEMBER}, write(c))), L), write(L)", "c[1,2]"),
    ],
)
def test_cleanup_runs_once(logic: PrologSystem, written: List[Any], goal: str, text: str) -> None:
    assert logic.once(read_term(goal, logic.operators).term)
    assert "".join(written).replace("\n", "") == text
    assert logic.machine.choices == []


def test_cut_undoes_bindings_of_cleanup(logic: PrologSystem) -> None:
    assert answers(logic, f"call_cleanup({MEMBER}, Y = 1), !, Z = Y") == [{"X": "1", "Y": "A", "Z": "A"}]


def test_cleanup_uses_bindings_of_goal(logic: PrologSystem, written: List[Any]) -> None:
    assert answers(logic, f"call_cleanup({MEMBER}, write(X)), !") == [{"X": "1"}]
    assert written == ["1"]


def test_closed_solutions_run_cleanup(logic: PrologSystem, written: List[Any]) -> None:
    solutions = logic.solutions(read_term(f"call_cleanup({MEMBER}, write(c))", logic.operators).term)
    next(solutions)
    assert written == []
    solutions.close()
    assert written == ["c"]


def test_setup_may_bind_cleanup(logic: PrologSystem, written: List[Any]) -> None:
    assert answers(logic, "setup_call_cleanup(G = write(x), true, G)") == [{"G": "write(x)"}]
    assert written == ["x"]
    assert answers(logic, "setup_call_cleanup(true, true, _)") == ["instantiation_error"]
