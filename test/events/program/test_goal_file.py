"""Goal files: one goal per line, goals over several lines, comments and errors."""

from typing import Any, List

import pytest
from asserting_accessors import place_of

from retalis import Operators, SyntaxFault
from retalis.events.program.goal_file import read_goals
from retalis.prolog.syntax.term_reader import ReadTerm, read_term
from retalis.prolog.syntax.term_writer import writeq


def goals_of(text: str) -> Any:
    goals: List[Any] = []
    for goal in read_goals(text, Operators.prolog(), "goals"):
        if isinstance(goal, SyntaxFault):
            goals.append(("error", place_of(goal).line))
        else:
            goals.append((writeq(goal.term), goal.place.line))
    return goals


def test_goal_ends_with_line_or_full_stop() -> None:
    assert goals_of("a(1)\n\n  b(x, y).\nc\n") == [("a(1)", 1), ("b(x,y)", 3), ("c", 4)]


def test_lines_are_counted_from_start_of_file() -> None:
    assert [line for _, line in goals_of("a\n\nb\n% comment\nc.")] == [1, 3, 5]


def test_comments_are_ignored() -> None:
    assert [goal for goal, _ in goals_of("% nothing\na % why\nb. % why\n")] == ["a", "b"]


def test_goal_may_span_lines() -> None:
    assert goals_of("memorize(a,\n  [],\n  m,\n  5).\nb") == [("memorize(a,[],m,5)", 1), ("b", 5)]


def test_error_affects_one_line() -> None:
    assert goals_of("a(\nb\nc)\n") == [("error", 1), ("b", 2), ("error", 3)]


def test_missing_full_stop_is_reported() -> None:
    text = "a(1,\n  2)\nb(\n\nc(1, % why\n  d e)\nf(1"
    errors = [
        error for error in read_goals(text, Operators.prolog(), "goals") if isinstance(error, SyntaxFault)
    ]
    lines_with_advice = [
        place_of(error).line
        for error in errors
        if "a goal over several lines ends with a full stop" in error.message
    ]
    assert [place_of(error).line for error in errors] == [1, 2, 3, 5, 6, 7]
    assert lines_with_advice == [1, 5]


def test_quoted_percent_sign_is_no_comment() -> None:
    assert [goal for goal, _ in goals_of("a('50%')\nb('1.%')")] == ["a('50%')", "b('1.%')"]


def test_lines_of_invalid_goal_are_skipped() -> None:
    assert goals_of("x(3\nshell(a)\n, b).\nc") == [("error", 2), ("c", 4)]


def characters_read(monkeypatch: pytest.MonkeyPatch, text: Any) -> Any:
    """Return the number of characters that are parsed for a text."""
    lengths: List[Any] = []

    def counting_read_term(text: Any, *args: Any, **options: Any) -> ReadTerm:
        lengths.append(len(text))
        return read_term(text, *args, **options)

    with monkeypatch.context() as patched:
        patched.setattr("retalis.events.program.goal_file.read_term", counting_read_term)
        goals = list(read_goals(text, Operators.prolog(), "goals"))
    assert all(isinstance(goal, SyntaxFault) for goal in goals[:-1])
    return sum(lengths)


@pytest.mark.slow
@pytest.mark.parametrize("line", ["a b\n", "'a\\\n", "/* a\n", "f(\n"])
def test_invalid_lines_take_linear_time(monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    work = [characters_read(monkeypatch, line * count + "c.\n") for count in (2_000, 4_000)]
    assert work[1] < 3 * work[0] + 200_000
