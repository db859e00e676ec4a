"""Checks of value types: arrays, messages and texts as arguments."""

from typing import Any, List, Optional

import pytest

from retalis import Definitions, Engine
from retalis.events.checks.program_model import ProgramModel
from retalis.events.checks.variable_type_checks import (
    _ARRAY_PREDICATES,
    find_type_conflicts,
)
from retalis.events.program.topic_configuration import Topics
from retalis.messages.message_templates import SENSOR_PREDICATES
from retalis.prolog.builtins.builtin_registry import ENTRIES


def messages_of(definitions: Definitions, rules: str) -> List[Any]:
    engine = Engine(definitions=definitions)
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, definitions, Topics())
    return [error.message for error in find_type_conflicts(program)]


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (
            "image_pixel(D, 0, 0, _)",
            "D is a text (data of sensor_msgs/Image), not a whole message: image_pixel/4 takes a sensor_msgs/Image",
        ),
        (
            "array_min(W, _)",
            "W is a number (width of sensor_msgs/Image), not an array: array_min/2 takes a list of numbers",
        ),
        (
            "map_cell(sensor_msgs__0__Image{width: W, data: D}, 0, 0, _)",
            "map_cell/4 takes a nav_msgs/OccupancyGrid, not a sensor_msgs/Image",
        ),
        ("array_min(D, W)", None),
        ("image_array(sensor_msgs__0__Image{width: W, data: D}, _)", None),
        ("(access_mem(m, I, _), image_pixel(I, W, W, D))", None),
    ],
)
def test_arguments_of_array_predicates_are_checked(
    definitions: Definitions, goal: str, message: Optional[str]
) -> None:
    rules = f"a <- sensor_msgs__0__Image{{data: D, width: W}} where {goal}."
    assert messages_of(definitions, rules) == ([message] if message else [])


def test_array_as_number_is_reported(definitions: Definitions) -> None:
    (message,) = messages_of(definitions, "a <- sensor_msgs__0__LaserScan{ranges: R} where R < 1.")
    assert message.startswith(
        "R is a list (ranges of sensor_msgs/LaserScan), not a number: take a number of it"
    )


@pytest.mark.parametrize("value_type", ["integer", "float", "number", "atom"])
def test_declared_value_is_no_array(definitions: Definitions, value_type: str) -> None:
    rules = f":- event level(height:{value_type}).\na(M) <- level(H) where array_max(H, M)."
    (message,) = messages_of(definitions, rules)
    assert message.endswith("(height of level/1), not an array: array_max/2 takes a list of numbers")


@pytest.mark.parametrize(
    "goal", ["Y is sin(T)", "Y is atan2(1, T)", "1 < 2 ** log(T)", "0 =:= powm(2, T, 7)"]
)
def test_text_in_any_function_is_reported(definitions: Definitions, goal: str) -> None:
    (message,) = messages_of(definitions, f"a <- std_msgs__0__String(T) where {goal}.")
    assert message == "T is a text (data of std_msgs/String), not a number: compare texts with == or \\=="


def test_array_and_message_predicates_are_known() -> None:
    assert {name for name, _ in ENTRIES} >= _ARRAY_PREDICATES
    assert {f"{name}/{arity}" for name, arity in ENTRIES} >= {
        predicate for predicates in SENSOR_PREDICATES.values() for predicate in predicates
    }


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("aggregate(avg(Ranges), msgs__0__Scan(_, Ranges, _), D, last(5))", []),
        ("aggregate(quantile(0.1, Ranges), msgs__0__Scan(_, Ranges, _), D, last(5))", []),
        (
            "aggregate(quantile(0.1, Id), msgs__0__Scan{id: Id}, D, last(5))",
            ["Id is a text (id of msgs/Scan): quantile collects numbers"],
        ),
        (
            "aggregate(stddev(Id), msgs__0__Scan{id: Id}, D, last(5))",
            ["Id is a text (id of msgs/Scan): stddev collects numbers"],
        ),
        (
            "b seq aggregate(avg(Ranges), msgs__0__Scan(_, Ranges, _), D)",
            ["Ranges is a list (ranges of msgs/Scan): avg collects numbers"],
        ),
    ],
)
def test_windows_accept_arrays(definitions: Definitions, pattern: str, message: List[str]) -> None:
    definitions.add("msgs/Scan", "float32 a\nfloat32[] ranges\nstring id\n")
    assert messages_of(definitions, f"a(D) <- {pattern}.") == message
