"""Places of errors with a short part of the line, and printable texts."""

import json
from xml.etree import ElementTree

import pytest
from asserting_accessors import required

from retalis import Operators, Place
from retalis.foundation.errors import (
    MAX_SHOWN_CHARACTERS,
    format_count,
    format_duration,
    place_at_column,
    place_at_offset,
    printable,
    printable_json,
    shorten,
)
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


def test_long_text_is_shortened() -> None:
    assert shorten("a" * MAX_SHOWN_CHARACTERS) == "a" * MAX_SHOWN_CHARACTERS
    assert shorten("a" * 5000) == "a" * MAX_SHOWN_CHARACTERS + "..."


@pytest.mark.slow
def test_error_in_long_line_is_short() -> None:
    (fault,) = read_program("f(" + "a," * 100_000 + "b c).", Operators.prolog(), "file")
    assert required(fault.place).column == 200_005
    assert len(str(fault)) < 1000


def test_count_has_singular_or_plural() -> None:
    assert [format_count(number, "slot") for number in (0, 1, 2)] == ["0 slots", "1 slot", "2 slots"]
    assert [format_count(number, "memory", "memories") for number in (1, 2)] == ["1 memory", "2 memories"]


CONTROL_CODES = [
    *range(9),
    *range(11, 32),
    *range(127, 160),
    0xAD,
    0x61C,
    0x200B,
    0x200E,
    0x200F,
    *range(0x2028, 0x202F),
]
CONTROL_CODES += [*range(0x2060, 0x2070), 0xFEFF, 0xFFFE, 0xFFFF, 0xD800, 0xDFFF, 0xE0001, 0xE0041]


@pytest.mark.parametrize("code", CONTROL_CODES, ids=hex)
def test_control_character_is_shown_as_escape(code: int) -> None:
    shown = printable(f"a{chr(code)}b")
    assert shown == f"a{ascii(chr(code))[1:-1]}b"
    ElementTree.fromstring(f"<t>{shown}</t>")


@pytest.mark.parametrize(
    "text",
    ["", "a\n\tb", "é\xa0日本\u3000", "\u0645\u06cc\u200c\u062e", "\U0001f469\u200d\U0001f680", "\ufffd"],
    ids=ascii,
)
def test_printable_text_is_unchanged(text: str) -> None:
    assert printable(text) == text


@pytest.mark.parametrize("joiner", "\u200c\u200d", ids=ascii)
def test_joiner_without_neighbor_is_shown_as_escape(joiner: str) -> None:
    assert printable(f"{joiner}a{joiner}b") == f"{ascii(joiner)[1:-1]}a{ascii(joiner)[1:-1]}b"


def test_texts_in_json_are_printable() -> None:
    data = {"a\x1b": ["b\u202e", 1, None, ("c\x9b", {"d": 0.5})]}
    assert json.loads(printable_json(data)) == {r"a\x1b": [r"b\u202e", 1, None, [r"c\x9b", {"d": 0.5}]]}


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (5000, "1 h 23 min 20 s"),
        (60, "1 min"),
        (0, "0 s"),
        (2.5, "2.5 s"),
        (0.5, "500 ms"),
        (1e-6, "0.001 ms"),
        (90061.25, "1 d 1 h 1 min 1.25 s"),
        (59.9999999999, "1 min"),
        (-61, "-1 min 1 s"),
    ],
)
def test_duration_has_units(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text
