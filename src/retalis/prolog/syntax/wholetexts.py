"""The pattern of all texts of a shape: one match takes the numbers and quoted atoms out of a text.

A text that it matches has the skeleton of the shape, with the same parts in its places as `EventReader` splits out;
what may be otherwise (a number that only JSON takes for one) is left to the reader. A match takes time in proportion
to the text: between two runs of numbers there is a character that stands in none.
"""

import re
from typing import List, NamedTuple, Optional, Pattern, Tuple

LONGEST = 4000
"""Characters of a skeleton from which on the pattern is not worth its memory."""

_PLACES = re.compile(r"(\0(?:,\0)*|'(?:[^\0'\"]*')*)")
"""Numbers with nothing but commas between them, and quoted atoms with no numbers between them."""

_IN_NUMBERS = "-+.,e0123456789"
_RUN = "([-+.,e0-9]{1,%d})"
_SPAN = "'[^'\\\\\n]*'"
_WIDTH = 32
"""Characters of a number, on average: as many numbers as `_SHORT` are too short then to be infinite."""

_SHORT = 9

_EXPONENTS = re.compile(r"(?:[^e]*\.[0-9]+e(?:-[0-9]{1,3}|\+?[0-9]{1,2})(?![0-9]))*[^e]*")
exponents_fit = _EXPONENTS.fullmatch
"""Whether all that stands before an exponent has a point, and no exponent is out of range, as the reader wants it."""


class WholeText(NamedTuple):
    """How the texts of a shape are matched.

    Attributes:
        pattern: has a group for each run of numbers and each span of quoted atoms.
        groups: for each group how many numbers there are in it, 0 for a span.
        atoms: for each group how many quoted atoms there are in it.
        infinite: whether a number may be so long that it is infinite as a float.
    """

    pattern: Pattern[str]
    groups: List[int]
    atoms: List[int]
    infinite: bool


def whole_text(skeleton: str) -> Optional[WholeText]:
    """Return how texts of a skeleton are matched; None where that is not possible or not worth while."""
    if len(skeleton) > LONGEST or "\\" in skeleton or "\n" in skeleton or '"' in skeleton:
        return None
    parts = _PLACES.split(skeleton)
    groups: List[int] = []
    atoms: List[int] = []
    source = [re.escape(parts[0])]
    for place, literal in zip(parts[1::2], parts[2::2]):
        number = place.count("\0")
        if number and not literal.strip(_IN_NUMBERS):
            return None
        groups.append(number)
        atoms.append(place.count("'"))
        source.append(_RUN % (_WIDTH * number) if number else _span(place))
        source.append(re.escape(literal))
    return WholeText(re.compile("".join(source)), groups, atoms, max(groups, default=0) > _SHORT)


def _span(place: str) -> str:
    """Return the pattern of quoted atoms and what stands between them; in a skeleton, a quote is an atom."""
    return f"({_SPAN.join(re.escape(literal) for literal in place.split(chr(39)))})"


def span_texts(span: str) -> Tuple[str, ...]:
    """Return the texts of the quoted atoms of a span."""
    return tuple(span.split("'")[1::2])
