"""Cooperative cancellation of long work within one inference of a Prolog machine.

A machine checks the limits of a goal (time, inferences, memory) between inferences. Walking over a large term or
searching a long text is one inference, so such code has to check the limits itself: it calls `check_limits` after
every `BULK` of small pieces of work, and before each large allocation with its size in bytes. `check_limits` raises
an error if the goal that runs in this thread must end.

The check finds the goal in one of two ways. A machine that runs in the current thread registers a function with
`watched_by`; budgets of machines that know which thread they run in are registered once with `watch_for`.
"""

from itertools import chain
from threading import local
from typing import Callable, Iterable, Iterator, Optional, Protocol, Sequence, Tuple, TypeVar, overload
from weakref import ref

BULK = (None,) * 1024
"""Number of pieces of work between two calls of `check_limits`, each as small as an inference."""


T = TypeVar("T")

Ask = Callable[[int, int], None]
"""Function of a number of inferences and a number of bytes to be allocated; it raises an error to end the work."""


class StepWatch(local):
    """Check of the current thread; thread-local, because each thread may run a machine of its own."""

    ask: Optional[Ask] = None


WATCH = StepWatch()


class WatchedBudget(Protocol):
    """Limits of a goal that knows in which thread it runs."""

    @property
    def runs_here(self) -> bool:
        """True if the goal runs in the current thread."""

    def check_limits(self, work: int, size: int) -> None:
        """Count inferences; raise an error if the goal must end or may not allocate ``size`` bytes."""


_BUDGETS: Tuple[Callable[[], Optional[WatchedBudget]], ...] = ()
"""Weak references to the budgets that `check_limits` asks if no function is registered for the thread."""


def watch_for(budget: WatchedBudget) -> None:
    """Register a budget that `check_limits` asks whenever a goal of it runs in the current thread."""
    global _BUDGETS
    # The tuple is replaced, never changed: `check_limits` iterates over it in other threads.
    _BUDGETS = (*[reference for reference in _BUDGETS if reference() is not None], ref(budget))


def unwatched(work: int, size: int) -> None:
    """Accept any amount of work; an argument of `watched_by` for work without limits."""


def check_limits(work: int = len(BULK), size: int = 0) -> None:
    """Check the limits of the goal in this thread; raise its error if it must end.

    Args:
        work: pieces of work since the last call, counted as inferences.
        size: bytes of the next allocation.
    """
    # A registered function takes precedence over the budgets.
    check = WATCH.ask
    if check is not None:
        check(work, size)
        return
    for reference in _BUDGETS:
        budget = reference()
        if budget is not None and budget.runs_here:
            budget.check_limits(work, size)


@overload
def in_bulks(parts: str) -> Iterable[str]: ...


@overload
def in_bulks(parts: Sequence[T]) -> Iterable[Sequence[T]]: ...


def in_bulks(parts: Sequence[T]) -> Iterable[Sequence[T]]:
    """Return the items of a list or characters of a text in slices of `BULK`; call `check_limits` between them."""
    # Short sequences are the usual case, and cost neither a generator nor a check.
    return (parts,) if len(parts) <= len(BULK) else _bulks(parts)


def _bulks(parts: Sequence[T]) -> Iterator[Sequence[T]]:
    for start in range(0, len(parts), len(BULK)):
        if start:
            check_limits()
        yield parts[start : start + len(BULK)]


def watched(parts: Sequence[T]) -> Iterable[T]:
    """Return the items of a list one by one, with a `check_limits` after every `BULK` of them."""
    return parts if len(parts) <= len(BULK) else chain.from_iterable(_bulks(parts))


def watched_by(ask: Optional[Ask]) -> Optional[Ask]:
    """Register the function that `check_limits` calls in this thread; return the previous one, to be restored."""
    previous = WATCH.ask
    WATCH.ask = ask
    return previous
