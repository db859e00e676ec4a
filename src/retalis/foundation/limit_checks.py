"""Checks of limits within one inference of a Prolog machine, which end long work (cooperative cancellation).

A machine checks the limits of a goal (time, inferences, memory) between inferences. Walking over a large term or
searching a long text is one inference, so such code has to check the limits itself: it calls `check_limits` after
each round of steps (`STEPS_PER_ROUND`), and before each large allocation with its size in bytes. `check_limits`
raises an error if the goal that runs in this thread must end.

The check finds the goal in one of two ways. A machine that runs in the current thread registers a function with
`set_limit_check`; a budget that knows which thread its machine runs in registers a method once with `register_check`.
"""

from itertools import chain
from threading import local
from typing import Callable, Iterable, Iterator, Optional, Sequence, Set, TypeVar, overload
from weakref import WeakMethod

STEPS_PER_ROUND = (None,) * 1024
"""Steps of one round, the work between two calls of `check_limits`. A step is as small as an inference."""


T = TypeVar("T")

LimitCheck = Callable[[int, int], None]
"""Takes a number of inferences and a number of bytes to be allocated; raises an error to end the work."""


class ThreadLimitCheck(local):
    """Check of the current thread; thread-local, because each thread may run a machine of its own."""

    check: Optional[LimitCheck] = None


CURRENT_CHECK = ThreadLimitCheck()


_GLOBAL_CHECKS: "Set[WeakMethod[LimitCheck]]" = set()
"""Weak references to the checks that `check_limits` calls if no function is registered for the thread."""


def register_check(check: LimitCheck) -> None:
    """Register a method that `check_limits` calls in all threads; it has to ignore work that is not its own."""
    _GLOBAL_CHECKS.add(WeakMethod(check, _GLOBAL_CHECKS.discard))


def accept_all_work(work: int, size: int) -> None:
    """Accept any amount of work; a check for `set_limit_check` that has no limits."""


def check_limits(work: int = len(STEPS_PER_ROUND), size: int = 0) -> None:
    """Check the limits of the goal in this thread; raise its error if it must end.

    Args:
        work: number of steps since the last call, which are counted as inferences.
        size: bytes of the next allocation.
    """
    # The function of the thread takes precedence over the checks for all threads.
    check = CURRENT_CHECK.check
    if check is not None:
        check(work, size)
        return
    # Copied in one step of the interpreter, because other threads register checks meanwhile.
    for reference in _GLOBAL_CHECKS.copy():
        check = reference()
        if check is not None:
            check(work, size)


@overload
def in_checked_slices(parts: str) -> Iterable[str]: ...


@overload
def in_checked_slices(parts: Sequence[T]) -> Iterable[Sequence[T]]: ...


def in_checked_slices(parts: Sequence[T]) -> Iterable[Sequence[T]]:
    """Return a list or text in slices of at most one round, with a `check_limits` between them."""
    # Short sequences are the usual case, and cost neither a generator nor a check.
    return (parts,) if len(parts) <= len(STEPS_PER_ROUND) else _checked_slices(parts)


def _checked_slices(parts: Sequence[T]) -> Iterator[Sequence[T]]:
    for start in range(0, len(parts), len(STEPS_PER_ROUND)):
        if start:
            check_limits()
        yield parts[start : start + len(STEPS_PER_ROUND)]


def with_limit_checks(parts: Sequence[T]) -> Iterable[T]:
    """Return the items of a list one by one, with a `check_limits` after each round."""
    return parts if len(parts) <= len(STEPS_PER_ROUND) else chain.from_iterable(_checked_slices(parts))


def set_limit_check(check: Optional[LimitCheck]) -> Optional[LimitCheck]:
    """Register the function that `check_limits` calls in this thread; return the previous one, to be restored."""
    previous = CURRENT_CHECK.check
    CURRENT_CHECK.check = check
    return previous
