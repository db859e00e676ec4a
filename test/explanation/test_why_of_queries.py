"""Explanations of events of synchronized queries."""

from typing import Any, List

import pytest

from retalis import Engine, explain, record_origins

RULE = "synchronized(answer(X), true, [[m, T]]{options}) <- seen(X, T).\nnext(X) <- answer(X).\n"


@pytest.fixture(params=["", ", [timeout(60)]"])
def engine(request: pytest.FixtureRequest) -> Engine:
    engine = Engine()
    record_origins(engine)
    rules = RULE.format(options=request.param) + "other(N) <- tick(N).\n"
    engine.load(rules=rules, goals="memorize(tick(N), [], tick(N), m, 10)")
    engine.event("tick(1)", 1)
    return engine


def explanation_lines(engine: Any, event: str) -> List[str]:
    (line,) = explain(engine, event).lines
    return [text.split(" by rule")[0].strip() for text in line.indented()]


def test_source_of_query_is_trigger_not_release(engine: Engine) -> None:
    engine.event("seen(a, 5)", 2)
    engine.event("seen(b, 6)", 3)
    assert not explain(engine, "answer(_)").happened
    engine.event("tick(7)", 7)
    first, second, third = explanation_lines(engine, "answer(a)")
    assert first == "answer(a) at 2 was released by"
    assert second.startswith("synchronized(answer(a),true,[[m,5]]")
    assert third == "seen(a,5) at 2 came from outside"
    assert explanation_lines(engine, "next(b)")[0] == "next(b) at 3"
    assert explanation_lines(engine, "next(b)")[-1] == "seen(b,6) at 3 came from outside"


def test_later_events_do_not_follow_from_query(engine: Engine) -> None:
    engine.event("seen(a, 5)", 2)
    engine.event("tick(7)", 7)
    assert explanation_lines(engine, "other(7)") == ["other(7) at 7", "tick(7) at 7 came from outside"]
    assert explanation_lines(engine, "tick(7)") == ["tick(7) at 7 came from outside"]
