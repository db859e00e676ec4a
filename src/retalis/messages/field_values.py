"""Strings, byte arrays and arrays of messages as terms.

Strings and byte arrays become atoms: ``'"text"'``, or base64 for bytes that are not text. A ``string`` is text if it
is valid UTF-8 and has no control characters (Unicode category Cc: U+0000 to U+001F, U+007F to U+009F) except tab,
line feed and carriage return. A ``uint8[]`` is text only if all its bytes are printable ASCII (or tab and the ASCII
line ends), because its bytes need not have an encoding. Text that begins with the marker of the base64 form is
encoded, so that decoding is unambiguous.

Long strings and arrays become lazy terms. Short strings are cached by their bytes, because frame names repeat in
every message.
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

BASE64_MARK = "FFFFFFFFFF"
"""Prefix of the base64 form; text that begins with it is itself written as base64."""

_BASE64_MARK_BYTES = BASE64_MARK.encode()

_BASE64_LINE_LENGTH, _BASE64_LINE_END = 76, "////"
_ASCII = re.compile(rb"[ -~\t\n\r\v\f]*\Z")
_CONTROL = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")

MAX_EAGER_BYTES = 1024
"""Strings longer than this many bytes become lazy terms."""

LAZY_STRING_FUNCTOR: Functor = functor("", 0)
"""Functor of a lazy string: an atom whose name is not known yet. No pattern has this functor."""


def text_atom(data: bytes) -> Atom:
    """Return the atom of a message's string."""
    if data.startswith(_BASE64_MARK_BYTES):
        return _base64_atom(data)
    try:
        text = str(data, "utf-8")
    except UnicodeDecodeError:
        return _base64_atom(data)
    return _base64_atom(data) if _CONTROL.search(text) else atom('"' + text + '"')


def blob_atom(data: bytes) -> Atom:
    """Return the atom of a message's byte array."""
    if _ASCII.match(data) and not data.startswith(_BASE64_MARK_BYTES):
        return atom('"' + str(data, "ascii") + '"')
    return _base64_atom(data)


def text_term(data: bytes) -> Term:
    """Return the atom of a message's string, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, text_atom, data)
    return text_atom(data)


def blob_term(data: bytes) -> Term:
    """Return the atom of a message's byte array, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, blob_atom, data)
    return blob_atom(data)


def raw_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes of a lazy term of `text_term` or `blob_term` that was not accessed; None for other terms."""
    if term.__class__ is Lazy and term.made is None and (term.make is text_atom or term.make is blob_atom):
        raw: bytes = term.source
        return raw
    return None


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
    if name.startswith(BASE64_MARK):
        return _decode_base64(name[len(BASE64_MARK) :])
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError as error:
        raise MessageError(
            f"expected bytes as text, got the code point {ord(name[error.start]):#x}"
        ) from None


def _base64_atom(data: bytes) -> Atom:
    text = str(b64encode(data), "ascii")
    lines = "".join(
        text[start : start + _BASE64_LINE_LENGTH] + _BASE64_LINE_END
        for start in range(0, len(text), _BASE64_LINE_LENGTH)
    )
    return atom(f'"{BASE64_MARK}{lines}"')


def _decode_base64(text: str) -> bytes:
    """Decode the lines of the base64 form.

    Lines are split by position, because the characters of a line end are also in the base64 alphabet.
    """
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


_Value = TypeVar("_Value")

CACHE_BYTES_PER_CHARACTER = 5
"""Bytes of memory per byte of a cached string: one in the key, and up to four per character in the atom."""


def text_cache() -> "Cache[bytes, _Value]":
    """Return a bounded cache of values by the bytes of strings.

    Only short strings are worth caching: frame names repeat, while long strings usually differ.
    """
    return Cache(2048, 1 << 20, 1024)


cached_texts: Cache[bytes, Term] = text_cache()


def cache_text(cache: Cache[bytes, _Value], key: bytes, value: _Value) -> _Value:
    """Store a value under the bytes of strings; return the value."""
    return cache.store(key, value, CACHE_BYTES_PER_CHARACTER * len(key))


def read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the string at a position of a message, after generated code has missed it in the cache."""
    raw = data[start:stop]
    # A slice beyond the end of the message is shorter than the length field says.
    if len(raw) != stop - start:
        raise StructError
    return cache_text(cached_texts, raw, text_term(raw))


def read_texts(key: bytes, number: int) -> Optional[Tuple[Term, ...]]:
    """Return the strings that fill ``key``, each preceded by its length; None if they do not fill it exactly."""
    terms: List[Term] = []
    offset = 0
    for _ in range(number):
        size = int.from_bytes(key[offset : offset + 4], "little")
        raw = key[offset + 4 : offset + 4 + size]
        # The counts do not fit the key, so the message does not have the assumed layout.
        if len(raw) != size:
            return None
        terms.append(text_term(raw))
        offset += 4 + size
    return tuple(terms) if offset == len(key) and number else None


MAX_EAGER_ELEMENTS = 4
"""Arrays up to this length are decoded with the message, because a lazy term would cost as much."""

ArrayDecoder = Callable[[bytes], Term]


@lru_cache(maxsize=None)
def array_maker(code: str) -> ArrayDecoder:
    """Return the function that decodes an array of numbers of a `struct` code into a list."""
    size = calcsize("<" + code)

    def make(source: bytes) -> Term:
        term: Term = NIL
        # A list is built from its end, because each cell contains the rest.
        for value in reversed(unpack(f"<{len(source) // size}{code}", source)):
            term = (CONS, value, term)
        return term

    return make


def repeated_list(element: Term, count: int) -> Term:
    """Return the list of ``number`` elements that are the same term."""
    term: Term = NIL
    for _ in range(count):
        term = (CONS, element, term)
    return term


def record_maker(
    title: str, layout: Struct, targets: List[str], element: str, names: Dict[str, object]
) -> ArrayDecoder:
    """Return the function that decodes an array of elements of equal size into a list.

    Args:
        title: name of the type, for tracebacks.
        layout: layout of one element.
        targets: variables of an element's values.
        element: expression of an element's term, in terms of these variables.
        names: globals of that expression.
    """
    lines = [
        "def make(source):",
        "  term = N",
        f"  for {', '.join(targets)}, in reversed(list(unpack(source))):",
        f"    term = (C, {element}, term)",
        "  return term",
    ]
    namespace = {**names, "unpack": layout.iter_unpack}
    make: ArrayDecoder = codegen.function(lines, namespace, f"decode {title}", "make")
    return make


def variable_array(
    element: Callable[[bytes, int], Tuple[Term, int]], min_size: int
) -> Callable[[bytes, int, int], Tuple[Term, int]]:
    """Return the function that decodes an array of elements that differ in size.

    Args:
        element: decodes the element at an offset; returns it and the offset after it.
        min_size: minimum size of an element in bytes.
    """

    def decode(data: bytes, offset: int, count: int) -> Tuple[Term, int]:
        # A wrong count must fail before memory is allocated for that many elements.
        if count * min_size > len(data) - offset:
            raise StructError
        items = []
        for _ in range(count):
            item, offset = element(data, offset)
            items.append(item)
        term: Term = NIL
        while items:
            term = (CONS, items.pop(), term)
        return term, offset

    return decode
