"""Positions in source texts.

A `Place` includes the source line, so that an error can be shown with a caret after the source is gone.
"""

from typing import NamedTuple

from .displayed_text import MAX_SHOWN_CHARACTERS


class Place(NamedTuple):
    """A position in a text; line and column count from 1.

    ``text`` is the line itself, so that the error can be shown without reading the source again. Of a long line, it
    is the part around the column, which begins ``before`` characters after the start of the line.

    >>> try:
    ...     Engine().query("X = (a b)")
    ... except SyntaxFault as error:
    ...     print(isinstance(error.place, Place), error.place)
    True query:1:8
    """

    source: str
    line: int
    column: int
    text: str = ""
    before: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}"

    @property
    def character(self) -> str:
        """The character at the position; empty at the end of a line.

        >>> Place("mine", 1, 3, "a $ b").character
        '$'
        """
        index = self.column - 1 - self.before
        return self.text[index : index + 1]

    def context(self) -> str:
        """Return the source line and, under it, a caret at the column.

        >>> print(Place("mine", 1, 3, "a $ b").context())
        a $ b
          ^
        """
        index = self.column - 1 - self.before
        # Tabs are repeated, so that the caret is in the right column at any tab width.
        lead = "".join("\t" if char == "\t" else " " for char in self.text[:index])
        return f"{self.text}\n{lead}^"


def line_of(place: object) -> str:
    """Return file and line of a position or of its text ``FILE:LINE:COLUMN``; "" if there is none."""
    return str(place or "").rpartition(":")[0]


def place_in_line(source: str, line_number: int, text: str, start: int, offset: int) -> Place:
    """Return the place of the character at ``offset`` of a text, in the line that begins at ``start``."""
    end = text.find("\n", offset, offset + MAX_SHOWN_CHARACTERS)
    if end < 0:
        end = min(len(text), offset + MAX_SHOWN_CHARACTERS)
    # Only a part of at most `MAX_SHOWN_CHARACTERS` around the offset is copied: a line may be as long as the file.
    before = max(0, min(offset - MAX_SHOWN_CHARACTERS // 2, end - MAX_SHOWN_CHARACTERS) - start)
    shown = text[start + before : min(end, start + before + MAX_SHOWN_CHARACTERS)]
    return Place(source, line_number, offset - start + 1, shown, before)


def place_at_column(source: str, line_number: int, column: int, line: str) -> Place:
    """Return the place at a column of a line."""
    return place_in_line(source, line_number, line, 0, column - 1)


def place_at_offset(source: str, text: str, offset: int) -> Place:
    """Return the place of the character at ``offset`` of ``text``."""
    start = text.rfind("\n", 0, offset) + 1
    return place_in_line(source, text.count("\n", 0, start) + 1, text, start, offset)
