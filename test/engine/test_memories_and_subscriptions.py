"""Memories and subscriptions that are added and deleted by methods of an engine."""

import pytest

from retalis import Engine, PrologError, Var, atom, functor


def test_memories_are_added_and_deleted():
    engine = Engine()
    events = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    value, name = Var(), atom("warm")
    engine.add_memory((functor("t", 1), value), [(functor(">", 2), value, 20)], Var(), name, 2)
    for degrees in (19, 21, 22):
        engine.event(f"t({degrees})", degrees)
    assert [str(solution["X"]) for solution in engine.query("access_mem(warm, t(X), _)")] == ["22", "21"]
    with pytest.raises(PrologError, match="one already exists"):
        engine.add_memory(atom("a"), [], Var(), name, 2)
    with pytest.raises(PrologError, match="integer"):
        engine.add_memory(atom("a"), [], Var(), atom("other"), atom("two"))
    assert engine.delete_memory(name) and not engine.delete_memory(name)
    assert not engine.has_memory(name)
    assert events[0].startswith("memory_created(t(") and events[-1] == "memory_deleted(warm)"


def test_subscriptions_are_added_and_deleted():
    engine = Engine()
    sent = []
    engine.on_output(lambda term, topic, name: sent.append((engine.show(term), topic, engine.show(name))))
    value, topic, name = Var(), atom("out"), atom("s")
    engine.add_subscription((functor("t", 1), value), [], (functor("got", 1), value), topic, name)
    engine.event("t(1)", 1)
    assert sent == [("got(1)", "out", "s")]
    with pytest.raises(PrologError, match="one already exists"):
        engine.add_subscription(atom("a"), [], Var(), topic, name)
    assert engine.delete_subscription(topic, name) and not engine.delete_subscription(topic, name)
    engine.event("t(2)", 2)
    assert len(sent) == 1
