"""Explanations of missing events that several rules need."""

from typing import List

import pytest

from retalis import Engine, explain, record_origins


@pytest.fixture
def engine() -> Engine:
    engine = Engine()
    record_origins(engine)
    return engine


def explanation_lines(engine: Engine, event: str) -> List[str]:
    return [text for line in explain(engine, event).lines for text in line.indented()]


def test_shared_missing_event_is_explained_once(engine: Engine) -> None:
    engine.load(
        rules="alarm <- fire seq bell.\nalarm <- fire seq call.\nfire <- smoke seq heat.", source="mine"
    )
    engine.event("smoke", 1)
    assert explanation_lines(engine, "alarm") == [
        "rule alarm <- fire seq bell (mine:1)",
        "  - seq: one side is missing",
        "    - fire: did not happen",
        "      rule fire <- smoke seq heat (mine:3)",
        "        - seq: one side is missing",
        "          + smoke: at 1",
        "          - heat: did not happen",
        "    - bell: did not happen",
        "rule alarm <- fire seq call (mine:2)",
        "  - seq: one side is missing",
        "    - fire: did not happen, see above",
        "    - call: did not happen",
    ]


def test_missing_events_with_other_arguments_are_explained(engine: Engine) -> None:
    engine.load(rules="alarm <- fire(hall) or fire(bath).\nfire(X) <- heat(X).", source="mine")
    lines = explanation_lines(engine, "alarm")
    assert "      - heat(hall): did not happen" in [line[2:] for line in lines]
    assert "      - heat(bath): did not happen" in [line[2:] for line in lines]


def test_shared_begin_of_states_is_explained_once(engine: Engine) -> None:
    engine.load(
        rules=":- state(docked(R), from(dock(R)), until(undock(R))).\n"
        "alarm <- docked(a) seq bell.\nalarm <- docked(a) seq call.\ndock(R) <- bump(R)."
    )
    lines = explanation_lines(engine, "alarm")
    assert sum("bump(a): did not happen" in line for line in lines) == 1
    assert sum("docked(a): did not happen, see above" in line for line in lines) == 1


def test_explanation_grows_linearly_with_layers_of_alternative_rules(engine: Engine) -> None:
    layer_count = 30
    engine.load(
        rules="\n".join(
            f"layer({number}) <- layer({number + 1}) seq {name}({number})."
            for number in range(layer_count)
            for name in ("left", "right")
        )
    )
    # Each layer adds two rules with three lines of parts each.
    assert len(explanation_lines(engine, "layer(0)")) < 10 * layer_count
