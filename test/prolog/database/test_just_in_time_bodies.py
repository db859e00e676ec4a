"""Just-in-time compilation of a running body, without a change of behaviour."""

from random import Random
from typing import Any, List

import pytest
from prolog.compiler.test_predicate_code import CALLS, SEEDS, program
from prolog.goal_answers import NEVER, answers, first, prolog

from retalis.prolog.compiler.predicate_code import PredicateGenerator
from retalis.prolog.database import just_in_time_bodies
from retalis.prolog.machine import machine


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("seed", SEEDS[:12])
def test_bodies_compiled_at_any_step_keep_answers(
    seed: Any, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = program(seed)
    expected = [answers(prolog(text), call) for call in CALLS]
    monkeypatch.setattr(machine, "SLICE", (None,) * steps)
    logic = prolog(text, NEVER)
    assert [answers(logic, call) for call in CALLS] == expected
    assert logic.machine.trail == [] == logic.machine.choices


SEARCH = """
digit(0). digit(1). digit(2). digit(3). digit(4). digit(5). digit(6). digit(7). digit(8). digit(9).
sum(N) :- digit(A), digit(B), A =\\= B, digit(C), C > B, digit(D), D =:= 9,
    ( A + B =:= C -> true ; A =:= 7, B =:= 1 ), N is A * 100 + B * 10 + C.
first(N) :- digit(A), digit(B), A * 10 + B > 95, !, N is A * 10 + B.
all(L) :- findall(N, sum(N), L).
"""


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> Any:
    arguments: List[Any] = []

    def record(*args: Any) -> PredicateGenerator:
        arguments.append(args)
        return PredicateGenerator(*args)

    monkeypatch.setattr(
        just_in_time_bodies,
        "PredicateGenerator",
        record,
    )
    return arguments


def test_search_of_one_call_is_compiled(compilations: Any) -> None:
    fast, slow = prolog(SEARCH, NEVER), prolog(SEARCH)
    expected = sorted(
        a * 100 + b * 10 + c
        for a in range(10)
        for b in range(10)
        for c in range(10)
        if a != b and c > b and (a + b == c or (a == 7 and b == 1))
    )
    assert first(slow, "all(L)") == first(fast, "all(L)") == str(expected).replace(" ", "")
    assert 1 <= len(compilations) <= 8
    assert first(fast, "first(N)") == "96"


BUILT_IN = """
big(L) :- findall(X, (between(1, 60000, X), X > 59998), L).
wrong(E) :- catch(refused, error(E, _), true).
refused :- call((member(Y, [1, z]), between(1, 60000, X), X > Y, fail)).
"""


def test_builtin_after_search_is_compiled(compilations: Any) -> None:
    logic = prolog(BUILT_IN, NEVER)
    assert first(logic, "big(L)") == "[59999,60000]"
    assert len(compilations) == 1
    assert first(logic, "wrong(E)") == "type_error(evaluable,z/0)"


def test_short_search_is_not_compiled(compilations: Any) -> None:
    assert first(prolog(SEARCH, NEVER), "first(N)") == "96"
    assert not compilations


def test_compiled_bodies_are_dropped_after_query(compilations: Any) -> None:
    logic = prolog(SEARCH, NEVER)
    assert first(logic, "all(L)")
    assert compilations
    assert len(logic.control.bodies) == 0


def test_facts_change_during_compiled_search() -> None:
    text = """
    :- dynamic(limit/1).
    limit(3).
    count(0). count(N) :- between(1, 3000, N).
    go(S) :- count(X), limit(L),
        ( X > 2500, L < 4 -> retract(limit(_)), assertz(limit(2999)), fail ; X > L ), S = X, !.
    """
    logic = prolog(text, NEVER)
    assert first(logic, "retract(limit(_)), assertz(limit(2998)), go(S)") == "2999"
    assert first(prolog(text, NEVER), "between(1, 9, X), limit(L), X > L, !") == {"X": "4", "L": "3"}


def test_compiled_body_keeps_errors_and_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    text = """
    go(S) :- between(1, 100, X), ( X =:= 60 -> Y = a ; Y = 1 ), catch(Z is X + Y, error(E, _), (S = X-E, !)), Z < 0.
    throws(N) :- between(1, 100, X), ( X > N -> throw(result(X)) ; true ), fail.
    """
    expected = [first(prolog(text), "go(S)"), answers(prolog(text), "throws(50)")]
    monkeypatch.setattr(machine, "SLICE", (None,) * 7)
    logic = prolog(text, NEVER)
    assert [first(logic, "go(S)"), answers(logic, "throws(50)")] == expected
    assert expected[1] == ["result(51)"]


def test_body_with_large_term_keeps_answer(compilations: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "SLICE", (None,) * 3)
    random = Random(1)
    numbers = ", ".join(str(random.randrange(9)) for _ in range(500))
    logic = prolog("go(L, N) :- member(X, L), X > 7, ( X =:= 8 -> N = X ; fail ).", NEVER)
    assert first(logic, f"go([{numbers}], N), !, true") is not None


@pytest.mark.parametrize(
    "goal",
    [
        "G = !, call((digit(X), digit(Y), X + Y > 9, G)), N is X * 10 + Y",
        "member(G, [true, !]), call((digit(X), digit(Y), X + Y > 15, G)), N is X * 10 + Y",
        "G = (digit(Y), !), call((digit(X), G, X > 3)), N is X * 10 + Y",
        "G = !, call((digit(X), (X > 5 -> G ; fail))), N = X",
    ],
)
@pytest.mark.parametrize("steps", [1, 3, 50])
def test_cut_bound_to_variable_is_local_to_body(
    goal: str, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = answers(prolog(SEARCH), goal)
    monkeypatch.setattr(machine, "SLICE", (None,) * steps)
    assert answers(prolog(SEARCH, NEVER), goal) == expected


def test_number_of_observed_bodies_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    attempts: List[Any] = []
    monkeypatch.setattr(
        just_in_time_bodies.JustInTimeBodies, "_compile", lambda self, body: attempts.append(body)
    )
    monkeypatch.setattr(machine, "SLICE", (None,))
    logic = prolog(SEARCH, NEVER)
    goal = " , ".join(
        f"\\+ (digit(X{number}), digit(Y{number}), X{number} + Y{number} > 18)" for number in range(20)
    )
    assert first(logic, f"{goal}, N = 1")["N"] == "1"
    assert 0 < len(attempts) <= 60
    assert len(logic.control.bodies) <= 2 * just_in_time_bodies._MAX_BODIES  # noqa: SLF001
