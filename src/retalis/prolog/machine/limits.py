"""What an event or a question may use with all that it starts, and the errors of what has used more."""

from typing import NamedTuple, Optional, Protocol

from ..terms import Term
from .faults import PrologError

SLICE = (None,) * 1021
"""Steps between two looks at the limits: a prime, so that no loop is always looked at at the same step of it."""

LOOP = (None,) * 256
"""Turns of a loop inside one step."""


class Limits(NamedTuple):
    """What an event or a question may use with all that it starts; None means without limit.

    >>> engine = Engine(settings=Settings(limits=Limits(inferences=10000)))
    >>> engine.load(rules="forever :- forever.")
    >>> engine.call("catch(forever, error(resource_error(_), _), true)")
    True

    Attributes:
        seconds: of wall time.
        inferences: calls of predicates, and steps of walks over large terms (counted by the thousand).
        megabytes: growth of the process's resident memory.
    """

    seconds: Optional[float] = None
    inferences: Optional[int] = None
    megabytes: Optional[int] = None


NO_LIMITS = Limits()


class Refuses(Protocol):
    """Whose limit has run out, a `Budget`."""

    def close(self, error: "LimitError") -> None:
        """Refuse further goals because of an error."""


class LimitError(PrologError):
    """A limit has run out.

    Attributes:
        final: whether no program can catch it.
        budget: whose limit it is; None for the limit that a program has set for a call.
        what: what has run out.
        refused: whether the goal was not begun any more: that is counted by the budget and reported by it.
    """

    final = False
    budget: Optional[Refuses] = None
    what = ""
    refused = False


class LimitPassed(LimitError):
    """The ball of a call that has a limit of its own.

    Attributes:
        kind: what is limited.
        open: whether the call still runs; then whoever stops for the error is not the one whose limit it was.
        kept_back: whether somebody inside the call stopped for it and the call went on.
    """

    def __init__(self, kind: str, term: Term):
        super().__init__(term)
        self.kind = kind
        self.open = True
        self.kept_back = False

    @property
    def message(self) -> str:  # type: ignore[override]
        """What went wrong, as text."""
        if self.open:
            return f"the {self.kind} limit of a calling goal has been reached"
        return super().message

    def close(self) -> None:
        """Note that the call is over."""
        self.open = False

    def deliver(self) -> None:
        """Throw the ball after all where the call exits and somebody inside had kept it back."""
        if self.kept_back:
            raise self


def keep_back(error: Exception) -> bool:
    """Note that somebody stops for an error and goes on.

    Where it is the limit of a call around, that ends later; where all is used up that the event may use, its
    further goals are refused.

    Returns:
        Whether the error is to be reported: not for a refused goal, see `Budget.admit`.
    """
    if isinstance(error, LimitPassed):
        error.kept_back = error.open
    elif isinstance(error, LimitError):
        if error.budget is not None:
            error.budget.close(error)
        return not error.refused
    return True
