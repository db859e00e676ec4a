"""Single-sided unification rules, as in SWI-Prolog 9."""

import pytest

from retalis import Engine, PrologError

RULES = """
p(a, X) => X = 1.
p(f(X,X), Y) => Y = X.
p(L, Y), is_list(L) => Y = list.
q(X, X) => true.
q(X, f(X)) => true.
len([], N) => N = 0.
len([_|T], N) => len(T, M), N is M+1.
none => fail.
"""


@pytest.fixture(scope="module")
def engine() -> Engine:
    rule_engine = Engine()
    rule_engine.load(rules=RULES)
    return rule_engine


@pytest.mark.parametrize(
    "goal",
    [
        "p(a, 1)",
        "p(f(1,1), 1)",
        "p([x], list)",
        "q(A, A)",
        "q(A, f(A))",
        "len([a,b,c], 3)",
        "\\+ none",
        "\\+ p(a, 2)",
        "findall(X, p(a, X), [1])",
        "clause(none, _)",
    ],
)
def test_first_matching_rule_is_committed(engine: Engine, goal: str) -> None:
    assert engine.call(goal)


@pytest.mark.parametrize("goal", ["p(_, _)", "p(f(1,_), _)", "p(b, _)", "q(_, _)", "q(A, f(_))", "len(_, _)"])
def test_call_without_matching_rule_is_an_error(engine: Engine, goal: str) -> None:
    with pytest.raises(PrologError) as error:
        engine.call(goal)
    assert "matching_rule" in engine.show(error.value.term)


def test_added_rules_precede_error_of_no_match() -> None:
    engine = Engine()
    assert engine.call(
        "assertz((p(1, X) => X = a)), assertz((p(2, X) => X = b)), asserta((p(0, X) => X = z))"
    )
    assert engine.call(
        "p(0, z), p(1, a), p(2, b), catch(p(3, _), error(existence_error(K, _), _), K = matching_rule)"
    )
    assert len([1 for _ in engine.query("clause(p(_, _), _)")]) == 4
