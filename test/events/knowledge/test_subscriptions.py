"""Creation and deletion of subscriptions by goals."""

import logging
from typing import Any, List

import pytest
from recording_engine import RecordingEngine

from retalis import Engine, PrologError, atom
from retalis.events.knowledge import memory
from retalis.prolog.terms.term_traversal import variables


def test_accepted_events_are_sent_by_template() -> None:
    engine = RecordingEngine(goals="subscribe(a(X), [X > 1, Y is X * 2], b(X, Y), topic, 1)")
    for value in (1, 2, 3):
        engine.event(f"a({value})", value)
    assert engine.outputs == [("b(2,4)", "topic", "1"), ("b(3,6)", "topic", "1")]


def test_subscriptions_precede_rules_in_order() -> None:
    rules = "a(2) <- a(1)."
    engine = RecordingEngine(rules, "subscribe(a(X), [], one(X), t, 1)\nsubscribe(a(_), [], _, t, 2)")
    engine.event("a(1)", 1)
    assert [term for term, _, _ in engine.outputs] == ["one(1)", "a(1)", "one(2)", "a(2)"]


def test_template_uses_first_solution() -> None:
    engine = RecordingEngine(goals="subscribe(a, [member(X, [p, q])], b(X), t, 1)")
    engine.event("a", 1)
    assert engine.outputs == [("b(p)", "t", "1")]


def test_topic_and_id_identify_subscription() -> None:
    engine = RecordingEngine(
        goals="subscribe(a, [], _, t, 1)\nsubscribe(a, [], _, u, 1)\nsubscribe(a, [], _, t, 2)"
    )
    with pytest.raises(PrologError):
        engine.call("subscribe(b, [], _, t, 1)")
    engine.event("b", 1)
    assert engine.outputs == []
    assert engine.call("delete_subscription(t, 1)")
    engine.event("a", 2)
    assert [(topic, name) for _, topic, name in engine.outputs] == [("u", "1"), ("t", "2")]


def test_topic_may_be_term_with_slash() -> None:
    engine = RecordingEngine(goals="subscribe(a, [], _, robot/marker, 1)")
    engine.event("a", 1)
    assert engine.outputs == [("a", "robot/marker", "1")]
    engine.call("delete_subscription('robot/marker', 1)")
    engine.event("a", 2)
    assert len(engine.outputs) == 1


def test_topic_is_shown_without_quotes() -> None:
    engine = RecordingEngine(goals="subscribe(a, [], _, 'Front Left'/'Camera', 1)")
    engine.event("a", 1)
    assert engine.outputs == [("a", "Front Left/Camera", "1")]
    subscriptions = engine.knowledge.subscriptions
    assert subscriptions.has(atom("Front Left/Camera"), 1)
    assert not subscriptions.has(atom("Front Left"), 1)


def test_subscriptions_are_restored_in_order() -> None:
    engine = RecordingEngine(goals="subscribe(a, [], one, t, 1)\nsubscribe(a, [], two, t, 2)")
    subscriptions = engine.knowledge.subscriptions
    engine.event("a", 1)
    subscriptions_before = subscriptions.items()
    engine.load(goals="delete_subscription(t, 1)\nsubscribe(a, [], three, t, 3)")
    engine.event("a", 2)
    subscriptions.restore_all(subscriptions_before)
    engine.event("a", 3)
    assert [term for term, _, _ in engine.outputs] == ["one", "two", "two", "three", "one", "two"]
    assert [subscription.sent for subscription in engine.status().subscriptions] == [2, 3]


def test_deletion_of_unknown_subscription_succeeds(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "retalis"):
        assert RecordingEngine().call("delete_subscription(t, never)")
    assert "never" in caplog.text


@pytest.mark.parametrize(
    "goal",
    [
        "subscribe(a, nothing, _, t, 1)",
        "subscribe(a, [3], _, t, 1)",
        "subscribe(3, [], _, t, 1)",
        "subscribe(a, [], 3, t, 1)",
        "subscribe(a, [], _, T, 1)",
        "subscribe(a, [], _, t, I)",
    ],
)
def test_invalid_subscription_is_refused(goal: str) -> None:
    engine = RecordingEngine()
    with pytest.raises(PrologError):
        engine.call(goal)
    assert list(engine.knowledge.subscriptions) == []
    engine.event("a", 1)
    assert engine.outputs == []


def test_error_of_condition_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = RecordingEngine("b <- a(_).", "subscribe(a(X), [X > 1], _, t, s)")
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("a(x)", 1)
    assert "subscription s" in caplog.text
    assert [event for event, _, _ in engine.events] == ["a(x)", "b"]


def test_variable_subscribes_to_all_events() -> None:
    engine = RecordingEngine("b <- a.", "subscribe(E, [], _, t, all)")
    engine.event("a", 1)
    assert [term for term, _, _ in engine.outputs] == ["a", "b"]


def test_variables_of_long_template_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: List[Any] = []

    class SearchedList(list):
        def __contains__(self, variable: Any) -> bool:
            searched.append(variable)
            return super().__contains__(variable)

    monkeypatch.setattr(memory, "variables", lambda term: SearchedList(variables(term)))
    slots = ",".join(f"X{number}" for number in range(100))
    engine = Engine()
    for goal in (
        "subscribe(long({0}), [], form({0}), t, s)",
        "memorize(long({0}), [Y = 1], form({0},Y), m, 10)",
    ):
        assert engine.call(goal.format(slots))
    assert len(searched) < 10
