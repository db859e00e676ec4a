"""Events that are not created because nothing observes them, and unchanged results."""

import logging
from typing import Any, List, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, Limits, Settings, StreamClock, Var, atom, functor, make_list
from retalis.events.dispatch.dispatcher import Dispatcher
from retalis.events.dispatch.listeners import ListenerPhase

TF, A, PACK = functor("tf", 2), functor("a", 1), functor("pack", 1)
X, Y = atom("x"), atom("y")

SPLIT = """
null do split(L) <- pack(L).
split([]).
split([[P, C, S, N]|Rest]) :- new_event(tf(P, C), S, N), split(Rest).
"""


class OutputRecorder:
    """An engine that records its outputs."""

    def __init__(self, rules: Any, goals: str = "", settings: Any = None) -> None:
        self.engine = Engine(StreamClock(0), settings)
        self.engine.load(rules=rules, goals=goals)
        self.outputs: List[Any] = []
        self.engine.on_output(lambda term, topic, name: self.outputs.append(self.engine.show(term)))

    def post(self, *items: Any) -> None:
        self.engine.post(PACK(make_list([make_list(item) for item in items])))


def listen(dispatcher: Any, pattern: Any) -> Any:
    return dispatcher.listen(ListenerPhase.MEMORIES, pattern, lambda term, values, start, end, frame: frame)


def plan(dispatcher: Any, term: Any) -> None:
    dispatcher.dispatch(term, 1, 1, None)


def test_filter_without_plan_passes_all_events() -> None:
    event_filter = Dispatcher().event_filter(TF, (1,))
    assert event_filter.passes(1, 1, X)


@pytest.mark.fused
def test_filter_rejects_other_constants() -> None:
    dispatcher = Dispatcher()
    listen(dispatcher, TF(X, Var()))
    event_filter, filter_without_constants = dispatcher.event_filter(TF, (1, 2)), dispatcher.event_filter(TF)
    plan(dispatcher, TF(X, Y))
    plan(dispatcher, TF(Y, Y))
    assert event_filter.passes(1, 1, X, Y)
    assert not event_filter.passes(1, 1, Y, X)
    assert event_filter.passes(1, 1, Var(), X), "a variable may stand for any constant"
    assert event_filter.passes(1, 1, 7, X), "a value that is no atom is decided by the dispatcher"
    assert filter_without_constants.passes(1, 1)


@pytest.mark.fused
def test_filter_reads_second_constant() -> None:
    dispatcher = Dispatcher()
    listen(dispatcher, TF(X, Y))
    event_filter = dispatcher.event_filter(TF, (1, 2))
    for parent in (X, Y):
        for child in (X, Y):
            plan(dispatcher, TF(parent, child))
    assert [event_filter.passes(1, 1, p, c) for p in (X, Y) for c in (X, Y)] == [False, True, False, False]


@pytest.mark.fused
@pytest.mark.parametrize("time", [(1.5, 0), (-1, 0), (1, 10**9), (1, -1), (10**12, 0), (Var(), 0), (1, X)])
def test_filter_passes_unusual_timestamps(time: Tuple[Any, ...]) -> None:
    dispatcher = Dispatcher()
    event_filter = dispatcher.event_filter(TF, (1, 2))
    plan(dispatcher, TF(X, Y))
    assert not event_filter.passes(1, 0, X, Y)
    assert event_filter.passes(*time, X, Y)


@pytest.mark.fused
def test_filter_follows_changes_of_listeners() -> None:
    dispatcher = Dispatcher()
    event_filter = dispatcher.event_filter(A, (1,))
    plan(dispatcher, A(X))
    assert not event_filter.passes(1, 1, X)
    listener = listen(dispatcher, A(X))
    assert event_filter.passes(1, 1, X)
    plan(dispatcher, A(X))
    plan(dispatcher, A(Y))
    assert event_filter.passes(1, 1, X)
    assert not event_filter.passes(1, 1, Y)
    listener_of_all = listen(dispatcher, Var())
    dispatcher.remove(listener)
    plan(dispatcher, A(Y))
    assert event_filter.passes(1, 1, X)
    assert event_filter.passes(1, 1, Y)
    dispatcher.remove(listener_of_all)
    plan(dispatcher, A(Y))
    assert not event_filter.passes(1, 1, X)


def test_compiled_clauses_emit_to_new_listener() -> None:
    program = OutputRecorder(SPLIT)
    program.post((X, Y, 1, 1))
    program.engine.call("subscribe(tf(x, C), [], _, t, i)")
    program.post((X, Y, 2, 0), (Y, Y, 3, 0), (X, X, 4, 0))
    assert program.outputs == ["tf(x,y)", "tf(x,x)"]
    program.engine.call("delete_subscription(t, i)")
    program.post((X, Y, 5, 0))
    assert len(program.outputs) == 2


def test_invalid_time_of_unobserved_event_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, "retalis")
    program = OutputRecorder(SPLIT)
    for _ in range(3):
        program.post((X, Y, X, 1))
    assert [record.getMessage() for record in caplog.records] != []


def test_error_in_fused_action_names_event(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, "retalis")
    rules = "null do check(X) <- a(X).\ncheck(X) :- Y is X + 1, new_event(b(Y), 1, 1)."
    program = OutputRecorder(rules, "subscribe(b(_), [], _, t, i)")
    program.engine.post(A(1))
    program.engine.post(A(X))
    program.engine.post(A(2))
    assert program.outputs == ["b(2)", "b(3)"]
    assert program.engine.dispatcher.current is None
    (message,) = [record.getMessage() for record in caplog.records]
    assert "at event a(x)" in message
    assert "x/0" in message


def test_listener_of_fused_action_gets_next_event() -> None:
    rules = "null do more(X) <- a(X).\nmore(X) :- new_event(go, 1, 1), subscribe(a(_), [], _, t, X)."
    program = OutputRecorder(rules)
    program.engine.post(A(X))
    assert program.outputs == []
    program.engine.post(A(Y))
    assert program.outputs == ["a(y)"]


def test_head_after_fused_action_is_dispatched() -> None:
    rules = "b(X) do new_event(c(X), 1, 1) <- a(X).\nd(X) <- c(X) and b(X)."
    program = OutputRecorder(rules, "subscribe(d(_), [], _, t, i)")
    program.engine.post(A(X))
    assert program.outputs == ["d(x)"]


def test_event_on_both_sides_is_one_event() -> None:
    """Only events that its goal derives read the token of an event in a fused action."""
    rules = "null do new_event(b(X), 1, 1) <- a(X).\nc <- b(X) and b(X)."
    plain, observed = (
        OutputRecorder(rules, "subscribe(c, [], _, t, i)"),
        OutputRecorder(rules, "subscribe(c, [], _, t, i)"),
    )
    observed.engine.on_event(lambda term, start, end: None)
    for program in (plain, observed):
        program.engine.post(A(X))
        program.engine.post(A(Y))
    assert plain.outputs == observed.outputs


@pytest.mark.parametrize("goal", ["loop(X)", "events(X)", "build(X, _)"])
def test_limits_stop_goal_of_fused_action(goal: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, "retalis")
    rules = f"""
    null do {goal} <- a(X).
    loop(X) :- loop(X).
    events(X) :- new_event(b(X), 1, 1), events(X).
    build(X, [X|Rest]) :- build(X, Rest).
    c(X) do note(X) <- b(X).
    note(X) :- atom_length(X, _).
    """
    program = OutputRecorder(rules, settings=Settings(Limits(inferences=20_000)))
    for _ in range(2):
        program.engine.post(A(X))
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == 2, messages
    assert all("inferences" in message for message in messages), messages


CONSTANTS = st.sampled_from([atom(name) for name in "xyz"])
ITEMS = st.lists(st.tuples(CONSTANTS, CONSTANTS, st.integers(0, 3), st.integers(0, 9)), max_size=4)
PATTERNS = ["tf(x, C)", "tf(P, y)", "tf(x, y)", "tf(P, P)", "tf(P, C)", "pack(_)"]


@pytest.mark.slow
@given(
    st.lists(ITEMS, min_size=1, max_size=6),
    st.lists(st.sampled_from(PATTERNS), max_size=3),
    st.lists(st.sampled_from(PATTERNS), max_size=2),
)
def test_listener_of_all_events_keeps_outputs(
    stream: List[Any], patterns: List[Any], later_patterns: List[Any]
) -> None:
    """A listener of all events keeps all filters open and all fused actions unused."""
    rules = SPLIT + "e(P) <- tf(P, x) seq tf(P, y).\nnull do new_event(f(P), 1, 1) <- e(P)."
    programs = [
        OutputRecorder(rules, "subscribe(f(_), [], _, t, f)"),
        OutputRecorder(rules, "subscribe(f(_), [], _, t, f)"),
    ]
    programs[1].engine.on_event(lambda term, start, end: None)
    for program in programs:
        for number, pattern in enumerate(patterns):
            program.engine.call(f"subscribe({pattern}, [], _, t, s{number})")
        for number, items in enumerate(stream):
            program.post(*items)
            if number == 0:
                for number, pattern in enumerate(later_patterns):
                    program.engine.call(f"subscribe({pattern}, [], _, t, l{number})")
    assert programs[0].outputs == programs[1].outputs
