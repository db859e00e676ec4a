"""Directives of ``format``."""

from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog

FORMATS = [
    (
        "~w and ~q: ~d ~2f ~e ~a",
        "[f(x),'A b',12,3.14159,2.5,abc]",
        "f(x) and 'A b': 12 3.14 2.500000e+00 abc",
    ),
    ("~t~w~10||~w~t~10+|", "[right,left]", "     right|left     |"),
    ("~`-t~30|", "[]", "-" * 30),
    ("~t~d~6|~t~d~12|", "[1,22]", "     1    22"),
    ("~t~s~t~11|", "[[0'a,0'b,0'c]]", "    abc    "),
    ("~D ~2d ~8r ~16R ~c~c", "[1234567,314,64,255,104,105]", "1,234,567 3.14 100 FF hi"),
    ("~*c~i~w~~", "[3,0'x,skipped,y]", "xxxy~"),
]


@pytest.mark.parametrize(("form", "arguments", "text"), FORMATS)
def test_format_directives_are_expanded(form: str, arguments: str, text: str) -> None:
    result = first(prolog(), f'format(atom(A), "{form}", {arguments})')
    assert result.strip("'").replace("\\'", "'") == text


@pytest.mark.parametrize(
    ("form", "text"), [("~I", "1_234_567"), ("~2I", "1_23_45_67"), ("x~Iy", "x1_234_567y")]
)
def test_digits_are_grouped(form: str, text: str) -> None:
    assert first(prolog(), f"format(atom(A), '{form}', [1234567])") == f"'{text}'".strip(
        "'" if text[0] == "x" else ""
    )


@pytest.mark.parametrize(
    ("form", "text"), [("a~Nb", "a\nb"), ("a~n~Nb", "a\nb"), ("~Na", "a"), ("a~N~n~Nb", "a\n\nb")]
)
def test_newline_directive_ends_started_line(form: str, text: str) -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, f"format('{form}', [])") == [{}]
    assert "".join(written) == text
