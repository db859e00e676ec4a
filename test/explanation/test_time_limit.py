"""Time limit of explanations."""

from itertools import chain, repeat
from typing import List

import pytest

from retalis import Engine, UsageError, explain, record_origins
from retalis.explanation import event_and_output_explanations


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


@pytest.mark.parametrize("check_count", range(20))
def test_rules_are_unchanged_after_interruption(check_count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine()
    record_origins(engine)
    engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", goals="subscribe(alarm(_), [], _, alarms, a)")
    published: List[str] = []
    engine.on_output(lambda term, topic, name: published.append(engine.show(term)))
    for number in range(30):
        engine.event(f"smoke(room({number}))", number)
    # The first call computes the end of the limit, each further one checks it.
    times = chain([0.0] * (check_count + 1), repeat(10.0))
    monkeypatch.setattr(event_and_output_explanations, "monotonic", lambda: next(times))
    with pytest.raises(UsageError, match="no explanation within 1 s"):
        explain(engine, "alarm(kitchen)", seconds=1.0)
    engine.event("smoke(bath)", 100)
    engine.event("heat(bath)", 101)
    assert published == ["alarm(bath)"]
