"""Why a subscription sent nothing."""

import pytest

from retalis import Engine, explain, record_origins


@pytest.fixture
def engine():
    found = Engine()
    record_origins(found)
    found.load(
        rules="bound(40).",
        goals="subscribe(heat(oven, T), [bound(L), T > L, T < 99], hot(T), alarms, a)\n"
        "subscribe(heat(_, T), [T > soon], _, alarms, b)\n"
        "subscribe(cold, [], _, alarms, c)",
    )
    return found


def told(engine, event):
    return [text.strip() for line in explain(engine, event).lines for text in line.indented()]


def test_an_event_that_is_sent_says_nothing_of_the_subscription(engine):
    engine.event("cold", 1)
    assert told(engine, "cold") == ["cold at 1 came from outside"]


def test_a_condition_that_is_false_is_named_with_its_values(engine):
    engine.event("heat(oven, 38)", 1)
    assert told(engine, "heat(_, _)") == [
        "heat(oven,38) at 1 came from outside",
        "subscription a of topic alarms does not take it: its condition 38 > 40 is false",
        "subscription b of topic alarms does not take it: its condition 38 > soon ends with an error: "
        "Type error: `evaluable' expected, found `soon/0' (in (>)/2)",
    ]


def test_another_pattern_is_shown(engine):
    engine.event("heat(hall, 45)", 1)
    assert "subscription a of topic alarms does not take it: it takes heat(oven,_)" in told(
        engine, "heat(hall, _)"
    )


def test_of_what_goes_out_in_another_form_the_events_are_told(engine):
    assert told(engine, "hot(_)")[:2] == [
        "subscription a of topic alarms sends it of heat(oven,_)",
        "no such event happened",
    ]
    engine.event("heat(oven, 38)", 1)
    engine.event("heat(oven, 50)", 2)
    engine.event("heat(hall, 50)", 3)
    assert told(engine, "hot(_)")[1:4] == [
        "heat(oven,38) at 1: its condition 38 > 40 is false",
        "heat(oven,50) at 2: sent",
        "heat(hall,50) at 3: it takes heat(oven,_)",
    ]


def test_only_so_many_subscriptions_are_told_of():
    engine = Engine()
    record_origins(engine)
    engine.load(goals="\n".join(f"subscribe(e({at}), [], f(_), alarms, {at})" for at in range(1, 50)))
    engine.event("e(0)", 1)
    assert len(told(engine, "e(0)")) == 21
    assert len(told(engine, "f(_)")) == 40
