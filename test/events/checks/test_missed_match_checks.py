"""Checks of missed matches: pairs under the default policy, throttles without key, and conditions after throttles."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine, TopicType
from retalis.events.checks.missed_match_checks import (
    find_conditions_after_throttle,
    find_missed_pairs,
    find_throttles_without_key,
)
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics

PAIR = "near <- (std_msgs__0__String(_) and std_msgs__0__Bool(_)) within 0.1."
TWO_TOPICS = Topics((TopicType("speech", "std_msgs/String"), TopicType("on", "std_msgs/Bool")))


def missed(rules: Any, topics: Any = TWO_TOPICS) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules)
    return [
        error.message
        for error in find_missed_pairs(ProgramModel(engine.rules, engine.knowledge, Definitions(), topics))
    ]


def test_message_pairs_under_default_policy_are_named() -> None:
    (message,) = missed(PAIR)
    assert message.startswith("under the policy recent a message is used for one pair only")


@pytest.mark.parametrize(
    "rules",
    [
        f"{PAIR} :- set_etalis_flag(event_consumption_policy, unrestricted).",
        f"l([property(policy, recent)]) : {PAIR}",
        "near <- std_msgs__0__String(_) and std_msgs__0__Bool(_).",
        "near <- (std_msgs__0__String(_) seq std_msgs__0__Bool(_)) within 0.1.",
        "near <- (std_msgs__0__String(_) and spoken) within 0.1.",
    ],
    ids=["other policy", "intended", "no window", "seq", "no message"],
)
def test_other_pairs_are_not_named(rules: str) -> None:
    assert missed(rules) == []


@pytest.mark.parametrize(
    ("pattern", "count"),
    [
        ("temp(M, T) with throttle(10, M) where T > 40", 1),
        ("(temp(M, T) where T > 40) with throttle(10, M)", 0),
        ("temp(M, T) with change(T, M) where T > 40", 0),
    ],
)
def test_condition_after_throttle_is_reported(pattern: str, count: int) -> None:
    engine = Engine()
    engine.load(rules=f"hot(M) <- {pattern}.")
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    assert len(list(find_conditions_after_throttle(program))) == count


def unkeyed(rules: str) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_throttles_without_key(program)]


@pytest.mark.parametrize(
    ("pattern", "advice"),
    [
        ("temp(R, T) where T > 30 with throttle(10)", "write throttle(10, R)"),
        ("temp(R, T) with throttle(2.5)", "write throttle(2.5, R)"),
        ("(temp(R, T) where T > 30) with debounce(2)", "write debounce(2, R)"),
        ("temp(R, T) with burst(2)", "write burst(2, R)"),
    ],
)
def test_throttle_without_key_is_reported(pattern: str, advice: str) -> None:
    (message,) = unkeyed(f"hot(R) <- {pattern}.")
    assert message.endswith(advice)


@pytest.mark.parametrize(
    "rules",
    [
        "hot(R) <- temp(R, T) with throttle(10, R).",
        "hot(R) <- temp(R, T) with throttle(10, T).",
        "hot(R, T) <- temp(R, T) with throttle(10).",
        "hot(T) <- temp(R, T) with throttle(10).",
        "hot(T) <- temp(T) with throttle(10).",
        "hot <- temp(R, T) with throttle(10).",
        "hot(T) <- temp(T, R) where T > 30 with throttle(10).",
        "hot(T) <- temp(T, R) with throttle(10). temp(3, E) <- b(E).",
        "hot(R) <- temp(R, T) with change(T).",
        "hot(R) <- (temp(R, T) seq door(T)) with throttle(10).",
        "hot(R) <- temp(left, R) with throttle(10).",
    ],
)
def test_throttle_that_needs_no_key_is_not_reported(rules: str) -> None:
    assert unkeyed(rules) == []
