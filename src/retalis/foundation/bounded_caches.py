"""Caches with limits for the number of entries and for their total size in bytes.

A cache is a dictionary, so that a hit costs one lookup and nothing else. It has no eviction order: when a limit is
exceeded, all entries are dropped. That needs no lock and no bookkeeping on hits; entries that are used often are
computed again at once, and threads that race compute the same entry twice at worst.
"""

from typing import Callable, Dict, TypeVar

from .cpython_and_pypy import text_size

Key = TypeVar("Key")
Value = TypeVar("Value")

ENTRY_BYTES = 200
"""Bytes of an entry in addition to key and value: its part of the dictionary, and small objects around it."""


class Cache(Dict[Key, Value]):
    """Bounded cache of computed values by key; cleared when it is full.

    Args:
        entries: maximum number of entries.
        size: maximum total size of the entries in bytes, as given to `keep`.
        longest: maximum size of one entry in bytes; larger values are not stored. One sixteenth of ``size`` by
            default.

    Attributes:
        held: total size of the entries in bytes.
    """

    __slots__ = ("entries", "size", "longest", "held")

    def __init__(self, entries: int, size: int, longest: int = 0):
        super().__init__()
        self.entries = entries
        self.size = size
        self.longest = longest or size // 16
        self.held = 0

    def keep(self, key: Key, value: Value, size: int) -> Value:
        """Store the value of a key unless it is too large; return the value.

        Args:
            key: the key.
            value: the value.
            size: size of key and value in bytes.
        """
        # A cache of many tiny entries would otherwise take a multiple of its limit.
        size += ENTRY_BYTES
        if size <= self.longest:
            # Not atomic on purpose: a race between threads can only lose entries or count them twice until the next
            # `clear`, which resets the count.
            if len(self) >= self.entries or self.held + size > self.size:
                self.clear()
            self.held += size
            self[key] = value
        return value

    def clear(self) -> None:
        """Remove all entries."""
        super().clear()
        self.held = 0


class Texts(Cache[str, str]):
    """Cache of a function on strings: ``texts[text]`` is ``make(text)``, stored if it is short.

    Args:
        make: the function.
        entries: see `Cache`.
        size: see `Cache`.
        longest: see `Cache`.
    """

    __slots__ = ("_make",)

    def __init__(self, make: Callable[[str], str], entries: int, size: int, longest: int = 0):
        super().__init__(entries, size, longest)
        self._make = make

    def __missing__(self, text: str) -> str:
        value = self._make(text)
        return self.keep(text, value, text_size(text) + text_size(value))
