"""What an engine tells of itself: counters, what it holds, and what it is busy with."""

import json
import threading

import pytest

from retalis import Engine, Limits, Settings, StreamClock, foreign


def rules_of(engine):
    return {rule.text: rule for rule in engine.status().rules}


@pytest.mark.parametrize(
    "text, events",
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
@pytest.mark.parametrize("wanted", [False, True])
@pytest.mark.parametrize("mode", ["", "set_etalis_flag(revision_flag, on)"])
def test_rules_count_how_often_they_fired(text, events, wanted, mode):
    engine = Engine()
    engine.load(rules=text, goals=mode or "true")
    engine.load(goals="memorize(never, [], _, late, 3)")
    if wanted:
        engine.on_event(lambda term, start, end: None)
    for at, event in enumerate(events, 1):
        engine.event(event, at)
    rule = engine.status().rules[0]
    assert (rule.fired, rule.last_fired) == (2, len(events) * 10**9)
    assert engine.status().fired == 2
    assert engine.status().taken == len(events)


def test_posted_messages_count_as_taken_in_every_way():
    engine = Engine(StreamClock(0))
    engine.load(rules="null do use(X) <- b(X). use(_).")
    for _ in range(3):
        engine.post(engine.query("X = b(1)")[0]["X"])
    engine.post_text("event(b(2))")
    assert (engine.status().taken, engine.status().rules[0].fired) == (4, 4)


def test_counts_stay_when_a_rule_is_deleted():
    engine = Engine()
    engine.load(rules="l : a <- b.")
    engine.event("b", 1)
    engine.call("del_event_rule(l)")
    assert engine.status().rules == () and engine.status().fired == 1


def test_errors_are_those_of_their_rule():
    engine = Engine()
    engine.load(rules="a <- b(X) where X > 1.\nc <- b(_).", source="mine")
    engine.event("b(many)", 1)
    first, second = engine.status().rules
    assert (first.place, first.errors, second.place, second.errors) == ("mine:1:1", 1, "mine:2:1", 0)
    assert engine.status().errors == 1


def test_variables_have_names():
    engine = Engine()
    engine.load(goals="memorize(t(X, Y, f(X)), [], _, m, 3)\nsubscribe(u(_), [], _, out, s)")
    status = engine.status()
    assert status.memories[0].event == "t(X1,_,f(X1))" and status.subscriptions[0].event == "u(_)"
    engine.call("delete_memory(m)")
    assert engine.status().memories == ()


def test_a_memory_tells_its_span_when_it_has_dropped_records():
    engine = Engine()
    engine.load(goals="memorize(t(_), [], _, m, 3)\nmemorize(t(_), [], _, none, 0)")
    for second in range(1, 100):
        engine.event(f"t({second})", second)
    kept, none = engine.status().memories
    assert (kept.records, kept.added, kept.oldest, kept.newest) == (3, 99, 97 * 10**9, 99 * 10**9)
    assert (none.records, none.added, none.oldest, none.newest) == (0, 99, None, 99 * 10**9)


def test_a_waiting_query_names_the_memories_that_are_behind():
    engine = Engine()
    engine.load(goals="\n".join(f"memorize({one}, [], _, m_{one}, 3)" for one in "abc"))
    engine.load(rules="synchronized(seen(X), true, [[m_a, 5], [m_b, 6], [m_c, 7]]) <- marker(X).")
    for event, second in (("marker(1)", 4), ("a", 5), ("b", 5)):
        engine.event(event, second)
    waiting = engine.status().waiting
    assert [(one.event, one.since) for one in waiting] == [("seen(1)", 4 * 10**9)]
    assert {tuple(one) for one in waiting[0].memories} == {
        ("m_b", 6 * 10**9, 10**9),
        ("m_c", 7 * 10**9, None),
    }


def test_lists_are_bounded_and_the_rest_is_counted():
    engine = Engine()
    engine.load(goals="\n".join(f"memorize(a, [], _, m{at}, 3)" for at in range(150)))
    engine.load(rules="\n".join(f"a{at} <- b({at}) where 1 < X." for at in range(150)))
    engine.event("b(149)", 1)
    status = engine.status()
    assert (len(status.rules), len(status.memories)) == (100, 100)
    assert tuple(status.left_out) == (50, 50, 0, 0)
    assert [rule.errors for rule in status.rules] == [0] * 99 + [1]
    assert engine.status(most=0).left_out.rules == 150
    long = Engine()
    long.load(goals=f"memorize({'f(' * 5000}x{')' * 5000}, [], _, m, 3)")
    assert len(json.dumps(long.status().json())) < 1000


def test_a_status_is_json():
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(x, true, [[m, 9]]) <- b.")
    engine.event("b", 1)
    read = json.loads(json.dumps(engine.status().json()))
    assert read["waiting"][0]["memories"] == [{"id": "m", "instant": 9 * 10**9, "behind": None}]
    assert read["work"] is None and read["rules"][0]["fired"] == 1


def test_alarms_that_are_set_are_told():
    engine = Engine()
    engine.load(rules="exceptionAlarm(late, 5) <- start.")
    engine.event("start", 1)
    assert (engine.status().alarms, engine.status().next_alarm) == (1, 6 * 10**9)


def test_a_busy_engine_tells_at_once_with_what():
    told = threading.Event()

    @foreign
    def waits_until_told() -> bool:
        return told.wait(60)

    engine = Engine(settings=Settings(limits=Limits(seconds=60.0)))
    engine.add_foreign(waits_until_told)
    engine.load(rules="alarm <- fire where waits_until_told.", source="mine")
    thread = threading.Thread(target=engine.event, args=("fire", 1), daemon=True)
    thread.start()
    work = None
    while work is None or not work.goal:  # until it has come so far
        work = engine.status().work
    engine.post_text("event(fire)")
    status = engine.status()
    told.set()
    thread.join()
    assert status.work.what == "fire" and status.work.event == "fire"
    assert "rule alarm: goal" in status.work.goal and status.work.place.startswith("mine:1:")
    assert status.work.seconds >= work.seconds >= 0
    assert status.queued == 1 and len(status.rules) == 1


def test_status_may_be_asked_for_in_a_callback():
    engine = Engine()
    engine.load(goals="subscribe(fire, [], _, alarms, a)")
    found = []
    engine.on_output(lambda term, topic, name: found.append(engine.status()))
    engine.event("fire", 1)
    assert found[0].work.what == "fire" and found[0].subscriptions[0].sent == 1
