"""Checks of the names of variables: constants that were probably meant as variables, and the reverse."""

from pathlib import Path
from typing import List

import pytest

from retalis import Definitions, Engine
from retalis.engine.program_check import check_program
from retalis.events.checks.program_model import ProgramModel
from retalis.events.checks.variable_name_checks import find_constants_meant_as_variables
from retalis.events.program.topic_configuration import Topics


def constants_of(rules: str) -> List[str]:
    engine = Engine()
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_constants_meant_as_variables(program)]


@pytest.mark.parametrize(
    ("rules", "name"),
    [
        ("hot(m) <- temp(m, T) where T > 40.", "m"),
        ("hot(m) <- temp(m, T) where T > 40. cold(N) <- temp(N, T) where T < 4.", "m"),
        ("hot(motor) <- temp(motor, T) where T > 40. cold(Motor) <- temp(Motor, T) where T < 4.", "motor"),
        ("hot(t) <- temp(left, t).", "t"),
        ("hot(m) <- temp(m, T) seq door(open) where T > 40.", "m"),
    ],
)
def test_constant_meant_as_variable_is_reported(rules: str, name: str) -> None:
    (message,) = constants_of(rules)
    assert message.startswith(f"{name} is a constant")
    assert message.endswith(f"write the variable {name.capitalize()}")


@pytest.mark.parametrize(
    "rules",
    [
        "hot(left) <- temp(left, T) where T > 40.",
        "hot(M) <- temp(M, T) where T > 40.",
        "hot <- temp(m, T) where T > 40.",
        "hot(m) <- temp(_, T) where T > 40.",
        "hot(a) <- temp(a, T) where T > 40. hot(b) <- temp(b, T) where T > 50.",
        "hot(m) <- temp(m, T) where T > 40. motor(m).",
        "hot(m) <- temp(m, T) where T > 40. temp(m, T) <- raw(T).",
        ":- memorize(temp(m, T), [], T, heat, 5). hot(m) <- temp(m, T) where T > 40.",
        "alarm(m) <- ok cnot temp(m, _).",
    ],
)
def test_constant_that_is_known_is_not_reported(rules: str) -> None:
    assert constants_of(rules) == []


@pytest.mark.parametrize(
    ("rule", "constant"),
    [
        (
            "full <- sensor_msgs__0__BatteryState{power_supply_status: S} where S == {POWER_SUPPLY_STATUS_FULL}.",
            "sensor_msgs__0__BatteryState{POWER_SUPPLY_STATUS_FULL}",
        ),
        (
            "full <- sensor_msgs__0__BatteryState{power_supply_status: S} where S =:= POWER_SUPPLY_STATUS_FULL.",
            "sensor_msgs__0__BatteryState{POWER_SUPPLY_STATUS_FULL}",
        ),
        (
            "broken <- diagnostic_msgs__0__DiagnosticArray{status: [{level: L}|_]} where L == {ERROR}.",
            "diagnostic_msgs__0__DiagnosticStatus{ERROR}",
        ),
    ],
)
def test_constant_of_message_in_condition_is_suggested(
    tmp_path: Path, definitions: Definitions, rule: str, constant: str
) -> None:
    (tmp_path / "rules.txt").write_text(rule)
    findings = check_program(tmp_path / "rules.txt", definitions)
    (message,) = [finding.problem.message for finding in findings if finding.problem.code == "RT1406"]
    assert message.endswith(f"write {constant}")


def test_unknown_name_in_condition_is_no_constant(tmp_path: Path, definitions: Definitions) -> None:
    rule = "full <- sensor_msgs__0__BatteryState{power_supply_status: S} where S == {STATUS_FULL}."
    (tmp_path / "rules.txt").write_text(rule)
    findings = check_program(tmp_path / "rules.txt", definitions)
    (message,) = [finding.problem.message for finding in findings if finding.problem.code == "RT1406"]
    assert message.startswith("STATUS_FULL occurs only here")
