"""Traced ports of goals."""

from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis.prolog.system.prolog_system import PrologSystem


@pytest.fixture
def logic() -> PrologSystem:
    return prolog("p(1).\np(2) :- p(1).")


def test_trace_prints_ports(logic: PrologSystem) -> None:
    lines: List[Any] = []
    logic.error_output = lines.append
    assert answers(logic, "trace(p(X)), X > 1, p(_)", 1) == [{"X": "2"}]
    assert [" ".join(line.split()[:3]) for line in lines][1:] == [
        "Exit: (1) p(1)",
        "Redo: (1) p(1)",
        "Call: (2) p(1)",
        "Exit: (2) p(1)",
        "Exit: (1) p(2)",
    ]


def test_error_ends_tracing(logic: PrologSystem) -> None:
    lines: List[Any] = []
    logic.error_output = lines.append
    assert answers(logic, "catch(trace(throw(x)), x, true)") == [{}]
    assert first(logic, "p(X)") == "1"
    assert [line.split()[0] for line in lines] == ["Call:", "Exception:"]
