"""Clauses that change while they are retracted."""

from typing import Any, List

from prolog.goal_answers import answers, prolog


def test_retract_enumerates_clauses_of_call_time() -> None:
    logic = prolog(":- dynamic(insect/1). insect(ant). insect(bee).")
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "retract(insect(I)), write(I), retract(insect(bee)), fail") == []
    assert "".join(written) == "antbee"
    assert answers(logic, "insect(X)") == []
