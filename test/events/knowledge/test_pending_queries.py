"""Synchronized queries: time, number and interval of their calls.

If only the queries listen to the synchronized events of a rule, these are not created: most tests run
both ways.
"""

import logging
import re
from typing import Any, List

import pytest
from recording_engine import RecordingEngine

from retalis import Engine, Limits, Settings, Term, Var, atom, functor
from retalis.events.dispatch.dispatcher import Dispatcher
from retalis.events.dispatch.listeners import DEPTH, ListenerPhase

QUERY_RULE = "syncronized(answer(X, V), (prev(m, v(V), _, _, T)), [[m, T]]) <- ask(X, T).\n"
MEMORY = "memorize(v(_), [], _, m, 10)\n"


class SelectiveEngine(Engine):
    """An engine that records events of a few types as text, and has no listener for others."""

    def __init__(self, rules: str = "", goals: str = "", **settings: Any) -> None:
        super().__init__(settings=Settings(**settings))
        self.events: List[Any] = []
        for name, arity in RECORDED_TYPES:
            pattern = functor(name, arity)(*(Var() for _ in range(arity))) if arity else atom(name)
            self.dispatcher.listen(ListenerPhase.TRACE, pattern, self._record)
        self.load(rules=rules, goals=goals)

    def _record(self, term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        self.events.append((self.show(term), int(start), int(end)))
        return frame


RECORDED_TYPES = (("a", 0), ("done", 0), ("answer", 2), ("done", 1), ("done", 2), ("v", 1))


@pytest.fixture(params=[RecordingEngine, SelectiveEngine], ids=["created", "not created"])
def make_engine(request: pytest.FixtureRequest) -> Any:
    return request.param


def answers(engine: Any) -> List[Any]:
    return [event for event in engine.events if event[0].startswith(("answer", "done"))]


def names(engine: Any) -> List[Any]:
    return [event for event, _, _ in answers(engine)]


def test_status_shows_last_query(make_engine: Any) -> None:
    engine = make_engine(QUERY_RULE, MEMORY)
    for second in (5, 7):
        engine.event("ask(1, 0)", second)
    (rule,) = engine.status().rules
    assert (rule.fired, rule.last_fired) == (2, 7 * 10**9)


def test_query_with_data_is_called_immediately(make_engine: Any) -> None:
    engine = make_engine(QUERY_RULE, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 10)", 3, 4)
    assert answers(engine) == [("answer(a,1)", 3 * 10**9, 4 * 10**9)]


def test_query_waits_for_data(make_engine: Any) -> None:
    engine = make_engine(QUERY_RULE, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 20)", 3)
    engine.event("v(2)", 19)
    assert answers(engine) == []
    engine.event("v(3)", 20)
    engine.event("v(4)", 30)
    assert answers(engine) == [("answer(a,3)", 3 * 10**9, 3 * 10**9)]
    assert len(engine.knowledge.pending_queries) == 0


def test_both_spellings_are_accepted(make_engine: Any) -> None:
    engine = make_engine(QUERY_RULE.replace("syncronized", "synchronized"), MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 10)", 3)
    assert names(engine) == ["answer(a,1)"]


def test_query_waits_for_all_memories(make_engine: Any) -> None:
    rules = "syncronized(done(X), true, [[m, 10], [n, 20]]) <- ask(X)."
    engine = make_engine(rules, MEMORY + "memorize(w(_), [], _, n, 10)")
    engine.event("ask(a)", 1)
    engine.event("v(1)", 30)
    engine.event("w(1)", 19)
    assert names(engine) == []
    engine.event("w(2)", 21)
    assert names(engine) == ["done(a)"]


def test_query_emits_first_solution_only(make_engine: Any) -> None:
    rules = (
        "syncronized(done(Y), member(Y, [1, 2]), [[m, T]]) <- ask(T).\n"
        "syncronized(done(no), fail, [[m, T]]) <- ask(T).\n"
    )
    engine = make_engine(rules, MEMORY)
    engine.event("ask(20)", 1)
    engine.event("v(1)", 20)
    engine.event("ask(20)", 2)
    assert names(engine) == ["done(1)", "done(1)"]


def test_queries_are_called_in_order_of_arrival(make_engine: Any) -> None:
    engine = make_engine("syncronized(done(X), true, [[m, T]]) <- ask(X, T).", MEMORY)
    for name, time in (("a", 30), ("b", 10), ("c", 20), ("d", 99)):
        engine.event(f"ask({name}, {time})", 1)
    engine.event("v(1)", 40)
    assert names(engine) == ["done(a)", "done(b)", "done(c)"]


def test_query_is_complete_before_next_call(make_engine: Any) -> None:
    rules = (
        "syncronized(done(X), note(X), [[m, T]]) <- ask(X, T).\n"
        "note(X) :- findall(Y, seen(Y), L), assertz(seen(X)), assertz(before(X, L)).\n"
        "null do assertz(seen(after(X))) <- done(X).\n"
        ":- dynamic(seen/1). :- dynamic(before/2).\n"
    )
    engine = make_engine(rules, MEMORY)
    engine.event("ask(a, 10)", 1)
    engine.event("ask(b, 10)", 1)
    engine.event("v(1)", 10)
    assert engine.query("before(b, [a, after(a)])") == [{}]


def test_query_precedes_rules_of_releasing_event(make_engine: Any) -> None:
    engine = make_engine("syncronized(done(X), true, [[m, 10]]) <- ask(X).\ndone(rule) <- v(_).", MEMORY)
    engine.event("ask(a)", 1)
    engine.event("v(1)", 10)
    assert names(engine) == ["done(a)", "done(rule)"]


@pytest.mark.parametrize(
    "time",
    ["Z", "[S, NS]", "D"],
    ids=["float", "ros time", "datime"],
)
def test_times_may_be_floats_ros_times_or_datimes(make_engine: Any, time: str) -> None:
    rules = (
        f"syncronized(done(X), true, [[m, {time}]]) <- ask(X, S, NS) "
        "where (Z is S + (NSX), convert_to_datime([S, NS], D)).".replace("NSX", "NS * 0.000000001")
    )
    engine = make_engine(rules, MEMORY)
    engine.event("ask(a, 1413748205, 981209993)", 1)
    engine.post_text("new_event(v(0), 1413748205, 981209000)")
    assert names(engine) == []
    engine.post_text("new_event(v(1), 1413748205, 981209993)")
    assert names(engine) == ["done(a)"]


@pytest.mark.parametrize(
    ("conditions", "pattern", "message"),
    [
        ("[[nothing, 1]]", "ask", "no memory nothing"),
        ("C", "ask where C = [m]", "[MemoryId, Time]"),
        ("C", "ask where C = x", "list"),
        ("[[m, soon]]", "ask", "datime"),
    ],
)
def test_invalid_conditions_are_reported(
    make_engine: Any, conditions: str, pattern: str, message: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make_engine(f"syncronized(done, true, {conditions}) <- {pattern}.", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
    assert message in caplog.text
    assert answers(engine) == []
    assert len(engine.knowledge.pending_queries) == 0


def test_error_of_query_is_reported(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(done, X is a + 1, []) <- ask.", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
    assert "evaluable" in caplog.text
    assert answers(engine) == []


@pytest.mark.parametrize("conditions", ["[]", "[[m, 10]]"])
def test_query_result_that_is_no_event_is_reported(
    make_engine: Any, conditions: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make_engine(f"syncronized(X, X = 1, {conditions}) <- ask. done <- ask. done(V) <- v(V).", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
        engine.event("v(1)", 10)
    assert "1 is dropped" in caplog.text
    assert names(engine) == ["done", "done(1)"]
    assert engine.dispatcher.current is None


def test_endless_chain_of_queries_is_reported(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(a, true, []) <- a. done <- b. b <- c. a <- c. done <- c.", max_depth=20)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("c", 1)
    assert "20 events" in caplog.text
    assert names(engine) == ["done", "done"]


def test_deleted_memory_drops_pending_queries(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(done(X), true, [[m, 10]]) <- ask(X).", MEMORY)
    engine.event("ask(a)", 1)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.call("delete_memory(m)")
    assert "done(a)" in caplog.text
    engine.call_goals(MEMORY, "again")
    engine.event("v(1)", 20)
    assert answers(engine) == []


def test_derived_query_waits_for_its_own_data(make_engine: Any) -> None:
    rules = (
        "syncronized(done(1, T2), true, [[m, T1]]) <- ask(T1, T2).\n"
        "syncronized(done(2), true, [[m, T2]]) <- done(1, T2).\n"
    )
    engine = make_engine(rules, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(10, 20)", 11)
    assert names(engine) == ["done(1,20)"]
    engine.event("v(2)", 20)
    assert names(engine) == ["done(1,20)", "done(2)"]


def test_pending_queries_are_limited(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(done(X), true, [[m, 10]]) <- ask(X).", MEMORY)
    engine.knowledge.pending_queries.limit = 3
    with caplog.at_level(logging.WARNING, "retalis"):
        for number in range(5):
            engine.event(f"ask({number})", 1)
    assert "more than 3 queries wait" in caplog.text
    engine.event("v(1)", 10)
    assert names(engine) == ["done(2)", "done(3)", "done(4)"]


def test_dropped_queries_leave_memory(make_engine: Any) -> None:
    engine = make_engine("syncronized(done(X), true, [[m, 10], [m, 11]]) <- ask(X).", MEMORY)
    engine.knowledge.pending_queries.limit = 3
    for number in range(50):
        engine.event(f"ask({number})", 1)
    (memory,) = engine.knowledge.memories
    assert len(memory.instants) <= 2 * 3 + 16
    engine.event("v(1)", 10)
    assert names(engine) == []
    engine.event("v(1)", 11)
    assert names(engine) == ["done(47)", "done(48)", "done(49)"]


def test_repeated_drops_are_reported_seldom(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(done(X), true, [[nothing, 1]]) <- ask(X).", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        for number in range(100):
            engine.event(f"ask({number})", 1)
    assert len(caplog.records) == 7


@pytest.mark.fused
def test_unobserved_query_events_are_not_created(monkeypatch: pytest.MonkeyPatch) -> None:
    dispatched, dispatch = [], Dispatcher.dispatch

    def recording_dispatch(dispatcher: Any, term: Any, *rest: Any) -> Any:
        dispatched.append(term[0].name)
        return dispatch(dispatcher, term, *rest)

    monkeypatch.setattr(Dispatcher, "dispatch", recording_dispatch)
    engine = SelectiveEngine("syncronized(done(X), true, [[m, 10]]) <- ask(X).", MEMORY)
    engine.event("ask(a)", 1)
    engine.event("v(1)", 10)
    assert names(engine) == ["done(a)"]
    assert "syncronized" not in dispatched
    engine.event("syncronized(done(b), true, [[m, 10]])", 1)
    engine.load(rules="done(heard) <- syncronized(_, _, _).")
    engine.event("ask(c)", 1)
    assert names(engine) == ["done(a)", "done(b)", "done(c)", "done(heard)"]


def without_variable_numbers(text: Any) -> str:
    """Return a report without numbers of variables and callers of built-ins."""
    return re.sub(r"_G?\d+", "_", text).replace(" (in (is)/2)", "")


@pytest.mark.parametrize("depth", range(1, 12))
def test_omitted_events_count_for_depth_limit(depth: int, caplog: pytest.LogCaptureFixture) -> None:
    rules = "syncronized(a, true, []) <- a. syncronized(done, true, []) <- a. done(1) <- done. a <- done(1)."
    results: List[Any] = []
    for engine_type in (RecordingEngine, SelectiveEngine):
        engine = engine_type(rules, max_depth=depth)
        with caplog.at_level(logging.WARNING, "retalis"):
            engine.event("a", 1)
        events = [event for event in engine.events if not event[0].startswith("sync")]
        results.append((events, [record.message for record in caplog.records]))
        caplog.clear()
    assert results[0] == results[1]


def test_depth_after_omitted_event() -> None:
    engine = SelectiveEngine(
        "syncronized(done(Y), true, []) <- a event_multiply member(Y, [1, 2, 3, 4, 5, 6]).\n"
        "t <- memory_updated(m, _).",
        "memorize(done(_), [], _, m, 10)",
    )
    depths: List[Any] = []

    def record_depth(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        depths.append(engine.dispatcher.current[DEPTH])
        return frame

    engine.dispatcher.listen(ListenerPhase.TRACE, functor("done", 1)(Var()), record_depth)
    engine.event("a", 1)
    assert depths == [3] * 6


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        ("done(X), X = f(Y), []", ["done(f(_))"]),
        ("done(Y), member(X, [1, 2]), [[m, 0]]", ["done(_)"]),
        ("Query, (Query = done(X), X = 2), []", ["done(2)"]),
        ("done(X), T, []", ["done(_)"]),
        ("done(X), Unknown, []", []),
        ("done(T), N, []", []),
        ("done(T), (! ; fail), []", ["done(true)"]),
        ("done(T), undefined_predicate(T), []", []),
        ("done(T), deeper, []", []),
        ("done(X), X is foo + 1, []", []),
        ("N, true, []", []),
        ("done(T), true, [[X, 0]]", []),
        ("done(T), true, [[m, X]]", []),
        ("done(T), true, [[m, datime(1970, 1, 1, 0, 0, 0, 1)], [m, 0.5], [m, [0, 1]]]", ["done(true)"]),
        ("done(T), true, T", []),
        ("done(A), A = T, [[m, 1], [m, 1]]", ["done(true)"]),
    ],
)
def test_omission_of_event_keeps_query(
    head: str, expected: List[str], caplog: pytest.LogCaptureFixture
) -> None:
    reports: List[Any] = []
    for engine_type in (RecordingEngine, SelectiveEngine):
        condition = " where N = 3" if "N" in head else ""
        engine = engine_type(f"syncronized({head}) <- ask(T){condition}.\ndeeper :- missing.", MEMORY)
        engine.event("v(1)", 5)
        caplog.clear()  # the reports about the rule itself
        with caplog.at_level(logging.WARNING, "retalis"):
            engine.event("ask(true)", 1)
        assert [without_variable_numbers(name) for name in names(engine)] == expected
        reports.append([without_variable_numbers(record.message) for record in caplog.records])
    assert reports[0] == reports[1]
    assert bool(reports[0]) == (not expected)


def test_variables_of_event_are_shared_with_query(make_engine: Any) -> None:
    engine = make_engine("syncronized(done(X), X = Y, [[m, 10]]) <- ask(X, Y).", MEMORY)
    engine.event("ask(p(A, B), p(B, c))", 1)
    engine.event("v(1)", 10)
    assert names(engine) == ["done(p(c,c))"]


def test_query_waits_for_memories_in_any_order() -> None:
    goals = "".join(f"memorize(e({name}), [], _, {name}, 10)\n" for name in "pqr")
    engine = SelectiveEngine("syncronized(done(X), true, [[p, 10], [q, T], [r, 30]]) <- ask(X, T).", goals)
    engine.event("ask(a, 20)", 1)
    engine.event("ask(b, 25)", 1)
    for name, time in (("r", 30), ("p", 9), ("q", 20), ("p", 10), ("q", 24)):
        assert names(engine) == []
        engine.event(f"e({name})", time)
        if (name, time) == ("p", 10):
            assert names(engine) == ["done(a)"]
            engine.events.clear()
    engine.event("e(q)", 25)
    assert names(engine) == ["done(b)"]
    assert len(engine.knowledge.pending_queries) == 0


def test_deleted_memory_keeps_queries_with_its_data(make_engine: Any) -> None:
    rules = "syncronized(done(X), true, [[m, T], [n, 50]]) <- ask(X, T)."
    engine = make_engine(rules, MEMORY + "memorize(w(_), [], _, n, 10)")
    engine.event("v(1)", 20)
    engine.event("ask(a, 20)", 1)
    engine.event("ask(b, 30)", 1)
    engine.call("delete_memory(m)")
    assert len(engine.knowledge.pending_queries) == 1
    engine.event("w(1)", 50)
    assert names(engine) == ["done(a)"]


@pytest.mark.parametrize(
    ("rules", "goals"),
    [
        ("syncronized(done, loop, []) <- in.", ""),
        ("", "memorize(in, [loop], _, m, 10)"),
        ("", "subscribe(in, [loop], _, t, s)"),
    ],
    ids=["query", "memory", "subscription"],
)
def test_limit_of_caller_is_error_of_caller(
    make_engine: Any, rules: str, goals: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make_engine("loop :- loop.\ndone(1) <- in.\n" + rules, goals)
    goal = "catch(call_with_time_limit(0.05, new_event(in, [1, 1])), R, true)"
    (answer,) = engine.query(goal)
    assert engine.show(answer["R"]) == "time_limit_exceeded"
    assert names(engine) == ["done(1)"]
    assert "the time limit of a calling goal has been reached" in caplog.text


@pytest.mark.parametrize("goal", ["", "do noted(X) ", "do noted(X, T) "])
def test_messages_may_trigger_queries(make_engine: Any, goal: str) -> None:
    rule = f"syncronized(done(X), true, [[m, T]]) {goal}<- ask(X, T).\n"
    engine = make_engine(rule + "noted(_).\nnoted(X, T) :- noted(X), noted(T).", MEMORY)
    make_query, value = functor("ask", 2), functor("v", 1)
    for second in range(1, 21):
        engine.post(value(second), second * 10**9)
        engine.post(make_query(second, float(second + second % 2)), second * 10**9)
    assert names(engine) == [f"done({second})" for second in range(1, 21)]


def test_error_in_query_of_message_is_isolated(make_engine: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make_engine("syncronized(done(X), X > 1, [[m, T]]) <- ask(X, T).\ndone(rule) <- v(_).", MEMORY)
    make_query, value = functor("ask", 2), functor("v", 1)
    engine.post(value(0), 10**9)
    arguments: List[Term] = [2, atom("a"), 3, atom("b")]
    for second, argument in enumerate(arguments, 1):
        engine.post(make_query(argument, 1.0), second * 10**9)
        assert engine.dispatcher.current is None
    engine.post(value(1), 20 * 10**9)
    assert names(engine) == ["done(rule)", "done(2)", "done(3)", "done(rule)"]
    assert "done(a) is dropped, its query raised" in caplog.text


@pytest.mark.parametrize("query", ["member(X, [1, 2])", "(new_event(v(2), 20, 0), X = 1)"])
def test_queries_of_messages_may_call_goals(make_engine: Any, query: str) -> None:
    engine = make_engine(
        f"syncronized(done(X), {query}, [[m, T]]) <- ask(T).\nnull do member(_, [1]) <- done(_).", MEMORY
    )
    make_query, value = functor("ask", 1), functor("v", 1)
    engine.post(value(0), 10**9)
    engine.post(make_query(1.0), 2 * 10**9)
    engine.post(make_query(10.0), 3 * 10**9)
    engine.post(value(1), 11 * 10**9)
    assert names(engine) == ["done(1)", "done(1)"]
    assert engine.dispatcher.current is None


@pytest.mark.parametrize("goal", ["loop", "length(_, 3000000)"])
def test_limits_apply_to_each_query(make_engine: Any, goal: str, caplog: pytest.LogCaptureFixture) -> None:
    rules = f"loop :- loop.\nsyncronized(done(X), {goal}, [[m, T]]) <- ask(X, T).\ndone(rule) <- v(_)."
    engine = make_engine(rules, MEMORY, limits=Limits(inferences=3000))
    make_query, value = functor("ask", 2), functor("v", 1)
    engine.post(value(0), 10**9)
    for number, second in ((1, 1.0), (2, 2.0), (3, 2.0)):
        engine.post(make_query(number, second), 10**9)
    engine.post(value(1), 2 * 10**9)
    assert names(engine) == ["done(rule)", "done(rule)"]
    assert "done(1) is dropped, its query raised: Not enough resources: inferences" in caplog.text
    assert "done(2) is dropped, its query raised: Not enough resources: inferences" in caplog.text


def test_query_of_message_may_derive_long_chain(make_engine: Any) -> None:
    rules = "syncronized(c(1), true, [[m, T]]) <- ask(T).\nc(Y) <- c(X) where (X < 20, Y is X + 1).\n"
    engine = make_engine(rules + "done(X) <- c(X) where (X = 20).", MEMORY)
    make_query, value = functor("ask", 1), functor("v", 1)
    engine.post(value(0), 10**9)
    for second in (1.0, 1.0, 5.0):
        engine.post(make_query(second), 10**9)
        assert engine.dispatcher.current is None
    engine.post(value(1), 5 * 10**9)
    assert names(engine) == ["done(20)"] * 3


def test_pending_queries_are_restored(make_engine: Any) -> None:
    memories = MEMORY + "memorize(w, [], _, n, 5)\n"
    rules = QUERY_RULE.replace("[[m, T]]", "[[m, T], [n, T]]")
    first, second = make_engine(rules, memories), make_engine(rules, memories)
    for number, instant in ((1, 1.0), (2, 2.0)):
        first.event(f"ask({number}, {instant})", instant)
    state = first.knowledge.pending_queries.snapshot()
    second.knowledge.pending_queries.restore(state)
    assert len(second.knowledge.pending_queries) == 2
    assert second.knowledge.pending_queries.snapshot() == state
    second.event("v(7)", 1)
    second.event("w", 1)
    second.event("v(8)", 3)
    assert names(second) == ["answer(1,7)"]
    second.event("w", 3)
    assert names(second) == ["answer(1,7)", "answer(2,7)"]
    assert len(second.knowledge.pending_queries) == 0
