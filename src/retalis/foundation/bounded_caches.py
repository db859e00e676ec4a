"""Caches that are bounded in entries and in bytes: a dictionary each, so that a hit costs a look-up and no more."""

from typing import Callable, Dict, TypeVar

from .python_interpreter import text_size

Key = TypeVar("Key")
Value = TypeVar("Value")

ENTRY = 200
"""Bytes that an entry takes besides its key and value: its place in the dictionary, and small objects around it."""


class Cache(Dict[Key, Value]):
    """What was made for keys, to be found again; it starts anew where it would hold more than it may.

    Starting anew, and not forgetting the oldest, needs no order and no lock: entries that are of use are back at
    their next use, and threads that race make at worst the same entry twice.

    Args:
        entries: how many it holds at most.
        size: how many bytes all entries may take, by what `keep` was told.
        longest: how many bytes one entry may take; what is larger is not kept. By default a sixteenth of ``size``.

    Attributes:
        held: bytes that the entries take.
    """

    __slots__ = ("entries", "size", "longest", "held")

    def __init__(self, entries: int, size: int, longest: int = 0):
        super().__init__()
        self.entries = entries
        self.size = size
        self.longest = longest or size // 16
        self.held = 0

    def keep(self, key: Key, value: Value, size: int) -> Value:
        """Keep what was made for a key, if it is not too large; return it.

        Args:
            key: what it is found by.
            value: what was made.
            size: the bytes that key and value take.
        """
        size += ENTRY
        if size <= self.longest:
            if len(self) >= self.entries or self.held + size > self.size:
                self.clear()
            self.held += size
            self[key] = value
        return value

    def clear(self) -> None:
        """Forget all."""
        super().clear()
        self.held = 0


class Texts(Cache[str, str]):
    """What a function makes of texts: ``texts[text]`` is ``make(text)``, kept where it is short.

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
        made = self._make(text)
        return self.keep(text, made, text_size(text) + text_size(made))
