"""Errors of calls of undefined procedures, and the number of searches for their hints."""

import pytest
from prolog.support import prolog

from retalis.prolog.machine.errors import PrologError
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system import undefined_procedures


@pytest.fixture
def searches(monkeypatch):
    """Return a list of the functors for which similar names have been searched."""
    names = []
    find_similar = undefined_procedures.find_similar

    def find(logic, key):
        names.append(str(key))
        return find_similar(logic, key)

    monkeypatch.setattr(undefined_procedures, "find_similar", find)
    return names


def error_text(logic, goal):
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    return str(error.value)


def test_error_names_caller_and_similar_procedure():
    logic = prolog("caller(X) :- apend(X, [], _), true.")
    text = error_text(logic, "caller([])")
    assert "Unknown procedure: apend/3" in text
    assert "called from caller/1" in text and "did you mean append/3?" in text


def test_repeated_call_searches_once(searches):
    logic = prolog("caller(X) :- apend(X, [], _), true.")
    texts = {error_text(logic, "caller([])") for _ in range(200)}
    assert len(texts) == 1 and searches == ["apend/3"]


def test_later_definition_is_suggested(searches):
    logic = prolog()
    assert "did you mean" not in error_text(logic, "mesure(_)")
    logic.add_clause(read_term("measure(1)", logic.operators).term)
    assert "did you mean measure/1?" in error_text(logic, "mesure(_)")


def test_constructed_names_are_searched_in_bounded_number(searches):
    logic = prolog()
    for number in range(3000):
        assert "Unknown procedure" in error_text(logic, f"missing_{number}(x)")
    assert 100 <= len(searches) <= 103
