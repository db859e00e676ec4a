"""Expansion of terms and goals while a program is read."""

from pathlib import Path

import pytest
from events.program_runner import ProgramRunner


def test_terms_are_expanded() -> None:
    program = ProgramRunner(
        """
term_expansion(twice(X), [one(X), two(X)]).
term_expansion(gone, []).
term_expansion(rule(H, B), (H :- B)).
term_expansion((:- my_directive(X)), note(X)).
twice(1). gone. rule(p(X), one(X)). :- my_directive(3). kept.
"""
    )
    assert program.warnings == []
    assert program.engine.call("one(1), two(1), p(1), note(3), kept, \\+ current_predicate(gone/0)")


def test_goals_are_expanded() -> None:
    program = ProgramRunner(
        """
goal_expansion(old(X), new(X)).
goal_expansion(older(X), old(X)).
new(1). new(2).
p(X) :- older(X), \\+ old(3).
q(L) :- ( true -> findall(X, old(X), L) ; fail ).
:- old(1), assertz(seen).
"""
    )
    assert program.warnings == []
    assert program.engine.call("p(1), q([1, 2]), seen")


@pytest.mark.parametrize("expansion", ["a", "(b, a)", "(a, a)", "\\+ a"])
def test_endless_goal_expansion_omits_clause(expansion: str) -> None:
    program = ProgramRunner(f"goal_expansion(a, {expansion}). p(1). q :- a.")
    (warning,) = program.warnings
    assert "goal_expansion/2 does not end" in warning.message
    assert program.engine.call("p(1)")


@pytest.mark.parametrize(
    "expansion",
    [
        "goal_expansion(a, X) :- X = (b, X).",
        "goal_expansion(b, c). term_expansion((q :- a), (q :- X)) :- X = (b, X).",
    ],
)
def test_goal_that_contains_itself_omits_clause(expansion: str) -> None:
    program = ProgramRunner(f"{expansion} p(1). q :- a.")
    (warning,) = program.warnings
    assert "the term contains itself" in warning.message
    assert program.engine.call("p(1)")


def test_goals_of_long_body_are_expanded() -> None:
    body = ", ".join(["old"] * 3000)
    program = ProgramRunner(f"goal_expansion(old, new). new. p :- {body}.")
    assert program.warnings == []
    assert program.engine.call("p")


def test_error_of_expansion_omits_term() -> None:
    program = ProgramRunner("term_expansion(p(X), _) :- X > 1. q(1). p(a). q(2).")
    (warning,) = program.warnings
    assert warning.place.column == 41
    assert program.engine.call("q(2)")


def test_expansion_may_return_event_rules(tmp_path: Path) -> None:
    program = ProgramRunner(folder=tmp_path)
    program.engine.load(rules="term_expansion(on(E, H), (H <- E)). on(a, c).")
    assert program.feed("a@1") == "c@1-1"


def test_expansions_apply_to_later_files() -> None:
    program = ProgramRunner("term_expansion(on(E, H), (H <- E)). goal_expansion(old(X), X = 1). p.")
    program.engine.load(rules="on(a, c). d <- a. f(X) :- old(X).")
    assert program.feed("a@1") == "c@1-1 d@1-1"
    assert program.engine.call("f(1)")


@pytest.mark.parametrize("dynamic", [":- dynamic term_expansion/2. ", ":- multifile term_expansion/2. "])
def test_declaration_of_expansion_replaces_nothing(dynamic: str) -> None:
    program = ProgramRunner(f"{dynamic}p(1).")
    assert program.warnings == []
    assert program.engine.call("p(1)")
