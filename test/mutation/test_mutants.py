"""Mutants of small sources."""

import pytest

from .mutants import mutants


def changed(body):
    """Return the mutated versions of a function's body of one line."""
    source = f"def f(a, b):\n    {body}\n"
    lines = [mutant.apply(source).splitlines()[1].strip() for mutant in mutants(source)]
    assert body not in lines
    return set(lines)


@pytest.mark.parametrize(
    "body, wanted",
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
def test_each_operator_changes_one_place(body, wanted):
    assert changed(body) == wanted


def test_conditions_are_negated_and_constants_of_modules_left():
    source = "LIMIT = 3\n\n\ndef f(a):\n    if a:\n        return 1\n    return None\n"
    described = [mutant.describe(source) for mutant in mutants(source)]
    assert described == ["if a:  =>  if not (a):", "return 1  =>  return None", "return 1  =>  return 2"]


def test_a_place_after_characters_of_several_bytes_is_found():
    source = 'def f(a, b):\n    x = ("ä€", a < b)\n'
    assert [mutant.apply(source) for mutant in mutants(source)] == ['def f(a, b):\n    x = ("ä€", a <= b)\n']


def test_an_operator_in_a_comment_is_not_changed():
    source = "def f(a, b):\n    return (\n        a  # < not this one\n        < b\n    )\n"
    found = [mutant for mutant in mutants(source) if mutant.operator == "comparison"]
    assert [mutant.line for mutant in found] == [4]
