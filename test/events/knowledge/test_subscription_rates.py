"""Subscriptions to ``P with Rate``: they send what a rule with the same rate operator would emit."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import required
from recording_engine import RecordingEngine

from retalis import Clock, Engine, PrologError
from retalis.prolog.terms.timestamps import SECOND

INPUT = "1:1:a 2:2:a 2:2.5:b 2:3:a 3:4:a 3:6:a 4:6.5:b 4:7:a 4:7.2:a 5:12:a"


def outputs_for_input(engine: Any, text: Any = INPUT) -> Any:
    """Process events, each as ``value:seconds:key``; return the outputs as texts with their instants."""
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append((engine.show(term), engine.clock.reached())))
    for event in text.split():
        value, seconds, key = event.split(":")
        engine.event(f"in({key},{value})", float(seconds))
    engine.clock.move_to(30 * SECOND)
    engine.advance()
    return outputs


@pytest.mark.parametrize(
    "rate",
    ["throttle(2)", "throttle(2,K)", "burst(1)", "burst(1,K)", "debounce(1)", "debounce(1,K)", "change(X,K)"],
)
def test_subscription_sends_what_rule_emits(rate: str) -> None:
    with_rule = Engine()
    with_rule.load(rules=f"out(K,X) <- in(K,X) with {rate}.", goals="subscribe(out(K,X), [], _, t, i)")
    subscription_only = Engine()
    subscription_only.load(goals=f"subscribe(in(K,X) with {rate}, [], out(K,X), t, i)")
    expected = outputs_for_input(with_rule)
    assert len(expected) > 1
    assert outputs_for_input(subscription_only) == expected


def test_refused_events_do_not_count_for_throttle() -> None:
    engine = RecordingEngine(
        goals="subscribe(t(X) with throttle(5), [X > 80, Y is X - 80], hot(Y), alarms, 1)"
    )
    for seconds, value in enumerate((70, 90, 85, 60, 95, 99, 82)):
        engine.event(f"t({value})", seconds)
    assert [term for term, _, _ in engine.outputs] == ["hot(10)", "hot(2)"]


def test_clock_sends_debounced_event_before_rules() -> None:
    now = [100 * SECOND]
    engine = Engine(Clock(lambda: now[0]))
    engine.load(
        rules="late(X) <- a(X) with debounce(2).", goals="subscribe(a(X) with debounce(2), [], _, t, 1)"
    )
    seen: List[Any] = []
    engine.on_output(lambda term, topic, name: seen.append(engine.show(term)))
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    engine.event("a(1)", 100)
    now[0] += 2 * SECOND
    engine.advance()
    assert seen == ["a(1)", "a(1)", "late(1)"]


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("a(X) with sometimes(1)", "with needs one of throttle(Seconds)"),
        ("a(X) with trottle(1)", "throttle"),
        ("a(X) with throttle(0)", "throttle needs a positive number of seconds"),
        ("a(X) with throttle(1, Y)", "a variable that no event of its pattern binds"),
        ("a(X) with change(Y)", "a variable that no event of its pattern binds"),
        ("a(X) with T", "with needs one of"),
        ("(a(X) seq b) with throttle(1)", "takes single events"),
        ("(a(X) with throttle(1)) with change(X)", "takes single events"),
        ("a(X) with throttle(1) where X > 1", "without further operators"),
        ("a(X) with throttle(1) within 2", "without further operators"),
        ("3 with throttle(1)", "takes single events"),
    ],
)
def test_invalid_rate_is_reported(pattern: str, message: str) -> None:
    engine = RecordingEngine()
    with pytest.raises(PrologError, match=r"subscription") as raised:
        engine.call(f"subscribe(({pattern}), [], _, t, 1)")
    assert message in str(raised.value)
    assert not engine.status().subscriptions


def test_deleted_subscription_sends_nothing() -> None:
    engine = RecordingEngine(
        goals="subscribe(a(X) with debounce(2), [], _, t, 1)\nsubscribe(a(X) with throttle(9), [], _, t, 2)"
    )
    engine.event("a(1)", 1)
    assert engine.call("delete_subscription(t, 1), delete_subscription(t, 2)")
    engine.event("b", 9)
    assert [name for _, _, name in engine.outputs] == ["2"]
    engine.call("subscribe(a(X) with throttle(9), [], _, t, 2)")
    engine.event("a(2)", 9.5)
    assert [term for term, _, _ in engine.outputs] == ["a(1)", "a(2)"]


@pytest.mark.parametrize("is_stopped", [False, True])
def test_stopped_rate_sends_nothing(is_stopped: bool) -> None:
    engine = RecordingEngine(goals="subscribe(a(X) with debounce(2), [], _, t, 1)")
    if is_stopped:
        required(engine.knowledge.subscriptions.items()[0][1].rate_limiter).stop()
    engine.event("a(1)", 1)
    engine.event("b", 9)
    assert len(engine.outputs) == (0 if is_stopped else 1)


def test_late_and_dropped_events_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = RecordingEngine(goals="subscribe(a(X) with debounce(2, X), [], _, t, 1)")
    reports: List[Any] = []
    monkeypatch.setattr(engine.reports, "warning", lambda text, *rest: reports.append(text))
    rate = required(engine.knowledge.subscriptions.items()[0][1].rate_limiter)
    rate._warn = engine.reports.warning  # noqa: SLF001
    engine.event("b", 10)
    engine.event("a(1)", 1)
    engine.rules.network.limit_stored(2)
    for number in (2, 3, 4):
        engine.event(f"a({number})", 10)
    subscription = engine.status().subscriptions[0]
    assert (subscription.late, subscription.dropped, subscription.sent) == (1, 1, 0)
    assert [text.split(";")[-1] for text in reports] == [
        " 1 so far",
        " 1 of the oldest have been dropped so far",
    ]
    assert "with debounce(2" in subscription.event


def test_reset_clears_state_of_rates() -> None:
    goal = "subscribe(a(X) with throttle(100), [], _, t, 1)\nsubscribe(a(X) with debounce(2), [], _, t, 2)"
    for reset in ("reset_db", "reset_etalis_state"):
        engine = RecordingEngine(goals=goal)
        engine.event("a(1)", 1)
        engine.call(reset)
        engine.event("b", 9)
        engine.event("a(2)", 10)
        assert [(term, name) for term, _, name in engine.outputs] == [("a(1)", "1"), ("a(2)", "1")]
    now = [1000 * SECOND]
    engine = RecordingEngine(goals=goal, clock=Clock(lambda: now[0]))
    for instant in (1000, 10, 11, 20):
        now[0] = instant * SECOND
        engine.event(f"a({instant})")
    assert [term for term, _, _ in engine.outputs] == ["a(1000)", "a(10)", "a(11)"]


def test_rates_are_restored() -> None:
    goal = "subscribe(a(X) with throttle(100), [], _, t, 1)\nsubscribe(a(X) with debounce(2, X), [], speech(X), t, 2)"
    engine = Engine()
    engine.load(goals=goal + "\nsubscribe(a(_), [], _, t, 3)\nsubscribe(a(X) with change(X), [], _, t, 4)")
    for second, value in ((1, 1), (2, 2), (3, 2)):
        engine.event(f"a({value})", second)
    restored = Engine.restore(engine.snapshot())
    outputs_of_engines: List[Any] = []
    for current in (engine, restored):
        outputs: List[Any] = []
        current.on_output(
            lambda term, topic, name, outputs=outputs, current=current: outputs.append(
                (current.show(term), str(name))
            )
        )
        current.event("a(2)", 3.5)
        current.event("b", 20)
        current.event("a(3)", 102)
        outputs_of_engines.append(outputs)
    assert outputs_of_engines[0] == outputs_of_engines[1]
    assert len(outputs_of_engines[0]) == 5
    assert engine.status().subscriptions == restored.status().subscriptions


def test_unchanged_rates_survive_reload(tmp_path: Path) -> None:
    (tmp_path / "eventRules.txt").write_text("")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>\n")
    goals = tmp_path / "goalPredicates.txt"
    goals.write_text(
        "subscribe(a(X) with debounce(3), [], _, t, 1).\nsubscribe(a(X) with throttle(9), [], _, t, 2).\n"
    )
    engine = Engine()
    engine.load_program(tmp_path)
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append((engine.show(term), engine.show(name))))
    engine.event("a(1)", 1)
    engine.reload(tmp_path)
    engine.event("a(2)", 2)
    goals.write_text(
        "subscribe(a(X) with debounce(3), [], _, t, 1).\nsubscribe(a(X) with throttle(8), [], _, t, 2).\n"
    )
    engine.reload(tmp_path)
    engine.event("a(3)", 3)
    engine.event("b", 20)
    assert outputs == [("a(1)", "2"), ("a(3)", "2"), ("a(3)", "1")]


def test_event_of_rate_is_checked_against_declaration() -> None:
    engine = RecordingEngine(rules=":- event in(x:integer).\nb(X) <- in(X).")
    with pytest.raises(PrologError, match="in/2 does not match its declaration"):
        engine.call("subscribe(in(a, b) with throttle(1), [], _, t, 1)")
