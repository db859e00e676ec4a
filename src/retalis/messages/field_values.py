"""Strings, byte arrays and arrays of messages as terms.

`byte_texts` defines the atoms of strings and byte arrays, and `array_terms` the lists of numbers. Long strings and
arrays become lazy terms. Short strings are cached by their bytes, because frame names repeat in every message.
"""

from struct import Struct
from struct import error as StructError
from typing import Callable, Dict, List, Optional, Tuple, TypeVar

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..prolog.terms.array_terms import BLOB, LAZY_STRING_FUNCTOR, decoder_of_code
from ..prolog.terms.byte_texts import blob_atom, text_atom
from ..prolog.terms.types import CONS, NIL, ArrayDecoder, Lazy, Term
from .type_definition import PRIMITIVES, Field

MAX_EAGER_BYTES = 1024
"""Strings longer than this many bytes become lazy terms."""


def text_term(data: bytes) -> Term:
    """Return the atom of a message's string, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, text_atom, data)
    return text_atom(data)


def blob_term(data: bytes) -> Term:
    """Return the atom of a message's byte array, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, BLOB, data)
    return blob_atom(data)


def raw_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes of a lazy term of `blob_term`, or of `text_term` if it was not accessed; otherwise None."""
    if term.__class__ is Lazy and (
        term.decoder is BLOB or (term.decoder is text_atom and term.decoded_term is None)
    ):
        raw: bytes = term.source
        return raw
    return None


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


def number_decoder(slot: Field) -> Optional[ArrayDecoder]:
    """Return the decoder of the array terms that have the bytes of a slot; None if its elements are no numbers."""
    if slot.definition is not None or slot.type == "bool" or slot.type not in PRIMITIVES:
        return None
    return decoder_of_code(PRIMITIVES[slot.type])


MakeList = Callable[[bytes], Term]


def repeated_list(element: Term, count: int) -> Term:
    """Return the list of ``number`` elements that are the same term."""
    term: Term = NIL
    for _ in range(count):
        term = (CONS, element, term)
    return term


def record_maker(
    title: str, layout: Struct, targets: List[str], element: str, names: Dict[str, object]
) -> MakeList:
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
    make: MakeList = codegen.function(lines, namespace, f"decode {title}", "make")
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
