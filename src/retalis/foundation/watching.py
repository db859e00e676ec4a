"""Long work inside one step of a machine, and who may end it.

A machine looks at the limits of a goal between steps. A walk over a large term or an operation on a long text
is one step, so whatever may take long calls `look` once in a while (every `BULK` of small pieces of work, or
before each large one), and who runs a goal in this thread is asked whether it may go on.
"""

from threading import local
from typing import Callable, Optional, Protocol, Tuple
from weakref import ref

BULK = (None,) * 1024
"""Pieces of work, each as small as an inference, between two calls of `look`."""


class StepWatch(local):
    """Whom to ask in a thread; local, because each thread may run a machine of its own."""

    ask: Optional[Callable[[int], None]] = None


WATCH = StepWatch()


class WatchedBudget(Protocol):
    """What knows by itself whether a goal of its own runs in this thread, and what that goal may still use."""

    @property
    def runs_here(self) -> bool:
        """Whether a goal of its own runs in this thread."""

    def look(self, work: int) -> None:
        """Count pieces of work; raises where the goal has to end."""


_BUDGETS: Tuple[Callable[[], Optional[WatchedBudget]], ...] = ()
"""Weak references to the budgets that know by themselves in which thread a goal of theirs runs."""


def watch_for(budget: WatchedBudget) -> None:
    """Have `look` ask a budget wherever a goal of an entry of its own runs; nothing has to be set for each goal."""
    global _BUDGETS
    _BUDGETS = (*[known for known in _BUDGETS if known() is not None], ref(budget))


def unwatched(work: int) -> None:
    """Let any work go on: for `watched_by`."""


def look(work: int = len(BULK)) -> None:
    """Let who runs the goal end it here: raises what the function given to `watched_by` raises.

    Args:
        work: pieces of work since the last call, to be counted as inferences.
    """
    ask = WATCH.ask
    if ask is not None:
        ask(work)
        return
    for known in _BUDGETS:
        budget = known()
        if budget is not None and budget.runs_here:
            budget.look(work)


def watched_by(ask: Optional[Callable[[int], None]]) -> Optional[Callable[[int], None]]:
    """Have `look` call a function in this thread; return the one before, to be put back."""
    before = WATCH.ask
    WATCH.ask = ask
    return before
