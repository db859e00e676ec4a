"""Clauses without a full stop: read in linear time, and followed by clauses that are read."""

from typing import Any, Dict, List, Tuple

import pytest

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax import term_reader
from retalis.prolog.syntax.term_reader import Parser, ReadTerm, read_program
from retalis.prolog.syntax.term_writer import writeq

OPERATORS = Operators.prolog()


def tokens_read(monkeypatch: pytest.MonkeyPatch, text: Any) -> Tuple[Any, ...]:
    """Return the number of tokens that the parser receives for a text, and the clauses of the text."""
    counts: List[Any] = []
    parser = term_reader.Parser

    def counted(clause: Any, *args: Any) -> Parser:
        counts.append(len(clause) - 3)  # without the three end tokens
        return parser(clause, *args)

    with monkeypatch.context() as patched:
        patched.setattr(term_reader, "Parser", counted)
        clauses = list(read_program(text, OPERATORS))
    return sum(counts), clauses


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", ["a\n", "a :- b\n", "h <- a seq b\n", "h <- a(b\n", "h(X) :- f([X, 'y', {Z}\n"]
)
def test_lines_without_full_stops_take_linear_time(monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    work: Dict[Any, Any] = {}
    for count in (500, 2000):
        work[count], clauses = tokens_read(monkeypatch, line * count + "z.\n")
        assert [clause.place.line for clause in clauses] == [*range(2, count + 2), count + 1]
    assert work[2000] < 5 * work[500]


def test_clause_after_unfinished_ones_is_read() -> None:
    for count in range(30):
        text = "a(1, b)\n" * count + "h <- a(X) * b(X)\n  where (X > 1,\n  true).\n"
        *errors, last = read_program(text, OPERATORS)
        assert all(isinstance(error, SyntaxFault) for error in errors)
        assert len(errors) == count
        assert isinstance(last, ReadTerm)
        assert last.place.line == count + 1
        assert writeq(last.term).startswith("h<-a(_")


def test_errors_in_long_line_are_short() -> None:
    errors = list(read_program("a b. " * 1000, OPERATORS))
    assert len(errors) == 1000
    assert max(len(str(error)) for error in errors) < 600
