"""Errors of calls of undefined procedures, and the number of searches for their hints."""

from typing import Any, List, Optional

import pytest
from prolog.goal_answers import NEVER, prolog

from retalis import Engine
from retalis.prolog.machine.errors import PrologError
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system import undefined_procedure_hints


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a list of the functors for which similar names have been searched."""
    names: List[Any] = []
    find_similar = undefined_procedure_hints.find_similar

    def find(logic: Any, key: Any) -> List[str]:
        names.append(str(key))
        return find_similar(logic, key)

    monkeypatch.setattr(undefined_procedure_hints, "find_similar", find)
    return names


def error_text(logic: Any, goal: str) -> str:
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    return str(error.value)


def test_error_names_caller_and_similar_procedure() -> None:
    logic = prolog("caller(X) :- apend(X, [], _), true.")
    text = error_text(logic, "caller([])")
    assert "Unknown procedure: apend/3" in text
    assert "called from caller/1 (program.pl:1:" in text
    assert "did you mean append/3?" in text


def test_repeated_call_searches_once(searches: Any) -> None:
    logic = prolog("caller(X) :- apend(X, [], _), true.")
    texts = {error_text(logic, "caller([])") for _ in range(200)}
    assert len(texts) == 1
    assert searches == ["apend/3"]


def test_later_definition_is_suggested(searches: Any) -> None:
    logic = prolog()
    assert "did you mean" not in error_text(logic, "mesure(_)")
    logic.add_clause(read_term("measure(1)", logic.operators).term)
    assert "did you mean measure/1?" in error_text(logic, "mesure(_)")


def test_number_of_searched_names_is_bounded(searches: Any) -> None:
    logic = prolog()
    for number in range(3000):
        assert "Unknown procedure" in error_text(logic, f"missing_{number}(x)")
    assert 100 <= len(searches) <= 103


CALLERS = """
one(X) :- missing(1, X).
two(X) :- missing(2, X), true(X).
three(X) :- missing(Y, X), atom(Y).
three(X) :- atom(X), missing(3, X), p(X).
four(L) :- maplist(other(a), L).
four([]).
p(missing).
"""


@pytest.mark.parametrize("compile_after", [0, NEVER])
@pytest.mark.parametrize(
    ("goal", "callers"),
    [
        ("one(X)", ["one/1 (program.pl:2:", "three/1 (program.pl:4:"]),
        ("two(X)", ["two/1 (program.pl:3:", "three/1 (program.pl:4:"]),
        ("three(X)", None),
        ("missing(5, X)", ["three/1 (program.pl:4:"]),
        ("four([b])", ["four/1 (program.pl:6:"]),
    ],
)
def test_error_names_clauses_that_may_call(
    compile_after: Any, goal: str, callers: Optional[List[str]]
) -> None:
    logic = prolog(CALLERS, compile_after)
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    named = error.value.message.split("called from ")[1].split(";")[0].split(", ")
    if callers is None:
        assert "three/1 (program.pl:4:" in named[0] or "three/1 (program.pl:4:" in named[-1]
    elif compile_after == NEVER or len(callers) == 1:
        assert [place.rpartition(":")[0] + ":" for place in named] == callers
    else:  # compiled, the frame that the call returns to is known
        assert named[0].startswith(callers[0])


def test_similar_name_with_same_number_of_arguments_is_suggested() -> None:
    engine = Engine()
    engine.load(rules="temperature_left(1, 2).\ntemperature_lift(1).")
    with pytest.raises(PrologError, match=r"did you mean temperature_lift/1\?"):
        engine.query("temperature_lefft(X)")
