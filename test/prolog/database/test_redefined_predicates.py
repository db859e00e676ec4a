"""Redefinition of system predicates by a program, without effect on the library."""

from typing import Any, Dict, List, Tuple

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Engine, ProgramErrors, PrologError, Var, atom, functor
from retalis.prolog.builtins.builtin_registry import ENTRIES
from retalis.prolog.compiler.clause_nodes import PROTECTED_PREDICATES
from retalis.prolog.database.predicate import NEVER_COMPILE


def rule_for(key: Any) -> Tuple[Any, ...]:
    return (
        functor(":-", 2),
        (key, *[Var() for _ in range(key.arity)]) if key.arity else atom(key.name),
        atom("true"),
    )


FREE = sorted({functor(*key) for key in ENTRIES} - PROTECTED_PREDICATES, key=str)


def test_unprotected_builtins_are_redefined() -> None:
    logic = prolog()
    for key in FREE:
        logic.add_clause(rule_for(key))
    assert len(FREE) > 200


@pytest.mark.parametrize("key", sorted(PROTECTED_PREDICATES, key=str), ids=str)
def test_redefinition_of_protected_builtin_is_refused(key: Any) -> None:
    with pytest.raises(PrologError, match="modify"):
        prolog().add_clause(rule_for(key))


@pytest.mark.parametrize("compile_after", [0, NEVER_COMPILE], ids=["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("program", "goal", "expected"),
    [
        ("not(X) :- X = mine.", "not(X)", [{"X": "mine"}]),
        ("between(a, b, own).", "between(a, b, X)", [{"X": "own"}]),
        ("arg(1, _, own).", "arg(1, f(x), X)", [{"X": "own"}]),
        ("arg(1, _, own). a(N, X) :- integer(N), arg(N, f(x), X).", "a(1, X)", [{"X": "own"}]),
        ("ignore(own).", "ignore(X)", [{"X": "own"}]),
        ("ignore(own). a(X) :- ignore(X).", "a(X)", [{"X": "own"}]),
        ("atom_length(_, own). a(X) :- atom_length(abc, X).", "a(X)", [{"X": "own"}]),
        ("forall(X, X).", "forall(X, one)", [{"X": "one"}]),
    ],
)
def test_program_calls_its_own_definition(
    program: str, goal: str, expected: List[Dict[str, Any]], compile_after: Any
) -> None:
    logic = prolog(program, compile_after)
    assert answers(logic, goal) == expected
    assert answers(logic, goal) == expected


def test_library_calls_builtin() -> None:
    logic = prolog("length(_, own). msort(_, []). between(_, _, none).")
    assert first(logic, "last([1, 2], X)") == "2"
    assert first(logic, "list_to_assoc([a-1], T)") == "t(a,1,-,t,t)"
    assert first(logic, "numlist(1, 3, X)") == "[1,2,3]"


def test_compiled_code_calls_new_definition() -> None:
    logic = prolog("a(X) :- succ(1, X).")
    for _ in range(20):
        assert answers(logic, "a(X)") == [{"X": "2"}]
    result = Var()
    goal = logic.compile_goal((functor("succ", 2), 1, result), outputs=[result])
    assert goal.first_solution(()) == (2,)
    logic.add_clause((functor("succ", 2), 1, atom("own")))
    assert answers(logic, "a(X)") == [{"X": "own"}]
    assert goal.first_solution(()) == (atom("own"),)
    assert goal.all_solutions(()) == [(atom("own"),)]


def test_assert_for_standard_builtin_is_refused() -> None:
    logic = prolog()
    with pytest.raises(PrologError, match="modify"):
        logic.once(goal := (functor("assertz", 1), (functor("atom_length", 2), 1, 2)))
    logic.once((functor("dynamic", 1), (functor("/", 2), atom("atom_length"), 2)))
    assert logic.once(goal)
    assert answers(logic, "atom_length(1, X)") == [{"X": "2"}]
    assert answers(logic, "assertz(counter(a, b)), counter(a, X)") == [{"X": "b"}]


def test_rules_of_file_call_its_own_definitions() -> None:
    engine = Engine()
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append(engine.show(term)))
    engine.load(
        rules="b(X) <- a(X) where not(X).\nc(X) <- a(X) where between(1, 2, X).\n"
        "not(X) :- X == yes.\nbetween(_, _, yes) :- true.\n",
        goals="subscribe(b(_), [], _, t, b), subscribe(c(_), [], _, t, c)",
    )
    engine.event("a(yes)", 1)
    engine.event("a(fail)", 2)
    assert outputs == ["b(yes)", "c(yes)"]


def test_refused_file_leaves_builtin() -> None:
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load(rules="succ(1, own) :- true.\nc <- a.\n:- throw(no).\n")
    assert engine.call("succ(1, 2)")
    assert engine.logic.is_system_predicate(functor("succ", 2))


@pytest.mark.parametrize(
    ("program", "refused"),
    [
        ("counter(rex, dog).\ncounter(tom, cat).", False),
        ("counter(rex, dog).", True),
        ("write(a).\nwrite(b).", True),
        ("reset_db.\nreset_db.", True),
    ],
)
def test_facts_redefine_unless_they_may_be_goals(program: str, refused: bool) -> None:
    engine = Engine()
    if refused:
        with pytest.raises(ProgramErrors, match="would replace"):
            engine.load(rules=f"c <- b.\n{program}")
    else:
        engine.load(rules=f"c <- b.\n{program}")
        assert engine.call("counter(tom, cat)")
