"""Undefined and emptied predicates, which are kept only as long as something refers to them."""

import pytest
from prolog.goal_answers import answers, prolog

from retalis import Engine
from retalis.prolog.database import predicate_database

IS_UNDEFINED = "catch({}, error(existence_error(_, _), _), R = undefined)"


def test_demoted_predicate_is_called_once_defined() -> None:
    logic = prolog("p :- foo, true.")
    for _ in range(300):
        assert answers(logic, IS_UNDEFINED.format("p"))[0]["R"] == "undefined"
    logic.database.demote_unused()
    assert answers(logic, "assertz(foo), p, R = defined")[0]["R"] == "defined"


def test_asserted_and_retracted_names_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predicate_database, "MAX_EMPTY_DYNAMIC", 50)
    logic = prolog("turn(N) :- atom_concat(seen_, N, Name), F =.. [Name, N], assertz(F), retract(F).")
    before = len(logic.database.predicates)
    for number in range(5000):
        assert answers(logic, f"turn({number})") == [{}]
    logic.database.demote_unused()
    assert len(logic.database.predicates) <= before + 10
    assert len(logic.database.empty_dynamic) == 50
    # The newest names are still dynamic; the oldest are as if they had never been asserted.
    assert answers(logic, "seen_4999(_)") == []
    assert answers(logic, IS_UNDEFINED.format("seen_0(_)")) == [{"R": "undefined"}]


@pytest.mark.parametrize("goal", ["assertz(f(1)), retract(f(1))", "retractall(f(_))"])
def test_emptied_predicate_stays_dynamic(goal: str) -> None:
    logic = prolog("p(X) :- f(X).")
    answers(logic, goal)
    logic.database.demote_unused()
    assert answers(logic, "f(_)") == [] == answers(logic, "p(_)")
    assert answers(logic, "assertz(f(2)), p(X)") == [{"X": "2"}]
    logic.database.demote_unused()
    assert answers(logic, "p(X)") == [{"X": "2"}]


def test_declared_predicate_is_not_demoted() -> None:
    logic = prolog(":- dynamic f/1.")
    answers(logic, "assertz(f(1)), retract(f(1))")
    logic.database.demote_unused()
    assert answers(logic, "predicate_property(f(_), dynamic)") == [{}]
    assert not logic.database.empty_dynamic


def test_restore_keeps_emptied_predicates() -> None:
    engine = Engine()
    engine.load(rules="p(X) :- f(X).")
    assert engine.call("assertz(f(1)), retract(f(1)), assertz(g(1))")
    for _ in range(2):
        engine = Engine.restore(engine.snapshot())
    assert engine.query("p(X)") == engine.query("f(X)") == []
    assert engine.call("g(1), retract(g(1))")
    engine.logic.database.demote_unused()
    assert {str(key) for key in engine.logic.database.empty_dynamic} == {"f/1", "g/1"}
    assert engine.query("g(X)") == []
