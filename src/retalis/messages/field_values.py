"""Strings and byte arrays of messages as atoms: ``'"text"'``, or base64 for bytes that are not text.

A ``string`` is text if it is valid UTF-8 and has no control characters (Unicode category Cc: U+0000 to U+001F,
U+007F to U+009F) except tab, line feed and carriage return. A ``uint8[]`` is text only if all its bytes are printable
ASCII (or tab and the ASCII line ends, as in the original), because its bytes need not have an encoding. Both are
base64 if they begin with the mark of that form.

Texts of messages that come again and again: frame names, mostly.

Lists of array elements, made from the bytes of the array.
"""

import re
from base64 import b64decode, b64encode
from binascii import Error as Base64Error
from functools import lru_cache
from struct import Struct, calcsize, unpack
from struct import error as StructError
from typing import Callable, Dict, List, Optional, Tuple, TypeVar

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError
from ..prolog.terms.types import CONS, NIL, Atom, Functor, Lazy, String, Term, atom, functor

MARK = "FFFFFFFFFF"
"""What the base64 form begins with; a text that begins so is written in base64 itself."""

_MARK_BYTES = MARK.encode()

_LINE, _BREAK = 76, "////"
_ASCII = re.compile(rb"[ -~\t\n\r\v\f]*\Z")
_CONTROL = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")

LONG = 1024
"""Bytes from which on a text is made only when something looks at it."""

TEXT: Functor = functor("", 0)
"""The functor of a lazy text: an atom whose name is not known yet. It is the functor of no pattern."""


def text_atom(data: bytes) -> Atom:
    """Return the atom of a message's string."""
    if data.startswith(_MARK_BYTES):
        return _base64_atom(data)
    try:
        text = str(data, "utf-8")
    except UnicodeDecodeError:
        return _base64_atom(data)
    return _base64_atom(data) if _CONTROL.search(text) else atom('"' + text + '"')


def blob_atom(data: bytes) -> Atom:
    """Return the atom of a message's byte array."""
    if _ASCII.match(data) and not data.startswith(_MARK_BYTES):
        return atom('"' + str(data, "ascii") + '"')
    return _base64_atom(data)


def text_term(data: bytes) -> Term:
    """Return the atom of a message's string, lazy where it is long."""
    if len(data) > LONG:
        return Lazy(TEXT, text_atom, data)
    return text_atom(data)


def blob_term(data: bytes) -> Term:
    """Return the atom of a message's byte array, lazy where it is long."""
    if len(data) > LONG:
        return Lazy(TEXT, blob_atom, data)
    return blob_atom(data)


def raw_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes of a lazy term of `text_term` or `blob_term` whose atom has not been made; None for others."""
    if term.__class__ is Lazy and term.made is None and (term.make is text_atom or term.make is blob_atom):
        raw: bytes = term.source
        return raw
    return None


def text_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes that a term stands for in a slot of text, or None where it stands for none.

    These are the atoms of `text_atom` and `blob_atom`, other atoms (their name is the text), and Prolog strings.
    ``term`` is dereferenced.

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


def _base64_atom(data: bytes) -> Atom:
    text = str(b64encode(data), "ascii")
    lines = "".join(text[at : at + _LINE] + _BREAK for at in range(0, len(text), _LINE))
    return atom(f'"{MARK}{lines}"')


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


_Made = TypeVar("_Made")

TEXT_COST = 5
"""Bytes that a text takes for each of its own: one in the key, and four in the atom if a character needs them."""


def text_cache() -> "Cache[bytes, _Made]":
    """Return a cache of what is made of texts by their bytes: names come again and again, other texts do not stay."""
    return Cache(2048, 1 << 20, 1024)


texts: Cache[bytes, Term] = text_cache()


def keep_text(cache: Cache[bytes, _Made], key: bytes, value: _Made) -> _Made:
    """Keep what was made of the bytes of texts; return it."""
    return cache.keep(key, value, TEXT_COST * len(key))


def read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the text at a place of a message; the generated code has looked it up in the cache in vain."""
    raw = data[start:stop]
    if len(raw) != stop - start:
        raise StructError
    return keep_text(texts, raw, text_term(raw))


def read_texts(key: bytes, number: int) -> Optional[Tuple[Term, ...]]:
    """Return the texts that, each with its length before it, make up ``key``; None where they do not."""
    found: List[Term] = []
    at = 0
    for _ in range(number):
        size = int.from_bytes(key[at : at + 4], "little")
        raw = key[at + 4 : at + 4 + size]
        if len(raw) != size:
            return None
        found.append(text_term(raw))
        at += 4 + size
    return tuple(found) if at == len(key) and number else None


SMALL = 4
"""Arrays up to this length are decoded with the message: a lazy term would cost as much."""

Make = Callable[[bytes], Term]


@lru_cache(maxsize=None)
def array_maker(code: str) -> Make:
    """Return the function that makes the list of the numbers of a `struct` code."""
    size = calcsize("<" + code)

    def make(source: bytes) -> Term:
        term: Term = NIL
        for value in reversed(unpack(f"<{len(source) // size}{code}", source)):
            term = (CONS, value, term)
        return term

    return make


def alike(element: Term, number: int) -> Term:
    """Return the list of so many elements that are one term."""
    term: Term = NIL
    for _ in range(number):
        term = (CONS, element, term)
    return term


def record_maker(
    title: str, layout: Struct, targets: List[str], element: str, names: Dict[str, object]
) -> Make:
    """Return the function that makes the list of elements of one size.

    Args:
        title: the type, for tracebacks.
        layout: how one element lies in the bytes.
        targets: the variables of its values.
        element: the source of the term of one element, from these variables.
        names: the globals of that source.
    """
    lines = [
        "def make(source):",
        "  term = N",
        f"  for {', '.join(targets)}, in reversed(list(unpack(source))):",
        f"    term = (C, {element}, term)",
        "  return term",
    ]
    given = {**names, "unpack": layout.iter_unpack}
    made: Make = codegen.function(lines, given, f"decode {title}", "make")
    return made


def variable_array(
    element: Callable[[bytes, int], Tuple[Term, int]], least: int
) -> Callable[[bytes, int, int], Tuple[Term, int]]:
    """Return the function that decodes elements of different sizes.

    Args:
        element: decodes the element at a place; returns it and the place after it.
        least: the size of the shortest element.
    """

    def decode(data: bytes, at: int, number: int) -> Tuple[Term, int]:
        if number * least > len(data) - at:  # before anything is made
            raise StructError
        items = []
        for _ in range(number):
            item, at = element(data, at)
            items.append(item)
        term: Term = NIL
        while items:
            term = (CONS, items.pop(), term)
        return term, at

    return decode
