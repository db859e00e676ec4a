"""Caches with limits for the number of entries and for their total size in bytes.

A cache is a dictionary, so that a hit costs only one lookup. It has no eviction order: when a limit is
exceeded, all entries are dropped. That needs no lock and no bookkeeping on hits; entries that are used often are
computed again at once, and threads that race compute the same entry twice at worst.
"""

from sys import getsizeof
from typing import Callable, Dict, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")

ENTRY_BYTES = 200
"""Bytes of an entry in addition to key and value: its part of the dictionary, and small objects around it."""


class Cache(Dict[Key, Value]):
    """Bounded cache of computed values by key; cleared when it is full.

    Args:
        max_entries: maximum number of entries.
        max_bytes: maximum total size of the entries in bytes, as given to `store`.
        max_entry_bytes: maximum size of one entry in bytes; larger values are not stored. One sixteenth of
            ``max_bytes`` by default.

    Attributes:
        total_bytes: total size of the entries in bytes.
    """

    __slots__ = ("max_entries", "max_bytes", "max_entry_bytes", "total_bytes")

    def __init__(self, max_entries: int, max_bytes: int, max_entry_bytes: int = 0):
        super().__init__()
        self.max_entries = max_entries
        self.max_bytes = max_bytes
        self.max_entry_bytes = max_entry_bytes or max_bytes // 16
        self.total_bytes = 0

    def store(self, key: Key, value: Value, size: int) -> Value:
        """Store the value of a key, unless both together, ``size`` bytes, are too large; return the value."""
        # A cache of many tiny entries would otherwise take a multiple of its limit.
        size += ENTRY_BYTES
        if size <= self.max_entry_bytes:
            # Not atomic on purpose: a race between threads can only lose entries or count them twice until the next
            # `clear`, which resets the count.
            if len(self) >= self.max_entries or self.total_bytes + size > self.max_bytes:
                self.clear()
            self.total_bytes += size
            self[key] = value
        return value

    def clear(self) -> None:
        """Remove all entries."""
        super().clear()
        self.total_bytes = 0


class TextCache(Cache[str, str]):
    """Cache of a function on strings: ``texts[text]`` is ``compute(text)``, stored if it is short.

    Args:
        max_entries: see `Cache`.
        max_bytes: see `Cache`.
        max_entry_bytes: see `Cache`.
    """

    __slots__ = ("_compute",)

    def __init__(
        self, compute: Callable[[str], str], max_entries: int, max_bytes: int, max_entry_bytes: int = 0
    ):
        super().__init__(max_entries, max_bytes, max_entry_bytes)
        self._compute = compute

    def __missing__(self, text: str) -> str:
        value = self._compute(text)
        return self.store(text, value, getsizeof(text) + getsizeof(value))
