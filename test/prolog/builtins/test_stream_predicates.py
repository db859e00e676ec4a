"""Predicates of the standard streams."""

from typing import Any

import pytest
from prolog.goal_answers import answers, prolog


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("read_term(user_input, X, [])", [{"X": "end_of_file"}]),
        ("read(user_input, X)", [{"X": "end_of_file"}]),
        ("get_char(X)", [{"X": "end_of_file"}]),
        ("peek_code(user_input, X)", [{"X": "-1"}]),
        ("get_char(user_output, _)", ["permission_error(input,stream,user_output)"]),
        ("get_char(s, _)", ["existence_error(stream,s)"]),
        ("get_char(_, _)", ["instantiation_error"]),
        ("at_end_of_stream(user_input)", [{}]),
        ("current_output(S), write(S, '')", [{"S": "user_output"}]),
        ("char_conversion(a, bc)", ["representation_error(character)"]),
        ("current_char_conversion(X, b)", [{"X": "b"}]),
    ],
)
def test_standard_input_is_empty(goal: str, expected: Any) -> None:
    assert answers(prolog(), goal) == expected
