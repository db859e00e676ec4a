"""Reading clause by clause in time linear in the clause."""

import pytest

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax import term_reader
from retalis.prolog.syntax.term_reader import ReadTerm, read_program
from retalis.prolog.syntax.term_writer import writeq

OPERATORS = Operators.prolog()


def tokens_read(monkeypatch, text):
    """Return how many tokens the parser is given for the clauses of a text, and the clauses."""
    given = []
    parser = term_reader.Parser

    def counted(clause, *args):
        given.append(len(clause) - 3)  # without the ends of it that stand behind it
        return parser(clause, *args)

    with monkeypatch.context() as patched:
        patched.setattr(term_reader, "Parser", counted)
        found = list(read_program(text, OPERATORS))
    return sum(given), found


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", ["a\n", "a :- b\n", "h <- a seq b\n", "h <- a(b\n", "h(X) :- f([X, 'y', {Z}\n"]
)
def test_lines_without_full_stops(monkeypatch, line):
    work = {}
    for count in (500, 2000):
        work[count], found = tokens_read(monkeypatch, line * count + "z.\n")
        assert [one.place.line for one in found] == [*range(2, count + 2), count + 1]
    assert work[2000] < 5 * work[500]


def test_the_last_of_many_without_a_full_stop_is_read():
    for count in range(30):
        text = "a(1, b)\n" * count + "h <- a(X) * b(X)\n  where (X > 1,\n  true).\n"
        *errors, last = read_program(text, OPERATORS)
        assert all(isinstance(one, SyntaxFault) for one in errors) and len(errors) == count
        assert isinstance(last, ReadTerm) and last.place.line == count + 1
        assert writeq(last.term).startswith("h<-a(_")


def test_the_errors_in_one_line_show_little_of_it():
    found = list(read_program("a b. " * 1000, OPERATORS))
    assert len(found) == 1000 and max(len(str(one)) for one in found) < 600
