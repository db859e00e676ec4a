"""Checks of times: instants in long chains of rules, spans, and limits that no match satisfies."""

from typing import Any, List, Optional

import pytest

from retalis import Definitions, Engine, TopicType
from retalis.events.checks.program_model import ProgramModel, RecordedTopic
from retalis.events.checks.time_checks import (
    find_impossible_pairs,
    find_likely_milliseconds,
    find_unreachable_limits,
)
from retalis.events.program.topic_configuration import Topics

TOPICS = Topics((TopicType("speech", "std_msgs/String"),))
FIRST = "e0 <- std_msgs__0__String(_) where true."
CHAIN_LENGTH = 400

CHAIN = [f"e{number + 1} <- e{number} where true." for number in range(CHAIN_LENGTH)]
TWICE = [f"e{number + 1} <- e{number} check true." for number in range(40)]


def messages_of(*rules: Any) -> List[Any]:
    engine = Engine()
    engine.load(rules="\n".join(rules))
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), TOPICS)
    return [error.message for error in find_impossible_pairs(program)]


@pytest.mark.slow
def test_instant_is_known_after_long_chain() -> None:
    (message,) = messages_of(FIRST, *CHAIN, *TWICE, f"x <- e{CHAIN_LENGTH} par e{CHAIN_LENGTH}.")
    assert message.startswith("par never matches here: both sides are instants")


def test_event_of_two_rules_is_instant_if_both_are() -> None:
    assert len(messages_of(FIRST, "e1 <- e0. e1 <- e0. x <- e1 par e1.")) == 1
    assert messages_of(FIRST, "e1 <- e0. e1 <- e0 seq e0. x <- e1 par e1.") == []


def test_recursive_events_are_no_instants() -> None:
    assert len(messages_of(FIRST, "a <- b where true. b <- e0 where true. x <- a par b.")) == 1
    assert messages_of(FIRST, "a <- b where true. b <- a where true. x <- a par b.") == []


def milliseconds(rules: Any, recorded: Any = ()) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules)
    topics = Topics((TopicType("speech", "std_msgs/String"),))
    program = ProgramModel(
        engine.rules, engine.knowledge, Definitions(), topics, recorded_topics=tuple(recorded)
    )
    return [error.message for error in find_likely_milliseconds(program)]


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("x <- a seq absent(b, 5000).", "5000 is 83.3 minutes"),
        ("x <- (a seq b) within 500.", "500 is 8.33 minutes"),
        ("x(N) <- aggregate(count, a, N, last(2500)).", "2500 is 41.7 minutes"),
        ("x(N) <- aggregate(count, a, N, last(10, every(1000))).", "1000 is 16.7 minutes"),
        ("x <- a with throttle(10000).", "10000 is 2.8 hours"),
        ("exceptionAlarm(x, 500) <- a.", "500 is 8.33 minutes"),
        ("x <- a do timer(t, after(1700)).", "1700 is 28.3 minutes"),
    ],
)
def test_span_of_no_whole_minute_is_reported(rule: str, message: str) -> None:
    (finding,) = milliseconds(rule)
    assert finding.startswith(f"{message}, because spans are in seconds: for milliseconds write ")


@pytest.mark.parametrize(
    "rule",
    [
        "x <- a seq absent(b, 5).",
        "x <- (a seq b) within 600.",
        "x(N) <- aggregate(count, a, N, last(3600)).",
        "x(N) <- aggregate(count, a, N, last(500, events)).",
        "x <- a with throttle(1800).",
        "x <- a where value(last(5000)).",
        "x <- every(1000).",
        "x <- a seq absent(b, 90000).",
    ],
)
def test_likely_seconds_are_not_reported(rule: str) -> None:
    assert milliseconds(rule) == []


@pytest.mark.parametrize(
    ("span", "period", "count"),
    [(3000, 0.1, 1), (250, 0.1, 1), (250, 0.5, 0), (600, 0.1, 0), (30, 0.001, 0), (3000, None, 0)],
)
def test_span_is_compared_with_the_rate_of_a_bag(
    span: int, period: Optional[float], count: int, definitions: Definitions
) -> None:
    rules = f"heard(T) <- std_msgs__0__String(T). x <- heard(T) seq absent(heard(T), {span})."
    engine = Engine()
    engine.load(rules=rules)
    recorded = (RecordedTopic("/speech", "std_msgs/String", period),)
    program = ProgramModel(engine.rules, engine.knowledge, definitions, TOPICS, recorded_topics=recorded)
    messages = [error.message for error in find_likely_milliseconds(program)]
    assert len(messages) == count
    assert all(f"in the bag, a message of speech arrives every {period} s" in message for message in messages)


def unreachable_limits(rule: str) -> List[str]:
    engine = Engine()
    engine.load(rules=rule)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_unreachable_limits(program)]


@pytest.mark.parametrize(
    ("pattern", "seconds"),
    [
        ("a seq absent(b, 5)", 5),
        ("aggregate(count, a, _, timed_out(steps([x, y]), 5))", 5),
        ("aggregate(avg(X), c(X), _, held(every(5)))", 5),
        ("aggregate(avg(X), c(X), _, held(last(5, every(2))))", 5),
        ("aggregate(count, a, _, every(5))", 5),
        ("aggregate(count, a, _, every(5, first))", 5),
        ("aggregate(count, a, _, last(5, every(2)))", 5),
        ("a with debounce(5)", 5),
        ("(a with debounce(2)) seq (b seq absent(c(_), 3))", 5),
        ("(a with debounce(2)) and (b seq absent(c(_), 5))", 5),
        ("(a seq absent(b, 5)) or (b seq absent(a, 7))", 5),
        ("(a with debounce(2.5)) ntimes 2", 5),
        ("(a seq absent(b, 5)) seq (b star_times)", 5),
    ],
)
def test_limit_that_no_match_satisfies_is_reported(pattern: str, seconds: int) -> None:
    """Each match takes exactly the seconds or more, and within allows less, a window of a label as many."""
    (message,) = unreachable_limits(f"x <- ({pattern}) within {seconds}.")
    assert message == (
        f"within never matches here: each match takes at least {seconds} s, and within allows less than {seconds} s"
    )
    assert unreachable_limits(f"x <- ({pattern}) within {seconds}.001.") == []
    (message,) = unreachable_limits(f"l([property(window, 4.5)]) : x <- {pattern}.")
    assert message == f"window 4.5 never matches: each match takes at least {seconds} s"
    assert unreachable_limits(f"l([property(window, {seconds})]) : x <- {pattern}.") == []


@pytest.mark.parametrize(
    "pattern",
    [
        "a seq b",
        "n(N) seq absent(a, N)",
        "a or (b seq absent(a, 5))",
        "at_end(a seq absent(b, 5))",
        "a with throttle(5)",
        "a with not_preceded(b, 5)",
        "(a seq b) cnot (c(_) seq absent(b, 5))",
        "a seq ((b seq absent(a, 5)) star_times)",
        "aggregate(count, a, _, last(5))",
        "aggregate(count, a, _, session(5))",
        "aggregate(count, a, _, running(every(5)))",
        "aggregate(count, a, _, steps([x, y]))",
        "aggregate(avg(X), c(X), _, held(last(5)))",
    ],
)
def test_limit_that_a_match_may_satisfy_is_not_reported(pattern: str) -> None:
    assert unreachable_limits(f"x <- ({pattern}) within 1.") == []


@pytest.mark.parametrize(
    ("pattern", "condition", "seconds"),
    [
        ("aggregate(count, a, _, last(30))", "E-S>=30", 30),
        ("aggregate(count, a, _, last(30))", "E-S>30.5", 30),
        ("(aggregate(count, a, _, last(30)) where true)", "30=<E-S", 30),
        ("((a seq b) within 5)", "5<E-S", 5),
    ],
)
def test_span_that_no_match_has_is_reported(pattern: str, condition: str, seconds: int) -> None:
    (message,) = unreachable_limits(f"x <- {pattern} check (t1(S), t2(E), {condition}).")
    assert message == f"{condition} never holds: each match takes less than {seconds} s"


@pytest.mark.parametrize(
    ("pattern", "condition"),
    [
        ("aggregate(count, a, _, last(30))", "E - S >= 29.9"),
        ("aggregate(count, a, _, last(30))", "E - S < 40"),
        ("aggregate(count, a, _, last(30))", "(E - S >= 30 ; E > 5)"),
        ("aggregate(count, a, _, last(30))", "(B is S - 40, E - B >= 30)"),
        ("aggregate(count, a, _, last(30, every(10)))", "E - S >= 30"),
        ("aggregate(count, a, _, last(30, events))", "E - S >= 30"),
        ("aggregate(count, a, _, last(30)) seq b", "E - S >= 30"),
    ],
)
def test_span_that_a_match_may_have_is_not_reported(pattern: str, condition: str) -> None:
    assert unreachable_limits(f"x <- ({pattern}) check (t1(S), t2(E), {condition}).") == []
