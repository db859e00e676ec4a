"""Levels and messages of a node's health."""

import pytest

from retalis import Engine, StreamClock, Work
from retalis.node.diagnostics import (
    MAX_REPORTED_TOPICS,
    MAX_STATUS_VALUES,
    RECENT_SECONDS,
    STALE_AFTER_SECONDS,
    CounterTrends,
    EngineHealth,
    InputHealth,
    InputRole,
    Level,
    NodeHealth,
    evaluate_memory,
    evaluate_output,
    evaluate_program,
)
from retalis.node.topic_statistics import InputCounts, InputStatus, OutputStatus

TOPIC = InputStatus("/tf", "tf/tfMessage", 1, 0, 0, 0, 0, None, None)


def engine_levels(engine, now=0.0, health=None, **changed):
    found = (health or EngineHealth(1.0, 10.0)).evaluate(now, engine.status()._replace(**changed))
    return {one.name: one for one in found}


def test_a_topic_has_its_rate():
    trends = CounterTrends()
    health = InputHealth(trends)
    for now, number in ((0.0, 0), (1.0, 50), (2.0, 150)):
        found = health.evaluate(now, TOPIC._replace(messages=number, age=0.0, lag=250_000_000))
        trends.remove_unrecorded()
    assert (found.name, found.level, found.message) == ("input /tf", Level.OK, "100.0 messages/s")
    assert dict(found.values)["lag (s)"] == "0.250"


def test_a_topic_without_a_publisher_is_worth_a_warning_and_one_without_messages_is_not():
    health = InputHealth(CounterTrends())
    assert health.evaluate(0.0, TOPIC._replace(publishers=0)).level is Level.WARN
    assert health.evaluate(1.0, TOPIC).level is Level.OK


@pytest.mark.parametrize(
    "interval, quiet, level", [(0.1, 6, Level.STALE), (0.1, 4, Level.OK), (60, 300, Level.OK)]
)
def test_a_topic_is_stale_by_its_usual_interval(interval, quiet, level):
    health = InputHealth(CounterTrends())
    for number in range(1, 20):
        health.evaluate(number * interval, TOPIC._replace(messages=number, age=0.0))
    last = TOPIC._replace(messages=19, age=float(quiet))
    assert health.evaluate(19 * interval + quiet, last).level is level


@pytest.mark.parametrize(
    ("role", "silent", "unpublished", "lost"),
    [
        (InputRole.NEEDED, Level.STALE, Level.WARN, Level.ERROR),
        (InputRole.LINK, Level.OK, Level.WARN, Level.ERROR),
        (InputRole.OPTIONAL, Level.OK, Level.OK, Level.ERROR),
        (InputRole.UNREAD, Level.OK, Level.OK, Level.OK),
    ],
)
def test_the_level_of_a_topic_depends_on_the_use_that_the_program_has_for_it(role, silent, unpublished, lost):
    health = InputHealth(CounterTrends(), lambda topic: role)
    for number in range(1, 20):
        health.evaluate(number * 0.1, TOPIC._replace(messages=number, age=0.0))
    seen = TOPIC._replace(messages=19, age=30.0)
    assert health.evaluate(32.0, seen).level is silent
    assert health.evaluate(33.0, seen._replace(publishers=0)).level is unpublished
    assert health.evaluate(34.0, seen._replace(refused=1)).level is lost


def test_a_latched_topic_does_not_become_stale():
    health = InputHealth(CounterTrends())
    for now in range(0, 1000, 100):
        assert health.evaluate(now, TOPIC._replace(messages=1, age=float(now))).level is Level.OK
    assert STALE_AFTER_SECONDS < 1000


def test_a_topic_that_is_subscribed_anew_is_judged_anew():
    health = InputHealth(CounterTrends())
    for number in range(100, 110):
        health.evaluate(float(number), TOPIC._replace(messages=number, age=0.0))
    for number in range(1, 20):
        health.evaluate(200.0 + number, TOPIC._replace(messages=number, age=0.0))
    assert health.evaluate(300.0, TOPIC._replace(messages=19, age=81.0)).level is Level.STALE


def test_topics_that_are_subscribed_no_more_are_forgotten():
    health = InputHealth(CounterTrends())
    for number in range(1, 20):
        health.evaluate(float(number), TOPIC._replace(messages=number, age=0.0))
    late = TOPIC._replace(messages=19, age=81.0)
    health.retain_topics({"/tf"})
    assert health.evaluate(100.0, late).level is Level.STALE
    health.retain_topics({"/other"})
    assert health.evaluate(100.0, late).level is Level.OK  # nothing is known of its interval


def test_a_loss_keeps_its_level_for_a_while():
    health = InputHealth(CounterTrends())
    health.evaluate(0.0, TOPIC)
    assert health.evaluate(1.0, TOPIC._replace(refused=1)).level is Level.ERROR
    assert health.evaluate(RECENT_SECONDS, TOPIC._replace(refused=1)).level is Level.ERROR
    assert health.evaluate(RECENT_SECONDS + 2, TOPIC._replace(refused=1)).level is Level.OK
    status = health.evaluate(RECENT_SECONDS + 3, TOPIC._replace(refused=1, missing=2))
    assert (status.level, dict(status.values)["missing"]) == (Level.ERROR, "2")


def test_an_output_whose_subscriber_is_slow():
    trends, one = CounterTrends(), OutputStatus("/pose", "geometry_msgs/PoseStamped", 1, 5, 0)
    assert evaluate_output(0.0, trends, one).level is Level.OK
    trends.remove_unrecorded()
    assert evaluate_output(1.0, trends, one._replace(dropped=3)).level is Level.WARN


def test_an_idle_engine_is_well():
    assert {one.level for one in engine_levels(Engine()).values()} == {Level.OK}


def test_a_queue_that_fills_and_drops():
    engine = Engine()
    assert engine_levels(engine, queued=engine.settings.queue - 1)["queue"].level is Level.WARN
    health = EngineHealth(1.0, 10.0)
    engine_levels(engine, 0.0, health)
    assert engine_levels(engine, 1.0, health, dropped=1)["queue"].level is Level.ERROR
    assert engine_levels(engine, 20.0, health, dropped=1)["queue"].level is Level.OK


@pytest.mark.parametrize("seconds, level", [(0.5, Level.OK), (2.0, Level.WARN), (11.0, Level.ERROR)])
def test_a_goal_that_runs_too_long(seconds, level):
    work = Work("fire", seconds, "rule alarm: goal endless", "fire", "mine:1:1")
    found = engine_levels(Engine(), work=work)["work"]
    assert found.level is level
    assert dict(found.values)["goal"] == "rule alarm: goal endless"


def test_rules_with_errors_are_named():
    engine = Engine()
    engine.load(rules="hot: a <- b(X) where X > 1.\nc <- b(_).", source="mine")
    engine.event("b(many)", 1)
    health = EngineHealth(1.0, 10.0)
    found = engine_levels(engine, 0.0, health)["rules"]
    assert (found.level, found.values) == (Level.ERROR, [("hot mine:1:1", "1 error")])
    assert engine_levels(engine, 2 * RECENT_SECONDS, health)["rules"].level is Level.WARN


def test_a_query_that_waits_for_long_is_named_with_its_memories():
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(seen, true, [[m, 9]]) <- marker.")
    engine.event("a", 2)
    engine.event("marker", 5)
    health = EngineHealth(1.0, 10.0)
    assert engine_levels(engine, 0.0, health)["waiting queries"].level is Level.OK
    found = engine_levels(engine, 11.0, health)["waiting queries"]
    assert found.level is Level.WARN
    assert found.values == [("seen", "since 5.000, for 11 s: waits for m (7.000 s behind)")]


def test_what_is_listed_is_bounded():
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 3)", rules="synchronized(seen(X), true, [[m, 9]]) <- marker(X).")
    for number in range(500):
        engine.event(f"marker({number})", 5)
    found = engine_levels(engine)["waiting queries"]
    assert found.message == "500 wait"
    assert len(found.values) == MAX_STATUS_VALUES + 1 and found.values[-1] == (
        "further queries",
        str(500 - MAX_STATUS_VALUES),
    )
    program = evaluate_program([], [str(number) for number in range(100)])
    assert program.level is Level.WARN and program.values[-1] == (
        "further ones",
        str(100 - MAX_STATUS_VALUES),
    )


def test_of_many_topics_those_that_somebody_has_to_look_at_are_told_of():
    wrong = TOPIC._replace(topic="/wrong", dropped=1)
    topics = [*(TOPIC._replace(topic=f"/t{at}") for at in range(300)), TOPIC._replace(publishers=0), wrong]
    found = NodeHealth(lambda: topics, list, list).evaluate()
    assert [one.name for one in found[:2]] == ["input /wrong", "input /tf"]
    assert len(found) == MAX_REPORTED_TOPICS + 2
    assert found[-2].name == "further inputs" and found[-2].message.startswith("102 ")


def test_more_rules_with_errors_than_are_looked_at():
    engine = Engine()
    engine.load(rules="\n".join(f"a{at} <- b({at}) where 1 < X." for at in range(150)))
    for at in range(150):
        engine.event(f"b({at})", 1)
    engine.event("b(149)", 2)
    found = engine_levels(engine)["rules"]
    assert found.message == "101 errors in 100 rules or more"


def test_a_program_that_did_not_load():
    assert evaluate_program(["mine:1:1: expected a term"], []).level is Level.ERROR
    assert evaluate_program([], []).level is Level.OK


def test_the_process_tells_its_memory():
    values = dict(evaluate_memory().values)
    assert int(values["resident (MB)"]) > 1


def test_a_node_tells_of_everything():
    engine = Engine()
    of_engine = EngineHealth(1.0, 10.0)
    output = OutputStatus("/pose", "geometry_msgs/PoseStamped", 1, 5, 0)
    node = NodeHealth(lambda: [TOPIC], lambda: [output], lambda: of_engine.evaluate(0.0, engine.status()))
    assert [one.name for one in node.evaluate()] == [
        "input /tf",
        "output /pose",
        "queue",
        "work",
        "rules",
        "waiting queries",
        "process memory",
    ]


def test_the_lag_is_that_of_a_message_with_a_stamp():
    counts = InputCounts(lambda: 5_000)
    counts.measure_lag(lambda data: 3_000, b"")
    assert (counts.lag, counts.needs_lag) == (2_000, False)
    counts.measure_lag(lambda data: None, b"")
    assert counts.lag is None


def test_the_rules_that_hold_most_are_named_with_what_they_hold():
    engine = Engine()
    engine.load(rules="few : a(K) <- b(K) with change(K, K).")
    engine.load(rules="many : c(K, A) <- aggregate(avg(V), d(K, V), A, last(3, events)).")
    engine.event("b(1)", 1)
    for at in range(100):
        engine.event(f"d({at}, 1)", at + 1)
    values = dict(engine_levels(engine)["rules"].values)
    assert list(values)[0].startswith("held by many")
    assert "100 items, 100 keys, about 0.2 MB" in list(values.values())[0]
    assert list(values)[1].startswith("held by few")


def test_lags_and_delays_are_reported():
    engine = Engine(StreamClock(10_000_000_000))
    engine.load(rules="lost <- beat seq absent(beat, 2).", source="mine")
    assert "late events" not in engine_levels(engine)
    engine.event("beat", 9.75)
    health = engine_levels(engine)["late events"]
    assert (health.level, health.message) == (Level.OK, "alarms wait up to 0.250 s")
    assert dict(health.values) == {"lag of beat/0 (s)": "0.250", "delay of mine:1:1 (s)": "0.250"}
