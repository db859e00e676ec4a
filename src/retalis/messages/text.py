"""Strings of messages as atoms: ``'"text"'``, with a base64 form for bytes that cannot stand in a text."""

import re
from base64 import b64decode, b64encode
from binascii import Error as Base64Error
from typing import Optional

from ..foundation import MessageError
from ..prolog.terms import NIL, Atom, Functor, Lazy, String, Term, atom, functor

MARK = "FFFFFFFFFF"
"""What the base64 form begins with; a text that begins so is written in base64 itself."""

_LINE, _BREAK = 76, "////"
_PRINTABLE = re.compile(rb"[ -~\t\n\r\v\f]*\Z")

LONG = 1024
"""Bytes from which on a text is made only when something looks at it."""

TEXT: Functor = functor("", 0)
"""The functor of a lazy text: an atom whose name is not known yet. It is the functor of no pattern."""


def text_atom(data: bytes) -> Atom:
    """Return the atom of a message's string."""
    if _PRINTABLE.match(data) and not data.startswith(b"FFFFFFFFFF"):
        return atom('"' + str(data, "ascii") + '"')
    return atom('"' + MARK + _encode_base64(data) + '"')


def text_term(data: bytes) -> Term:
    """Return the atom of a message's string or byte array, lazy where it is long."""
    if len(data) > LONG:
        return Lazy(TEXT, text_atom, data)
    return text_atom(data)


def text_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes that a term stands for in a slot of text, or None where it stands for none.

    Taken are the atoms of `text_atom`, other atoms (their name is the text), and Prolog strings. ``term`` is
    dereferenced.

    Raises:
        MessageError: for a base64 form that is broken, and for a text that is none (half a surrogate pair).
    """
    if term.__class__ is Atom:
        if term is NIL:
            return None
        name = term.name
        if len(name) >= 2 and name[0] == '"' and name[-1] == '"':
            name = name[1:-1]
    elif term.__class__ is String:
        name = term.text
    else:
        return None
    if name.startswith(MARK):
        return _decode_base64(name[len(MARK) :])
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError as error:
        raise MessageError(
            f"expected bytes as text, got the code point {ord(name[error.start]):#x}"
        ) from None


def _encode_base64(data: bytes) -> str:
    text = str(b64encode(data), "ascii")
    return "".join(text[at : at + _LINE] + _BREAK for at in range(0, len(text), _LINE))


def _decode_base64(text: str) -> bytes:
    """Read lines back by position: the characters of a break are in the alphabet too."""
    step = _LINE + len(_BREAK)
    lines = [text[at : at + step] for at in range(0, len(text), step)]
    if any(not line.endswith(_BREAK) for line in lines):
        raise MessageError(f"expected base64 in lines of {_LINE} characters, each followed by {_BREAK}")
    try:
        return b64decode("".join(line[: -len(_BREAK)] for line in lines), validate=True)
    except (Base64Error, ValueError) as error:
        raise MessageError(f"expected base64 after {MARK}: {error}") from None
