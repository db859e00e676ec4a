"""Rules before a declaration that do not fit it, and value types of declared events and messages."""

from pathlib import Path
from typing import Any, Dict, List

import pytest
from events.checks.inserted_mistakes import find_mistakes, write_program

from retalis import Definitions
from retalis.engine.client_requests import add_rule
from retalis.engine.engine import Engine

DECLARATION = "\n:- event near(thing:atom, distance:number)."
INPUT_EVENT = "input_event(near/2).\n"


@pytest.mark.parametrize(
    ("program", "positions"),
    [
        ({"rule": "alarm('\"a\"') <- near(_, far).\n" + INPUT_EVENT + DECLARATION}, ["eventRules.txt:3:25"]),
        ({"rule": "alarm('\"a\"') do event(near(1, 2)) <- hit." + DECLARATION}, ["eventRules.txt:3:28"]),
        ({"rule": "null_event do event(near(1, 2)) <- hit." + DECLARATION}, ["eventRules.txt:3:26"]),
        ({"rule": "go :- event(near(1, 2)).\nhit do go." + DECLARATION}, ["eventRules.txt:3:18"]),
        (
            {
                "rule": INPUT_EVENT,
                "goal": "memorize(near(_, far), [], _, n, 3)\nevent near(thing:atom, distance:number)",
            },
            ["goalPredicates.txt:4:18"],
        ),
        (
            {"goal": "state(held, from(near(1, 2)), until(hit))\nevent near(thing:atom, distance:number)"},
            # Nothing else makes the event either.
            ["goalPredicates.txt:4:18", "goalPredicates.txt:4:23"],
        ),
        (
            {"rule": "synchronized(near(1, 2), true, []) <- hit.\nalarm(T) <- near(_, T)." + DECLARATION},
            ["eventRules.txt:3:19"],
        ),
    ],
)
def test_rule_before_declaration_is_checked(
    tmp_path: Path, definitions: Definitions, program: Dict[str, Any], positions: List[str]
) -> None:
    write_program(tmp_path, **program)
    mistakes = find_mistakes(tmp_path, definitions)
    assert [mistake.place for mistake in mistakes] == positions
    assert mistakes[-1].code == "RT1108"


@pytest.mark.parametrize(
    ("rule", "column", "message"),
    [
        (
            "alarm(T) <- near(_, T) and std_msgs__0__String(T).",
            48,
            "T is a number (distance of near/2) and, here, a text (data of std_msgs/String): these are never equal",
        ),
        (
            "alarm(T) <- near(_, T) and std_msgs__0__Bool(T).",
            46,
            "T is a number (distance of near/2) and, here, true or false (data of std_msgs/Bool): "
            "these are never equal",
        ),
        (
            "alarm(T) <- near(T, D) where D == far.",
            35,
            "D is a number (distance of near/2): it is never far",
        ),
        (
            "alarm(T) <- near(T, D) where T > D.",
            30,
            "T is an atom (thing of near/2), not a number: compare atoms with == or \\==",
        ),
    ],
)
def test_values_unlike_declaration_are_reported(
    tmp_path: Path, definitions: Definitions, rule: str, column: int, message: str
) -> None:
    write_program(tmp_path, rule=f"{INPUT_EVENT}{DECLARATION}\n{rule}")
    assert find_mistakes(tmp_path, definitions) == [("RT1106", f"eventRules.txt:6:{column}", message)]


@pytest.mark.parametrize(
    "rule",
    [
        "alarm(T) <- near(T, _) and std_msgs__0__String(T).",
        "alarm(T) <- near(T, _) and std_msgs__0__Bool(T).",
        "alarm(T) <- near(_, T) and sensor_msgs__0__Temperature(_, T, _).",
        "alarm(T) <- near(T, D) where near(D, T).\nnear(1, 2).",
    ],
)
def test_values_of_messages_fit_declared_events(tmp_path: Path, definitions: Definitions, rule: str) -> None:
    write_program(tmp_path, rule=f"{INPUT_EVENT}{DECLARATION}\n{rule}")
    assert find_mistakes(tmp_path, definitions) == []


def test_earlier_added_rule_is_checked(tmp_path: Path, definitions: Definitions) -> None:
    engine = Engine()
    add_rule(engine, "alarm <- near(_)", "mine")
    engine.call("declare_event(near(thing:atom, distance:number))")
    message = [warning.message for warning in engine.warnings(tmp_path, definitions)]
    assert (
        "near/1 does not match its declaration: near(thing:atom,distance:number) has 2 arguments" in message
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "temperature:number, variance:number",
            "near/3 does not match its declaration: near(temperature:number,variance:number) has 2 arguments",
        ),
        (
            "header:any, temperature:atom, variance:number",
            "temperature of near/3 is an atom, and temperature of sensor_msgs/Temperature a number",
        ),
        ("header:std_msgs__0__Header, temperature:number, variance:number", ""),
    ],
)
def test_named_event_of_topic_fits_declaration(
    tmp_path: Path, definitions: Definitions, arguments: str, message: str
) -> None:
    topic = '  <subscribe_to name="cold" msg_type="sensor_msgs/Temperature" event="near"/>'
    write_program(tmp_path, rule=f":- event near({arguments}).", topic=topic)
    expected = [("RT1108", "", f"the events of topic cold: {message}")] if message else []
    assert find_mistakes(tmp_path, definitions) == expected
