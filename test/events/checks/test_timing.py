"""Programs with very many rules, looked through for what is wrong with their times."""

import pytest

from retalis.engine import Engine, parts_of
from retalis.events.checks.overview import Overview
from retalis.events.checks.timing import cycles, missed_pairs, never_meet
from retalis.events.program import Topics, TopicType
from retalis.messages import Definitions

TOPICS = Topics((TopicType("said", "std_msgs/String"),))
FIRST = "e0 <- std_msgs__0__String(_) where true."
LONG = 400

CHAIN = [f"e{at + 1} <- e{at} where true." for at in range(LONG)]
TWICE = [f"e{at + 1} <- e{at} check true." for at in range(40)]
PLAIN = [f"f{at + 1} <- f{at}." for at in range(LONG)]


def said_of(*rules):
    engine = Engine()
    engine.load(rules="\n".join(rules))
    parts = parts_of(engine)
    program = Overview(parts.rules, parts.knowledge, Definitions(), TOPICS)
    return [error.message for error in (*never_meet(program), *cycles(program))]


@pytest.mark.slow
def test_an_instant_is_known_behind_a_long_chain_of_rules():
    (said,) = said_of(FIRST, *CHAIN, *TWICE, f"x <- e{LONG} par e{LONG}.")
    assert said.startswith("par never matches here: both sides are instants")


def test_an_event_of_two_rules_is_an_instant_where_both_say_so():
    assert said_of(FIRST, "e1 <- e0. e1 <- e0 seq e0. x <- e1 par e1.") == []


def test_events_that_wait_for_each_other_are_no_instants():
    assert said_of(FIRST, "a <- b where true. b <- a where true. x <- a par b.") == []


@pytest.mark.slow
def test_a_cycle_at_the_end_of_a_long_chain_is_said_once():
    (said,) = said_of(*PLAIN, f"g <- f{LONG}. g <- h. h <- g.")
    assert said.startswith("these events fire each other (g/0 <- h/0 <- g/0)")


def test_a_cycle_is_said_once():
    (said,) = said_of(*PLAIN[:9], "f0 <- f9.")
    assert said.startswith("these events fire each other (f1/0 <- f0/0 <- f9/0 <- ")


PAIR = "near <- (std_msgs__0__String(_) and std_msgs__0__Bool(_)) within 0.1."
TWO_TOPICS = Topics((TopicType("said", "std_msgs/String"), TopicType("on", "std_msgs/Bool")))


def missed(rules, topics=TWO_TOPICS):
    engine = Engine()
    engine.load(rules=rules)
    parts = parts_of(engine)
    return [
        error.message for error in missed_pairs(Overview(parts.rules, parts.knowledge, Definitions(), topics))
    ]


def test_pairs_of_messages_under_the_default_policy_are_named():
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
def test_other_pairs_are_not_named(rules):
    assert missed(rules) == []
