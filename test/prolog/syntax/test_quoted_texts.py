"""End and value of quoted text."""

from typing import Any, Optional

import pytest
from asserting_accessors import place_of

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.syntax.literals import quote_end, unclosed_quote_end
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.tokenizer import ReadFlags

OPERATORS = Operators.prolog()


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("'a' b'", 3),
        ("'a''b'", 6),
        ("'a'''", 5),
        ("'a\\'b'", 6),
        ("'\\x41\\'b'", 7),
        ("'\\x41'b'", 6),
        ("'\\1\\'b'", 5),
        ("'\\\n'", 4),
        ("'\\c \n '", 7),
        ("'a", None),
        ("'a''", None),
        ("'a\n'", None),
        ("'a\\", None),
        ("'\\x41\\\n'", None),
        ('"a\'"', 4),
        ("`a``'`", 6),
    ],
)
def test_closing_quote_ends_text(text: str, end: Optional[int]) -> None:
    assert quote_end(text, 0) == end


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("'a. b.\nc", 5),
        ("'a. b. \t\nc", 5),
        ("'a.", 2),
        ("'a", 2),
        ("'a\\\nb.\n", 5),
        ("'a\\.\n", 4),
        ("'a.\\", 3),
    ],
)
def test_unclosed_text_ends_with_clause(text: str, end: int) -> None:
    assert unclosed_quote_end(text, 0) == end


@pytest.mark.parametrize(
    "text",
    ["f('\\x41\\',',b)", "f('\\x41\\','b')", "f('\\c\n ',1)", "'a'''", "f('a'',b)", "f('a\\x41\\''',\n1)"],
)
def test_readers_agree_on_quoted_text(text: str) -> None:
    def outcome(read: Any) -> Any:
        try:
            return read(text)
        except SyntaxFault as fault:
            return fault.message, place_of(fault).column

    def read_completely(text: Any) -> Any:
        return read_term(text, OPERATORS, "event text", ReadFlags(event_text=True)).term

    assert outcome(EventReader(OPERATORS).read) == outcome(read_completely)
