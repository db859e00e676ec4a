"""Why an event happened that a query triggers after it has waited."""

import pytest

from retalis import Engine, explain, record_origins

RULE = "synchronized(found(X), true, [[m, T]]{options}) <- seen(X, T).\nnext(X) <- found(X).\n"


@pytest.fixture(params=["", ", [timeout(60)]"])
def engine(request):
    found = Engine()
    record_origins(found)
    rules = RULE.format(options=request.param) + "other(N) <- tick(N).\n"
    found.load(rules=rules, goals="memorize(tick(N), [], tick(N), m, 10)")
    found.event("tick(1)", 1)
    return found


def told(engine, event):
    (line,) = explain(engine, event).lines
    return [text.split(" by rule")[0].strip() for text in line.indented()]


def test_it_follows_from_the_event_that_asked_not_from_the_one_that_released_it(engine):
    engine.event("seen(a, 5)", 2)
    engine.event("seen(b, 6)", 3)
    assert not explain(engine, "found(_)").happened
    engine.event("tick(7)", 7)
    first, second, third = told(engine, "found(a)")
    assert first == "found(a) at 2 was released by"
    assert second.startswith("synchronized(found(a),true,[[m,5]]")
    assert third == "seen(a,5) at 2 came from outside"
    assert told(engine, "next(b)")[0] == "next(b) at 3"
    assert told(engine, "next(b)")[-1] == "seen(b,6) at 3 came from outside"


def test_what_follows_afterwards_does_not(engine):
    engine.event("seen(a, 5)", 2)
    engine.event("tick(7)", 7)
    assert told(engine, "other(7)") == ["other(7) at 7", "tick(7) at 7 came from outside"]
    assert told(engine, "tick(7)") == ["tick(7) at 7 came from outside"]
