"""Checks of numbers: integers and floats in slots, and inexact decimals."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.events.checks.number_type_checks import find_inexact_decimals, find_number_type_mismatches
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics, topic_type

TOPICS = Topics((topic_type("at", "geometry_msgs/Point"), topic_type("n", "std_msgs/Int32")))


def messages_of(
    definitions: Any, rules: str = "", goals: str = "", check: Any = find_number_type_mismatches
) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules, goals=goals)
    return [
        error.message for error in check(ProgramModel(engine.rules, engine.knowledge, definitions, TOPICS))
    ]


@pytest.mark.parametrize(
    ("rules", "goals", "message"),
    [
        ("a <- std_msgs__0__Int32(2.0).", "", "data of std_msgs/Int32 is an integer in events: write 2"),
        (
            "a <- std_msgs__0__Int32(2.5).",
            "",
            "data of std_msgs/Int32 is an integer in events: write one",
        ),
        (
            "a <- std_msgs__0__Int32(N) where 3.0 == N.",
            "",
            "N is an integer (data of std_msgs/Int32), never a float: write =:=",
        ),
        (
            "",
            "memorize(geometry_msgs__0__Point(X, _, 0), [], X, m, 5)",
            "memory m: z of geometry_msgs/Point is a float in events: write 0.0",
        ),
        (
            "",
            "subscribe(geometry_msgs__0__Point(X, _, _), [X = 0], X, t, s)",
            "a subscription of topic t: this variable is a float (x of geometry_msgs/Point), "
            "never an integer: write =:=",
        ),
    ],
)
def test_comparison_with_other_number_type_is_reported(
    definitions: Definitions, rules: str, goals: str, message: str
) -> None:
    assert messages_of(definitions, rules, goals) == [message]


@pytest.mark.parametrize(
    "rules",
    [
        "a <- geometry_msgs__0__Point(0.0, X, Y) where (X =:= 0, Y == 0.0, X > 3).",
        "a <- std_msgs__0__Int32(N) where (N == 3, N =\\= 3.0).",
        "geometry_msgs__0__Point(0, 1, 2) <- b. a <- geometry_msgs__0__Point(0, X, _) where X == 1.",
        "null do new_event(geometry_msgs__0__Point(0, 1, 2), 1, 2) <- b. a <- geometry_msgs__0__Point(0, _, _).",
        "null do (thing(T), new_event(T, 1, 2)) <- b. a <- geometry_msgs__0__Point(0, _, _). thing(x).",
        "a <- b(geometry_msgs__0__Point(0, _, _)).",
        "a <- (geometry_msgs__0__Point(X, _, _) or b(X)) where X == 0.",
        "a <- geometry_msgs__0__Point(X, _, _) where (Y = 0 ; Y = 1), X > Y.",
    ],
)
def test_possible_comparison_is_not_reported(definitions: Definitions, rules: str) -> None:
    assert messages_of(definitions, rules) == []


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (
            "a <- geometry_msgs__0__Point(X, _, _) where X =:= 11.6.",
            "X is a float (x of geometry_msgs/Point), which a measured value rarely equals exactly: "
            "write abs(X - 11.6) < 0.001",
        ),
        (
            "a <- geometry_msgs__0__Point(X, _, _) where X == 0.1.",
            "X is a float (x of geometry_msgs/Point), which a measured value rarely equals exactly: "
            "write abs(X - 0.1) < 0.001",
        ),
        (
            "a <- geometry_msgs__0__Point(0.1, _, _).",
            "x of geometry_msgs/Point is matched only if it is exactly 0.1: for a measured value write a variable V, "
            "and where abs(V - 0.1) < 0.001",
        ),
    ],
)
def test_equality_with_inexact_decimal_is_reported(definitions: Definitions, rule: str, message: str) -> None:
    assert messages_of(definitions, rule, check=find_inexact_decimals) == [message]


@pytest.mark.parametrize(
    "rule",
    [
        "a <- geometry_msgs__0__Point(0.5, _, _).",
        "a <- geometry_msgs__0__Point(X, _, _) where X =:= 0.",
        "a <- geometry_msgs__0__Point(X, _, _) where X > 0.1.",
        "a <- geometry_msgs__0__Point(X, _, _) where X =:= inf.",
        "a <- b(X) where X =:= 0.1.",
        "a <- std_msgs__0__Int32(N) where N =:= 2.",
        "a <- b(0.1).",
    ],
)
def test_exact_or_unmeasured_numbers_are_not_reported(definitions: Definitions, rule: str) -> None:
    assert messages_of(definitions, rule, check=find_inexact_decimals) == []
