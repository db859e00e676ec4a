"""Printable and shortened texts, counts and durations."""

import json
from xml.etree import ElementTree

import pytest

from retalis.foundation.displayed_text import (
    MAX_SHOWN_CHARACTERS,
    format_count,
    format_duration,
    printable,
    printable_json,
    shorten,
)


def test_long_text_is_shortened() -> None:
    assert shorten("a" * MAX_SHOWN_CHARACTERS) == "a" * MAX_SHOWN_CHARACTERS
    assert shorten("a" * 5000) == "a" * MAX_SHOWN_CHARACTERS + "..."


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
