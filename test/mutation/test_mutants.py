"""Mutants of small sources: one change of an operator, constant or statement each."""

from typing import Any, Set

import pytest

from .mutants import mutants


def mutated_bodies(body: Any) -> Set[Any]:
    """Return the mutants of the one-line body of a function."""
    source = f"def f(a, b):\n    {body}\n"
    lines = [mutant.apply(source).splitlines()[1].strip() for mutant in mutants(source)]
    assert body not in lines
    return set(lines)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("x = a < b", {"x = a <= b"}),
        ("x = a <= b", {"x = a < b"}),
        ("x = a is not b", {"x = a is b"}),
        ("x = a  not  in b", {"x = a  in b"}),
        ("x = a and b", {"x = a or b"}),
        ("x = (a) or (b)", {"x = (a) and (b)"}),
        ("x = not a", {"x = bool(a)"}),
        ("x = a + b", {"x = a - b"}),
        ("x = 7", {"x = 8"}),
        ("x = True", {"x = False"}),
        ("a.x = b", {"pass"}),
        ("a(b)", {"pass"}),
        ("return a", {"return None"}),
        ("raise a", {"pass"}),
        ("x: int = b", set()),
        ("return None", set()),
        ('"""A docstring of 1 line."""', set()),
    ],
)
def test_each_mutant_changes_one_operator(body: str, expected: Set[Any]) -> None:
    assert mutated_bodies(body) == expected


def test_conditions_and_local_constants_are_mutated() -> None:
    source = "LIMIT = 3\n\n\ndef f(a):\n    if a:\n        return 1\n    return None\n"
    described = [mutant.describe(source) for mutant in mutants(source)]
    assert described == ["if a:  =>  if not (a):", "return 1  =>  return None", "return 1  =>  return 2"]


def test_operator_after_non_ascii_text_is_mutated() -> None:
    source = 'def f(a, b):\n    x = ("ä€", a < b)\n'
    assert [mutant.apply(source) for mutant in mutants(source)] == ['def f(a, b):\n    x = ("ä€", a <= b)\n']


def test_operator_in_comment_is_not_mutated() -> None:
    source = "def f(a, b):\n    return (\n        a  # < not this one\n        < b\n    )\n"
    comparisons = [mutant for mutant in mutants(source) if mutant.operator == "comparison"]
    assert [mutant.line for mutant in comparisons] == [4]
