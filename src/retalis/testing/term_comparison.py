"""Comparison of terms and messages with patterns, with tolerances for numbers.

An anonymous variable of a pattern stands for any term, and a named one for the same term everywhere in the pattern.
Numbers are compared by value, so that ``3`` equals ``3.0``. A number also equals a timestamp that is so many seconds
after the start of the case.
"""

from typing import Dict, List, NamedTuple, Tuple

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import SyntaxFault
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import ReadTerm, read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.terms import timestamps
from ..prolog.terms.types import Term, Var, deref
from ..prolog.terms.unification import compare
from .case_definition import TermText, Tolerance
from .yaml_documents import CaseFileError

_NUMBERS = (int, float)


class TermPattern(NamedTuple):
    """A term with variables.

    Attributes:
        tolerance: tolerance for its numbers.
        start: start of the case in nanoseconds since the epoch.
    """

    term: Term
    tolerance: Tolerance
    start: int

    def matches(self, term: Term) -> bool:
        """Return whether a term matches the pattern."""
        bindings: Dict[Var, Term] = {}
        stack: List[Tuple[Term, Term]] = [(self.term, term)]
        while stack:
            expected, actual = map(deref, stack.pop())
            if expected.__class__ is Var:
                bound = bindings.setdefault(expected, actual)
                if bound is not actual and compare(bound, actual) != 0:
                    return False
            elif isinstance(expected, _NUMBERS):
                if not self._accepts(expected, actual):
                    return False
            elif expected.__class__ is tuple and actual.__class__ is tuple:
                # The first item is the functor, which includes the number of arguments.
                if expected[0] is not actual[0]:
                    return False
                stack.extend(zip(expected[1:], actual[1:]))
            elif expected is not actual and (
                expected.__class__ is not actual.__class__ or compare(expected, actual) != 0
            ):
                return False
        return True

    def _accepts(self, expected: float, actual: Term) -> bool:
        if isinstance(actual, _NUMBERS):
            return self.tolerance.accepts(expected, actual)
        if not timestamps.is_instant(actual):
            return False
        # Exact to the nanosecond: times of a case are written with few digits.
        seconds = timestamps.to_seconds(timestamps.from_term(actual) - self.start)
        return self.tolerance._replace(absolute=max(self.tolerance.absolute, 1e-9)).accepts(expected, seconds)


def read_term_text(text: TermText, operators: Operators, flags: ReadFlags = ReadFlags()) -> Term:  # noqa: B008
    """Return the term of a text.

    Raises:
        CaseFileError: if the text is not a term; the place is that of the term in the file.
    """
    return _read(text, operators, flags).term


def _read(text: TermText, operators: Operators, flags: ReadFlags) -> ReadTerm:
    place = text.place
    try:
        return read_term(text.text, operators, place.source, flags, first_line=place.line)
    except SyntaxFault as error:
        is_cut = text.text.count("(") + text.text.count("[") != text.text.count(")") + text.text.count("]")
        hint = '; YAML splits at commas: write a term with commas in quotes, as "f(a, b)"' if is_cut else ""
        raise CaseFileError(f"{quote_shortened(text.text)}: {error.message}{hint}", place) from error


def read_pattern(text: TermText, operators: Operators, tolerance: Tolerance, start: int) -> TermPattern:
    """Return the pattern of a text.

    Args:
        text: the text.
        operators: operators of the program.
        tolerance: tolerance for its numbers.
        start: start of the case in nanoseconds since the epoch.

    Raises:
        CaseFileError: if the text is not a term, or has a variable that stands for any term without looking so.
    """
    read = _read(text, operators, ReadFlags())
    for name in read.singletons:
        raise CaseFileError(
            f"{quote_shortened(text.text)}: variable {name} occurs once, and matches anything: write _ for anything, "
            f"or the atom in quotes, as \"'{name}'\"",
            text.place,
        )
    return TermPattern(read.term, tolerance, start)
