"""Texts and byte arrays of messages as atoms, and the bytes that such an atom stands for.

Strings and byte arrays become atoms: ``'"text"'``, or base64 for bytes that are not text. In programs with plain
texts, strings become atoms without the double quotes; byte arrays are equal in both forms. A ``string`` is text if it
is valid UTF-8 and has no control characters (Unicode category Cc: U+0000 to U+001F, U+007F to U+009F) except tab,
line feed and carriage return. A ``uint8[]`` is text only if all its bytes are printable ASCII (or tab and the ASCII
line ends), because its bytes need not have an encoding. Text that begins with the marker of the base64 form is
encoded, so that decoding is unambiguous.
"""

import re
from base64 import b64decode, b64encode
from binascii import Error as Base64Error
from binascii import a2b_base64
from typing import Optional

from ...foundation.errors import MessageError
from .types import NIL, Atom, String, Term, atom

BASE64_MARK = "FFFFFFFFFF"
"""Prefix of the base64 form; text that begins with it is itself written as base64."""

_BASE64_MARK_BYTES = BASE64_MARK.encode()

_BASE64_LINE_LENGTH, _BASE64_LINE_END = 76, "////"
_ASCII = re.compile(rb"[ -~\t\n\r\v\f]*\Z")
_CONTROL = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


def text_atom(data: bytes) -> Atom:
    """Return the atom of a message's string."""
    text = _find_text(data)
    return _base64_atom(data) if text is None else atom('"' + text + '"')


def plain_text_atom(data: bytes) -> Atom:
    """Return the atom of a message's string in the plain form, without double quotes."""
    text = _find_text(data)
    return atom(_base64_text(data) if text is None else text)


def _find_text(data: bytes) -> Optional[str]:
    """Return the text of a message's string; None if it is written as base64."""
    if data.startswith(_BASE64_MARK_BYTES):
        return None
    try:
        text = str(data, "utf-8")
    except UnicodeDecodeError:
        return None
    return None if _CONTROL.search(text) else text


def blob_atom(data: bytes) -> Atom:
    """Return the atom of a message's byte array."""
    if _ASCII.match(data) and not data.startswith(_BASE64_MARK_BYTES):
        return atom('"' + str(data, "ascii") + '"')
    return _base64_atom(data)


def text_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes that a term denotes in a string slot, or None if it does not denote a string.

    Accepted are the atoms of `text_atom` and `blob_atom`, other atoms (their name is the text), and Prolog strings.
    ``term`` is dereferenced.

    Raises:
        MessageError: for malformed base64, and for text that cannot be encoded (an unpaired surrogate).
    """
    if term.__class__ is Atom:
        # The empty list is an atom in Prolog, but never a string.
        if term is NIL:
            return None
        name = term.name
        if len(name) >= 2 and name[0] == '"' and name[-1] == '"':
            name = name[1:-1]
    elif term.__class__ is String:
        name = term.text
    else:
        return None
    return _encode_text(name)


def plain_text_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes that a term denotes in a string slot of the plain form, or None if it is no atom or string.

    Double quotes are part of the text, and the atom ``[]`` is the text of a message with these two characters.
    ``term`` is dereferenced.

    Raises:
        MessageError: see `text_bytes`.
    """
    if term.__class__ is Atom:
        return _encode_text(term.name)
    return _encode_text(term.text) if term.__class__ is String else None


def _encode_text(name: str) -> bytes:
    """Return the bytes of a text without double quotes."""
    if name.startswith(BASE64_MARK):
        return _decode_base64(name[len(BASE64_MARK) :])
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError as error:
        raise MessageError(
            f"expected bytes as text, got the code point {ord(name[error.start]):#x}"
        ) from None


def _base64_atom(data: bytes) -> Atom:
    return atom(f'"{_base64_text(data)}"')


def _base64_text(data: bytes) -> str:
    text = str(b64encode(data), "ascii")
    lines = "".join(
        text[start : start + _BASE64_LINE_LENGTH] + _BASE64_LINE_END
        for start in range(0, len(text), _BASE64_LINE_LENGTH)
    )
    return BASE64_MARK + lines


def _decode_base64(text: str) -> bytes:
    """Decode the lines of the base64 form.

    Lines are split by position, because the characters of a line end are also in the base64 alphabet.
    """
    decoded = _decode_valid_base64(text)
    if decoded is not None:
        return decoded
    # `/` is a base64 digit, so searching for the line end could find data.
    step = _BASE64_LINE_LENGTH + len(_BASE64_LINE_END)
    lines = [text[start : start + step] for start in range(0, len(text), step)]
    if any(not line.endswith(_BASE64_LINE_END) for line in lines):
        raise MessageError(
            f"expected base64 in lines of {_BASE64_LINE_LENGTH} characters, each followed by {_BASE64_LINE_END}"
        )
    try:
        return b64decode("".join(line[: -len(_BASE64_LINE_END)] for line in lines), validate=True)
    except (Base64Error, ValueError) as error:
        raise MessageError(f"expected base64 after {BASE64_MARK}: {error}") from None


def _decode_valid_base64(text: str) -> Optional[bytes]:
    """Return the bytes of valid lines, or None for others; in a third of the time of the general way."""
    try:
        data = bytearray(text, "ascii")
    except UnicodeEncodeError:
        return None
    step = _BASE64_LINE_LENGTH + len(_BASE64_LINE_END)
    rest = data[len(data) // step * step :]
    if rest:
        if not rest.endswith(_BASE64_LINE_END.encode()):
            return None
        del rest[-len(_BASE64_LINE_END) :]
        del data[len(data) // step * step :]
    for column in range(_BASE64_LINE_LENGTH, step):
        if data[column::step].count(b"/") != len(data) // step:
            return None
    # Each deletion makes the lines one character shorter.
    for column in reversed(range(_BASE64_LINE_LENGTH, step)):
        del data[column :: column + 1]
    data += rest
    try:
        decoded = a2b_base64(data)
    except Base64Error:
        return None
    # Characters that are no digits are skipped, so the result is too short if there is one.
    padding = 2 if data.endswith(b"==") else int(data.endswith(b"="))
    return decoded if 4 * len(decoded) == 3 * len(data) - 4 * padding else None
