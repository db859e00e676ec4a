"""Terms from text."""

from retalis.prolog.syntax import Operators, read_term


def parse_term(text):
    """Return the term that a text stands for, read with the operators of Prolog alone."""
    return read_term(text, Operators.prolog()).term
