"""Synchronized queries: when they are called, how often, with which interval."""

import logging
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
from watched import Watched  # noqa: E402

ASK = "syncronized(answer(X, V), (prev(m, v(V), _, _, T)), [[m, T]]) <- ask(X, T).\n"
MEMORY = "memorize(v(_), [], _, m, 10)\n"


def answers(engine):
    return [event for event in engine.events if event[0].startswith(("answer", "done"))]


def names(engine):
    return [event for event, _, _ in answers(engine)]


def test_a_query_that_has_its_data_is_called_at_once():
    engine = Watched(ASK, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 10)", 3, 4)
    assert answers(engine) == [("answer(a,1)", 3 * 10**9, 4 * 10**9)]


def test_another_waits_and_is_called_once_with_the_interval_of_its_own_event():
    engine = Watched(ASK, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 20)", 3)
    engine.event("v(2)", 19)
    assert answers(engine) == []
    engine.event("v(3)", 20)
    engine.event("v(4)", 30)
    assert answers(engine) == [("answer(a,3)", 3 * 10**9, 3 * 10**9)]
    assert len(engine.knowledge.waiting) == 0


def test_both_spellings_hold():
    engine = Watched(ASK.replace("syncronized", "synchronized"), MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(a, 10)", 3)
    assert names(engine) == ["answer(a,1)"]


def test_all_memories_have_to_be_there():
    rules = "syncronized(done(X), true, [[m, 10], [n, 20]]) <- ask(X)."
    engine = Watched(rules, MEMORY + "memorize(w(_), [], _, n, 10)")
    engine.event("ask(a)", 1)
    engine.event("v(1)", 30)
    engine.event("w(1)", 19)
    assert names(engine) == []
    engine.event("w(2)", 21)
    assert names(engine) == ["done(a)"]


def test_the_first_solution_counts_and_none_triggers_nothing():
    rules = (
        "syncronized(done(Y), member(Y, [1, 2]), [[m, T]]) <- ask(T).\n"
        "syncronized(done(no), fail, [[m, T]]) <- ask(T).\n"
    )
    engine = Watched(rules, MEMORY)
    engine.event("ask(20)", 1)
    engine.event("v(1)", 20)
    engine.event("ask(20)", 2)
    assert names(engine) == ["done(1)", "done(1)"]


def test_queries_are_released_in_the_order_they_came_in():
    engine = Watched("syncronized(done(X), true, [[m, T]]) <- ask(X, T).", MEMORY)
    for name, time in (("a", 30), ("b", 10), ("c", 20), ("d", 99)):
        engine.event(f"ask({name}, {time})", 1)
    engine.event("v(1)", 40)
    assert names(engine) == ["done(a)", "done(b)", "done(c)"]


def test_each_is_finished_before_the_next_is_called():
    rules = (
        "syncronized(done(X), note(X), [[m, T]]) <- ask(X, T).\n"
        "note(X) :- findall(Y, seen(Y), L), assertz(seen(X)), assertz(before(X, L)).\n"
        "null do assertz(seen(after(X))) <- done(X).\n"
        ":- dynamic(seen/1). :- dynamic(before/2).\n"
    )
    engine = Watched(rules, MEMORY)
    engine.event("ask(a, 10)", 1)
    engine.event("ask(b, 10)", 1)
    engine.event("v(1)", 10)
    assert engine.query("before(b, [a, after(a)])") == [{}]


def test_a_query_is_called_before_the_rules_of_the_event_that_releases_it():
    engine = Watched("syncronized(done(X), true, [[m, 10]]) <- ask(X).\ndone(rule) <- v(_).", MEMORY)
    engine.event("ask(a)", 1)
    engine.event("v(1)", 10)
    assert names(engine) == ["done(a)", "done(rule)"]


@pytest.mark.parametrize(
    "time",
    ["Z", "[S, NS]", "D"],
    ids=["float", "ros time", "datime"],
)
def test_times_are_floats_ros_times_or_stamps(time):
    rules = (
        f"syncronized(done(X), true, [[m, {time}]]) <- ask(X, S, NS) "
        "where (Z is S + (NSX), convert_to_datime([S, NS], D)).".replace("NSX", "NS * 0.000000001")
    )
    engine = Watched(rules, MEMORY)
    engine.event("ask(a, 1413748205, 981209993)", 1)
    engine.post_text("new_event(v(0), 1413748205, 981209000)")
    assert names(engine) == []
    engine.post_text("new_event(v(1), 1413748205, 981209993)")
    assert names(engine) == ["done(a)"]


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ("[[nothing, 1]]", "no memory nothing"),
        ("[m]", "[MemoryId, Time]"),
        ("x", "list"),
        ("[[m, soon]]", "datime"),
    ],
)
def test_wrong_conditions_are_reported_and_the_event_is_dropped(conditions, message, caplog):
    engine = Watched(f"syncronized(done, true, {conditions}) <- ask.", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
    assert message in caplog.text
    assert answers(engine) == []
    assert len(engine.knowledge.waiting) == 0


def test_a_query_that_raises_is_reported(caplog):
    engine = Watched("syncronized(done, X is a + 1, []) <- ask.", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
    assert "evaluable" in caplog.text
    assert answers(engine) == []


@pytest.mark.parametrize("when", ["[]", "[[m, 10]]"])
def test_a_query_that_gives_no_event_is_reported_and_the_rest_goes_on(when, caplog):
    engine = Watched(f"syncronized(X, X = 1, {when}) <- ask. done <- ask. done(V) <- v(V).", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("ask", 1)
        engine.event("v(1)", 10)
    assert "1 is dropped" in caplog.text
    assert names(engine) == ["done", "done(1)"]
    assert engine.dispatcher.current is None


def test_a_chain_of_synchronized_events_without_end_is_an_error_of_its_own(caplog):
    engine = Watched("syncronized(a, true, []) <- a. done <- b. b <- c. a <- c. done <- c.", max_depth=20)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("c", 1)
    assert "20 events" in caplog.text
    assert names(engine) == ["done", "done"]


def test_deleting_a_memory_drops_its_waiting_queries_with_a_warning(caplog):
    engine = Watched("syncronized(done(X), true, [[m, 10]]) <- ask(X).", MEMORY)
    engine.event("ask(a)", 1)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.call("delete_memory(m)")
    assert "done(a)" in caplog.text
    engine.call_goals(MEMORY, "again")
    engine.event("v(1)", 20)
    assert answers(engine) == []


def test_a_chain_of_synchronized_events_waits_for_each_anew():
    rules = (
        "syncronized(done(1, T2), true, [[m, T1]]) <- ask(T1, T2).\n"
        "syncronized(done(2), true, [[m, T2]]) <- done(1, T2).\n"
    )
    engine = Watched(rules, MEMORY)
    engine.event("v(1)", 10)
    engine.event("ask(10, 20)", 11)
    assert names(engine) == ["done(1,20)"]
    engine.event("v(2)", 20)
    assert names(engine) == ["done(1,20)", "done(2)"]


def test_those_that_wait_are_bounded(caplog):
    engine = Watched("syncronized(done(X), true, [[m, 10]]) <- ask(X).", MEMORY)
    engine.knowledge.waiting._limit = 3
    with caplog.at_level(logging.WARNING, "retalis"):
        for number in range(5):
            engine.event(f"ask({number})", 1)
    assert "more than 3 queries wait" in caplog.text
    engine.event("v(1)", 10)
    assert names(engine) == ["done(2)", "done(3)", "done(4)"]


def test_a_memory_without_events_does_not_pile_up_what_was_dropped():
    engine = Watched("syncronized(done(X), true, [[m, 10], [m, 11]]) <- ask(X).", MEMORY)
    engine.knowledge.waiting._limit = 3
    for number in range(50):
        engine.event(f"ask({number})", 1)
    (memory,) = engine.knowledge.memories
    assert len(memory.waiting) <= 2 * 3
    engine.event("v(1)", 10)
    assert names(engine) == []
    engine.event("v(1)", 11)
    assert names(engine) == ["done(47)", "done(48)", "done(49)"]


def test_what_is_dropped_again_and_again_is_no_flood(caplog):
    engine = Watched("syncronized(done(X), true, [[nothing, 1]]) <- ask(X).", MEMORY)
    with caplog.at_level(logging.WARNING, "retalis"):
        for number in range(100):
            engine.event(f"ask({number})", 1)
    assert len(caplog.records) == 7
