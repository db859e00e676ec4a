"""Tokens of Prolog text: numbers, atoms and quoted texts, as SWI-Prolog 9 reads them where ISO leaves it open."""

import math
from typing import Any

import pytest

from retalis import Operators, String, SyntaxFault, atom, make_list
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.terms.types import NIL

OPERATORS = Operators.prolog()


def read(text: str, **flags: Any) -> Any:
    return read_term(text, OPERATORS, flags=ReadFlags(**flags)).term


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0'a", 97),
        ("0'''", 39),
        ("0''", 39),
        ("0'\\n", 10),
        ("0'\\x41\\", 65),
        ("0' ", 32),
        ("0x1F", 31),
        ("0o17", 15),
        ("0b101", 5),
        ("16'FF", 255),
        ("36'Zz", 1295),
        ("1_000_000", 1000000),
        ("1_\n000", 1000),
        ("0xFF_FF", 65535),
        ("1.5e3", 1500.0),
        ("1e10", 1e10),
        ("1.0Inf", math.inf),
        ("-1.0Inf", -math.inf),
        ("-7", -7),
    ],
)
def test_number_has_value_and_type(text: str, value: Any) -> None:
    number = read(text)
    assert number == value
    assert type(number) is type(value)
    if isinstance(value, float):
        assert read(write_term(value)) == value


def test_long_integers_are_read_and_written() -> None:
    assert read("9" * 10_000) == 10**10_000 - 1
    assert write_term(10**20_000 + 7) == "1" + "0" * 19_999 + "7"
    assert write_term(-(10**9000)) == "-1" + "0" * 9000


def test_nan_is_read_and_written() -> None:
    assert math.isnan(read("1.5NaN"))
    assert write_term(math.nan) == "1.5NaN"


@pytest.mark.parametrize("text", ["1 000", "1e", "1r3", "1a", "2'12", "0x", "37'1", "1'1", "1.0e400"])
def test_invalid_number_is_refused(text: str) -> None:
    with pytest.raises(SyntaxFault):
        read(text)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("'a\\\nb'", "ab"),
        ("'a\\x41\\b'", "aAb"),
        ("'a\\x41b'", "a\u041b"),
        ("'\\101\\'", "A"),
        ("'\\e\\s\\a'", "\x1b \a"),
        ("'\\u0041\\U00000041'", "AA"),
        ("'a\\c  \n b'", "ab"),
        ("'a''b'", "a'b"),
        ("'a\"\"b`'", 'a""b`'),
        ("''", ""),
        ("[]", "[]"),
        ("{ }", "{}"),
        ("\u00e9t\u00e9", "\u00e9t\u00e9"),
        ("\u2192", "\u2192"),
        ("a%b", "a"),
        ("/* c */ a /* d */", "a"),
        ("\ufeffa", "a"),
    ],
)
def test_atom_has_name(text: str, name: str) -> None:
    assert read(text) is atom(name)


def test_comment_does_not_begin_inside_symbol_atom() -> None:
    with pytest.raises(SyntaxFault):
        read("+/*x*/")


def test_double_quotes_follow_flag() -> None:
    codes, chars = make_list([97, 98]), make_list([atom("a"), atom("b")])
    assert read('"ab"') == String("ab")
    assert read('"ab"', double_quotes="codes") == codes == read("`ab`")
    assert read('"ab"', double_quotes="chars") == chars
    assert read('"ab"', double_quotes="atom") is atom("ab")
    assert read('"ab"', event_text=True) is atom('"ab"')
    assert read('""', double_quotes="codes") is NIL
