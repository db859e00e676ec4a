"""Status of an engine: counters, contents, and current work."""

import json
import threading
from typing import Any, List

import pytest
from checked_threads import CheckedThread, wait_until

from retalis import Engine, Limits, Settings, StreamClock, foreign


@pytest.mark.parametrize(
    ("text", "events"),
    [
        ("a(X) <- b(X).", ["b(1)", "b(2)"]),
        ("a(X) <- b(X) where X > 1.", ["b(1)", "b(2)", "b(3)"]),
        ("a(X) <- b(X) seq c.", ["b(1)", "c", "b(1)", "c"]),
        ("null do true <- b(X).", ["b(1)", "b(2)"]),
        ("null do use(X) <- b(X). use(X) :- X > 1.", ["b(1)", "b(2)", "b(3)"]),
        ("synchronized(a(X), true, []) <- b(X).", ["b(1)", "b(2)"]),
        ("synchronized(a(X), true, [[late, 9]]) <- b(X).", ["b(1)", "b(2)"]),
        ("exceptionAlarm(a, 5) <- b(X).", ["b(1)", "b(2)"]),
        ("event_rule_property(l, event_rule_window, 9). l : a(X) <- b(X).", ["b(1)", "b(2)"]),
    ],
)
@pytest.mark.parametrize("has_listener", [False, True])
@pytest.mark.parametrize("mode", ["", "set_etalis_flag(revision_flag, on)"])
def test_rule_counts_its_firings(text: str, events: List[str], has_listener: bool, mode: str) -> None:
    engine = Engine()
    engine.load(rules=text, goals=mode or "true")
    engine.load(goals="memorize(never, [], _, late, 3)")
    if has_listener:
        engine.on_event(lambda term, start, end: None)
    for time, event in enumerate(events, 1):
        engine.event(event, time)
    rule = engine.status().rules[0]
    assert (rule.fired, rule.last_fired) == (2, len(events) * 10**9)
    assert engine.status().fired == 2
    assert engine.status().taken == len(events)


def test_posted_terms_and_texts_are_counted() -> None:
    engine = Engine(StreamClock(0))
    engine.load(rules="null do use(X) <- b(X). use(_).")
    for _ in range(3):
        engine.post(engine.query("X = b(1)")[0]["X"])
    engine.post_text("event(b(2))")
    assert (engine.status().taken, engine.status().rules[0].fired) == (4, 4)


def test_deleted_rule_keeps_total_counts() -> None:
    engine = Engine()
    engine.load(rules="l : a <- b.")
    engine.event("b", 1)
    engine.call("del_event_rule(l)")
    assert engine.status().rules == ()
    assert engine.status().fired == 1


def test_errors_are_counted_per_rule() -> None:
    engine = Engine()
    engine.load(rules="a <- b(X) where X > 1.\nc <- b(_).", source="mine")
    engine.event("b(many)", 1)
    first, second = engine.status().rules
    assert (first.place, first.errors, second.place, second.errors) == ("mine:1:1", 1, "mine:2:1", 0)
    assert engine.status().errors == 1


def test_patterns_have_named_variables() -> None:
    engine = Engine()
    engine.load(goals="memorize(t(X, Y, f(X)), [], _, m, 3)\nsubscribe(u(_), [], _, out, s)")
    status = engine.status()
    assert status.memories[0].event == "t(X1,_,f(X1))"
    assert status.subscriptions[0].event == "u(_)"
    engine.call("delete_memory(m)")
    assert engine.status().memories == ()


def test_memory_has_span_of_its_records() -> None:
    engine = Engine()
    engine.load(goals="memorize(t(_), [], _, m, 3)\nmemorize(t(_), [], _, none, 0)")
    for second in range(1, 100):
        engine.event(f"t({second})", second)
    memory, empty_memory = engine.status().memories
    assert (memory.records, memory.added, memory.oldest, memory.newest) == (3, 99, 97 * 10**9, 99 * 10**9)
    assert (empty_memory.records, empty_memory.added, empty_memory.oldest, empty_memory.newest) == (
        0,
        99,
        None,
        99 * 10**9,
    )


def test_waiting_query_names_late_memories() -> None:
    engine = Engine()
    engine.load(goals="\n".join(f"memorize({name}, [], _, m_{name}, 3)" for name in "abc"))
    engine.load(rules="synchronized(seen(X), true, [[m_a, 5], [m_b, 6], [m_c, 7]]) <- marker(X).")
    for event, second in (("marker(1)", 4), ("a", 5), ("b", 5)):
        engine.event(event, second)
    waiting = engine.status().waiting
    assert [(entry.event, entry.since) for entry in waiting] == [("seen(1)", 4 * 10**9)]
    assert {tuple(entry) for entry in waiting[0].memories} == {
        ("m_b", 6 * 10**9, 10**9),
        ("m_c", 7 * 10**9, None),
    }


def test_lists_are_bounded_with_count_of_rest() -> None:
    engine = Engine()
    engine.load(goals="\n".join(f"memorize(a, [], _, m{number}, 3)" for number in range(150)))
    engine.load(rules="\n".join(f"a{number} <- b({number}) where 1 < X." for number in range(150)))
    engine.event("b(149)", 1)
    status = engine.status()
    assert (len(status.rules), len(status.memories)) == (100, 100)
    assert tuple(status.left_out) == (50, 50, 0, 0)
    assert [rule.errors for rule in status.rules] == [0] * 99 + [1]
    assert engine.status(most=0).left_out.rules == 150
    long = Engine()
    long.load(goals=f"memorize({'f(' * 5000}x{')' * 5000}, [], _, m, 3)")
    assert len(json.dumps(long.status().json())) < 1000


def test_status_is_converted_to_json() -> None:
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(x, true, [[m, 9]]) <- b.")
    engine.event("b", 1)
    read = json.loads(json.dumps(engine.status().json()))
    assert read["waiting"][0]["memories"] == [{"id": "m", "instant": 9 * 10**9, "behind": None}]
    assert read["work"] is None
    assert read["rules"][0]["fired"] == 1


def test_pending_alarms_are_counted() -> None:
    engine = Engine()
    engine.load(rules="exceptionAlarm(late, 5) <- start.")
    engine.event("start", 1)
    assert (engine.status().alarms, engine.status().next_alarm) == (1, 6 * 10**9)


def test_status_of_busy_engine_names_its_work() -> None:
    released = threading.Event()

    @foreign
    def waits_until_released() -> bool:
        return released.wait(60)

    engine = Engine(settings=Settings(limits=Limits(seconds=60.0)))
    engine.add_foreign(waits_until_released)
    engine.load(rules="alarm <- fire where waits_until_released.", source="mine")
    thread = CheckedThread(engine.event, "fire", 1)
    thread.start()

    def find_running_goal() -> Any:
        work = engine.status().work
        return work if work is not None and work.goal else None

    try:
        wait_until(find_running_goal, "the goal is running")
        work = find_running_goal()
        engine.post_text("event(fire)")
        status = engine.status()
    finally:
        released.set()
    thread.end()
    assert status.work is not None
    assert status.work.what == "fire"
    assert status.work.event == "fire"
    assert "rule alarm: goal" in status.work.goal
    assert status.work.place.startswith("mine:1:")
    assert status.work.seconds >= work.seconds >= 0
    assert status.queued == 1
    assert len(status.rules) == 1


def test_status_is_available_in_callback() -> None:
    engine = Engine()
    engine.load(goals="subscribe(fire, [], _, alarms, a)")
    statuses: List[Any] = []
    engine.on_output(lambda term, topic, name: statuses.append(engine.status()))
    engine.event("fire", 1)
    assert statuses[0].work.what == "fire"
    assert statuses[0].subscriptions[0].sent == 1
