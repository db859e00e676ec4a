"""Explanations of subscriptions that send nothing."""

from typing import Any, List

import pytest

from retalis import Engine, explain, record_origins


@pytest.fixture
def engine() -> Engine:
    engine = Engine()
    record_origins(engine)
    engine.load(
        rules="bound(40).",
        goals="subscribe(heat(oven, T), [bound(L), T > L, T < 99], hot(T), alarms, a)\n"
        "subscribe(heat(_, T), [T > soon], _, alarms, b)\n"
        "subscribe(cold, [], _, alarms, c)",
    )
    return engine


def explanation_lines(engine: Any, event: str) -> List[str]:
    return [text.strip() for line in explain(engine, event).lines for text in line.indented()]


def test_sent_event_has_no_subscription_lines(engine: Engine) -> None:
    engine.event("cold", 1)
    assert explanation_lines(engine, "cold") == ["cold at 1 came from outside"]


def test_false_condition_is_shown_with_values(engine: Engine) -> None:
    engine.event("heat(oven, 38)", 1)
    assert explanation_lines(engine, "heat(_, _)") == [
        "heat(oven,38) at 1 came from outside",
        "subscription a of topic alarms does not select it: its condition 38 > 40 is false",
        "subscription b of topic alarms does not select it: its condition 38 > soon ends with an error: "
        "Type error: `evaluable' expected, found `soon/0' (in (>)/2)",
    ]


def test_other_pattern_is_shown(engine: Engine) -> None:
    engine.event("heat(hall, 45)", 1)
    assert "subscription a of topic alarms does not select it: it selects heat(oven,_)" in explanation_lines(
        engine, "heat(hall, _)"
    )


def test_events_of_converted_output_are_shown(engine: Engine) -> None:
    assert explanation_lines(engine, "hot(_)")[:2] == [
        "subscription a of topic alarms publishes it for heat(oven,_)",
        "no such event happened",
    ]
    engine.event("heat(oven, 38)", 1)
    engine.event("heat(oven, 50)", 2)
    engine.event("heat(hall, 50)", 3)
    assert explanation_lines(engine, "hot(_)")[1:4] == [
        "heat(oven,38) at 1: its condition 38 > 40 is false",
        "heat(oven,50) at 2: sent",
        "heat(hall,50) at 3: it selects heat(oven,_)",
    ]


def test_number_of_subscriptions_is_limited() -> None:
    engine = Engine()
    record_origins(engine)
    engine.load(
        goals="\n".join(f"subscribe(e({number}), [], f(_), alarms, {number})" for number in range(1, 50))
    )
    engine.event("e(0)", 1)
    assert len(explanation_lines(engine, "e(0)")) == 21
    assert len(explanation_lines(engine, "f(_)")) == 40
