"""Execution of cleanup goals."""

import pytest
from prolog.support import answers, prolog

from retalis.prolog.syntax.term_reader import read_term

LATER = "member(X, [1,2,3])"


@pytest.fixture
def written():
    return []


@pytest.fixture
def logic(written):
    made = prolog("""
        cut(G) :- setup_call_cleanup(write(s), G, write(c)), write(g), !, write(e).
        first(G) :- setup_call_cleanup(true, G, write(c)), !.
        both(G) :- setup_call_cleanup(true, setup_call_cleanup(true, G, write(i)), write(o)), !.
    """)
    made.output = made.error_output = written.append
    return made


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        (f"setup_call_cleanup(write(s), {LATER}, write(c)), write(g), !, write(e)", "sgce"),
        (f"cut({LATER})", "sgce"),
        (f"both({LATER})", "io"),
        (f"(call_cleanup({LATER}, write(c)) -> write(t) ; true)", "ct"),
        (f"once(call_cleanup({LATER}, write(c))), write(e)", "ce"),
        (f"\\+ \\+ call_cleanup({LATER}, write(c)), write(e)", "ce"),
        (f"forall(call_cleanup({LATER}, write(c)), write(X))", "12c3"),
        (f"call_cleanup({LATER}, write(c)), write(X), X == 3, write(e)", "12c3e"),
        (f"\\+ (call_cleanup({LATER}, write(c)), write(X), fail)", "12c3"),
        (f"catch((call_cleanup({LATER}, write(c)), throw(t)), t, write(e))", "ce"),
        ("catch(call_cleanup(throw(t), write(c)), t, write(e))", "ce"),
        ("call_cleanup(true, write(c)), write(e)", "ce"),
        ("\\+ call_cleanup(fail, write(c)), write(e)", "ce"),
        (f"first({LATER}), first({LATER})", "cc"),
        (f"call_cleanup({LATER}, (write(c), fail)), !, write(e)", "ce"),
        (f"call_cleanup({LATER}, throw(t)), !, write(e)", "Warning: cleanup: Unhandled exception: te"),
        (f"call_cleanup({LATER}, (member(_, [1,2]), write(c))), !, write(e)", "ce"),
        (f"limit(1, call_cleanup({LATER}, write(c))), write(e)", "ce"),
        (f"findall(X, limit(2, call_cleanup({LATER}, write(c))), L), write(L)", "c[1,2]"),
    ],
)
def test_a_cleanup_runs_once(logic, written, goal, text):
    assert logic.once(read_term(goal, logic.operators).term)
    assert "".join(written).replace("\n", "") == text
    assert logic.machine.choices == []


def test_bindings_of_a_cleanup_do_not_count_where_the_goal_is_cut(logic):
    assert answers(logic, f"call_cleanup({LATER}, Y = 1), !, Z = Y") == [{"X": "1", "Y": "A", "Z": "A"}]


def test_a_cleanup_sees_what_the_goal_has_bound(logic, written):
    assert answers(logic, f"call_cleanup({LATER}, write(X)), !") == [{"X": "1"}]
    assert written == ["1"]


def test_a_goal_left_by_python_is_cleaned_up(logic, written):
    solutions = logic.solutions(read_term(f"call_cleanup({LATER}, write(c))", logic.operators).term)
    next(solutions)
    assert written == []
    solutions.close()
    assert written == ["c"]


def test_the_setup_may_give_the_cleanup(logic, written):
    assert answers(logic, "setup_call_cleanup(G = write(x), true, G)") == [{"G": "write(x)"}]
    assert written == ["x"]
    assert answers(logic, "setup_call_cleanup(true, true, _)") == ["instantiation_error"]
