"""Texts of messages that come again and again: frame names, mostly."""

from struct import error as StructError
from typing import Any, Dict, List, Optional, Tuple

from ..terms import Term
from .text import text_term

_CACHED_TEXTS = 2048
_CACHED_LENGTH = 128


class TextCache(Dict[bytes, Any]):
    """Atoms by the bytes of their texts, bounded: names come again and again, other texts do not stay."""

    def keep(self, key: bytes, value: Any) -> None:
        """Remember a value, if its key is short."""
        if len(key) <= _CACHED_LENGTH:
            if len(self) >= _CACHED_TEXTS:
                self.clear()
            self[key] = value


texts = TextCache()


def read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the text at a place of a message; the generated code has looked it up in the cache in vain."""
    raw = data[start:stop]
    if len(raw) != stop - start:
        raise StructError
    found = text_term(raw)
    texts.keep(raw, found)
    return found


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
