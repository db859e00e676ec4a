"""Atoms for strings and byte arrays of messages, and the bytes of atoms."""

import base64
import unicodedata
from typing import Any, List, Optional

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import MessageError, String, atom
from retalis.prolog.terms import byte_texts
from retalis.prolog.terms.byte_texts import blob_atom, text_atom, text_bytes
from retalis.prolog.terms.types import NIL


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"", '""'),
        (b"base_link", '"base_link"'),
        (b"/odom", '"/odom"'),
        (b'say "hi"', '"say "hi""'),
        (b"it's\\", '"it\'s\\"'),
        (b"two\nlines\t", '"two\nlines\t"'),
        (b"FFFFFFFFF", '"FFFFFFFFF"'),
        (b"\0", '"FFFFFFFFFFAA==////"'),
        (b"two\r\nlines", '"two\r\nlines"'),
        ("Jürgen".encode(), '"Jürgen"'),
        ("日本 🤖".encode(), '"日本 🤖"'),
        ("\u2028 \u200b \ufeff \ufffd \uffff \xa0".encode(), '"\u2028 \u200b \ufeff \ufffd \uffff \xa0"'),
        (b"J\xfcrgen", '"FFFFFFFFFFSvxyZ2Vu////"'),  # Latin-1
        (b"\xed\xa0\x80", '"FFFFFFFFFF7aCA////"'),  # half a surrogate pair
        (b"\xc3", '"FFFFFFFFFFww==////"'),
        (b"\x0b", '"FFFFFFFFFFCw==////"'),
        (b"\x0c", '"FFFFFFFFFFDA==////"'),
        (b"\x1f", '"FFFFFFFFFFHw==////"'),
        (b"\x7f", '"FFFFFFFFFFfw==////"'),
        ("ü\x1b".encode(), '"FFFFFFFFFFw7wb////"'),
        ("\x80".encode(), '"FFFFFFFFFFwoA=////"'),
        ("\x9f".encode(), '"FFFFFFFFFFwp8=////"'),
        (b"FFFFFFFFFF", '"FFFFFFFFFFRkZGRkZGRkZGRg==////"'),
        ("FFFFFFFFFFü".encode(), '"FFFFFFFFFFRkZGRkZGRkZGRsO8////"'),
    ],
)
def test_string_is_converted_to_atom(data: bytes, name: str) -> None:
    assert text_atom(data) is atom(name)
    assert text_bytes(atom(name)) == data


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"", '""'),
        (b"base_link", '"base_link"'),
        (b"\t\n\r\v\f", '"\t\n\r\v\f"'),
        (b"FFFFFFFFF", '"FFFFFFFFF"'),
        (b"\0", '"FFFFFFFFFFAA==////"'),
        (b"\x7f", '"FFFFFFFFFFfw==////"'),
        ("é".encode(), '"FFFFFFFFFFw6k=////"'),
        (b"FFFFFFFFFF", '"FFFFFFFFFFRkZGRkZGRkZGRg==////"'),
    ],
)
def test_byte_array_is_converted_to_atom(data: bytes, name: str) -> None:
    assert blob_atom(data) is atom(name)
    assert text_bytes(atom(name)) == data


@given(st.text(max_size=20))
def test_text_with_control_characters_is_base64(text: str) -> None:
    is_text = not text.startswith("FFFFFFFFFF") and all(
        char in "\t\n\r" or unicodedata.category(char) != "Cc" for char in text
    )
    assert (text_atom(text.encode()) is atom(f'"{text}"')) == is_text


def test_base64_has_lines_of_76_characters() -> None:
    data = bytes(range(256))
    name = text_atom(data).name
    assert name.startswith('"FFFFFFFFFF')
    lines = name[11:-1]
    expected = base64.encodebytes(data).decode().replace("\n", "////")
    assert lines == expected
    assert len(lines.split("////")[0]) == 76


def test_slashes_in_base64_are_no_line_breaks() -> None:
    data = b"\xff" * 60  # all of it "/" in base64
    assert text_atom(data).name == '"FFFFFFFFFF' + "/" * 76 + "////" + "/" * 4 + "////" + '"'
    assert text_bytes(text_atom(data)) == data


@given(st.binary(max_size=300) | st.text(max_size=100).map(str.encode))
def test_atom_is_converted_to_same_bytes(data: Any) -> None:
    assert text_bytes(text_atom(data)) == data
    assert text_bytes(blob_atom(data)) == data


@pytest.mark.parametrize(
    ("term", "data"),
    [
        (atom("base_link"), b"base_link"),
        (String("base_link"), b"base_link"),
        (String('"quoted"'), b'"quoted"'),
        (atom('"'), b'"'),
        (atom(""), b""),
        (atom("é"), "é".encode()),
        (String("FFFFFFFFFFAA==////"), b"\0"),
        (NIL, None),
        (3, None),
        (2.5, None),
    ],
)
def test_term_is_converted_to_bytes(term: Any, data: Optional[bytes]) -> None:
    assert text_bytes(term) == data


@pytest.mark.parametrize(
    "broken", ["FFFFFFFFFFAA==", "FFFFFFFFFFA////", "FFFFFFFFFF?!==////", "FFFFFFFFFFé////"]
)
def test_invalid_base64_is_refused(broken: str) -> None:
    with pytest.raises(MessageError, match="base64"):
        text_bytes(atom(f'"{broken}"'))


def test_lone_surrogate_is_refused() -> None:
    with pytest.raises(MessageError, match="code point 0xd800"):
        text_bytes(atom("a\ud800"))


def outcome(text: Any) -> Any:
    try:
        return text_bytes(atom(text))
    except MessageError as error:
        return error.message


@given(
    st.binary(max_size=200),
    st.lists(
        st.tuples(st.integers(0, 400), st.sampled_from(["", "=", "/", "A", "!", "\n", "é", "////"])),
        max_size=2,
    ),
)
def test_fast_base64_decoder_equals_general_one(data: bytes, changes: List[Any]) -> None:
    lines = blob_atom(b"\0" + data).name[1 + len(byte_texts.BASE64_MARK) : -1]
    for place, replacement in changes:
        lines = lines[:place] + replacement + lines[place + 1 :]
    text = f'"{byte_texts.BASE64_MARK}{lines}"'
    bytes_or_error = outcome(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(byte_texts, "_decode_valid_base64", lambda text: None)
        assert outcome(text) == bytes_or_error
    if not changes:
        assert bytes_or_error == b"\0" + data
