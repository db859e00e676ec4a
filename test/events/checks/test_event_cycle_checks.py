"""Check of events that raise themselves: long chains of rules, and cycles of several events."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.events.checks import event_cycle_checks
from retalis.events.checks.event_cycle_checks import find_cycles
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics
from retalis.prolog.terms.unification import unify

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


def test_argument_that_ends_the_second_round_excludes_cycle() -> None:
    assert cycles_of("q(1) <- p.", "r(X) <- q(X).", "p <- r(2).") == []
    (message,) = cycles_of("q(1) <- p.", "r(X) <- q(X).", "p <- r(1).")
    assert message.startswith("these events fire each other (")


def test_constants_at_any_argument_separate_events() -> None:
    (message,) = cycles_of(
        "s(d, 2, f(_)) <- s(d, 1, _).", "s(d, 1, g) <- s(d, 2, f(3)).", "s(d, 4, X) <- s(d, 3, X)."
    )
    assert message.startswith("these events fire each other (s/3 <- s/3 <- s/3)")
    (message,) = cycles_of("s(X, 1) <- s(X, _).")
    assert message.startswith("s/2 fires itself")


def test_states_of_one_functor_are_checked_in_linear_time(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 0

    def count_call(*arguments: Any) -> Any:
        nonlocal count
        count += 1
        return unify(*arguments)

    monkeypatch.setattr(event_cycle_checks, "unify", count_call)
    assert cycles_of(*(f"s(door, {number + 1}) <- s(door, {number})." for number in range(60))) == []
    assert count < 100
