"""Terms from text."""

from typing import Any, Iterator

from retalis import Operators
from retalis.prolog.syntax.term_reader import DEFAULT, ReadTerm, read_program, read_term
from retalis.prolog.syntax.tokenizer import ReadFlags


def parse_term(text: Any) -> Any:
    """Return the term in a text, parsed with the standard operators of Prolog."""
    return read_term(text, Operators.prolog()).term


def read_clauses(
    text: str, operators: Operators, source: str = "text", flags: ReadFlags = DEFAULT
) -> Iterator[ReadTerm]:
    """Yield the clauses of a program without syntax errors."""
    for clause in read_program(text, operators, source, flags):
        assert isinstance(clause, ReadTerm), clause
        yield clause
