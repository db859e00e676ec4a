"""Texts of messages that come again and again: frame names, mostly."""

from struct import error as StructError
from typing import List, Optional, Tuple, TypeVar

from ..foundation import Cache
from ..prolog.terms import Term
from .text import text_term

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
