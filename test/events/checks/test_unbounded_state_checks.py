"""Checks of state that no time ends: keys of stream operators."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.events.checks.program_model import ProgramModel
from retalis.events.checks.unbounded_state_checks import find_unbounded_keys
from retalis.events.program.topic_configuration import Topics


def unbounded(rules: str, flags: Any = ()) -> List[Any]:
    engine = Engine()
    for flag, value in flags:
        assert engine.call(f"set_etalis_flag({flag}, {value})")
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_unbounded_keys(program)]


KEYED = [
    "p(K) <- aggregate(count, q(K, V), _, steps([up where V == 1, down where V == 0])).",
    "p(K, A) <- aggregate(avg(V), q(K, V), A, last(3, events)).",
    "p(K, A) <- aggregate(avg(V), q(K, V), A, running(every(3, events))).",
    "p(K, A) <- aggregate(avg(V), q(K, V), A, held(last(3))).",
    "p(K) <- q(K, V) with change(V, f(K)).",
    "p(K) <- aggregate(count, (q(K, V) with change(V, K)), _, last(3)) within 5.",
    "p <- s cnot (q(K, V) with change(V, K)) within 5.",
]


@pytest.mark.parametrize("rule", KEYED)
def test_state_of_keys_that_no_time_ends_is_named(rule: str) -> None:
    (message,) = unbounded(rule)
    assert "no time ends the state" in message
    assert "property(ttl, SECONDS), or property(ttl, 0)" in message
    assert unbounded(f"l([property(ttl, 5)]) : {rule}") == []
    assert unbounded(f"l([property(ttl, 0)]) : {rule}") == []
    assert unbounded(f"l([property(window, 5)]) : {rule}") == []
    assert unbounded(rule, [("state_ttl", 5)]) == []
    assert unbounded(rule, [("garbage_control", "general")]) == []


@pytest.mark.parametrize(
    "rule",
    [
        "p(A) <- aggregate(avg(V), q(_, V), A, last(3, events)).",
        "p(A) <- aggregate(avg(V), q(left, V), A, last(3, events)).",
        "p(K, A) <- aggregate(avg(V), q(K, V), A, last(3)).",
        "p(K, A) <- aggregate(avg(V), q(K, V), A, every(3)).",
        "p(K, A) <- aggregate(avg(V), q(K, V), A, held(last(3), max(9))).",
        "p(K, A) <- aggregate(avg(V), q(K, V), A, held(every(3))).",
        "p(K) <- q(K, V) with throttle(3, K).",
        "p(V) <- q(_, V) with change(V).",
        "p(K) <- (q(K, V) with change(V, K)) within 5.",
        "p(K) <- (s(K) seq aggregate(count, q(K, V), _, last(3, events))) within 5.",
    ],
)
def test_bounded_state_is_not_named(rule: str) -> None:
    assert unbounded(rule) == []
