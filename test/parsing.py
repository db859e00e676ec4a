"""Terms from text."""

from typing import Any

from retalis import Operators
from retalis.prolog.syntax.term_reader import read_term


def parse_term(text: Any) -> Any:
    """Return the term in a text, parsed with the standard operators of Prolog."""
    return read_term(text, Operators.prolog()).term
