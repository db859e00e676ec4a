"""What SWI-Prolog and this package know each other's atoms and functors by."""

from typing import Any, Callable

from ...foundation import Cache


class Handles(Cache[Any, int]):
    """What SWI-Prolog knows our atoms and functors by; it keeps them as long as they are held here."""

    __slots__ = ("let_go",)

    def __init__(self, let_go: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.let_go = let_go

    def clear(self) -> None:
        """Forget all."""
        while self:
            _, handle = self.popitem()  # first: what is found in it must be there
            self.let_go(handle)
        super().clear()


class HeldHandles(Cache[int, Any]):
    """The other way: our atoms and functors by what SWI-Prolog knows them by."""

    __slots__ = ("let_go",)

    def __init__(self, let_go: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.let_go = let_go

    def clear(self) -> None:
        """Forget all."""
        while self:
            handle, _ = self.popitem()
            self.let_go(handle)
        super().clear()


def kept(handle: int) -> None:
    """Let a functor go: SWI-Prolog keeps those for ever."""
