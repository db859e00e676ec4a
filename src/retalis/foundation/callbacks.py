"""Callbacks that several objects add to one list."""

from typing import Generic, Iterator, List, TypeVar

Callback = TypeVar("Callback")


class CallbackList(Generic[Callback]):
    """Functions to call at an occurrence, in the order in which they were added.

    The object that reports the occurrence owns them and calls each; other objects add theirs.
    """

    def __init__(self) -> None:
        self._callbacks: List[Callback] = []

    def __iter__(self) -> Iterator[Callback]:
        return iter(self._callbacks)

    def add(self, callback: Callback) -> None:
        """Add a function."""
        self._callbacks.append(callback)
