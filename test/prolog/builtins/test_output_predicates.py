"""Captured output, and terms as strings."""

from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog


def test_capture_of_output_ends_with_its_goal() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert first(logic, "with_output_to(string(S), (write(a), print('B c')))") == "\"a'B c'\""
    assert answers(logic, "catch(with_output_to(string(_), throw(x)), x, true), write(hi)") == [{}]
    assert answers(logic, "with_output_to(atom(_), fail)") == []
    assert answers(logic, "write(ho)") == [{}]
    assert "".join(written) == "hiho"


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("term_string(f('A b', \"s\"), S, [quoted(false)])", {"S": '"f(A b,s)"'}),
        ("term_string(f('A b', \"s\"), S, [])", {"S": '"f(\'A b\',\\"s\\")"'}),
        ("term_string(1 + a, S, [ignore_ops(true)])", {"S": '"+(1,a)"'}),
        ("X = f(A), term_string(X, S, [variable_names(['Left' = A])])", {"S": '"f(Left)"'}),
        ("term_string(_, \"p(X, Y)\", [variable_names(['X' = 1, 'Y' = Z])]), Z = 2", {"Z": "2"}),
        ('term_string(X, "\\"s\\"", [double_quotes(atom)])', {"X": "s"}),
        ('term_string(X, "s", [2])', "type_error(option,2)"),
        ("term_string(X, S, Options)", "instantiation_error"),
    ],
)
def test_term_string_uses_options(goal: str, expected: Any) -> None:
    solution = answers(prolog(), goal)[0]
    if isinstance(expected, dict):
        solution = {name: solution[name] for name in expected}
    assert solution == expected
