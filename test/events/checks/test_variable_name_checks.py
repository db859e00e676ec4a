"""Checks of the names of variables: constants that were probably meant as variables."""

from typing import List

import pytest

from retalis import Definitions, Engine
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
