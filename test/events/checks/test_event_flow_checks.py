"""Events without a producer, and events without a consumer."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine, TopicType
from retalis.events.checks.event_flow_checks import find_unconsumed_events, find_unproduced_events
from retalis.events.checks.program_model import ProgramModel
from retalis.events.knowledge.knowledge_base import OWN_EVENTS
from retalis.events.program.topic_configuration import Topics

TOPICS = Topics((TopicType("speech", "std_msgs/String"),))


def messages_of(check: Any, rules: str) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), TOPICS)
    return [error.message for error in check(program)]


def test_events_of_package_have_producer() -> None:
    patterns = [f"{key.name}({', '.join('_' * key.arity)})" for key in OWN_EVENTS]
    assert len(patterns) == 7
    assert messages_of(find_unproduced_events, "\n".join(f"seen <- {pattern}." for pattern in patterns)) == []
    (message,) = messages_of(find_unproduced_events, "seen <- query_given_up(_, _).")
    assert (
        message == "no producer of query_given_up/2: no topic, rule or goal; did you mean query_given_up/3?"
    )


@pytest.mark.parametrize(
    "rule",
    [
        "null <- {}.",
        "null do assertz(n(1)) <- {}.",
        "null_event do assertz(n(1)) <- {}.",
        "noted do assertz(n(1)) <- {} where true.",
    ],
)
def test_rule_with_side_effects_needs_no_consumer(rule: str) -> None:
    assert messages_of(find_unconsumed_events, rule.format("std_msgs__0__String(_)")) == []


def test_event_without_consumer_is_reported() -> None:
    (message,) = messages_of(find_unconsumed_events, "noted <- std_msgs__0__String(_).")
    assert message == "no consumer of noted/0: no rule, memory or subscription"


def test_timer_is_producer() -> None:
    rules = ":- timer(tick, every(5)).\nnull do timer(later(X), after(X)) <- std_msgs__0__String(X).\n"
    assert messages_of(find_unproduced_events, rules + "null <- tick.\nnull <- later(X).") == []
    assert messages_of(find_unconsumed_events, rules + "null <- tick.") == [
        "no consumer of later/1: no rule, memory or subscription"
    ]


def test_state_is_consumer_and_producer() -> None:
    rules = ":- state(docked(R), from(dock(R)), until(undock(R))).\ndock(X) <- std_msgs__0__String(X).\n"
    assert messages_of(find_unproduced_events, rules + "null <- docked(_).") == [
        "state docked(_): no producer of undock/1: no topic, rule or goal; did you mean dock/1?"
    ]
    assert messages_of(find_unconsumed_events, rules) == []


def test_subscription_with_rate_is_consumer() -> None:
    goal = "subscribe({} with throttle(2), [], _, t, 1)"
    assert (
        messages_of(find_unconsumed_events, f":- {goal.format('noted')}.\nnoted <- std_msgs__0__String(_).")
        == []
    )
    (message,) = messages_of(
        find_unproduced_events, f":- {goal.format('notde')}.\nnoted <- std_msgs__0__String(_)."
    )
    assert message.endswith("no producer of notde/0: no topic, rule or goal; did you mean noted/0?")
