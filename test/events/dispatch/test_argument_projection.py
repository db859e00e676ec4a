"""Omission of unread arguments of events without visible effects."""

from typing import Any, List, Set

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, Var, atom, functor
from retalis.events.dispatch import argument_projection
from retalis.events.dispatch.argument_projection import NOT_READ
from retalis.events.dispatch.listeners import ListenerPhase

IMAGE = functor("image", 3)
SEEN = "subscribe(seen(_,_), [], _, t, seen)"


def announced_arguments(engine: Any, event_functor: Any = IMAGE) -> Set[Any]:
    return set(engine.dispatcher.projection.announce().get(event_functor, ()))


class OutputEngine(Engine):
    """An engine with a program, whose outputs are recorded; a listener of all events would read all arguments."""

    def __init__(self, rules: str = "", goals: str = "") -> None:
        super().__init__()
        self.outputs: List[str] = []
        self.on_output(lambda term, topic, name: self.outputs.append(self.show(term)))
        self.load(rules=rules, goals=goals)


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
def test_unread_arguments_are_announced(rules: str, goals: str, unread: Set[Any]) -> None:
    assert announced_arguments(OutputEngine(rules, goals)) == unread


@pytest.mark.slow
def test_deep_and_long_patterns_are_analyzed() -> None:
    deep = "f(" * 20_000 + "x" + ")" * 20_000
    assert announced_arguments(OutputEngine(goals=f"subscribe(image(H, _, {deep}), [], seen(H), t, s)")) == {
        2
    }
    slots = ",".join(f"X{number}" for number in range(20_000))
    engine = OutputEngine(goals=f"subscribe(image({slots}), [], seen(X7), t, s)")
    assert announced_arguments(engine, functor("image", 20_000)) == set(range(1, 20_001)) - {8}


def test_listener_of_all_events_reads_all_arguments() -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).")
    assert announced_arguments(engine) == {2, 3}
    engine.on_event(lambda term, start, end: None)
    assert announced_arguments(engine) == set()


def test_storage_of_events_reads_all_arguments() -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).")
    engine.call("set_etalis_flag(store_fired_events, on)")
    assert announced_arguments(engine) == set()


def test_changes_are_announced() -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).")
    changes: List[Any] = []
    engine.dispatcher.on_change.add(lambda: changes.append(announced_arguments(engine)))
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
def test_later_reader_ignores_incomplete_events(goal: str) -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).", SEEN)
    assert announced_arguments(engine) == {2, 3}
    assert engine.call(goal)
    assert 3 not in announced_arguments(engine)
    event_without_data, complete_event = IMAGE(atom("a"), 2, NOT_READ), IMAGE(atom("b"), 2, atom("data"))
    engine.event(event_without_data, 1)
    assert set(engine.outputs) == {"seen(a,1)"}
    del engine.outputs[:]
    engine.event(complete_event, 2)
    assert sum("data" in term for term in engine.outputs) == 1


def test_fused_action_ignores_incomplete_events() -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).")
    assert announced_arguments(engine) == {2, 3}
    engine.call("del_event_rule((seen(H, 1) <- image(H, _, _)))")
    engine.load_rules(
        "null_event do got(D) <- image(_, _, D).\ngot(D) :- assertz(data(D)).\n:- dynamic data/1."
    )
    for data in (NOT_READ, atom("x"), NOT_READ, atom("y")):
        engine.post(IMAGE(atom("a"), 1, data), 1)
    assert engine.query("data(D)") == [{"D": atom("x")}, {"D": atom("y")}]


def test_announced_functors_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(argument_projection, "MAX_PROJECTED_FUNCTORS", 5)
    engine = OutputEngine(
        goals="".join(f"subscribe(kind{number}(_), [], seen, t, {number})\n" for number in range(10))
    )
    assert len(engine.dispatcher.projection.announce()) == 5


RULES = [
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
def test_omission_of_unread_arguments_keeps_outputs(parts: Any, goals: Any, events: Any) -> None:
    rules = "\n".join(RULES[number] for number in sorted(parts))
    goals_of_run = "\n".join(GOALS[number] for number in sorted(goals | {0}))
    results: List[Any] = []
    for leaves_out in (False, True):
        engine = OutputEngine(rules, goals_of_run)
        unread = announced_arguments(engine) if leaves_out else ()
        for instant, event in enumerate(events, 1):
            values = [atom(value) if isinstance(value, str) else value for value in event]
            slots = (NOT_READ if number in unread else value for number, value in enumerate(values, 1))
            engine.event(IMAGE(*slots), instant)
            engine.event("other", instant)
        records = [engine.query(f"access_mem({name}, R, I)") for name in ("m", "m2", "m3")]
        results.append(
            (engine.outputs, [[engine.show(answer["R"]) for answer in answers] for answers in records])
        )
    assert results[0] == results[1]


def test_trace_listener_gets_incomplete_events() -> None:
    engine = OutputEngine("seen(H, 1) <- image(H, _, _).")
    assert announced_arguments(engine) == {2, 3}
    event, terms = Var(), []

    def record(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        terms.append(term)
        return frame

    engine.dispatcher.listen(ListenerPhase.TRACE, event, record, unread_variables={event})
    assert announced_arguments(engine) == {2, 3}
    engine.event_at(IMAGE(atom("a"), NOT_READ, NOT_READ), 1, 1)
    assert terms[0] == IMAGE(atom("a"), NOT_READ, NOT_READ)
    engine.on_event(lambda term, start, end: None)
    assert announced_arguments(engine) == set()
