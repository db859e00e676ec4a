"""Places of errors in texts, shown with a short part of the line."""

import pytest
from asserting_accessors import required

from retalis import Operators, Place
from retalis.foundation.displayed_text import MAX_SHOWN_CHARACTERS
from retalis.foundation.source_places import place_at_column, place_at_offset
from retalis.prolog.syntax.term_reader import read_program


@pytest.mark.parametrize(
    ("length", "column"), [(10, 1), (10, 10), (10, 11), (5000, 1), (5000, 2500), (5000, 5000)]
)
def test_caret_is_below_column_of_shown_part(length: int, column: int) -> None:
    line = "".join(chr(ord("a") + index % 26) for index in range(length))
    for place in (
        place_at_column("file", 3, column, line),
        place_at_offset("file", f"1\n\n{line}\nend", column + 2),
    ):
        assert (place.source, place.line, place.column) == ("file", 3, column)
        shown, caret = place.context().split("\n")
        assert len(shown) <= MAX_SHOWN_CHARACTERS
        assert len(caret) <= MAX_SHOWN_CHARACTERS + 1
        assert shown in line
        assert shown == line or length > MAX_SHOWN_CHARACTERS
        assert caret.index("^") == len(caret) - 1
        assert shown[len(caret) - 1 : len(caret)] == line[column - 1 : column]


def test_place_shows_short_line_completely() -> None:
    assert Place("file", 1, 3, "a\tb").context() == "a\tb\n \t^"


@pytest.mark.slow
def test_error_in_long_line_is_short() -> None:
    (fault,) = read_program("f(" + "a," * 100_000 + "b c).", Operators.prolog(), "file")
    assert required(fault.place).column == 200_005
    assert len(str(fault)) < 1000
