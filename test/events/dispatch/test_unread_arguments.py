"""Omission of unread arguments of events without visible effects."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, Var, atom, functor
from retalis.events.dispatch import listeners as room
from retalis.events.dispatch.listeners import NOT_READ, ListenerPhase

IMAGE = functor("image", 3)
SEEN = "subscribe(seen(_,_), [], _, t, seen)"


def told(engine, kind=IMAGE):
    return set(engine.dispatcher.projection.announce().get(kind, ()))


def made(rules="", goals=""):
    engine = Engine()
    engine.outputs = []
    engine.on_output(lambda term, topic, name: engine.outputs.append(engine.show(term)))
    engine.load(rules=rules, goals=goals)
    return engine


@pytest.mark.parametrize(
    ("rules", "goals", "unread"),
    [
        ("seen(H, 1) <- image(H, _, _).", "", {2, 3}),
        ("seen(H, N) <- image(H, N, _).", "", {3}),
        ("seen(H, 1) <- image(H, N, D) where N > 1.", "", {3}),
        ("seen(1, 1) do write(D) <- image(_, _, D).", "", {1, 2}),
        ("seen(H, 1) <- image(H, big, _).", "", {3}),
        ("seen(H, 1) <- image(H, [_|_], _).", "", {3}),
        ("seen(H, 1) <- image(H, D, D).", "", set()),
        ("seen(H, G) <- image(H, _, D) seq image(G, _, D).", "", {2}),
        ("seen(H, G) <- image(H, _, _) seq image(G, N, _) where N > 1.", "", {3}),
        ("seen(H, 1) <- image(H, _, _).\nseen(2, D) <- image(_, _, D).", "", {2}),
        ("seen(H, 1) <- start(H) fnot image(H, _, _).", "", {2, 3}),
        ("seen(1, 1) <- ntimes(image(_, _, _), 3).", "", set()),
        ("seen(1, N) <- aggregate(start, count, image(_, _, _), N).", "", set()),
        ("seen(E, 1) <- image(H, _, _) and E.", "", set()),
        ("", "subscribe(image(H, _, _), [], seen(H), t, s)", {2, 3}),
        ("", "subscribe(image(H, _, _), [], _, t, s)", set()),
        ("", "subscribe(image(H, N, D), [], image(H, N, D), t, s)", set()),
        ("", "subscribe(image(H, N, _), [N > 1], seen(H), t, s)", {3}),
        ("", "subscribe(image(H, _, D), [], D, t, s)", set()),
        ("", "memorize(image(H, _, _), [], seen(H), m, 10)", {2, 3}),
        ("", "memorize(image(H, _, _), [], _, m, 10)", set()),
        ("", "memorize(image(H, _, D), [length(D, N)], seen(H, N), m, 10)", {2}),
        ("", "memorize(X, [], _, m, 10)", set()),
        ("", "subscribe(other, [], _, t, s)", set()),
    ],
)
def test_what_is_read(rules, goals, unread):
    assert told(made(rules, goals)) == unread


@pytest.mark.slow
def test_nested_and_long_patterns_are_looked_at_once():
    deep = "f(" * 20_000 + "x" + ")" * 20_000
    assert told(made(goals=f"subscribe(image(H, _, {deep}), [], seen(H), t, s)")) == {2}
    slots = ",".join(f"X{at}" for at in range(20_000))
    engine = made(goals=f"subscribe(image({slots}), [], seen(X7), t, s)")
    assert told(engine, functor("image", 20_000)) == set(range(1, 20_001)) - {8}


def test_who_sees_all_events_sees_them_whole():
    engine = made("seen(H, 1) <- image(H, _, _).")
    assert told(engine) == {2, 3}
    engine.on_event(lambda term, start, end: None)
    assert told(engine) == set()


def test_revision_and_justification_see_them_whole():
    engine = made("seen(H, 1) <- image(H, _, _).")
    engine.call("set_etalis_flag(store_fired_events, on)")
    assert told(engine) == set()


def test_what_changes_is_told_anew():
    engine = made("seen(H, 1) <- image(H, _, _).")
    changes = []
    engine.dispatcher.on_change = lambda: changes.append(told(engine))
    engine.call("memorize(image(_, N, _), [], got(N), m, 10)")
    assert changes[-1] == {3}
    engine.call("delete_memory(m)")
    assert changes[-1] == {2, 3}


@pytest.mark.parametrize(
    "goal",
    [
        "subscribe(image(_, _, D), [], got(D), t, late)",
        "subscribe(image(_, _, _), [], _, t, late)",
        "subscribe(X, [], _, t, late)",
    ],
)
def test_who_comes_later_and_reads_it_never_sees_that_it_was_left_out(goal):
    engine = made("seen(H, 1) <- image(H, _, _).", SEEN)
    assert told(engine) == {2, 3}
    assert engine.call(goal)
    assert 3 not in told(engine)
    lacking, whole = IMAGE(atom("a"), 2, NOT_READ), IMAGE(atom("b"), 2, atom("data"))
    engine.event(lacking, 1)
    assert set(engine.outputs) == {"seen(a,1)"}
    del engine.outputs[:]
    engine.event(whole, 2)
    assert sum("data" in term for term in engine.outputs) == 1


def test_a_rule_that_takes_messages_whole_by_a_fused_action_does_not_take_those_either():
    engine = made("seen(H, 1) <- image(H, _, _).")
    assert told(engine) == {2, 3}
    engine.call("del_event_rule((seen(H, 1) <- image(H, _, _)))")
    engine.load_rules(
        "null_event do got(D) <- image(_, _, D).\ngot(D) :- assertz(data(D)).\n:- dynamic data/1."
    )
    for data in (NOT_READ, atom("x"), NOT_READ, atom("y")):
        engine.post(IMAGE(atom("a"), 1, data), 1)
    assert engine.query("data(D)") == [{"D": atom("x")}, {"D": atom("y")}]


def test_what_is_told_is_bounded(monkeypatch):
    monkeypatch.setattr(room, "MAX_PROJECTED_FUNCTORS", 5)
    engine = made(goals="".join(f"subscribe(kind{at}(_), [], seen, t, {at})\n" for at in range(10)))
    assert len(engine.dispatcher.projection.announce()) == 5


PARTS = [
    "seen(H, 1) <- image(H, _, _).",
    "seen(H, N) <- image(H, N, _) where N > 1.",
    "seen(D, 2) <- image(_, _, D).",
    "seen(A, B) <- image(A, _, _) seq image(B, _, _).",
    "seen(A, D) <- image(A, N, _) and image(D, N, _).",
    "seen(A, 3) <- (image(A, _, _) or image(_, A, _)) seq other.",
    "seen(A, 4) <- image(A, _, _) cnot image(A, 2, _).",
    "seen(1, N) <- aggregate(other, count, image(_, _, _), N).",
    "seen(A, D) <- image(A, D, D).",
]
GOALS = [
    SEEN,
    "memorize(image(H, _, _), [], seen(H), m, 10)",
    "memorize(image(H, N, _), [N > 1], seen(H), m2, 10)",
    "memorize(image(H, _, _), [], _, m3, 10)",
    "subscribe(image(H, _, _), [], got(H), t, s)",
]
EVENTS = st.lists(
    st.tuples(st.sampled_from("ab"), st.integers(1, 3), st.sampled_from([1, 2, "x"])), max_size=8
)


@given(st.sets(st.sampled_from(range(8))), st.sets(st.sampled_from(range(5))), EVENTS)
@pytest.mark.slow
def test_nobody_can_tell(parts, goals, events):
    rules = "\n".join(PARTS[at] for at in sorted(parts))
    asked = "\n".join(GOALS[at] for at in sorted(goals | {0}))
    seen = []
    for leaves_out in (False, True):
        engine = made(rules, asked)
        unread = told(engine) if leaves_out else ()
        for instant, event in enumerate(events, 1):
            values = [atom(one) if isinstance(one, str) else one for one in event]
            slots = (NOT_READ if at in unread else value for at, value in enumerate(values, 1))
            engine.event(IMAGE(*slots), instant)
            engine.event("other", instant)
        records = [engine.query(f"access_mem({name}, R, I)") for name in ("m", "m2", "m3")]
        seen.append((engine.outputs, [[engine.show(one["R"]) for one in found] for found in records]))
    assert seen[0] == seen[1]


def test_one_who_takes_events_as_they_come_has_nothing_made_for_it():
    engine = made("seen(H, 1) <- image(H, _, _).")
    assert told(engine) == {2, 3}
    event, found = Var(), []

    def see(term, values, start, end, frame):
        found.append(term)
        return frame

    engine.dispatcher.listen(ListenerPhase.TRACE, event, see, unread_variables={event})
    assert told(engine) == {2, 3}
    engine.event_at(IMAGE(atom("a"), NOT_READ, NOT_READ), 1, 1)
    assert found[0] == IMAGE(atom("a"), NOT_READ, NOT_READ)
    engine.on_event(lambda term, start, end: None)
    assert told(engine) == set()
