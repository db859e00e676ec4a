"""Hints for goals that call an event or a state as a predicate."""

import pytest

from retalis.engine.engine import Engine
from retalis.prolog.machine.errors import PrologError

PROGRAM = """
:- state(open(Door), from(opened(Door)), until(closed(Door))).
:- memorize(temp(Room, T), [], measured(Room, T), 'room temperatures', 10).
hot(Room) <- temp(Room, T) where T > 30.
"""


@pytest.fixture
def engine() -> Engine:
    engine = Engine()
    engine.load(rules=PROGRAM)
    return engine


def error_text(engine: Engine, goal: str) -> str:
    with pytest.raises(PrologError) as error:
        engine.query(goal)
    return error.value.message


NOT_RECORDED = "record it by memorize/5 and call access_mem/3, or declare a state and call holds/1"
RECORDED = "memory 'room temperatures' records it, so call access_mem('room temperatures',Record,[T1,T2])"


@pytest.mark.parametrize(
    ("goal", "event", "advice"),
    [
        ("temp(Room, T)", "temp/2", RECORDED),
        ("temp(kitchen)", "temp/2", RECORDED),
        ("hot(Room)", "hot/1", NOT_RECORDED),
        ("opened(front)", "opened/1", NOT_RECORDED),
    ],
)
def test_call_of_event_shows_alternative(engine: Engine, goal: str, event: str, advice: str) -> None:
    assert error_text(engine, goal).endswith(f": {event} is an event, and events are not facts: {advice}")


def test_advice_has_solutions(engine: Engine) -> None:
    engine.event("temp(kitchen, 20)", 1)
    assert engine.query("access_mem('room temperatures', Record, _), Record = measured(_, T)")[0]["T"] == 20


def test_call_of_state_names_holds(engine: Engine) -> None:
    assert (
        error_text(engine, "open(Door)")
        == "Unknown procedure: open/1: open/1 is a state: call holds(open(_))"
    )


def test_other_names_have_similar_predicates(engine: Engine) -> None:
    assert error_text(engine, "apend([], X, Y)").endswith("did you mean append/3?")


def test_condition_that_calls_event_is_reported(engine: Engine, caplog: pytest.LogCaptureFixture) -> None:
    engine.load(rules="cold(Room) <- asked(Room) where temp(Room, 5).")
    assert (
        f"there is no predicate temp/2 yet; temp/2 is an event, and events are not facts: {RECORDED}"
        in caplog.text
    )
