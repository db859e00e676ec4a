"""Long work inside one step of a machine, and who may end it.

A machine looks at the limits of a goal between steps. A walk over a large term or an operation on a long text
is one step, so whatever may take long calls `look` once in a while (every `BULK` of small pieces of work, or
before each large one, with the bytes that it will need), and who runs a goal in this thread is asked whether it may
go on.
"""

from itertools import chain
from threading import local
from typing import Callable, Iterable, Iterator, Optional, Protocol, Sequence, Tuple, TypeVar, overload
from weakref import ref

BULK = (None,) * 1024
"""Pieces of work, each as small as an inference, between two calls of `look`."""


T = TypeVar("T")

Ask = Callable[[int, int], None]
"""Takes pieces of work and the bytes that are about to be allocated; raises an error to end the work."""


class StepWatch(local):
    """Whom to ask in a thread; local, because each thread may run a machine of its own."""

    ask: Optional[Ask] = None


WATCH = StepWatch()


class WatchedBudget(Protocol):
    """What knows by itself whether a goal of its own runs in this thread, and what that goal may still use."""

    @property
    def runs_here(self) -> bool:
        """Whether a goal of its own runs in this thread."""

    def look(self, work: int, size: int) -> None:
        """Count pieces of work; raises where the goal has to end, or has no room for so many bytes."""


_BUDGETS: Tuple[Callable[[], Optional[WatchedBudget]], ...] = ()
"""Weak references to the budgets that know by themselves in which thread a goal of theirs runs."""


def watch_for(budget: WatchedBudget) -> None:
    """Have `look` ask a budget wherever a goal of an entry of its own runs; nothing has to be set for each goal."""
    global _BUDGETS
    _BUDGETS = (*[known for known in _BUDGETS if known() is not None], ref(budget))


def unwatched(work: int, size: int) -> None:
    """Let any work go on: for `watched_by`."""


def look(work: int = len(BULK), size: int = 0) -> None:
    """Let who runs the goal end it here: raises what the function given to `watched_by` raises.

    Args:
        work: pieces of work since the last call, to be counted as inferences.
        size: bytes that are allocated next in one piece.
    """
    ask = WATCH.ask
    if ask is not None:
        ask(work, size)
        return
    for known in _BUDGETS:
        budget = known()
        if budget is not None and budget.runs_here:
            budget.look(work, size)


@overload
def in_bulks(parts: str) -> Iterable[str]: ...


@overload
def in_bulks(parts: Sequence[T]) -> Iterable[Sequence[T]]: ...


def in_bulks(parts: Sequence[T]) -> Iterable[Sequence[T]]:
    """Return the parts of a list or the characters of a text, `BULK` at a time, with a `look` between them."""
    return (parts,) if len(parts) <= len(BULK) else _bulks(parts)


def _bulks(parts: Sequence[T]) -> Iterator[Sequence[T]]:
    for start in range(0, len(parts), len(BULK)):
        if start:
            look()
        yield parts[start : start + len(BULK)]


def watched(parts: Sequence[T]) -> Iterable[T]:
    """Return the parts of a list one by one, with a `look` after each `BULK` of them."""
    return parts if len(parts) <= len(BULK) else chain.from_iterable(_bulks(parts))


def watched_by(ask: Optional[Ask]) -> Optional[Ask]:
    """Have `look` call a function in this thread; return the one before, to be put back."""
    before = WATCH.ask
    WATCH.ask = ask
    return before
