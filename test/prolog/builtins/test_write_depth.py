"""Depth limit of written terms, finite and cyclic."""

from typing import Any, List

import pytest
from prolog.goal_answers import answers, prolog


@pytest.mark.parametrize(
    ("term", "depth", "text"),
    [
        ("[1,2,3,4,5]", 0, "[1,2,3,4,5]"),
        ("[1,2,3,4,5]", 3, "[1,2|...]"),
        ("[1,2,3]", 4, "[1,2,3]"),
        ("[1,2]", 1, "[...|...]"),
        ("[a|b]", 2, "[a|...]"),
        ("[a|b]", 3, "[a|b]"),
        ("[a,b|f(c)]", 4, "[a,b|f(...)]"),
        ("f([1,2,3,4,5])", 4, "f([1,2|...])"),
        ("[[1,2,[3,[4]]],a,b]", 4, "[[1,2|...],a,b]"),
        ("f(g(h(i(j))))", 3, "f(g(h(...)))"),
        ("f(1,2,3,4,5,6,7)", 3, "f(1,2,3,4,5,6,7)"),
        ("1+2+3+4+5", 3, "... + ... + 4+5"),
        ("{a,b,c,d}", 3, "{a,...,...}"),
        ("- (- (- (1)))", 3, "- - - ..."),
        ("abc", 1, "abc"),
        ("f(x)", 1, "f(...)"),
    ],
)
def test_parts_beyond_depth_limit_are_elided(term: str, depth: int, text: str) -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, f"write_term({term}, [max_depth({depth})])") == [{}]
    assert "".join(written) == text


def test_cyclic_term_is_elided() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "L = [a|L], T = f(T), write_term(L-T, [max_depth(4)]), fail") == []
    assert "".join(written) == "[a,a|...]-f(f(f(...)))"


@pytest.mark.slow
def test_deep_term_below_limit_is_written_completely() -> None:
    logic = prolog("deep(0, a) :- !. deep(N, f(T)) :- M is N - 1, deep(M, T).")
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "deep(5000, T), write_term(T, [max_depth(100000)]), fail") == []
    assert len("".join(written)) == 5000 * 3 + 1


def test_depth_that_is_no_integer_is_refused() -> None:
    assert answers(prolog(), "write_term(a, [max_depth(x)])") == ["type_error(integer,x)"]
