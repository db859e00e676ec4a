"""Integer roots."""

from typing import Any

import pytest
from prolog.goal_answers import answers, prolog


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("3, 30, Root, Remainder", [{"Root": "3", "Remainder": "3"}]),
        ("3, -30, Root, Remainder", [{"Root": "-3", "Remainder": "-3"}]),
        ("1, -7, Root, Remainder", [{"Root": "-7", "Remainder": "0"}]),
        ("2, 0, Root, Remainder", [{"Root": "0", "Remainder": "0"}]),
        ("2, 10 ** 40, Root, Remainder", ["type_error(integer,10**40)"]),
        ("2, 5, 3, _", []),
        ("2, -30, Root, Remainder", ["evaluation_error(undefined)"]),
        ("0, 30, Root, Remainder", ["domain_error(not_less_than_one,0)"]),
        ("Degree, 30, Root, Remainder", ["instantiation_error"]),
    ],
)
def test_nth_integer_root_and_remainder(arguments: str, expected: Any) -> None:
    assert answers(prolog(), f"nth_integer_root_and_remainder({arguments})") == expected


def test_root_of_huge_integer_is_exact_or_refused() -> None:
    logic = prolog()
    goal = "X is 7 ** 5000 + 12345, nth_integer_root_and_remainder(D, X, R, M), X =:= R ** D + M, X < (R + 1) ** D"
    for degree in (2, 3, 7, 1000):
        assert len(answers(logic, f"D = {degree}, {goal}")) == 1
    assert answers(logic, "X is 3 ** 500000, nth_integer_root_and_remainder(2, X, R, M)") == [
        "resource_error(integer_size)"
    ]
