"""Check of events that raise themselves: long chains of rules, and cycles of several events."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.events.checks.event_cycle_checks import find_cycles
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics

CHAIN_LENGTH = 400

PLAIN = [f"f{number + 1} <- f{number}." for number in range(CHAIN_LENGTH)]


def cycles_of(*rules: Any) -> List[Any]:
    engine = Engine()
    engine.load(rules="\n".join(rules))
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_cycles(program)]


@pytest.mark.slow
def test_cycle_after_long_chain_is_reported_once() -> None:
    (message,) = cycles_of(*PLAIN, f"g <- f{CHAIN_LENGTH}. g <- h. h <- g.")
    assert message.startswith("these events fire each other (g/0 <- h/0 <- g/0)")


def test_cycle_is_reported_once() -> None:
    (message,) = cycles_of(*PLAIN[:9], "f0 <- f9.")
    assert message.startswith("these events fire each other (f1/0 <- f0/0 <- f9/0 <- ")
