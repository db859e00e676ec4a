"""Explanations that would take too long."""

import pytest

from retalis import Engine, UsageError, explain, record_origins


@pytest.fixture
def engine():
    found = Engine()
    record_origins(found)
    found.load(rules="c(X, Y) <- a(X) seq b(Y) where X > 1000.")
    for number in range(50):
        found.event(f"a({number})", number)
        found.event(f"b({number})", number)
    return found


def test_it_gives_up_when_the_time_is_over(engine):
    with pytest.raises(UsageError, match="no explanation within 0 s"):
        explain(engine, "c(_, _)", 0)
    assert not explain(engine, "c(_, _)", 3600).happened
    assert explain(engine, "a(1)", 0).happened
    assert engine.query("between(1, 100000, X), X =:= 100000")


def test_limits_of_goals_hold_as_before(engine):
    with pytest.raises(UsageError):
        explain(engine, "c(_, _)", 0)
    assert not engine.call(
        "catch(call_with_inference_limit(numlist(1, 100000, _), 100, R), _, true), R == true"
    )
