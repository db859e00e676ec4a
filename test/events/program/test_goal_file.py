import pytest

from retalis import Operators, SyntaxFault
from retalis.events.program.goal_file import read_goals
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq


def read(text):
    found = []
    for goal in read_goals(text, Operators.prolog(), "goals"):
        if isinstance(goal, SyntaxFault):
            found.append(("error", goal.place.line))
        else:
            found.append((writeq(goal.term), goal.place.line))
    return found


def test_one_goal_a_line_with_or_without_a_full_stop():
    assert read("a(1)\n\n  b(x, Y).\nc\n")[::2] == [("a(1)", 1), ("c", 4)]
    assert read("a(1)\n\n  b(x, Y).\nc\n")[1][0].startswith("b(x,")


def test_lines_are_counted_from_the_start_of_the_file():
    assert [line for _, line in read("a\n\nb\n% comment\nc.")] == [1, 3, 5]


def test_comments_stand_alone_or_behind_a_goal():
    assert [goal for goal, _ in read("% nothing\na % why\nb. % why\n")] == ["a", "b"]


def test_a_goal_goes_on_over_lines_to_its_full_stop():
    assert read("memorize(a,\n  [],\n  m,\n  5).\nb") == [("memorize(a,[],m,5)", 1), ("b", 5)]


def test_an_error_takes_one_line_and_the_rest_is_read():
    assert read("a(\nb\nc)\n") == [("error", 1), ("b", 2), ("error", 3)]


def test_a_goal_that_goes_on_without_a_full_stop_is_told_of_it():
    text = "a(1,\n  2)\nb(\n\nc(1, % why\n  d e)\nf(1"
    found = [one for one in read_goals(text, Operators.prolog(), "goals") if isinstance(one, SyntaxFault)]
    told = [
        one.place.line for one in found if "a goal over several lines ends with a full stop" in one.message
    ]
    assert [one.place.line for one in found] == [1, 2, 3, 5, 6, 7]
    assert told == [1, 5]


def test_a_quoted_percent_sign_is_no_comment():
    assert [goal for goal, _ in read("a('50%')\nb('1.%')")] == ["a('50%')", "b('1.%')"]


def test_lines_of_a_goal_with_an_error_are_no_goals():
    assert read("x(3\nshell(a)\n, b).\nc") == [("error", 2), ("c", 4)]


def characters_read(monkeypatch, text):
    """Return how many characters of goals are read for a text."""
    read = []

    def counted(text, *args, **options):
        read.append(len(text))
        return read_term(text, *args, **options)

    with monkeypatch.context() as patched:
        patched.setattr("retalis.events.program.goal_file.read_term", counted)
        found = list(read_goals(text, Operators.prolog(), "goals"))
    assert all(isinstance(goal, SyntaxFault) for goal in found[:-1])
    return sum(read)


@pytest.mark.slow
@pytest.mark.parametrize("line", ["a b\n", "'a\\\n", "/* a\n", "f(\n"])
def test_lines_that_fail_are_not_all_read_on_to_a_full_stop_far_below(monkeypatch, line):
    work = [characters_read(monkeypatch, line * count + "c.\n") for count in (2_000, 4_000)]
    assert work[1] < 3 * work[0] + 200_000
