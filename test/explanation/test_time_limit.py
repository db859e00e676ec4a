"""Time limit of explanations."""

import pytest

from retalis import Engine, UsageError, explain, record_origins


@pytest.fixture
def engine() -> Engine:
    engine = Engine()
    record_origins(engine)
    engine.load(rules="c(X, Y) <- a(X) seq b(Y) where X > 1000.")
    for number in range(50):
        engine.event(f"a({number})", number)
        engine.event(f"b({number})", number)
    return engine


def test_explanation_beyond_limit_is_an_error(engine: Engine) -> None:
    with pytest.raises(UsageError, match="no explanation within 0 s"):
        explain(engine, "c(_, _)", 0)
    assert not explain(engine, "c(_, _)", 3600).happened
    assert explain(engine, "a(1)", 0).happened
    assert engine.query("between(1, 100000, X), X =:= 100000")


def test_limits_of_goals_follow_interruption(engine: Engine) -> None:
    with pytest.raises(UsageError):
        explain(engine, "c(_, _)", 0)
    assert not engine.call(
        "catch(call_with_inference_limit(numlist(1, 100000, _), 100, R), _, true), R == true"
    )
