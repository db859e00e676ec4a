"""Consumption policies: partners of joins, policies of single rules, and refused policies."""

from enum import Enum
from typing import Any, List, cast

import pytest
from events.program_runner import ProgramRunner, format_events, outputs_of

from retalis import Engine, UsageError
from retalis.events.matches.match_policies import ConsumptionPolicy, check_policy

DISTINCT_EVENTS = "a(1)@1 a(2)@2 b@3 b@4"
EQUAL_EVENTS = "a@1 a@2 b@3 b@4"


@pytest.mark.parametrize(
    ("policy", "different", "identical"),
    [
        ("recent", "c(2)@2-3 c(1)@1-4", "d@2-3"),
        ("recent_2", "c(2)@2-3 c(1)@1-4", "d@2-3 d@1-4"),
        ("chronological", "c(1)@1-3 c(2)@2-4", "d@1-3 d@2-4"),
        ("chronological_2", "c(1)@1-3 c(2)@2-4", "d@1-3 d@2-4"),
        ("unrestricted", "c(1)@1-3 c(2)@2-3 c(1)@1-4 c(2)@2-4", "d@1-3 d@2-3 d@1-4 d@2-4"),
    ],
)
@pytest.mark.parametrize("operator", ["seq", "and"])
def test_policy_selects_partners_of_joins(policy: str, operator: str, different: str, identical: str) -> None:
    assert outputs_of(f"c(X) <- a(X) {operator} b.", DISTINCT_EVENTS, policy) == different
    assert outputs_of(f"d <- a {operator} b.", EQUAL_EVENTS, policy) == identical


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "c(1)@1-1 c(2)@2-2 c(2)@2-3"),
        ("chronological", "c(1)@1-1 c(2)@2-2 c(1)@1-3"),
        ("unrestricted", "c(1)@1-1 c(2)@2-2 c(1)@1-3 c(2)@2-3"),
    ],
)
def test_policy_selects_starts_of_runs(policy: str, expected: str) -> None:
    assert outputs_of("c(X) <- a(X) seq b star_times.", "a(1)@1 a(2)@2 b@3", policy) == expected


def test_rule_has_own_policy() -> None:
    rules = "r([property(policy,{})]) : c(X) <- a(X) seq b. d(X) <- a(X) seq b."
    own = {"chronological": "c(1)@1-3 d(2)@2-3", "unrestricted": "c(1)@1-3 c(2)@2-3 d(2)@2-3"}
    for policy, expected in own.items():
        assert outputs_of(rules.format(policy), "a(1)@1 a(2)@2 b@3") == expected
    assert outputs_of(rules.format("recent"), "a(1)@1 a(2)@2 b@3", "chronological") == "c(2)@2-3 d(1)@1-3"


def test_last_policy_applies_immediately() -> None:
    program = ProgramRunner("r([property(policy,chronological)]) : c(X) <- a(X) seq b.")
    program.feed("a(1)@1 a(2)@2")
    program.engine.load(rules="event_rule_property(r, policy, unrestricted).")
    assert program.feed("b@3") == "c(1)@1-3 c(2)@2-3"
    program.engine.load(rules="event_rule_property(r, policy, chronological).")
    assert program.feed("b@4") == "c(1)@1-4"
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("b@5") == "c(2)@2-5"


def test_properties_of_rule_are_restored() -> None:
    rules = "r([property(policy,chronological),property(out_of_order,on)]) : c(X) <- a(X) seq b."
    program = ProgramRunner(rules)
    program.feed("a(2)@2 a(1)@1")
    engine = Engine.restore(program.engine.snapshot())
    events: List[Any] = []
    engine.on_event(lambda *event: events.append(event))
    for term, second in (("b", 3), ("b", 4), ("b", 9), ("a(8)", 8)):
        engine.event(term, second, second)
    assert format_events(
        event for event in events if event[0].__class__ is tuple and event[0][0].name == "c"
    ) == ("c(2)@2-3 c(1)@1-4 c(8)@8-9")


def test_rejected_partners_are_kept() -> None:
    assert (
        outputs_of("c(X) <- a(X) seq b(Y) where X < Y.", "a(1)@1 a(9)@2 b(5)@3 b(10)@4")
        == "c(1)@1-3 c(9)@2-4"
    )


def test_identical_rules_both_emit() -> None:
    assert outputs_of("c <- a seq b. c <- a seq b.", "a@1 b@2") == "c@1-2 c@1-2"


class PolicyWithoutJoin(Enum):
    """A policy that prefers the newest partner and consumes none."""

    NEWEST = "newest_of_all"

    prefers_newest = property(lambda self: True)
    consumes_partners = replaces_identical = property(lambda self: False)


@pytest.mark.parametrize("policy", ConsumptionPolicy)
def test_policy_with_join_is_accepted(policy: ConsumptionPolicy) -> None:
    check_policy(policy)


def test_policy_without_join_is_refused() -> None:
    with pytest.raises(UsageError, match="policy newest_of_all: the network has no join"):
        check_policy(cast("ConsumptionPolicy", PolicyWithoutJoin.NEWEST))


def test_refused_policy_leaves_rule_unchanged() -> None:
    engine = Engine()
    engine.load("c(X) <- a(X) seq b(X).")
    (rule,) = engine.rules.rules
    options = rule.options
    with pytest.raises(UsageError, match="no join"):
        rule.configure(
            options._replace(policy=cast("ConsumptionPolicy", PolicyWithoutJoin.NEWEST)), None, None
        )
    assert rule.options is options
