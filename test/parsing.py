"""Terms from text."""

from retalis import Operators
from retalis.prolog.syntax.term_reader import read_term


def parse_term(text):
    """Return the term that a text stands for, read with the operators of Prolog alone."""
    return read_term(text, Operators.prolog()).term
