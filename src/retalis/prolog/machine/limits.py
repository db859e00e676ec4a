"""What an event or a question may use with all that it starts, and the errors of what has used more."""

from typing import Any, Iterable, NamedTuple, Optional, Protocol, Type, TypeVar

from ...foundation import UsageError, shortened
from ..terms import Term
from .faults import PrologError

SLICE = (None,) * 1021
"""Steps between two looks at the limits: a prime, so that no loop is always looked at at the same step of it."""

LOOP = (None,) * 256
"""Turns of a loop inside one step."""


MEGABYTE = 1_000_000
"""Bytes of a megabyte, wherever a limit is given in megabytes."""

MAX_LIMIT = 1e9
"""The largest number of seconds or megabytes that a limit may be: 31 years."""

MAX_COUNT = 10**20
"""The largest number of inferences that a limit may be."""

Number = TypeVar("Number", int, float)


def checked_number(name: str, value: object, kind: Type[Number]) -> Number:
    """Return a number of 0 or more that a setting gives.

    Args:
        name: the setting's, for the error.
        value: an ``int`` or a ``float``.
        kind: ``int`` for whole numbers, which may be given as floats (``1e6``).

    Raises:
        UsageError: for anything else: a ``bool``, a text, a negative number, NaN, infinity, or a number that is too
            large for a time.
    """
    largest = MAX_COUNT if kind is int else MAX_LIMIT
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if 0 <= value <= largest and kind(value) == value:
            return kind(value)
        found = str(value) if abs(value) < 1e300 else "a larger number"
    else:
        found = shortened(repr(value))
    whole = "a whole number" if kind is int else "a number"
    raise UsageError(f"{name}: expected {whole} from 0 to {largest:.0e}, found {found}")


class _LimitFields(NamedTuple):
    seconds: Optional[float]
    inferences: Optional[int]
    megabytes: Optional[float]
    output_megabytes: Optional[float]


class Limits(_LimitFields):
    """What an event or a question may use with all that it starts; None means without limit.

    >>> engine = Engine(settings=Settings(limits=Limits(inferences=10000)))
    >>> engine.load(rules="forever :- forever.")
    >>> engine.call("catch(forever, error(resource_error(_), _), true)")
    True

    Attributes:
        seconds: of wall time.
        inferences: calls of predicates, and steps of walks over large terms (counted by the thousand).
        megabytes: growth of the process's resident memory, in 1,000,000 bytes.
        output_megabytes: what goals write to ``user_output`` and ``user_error`` together, in 1,000,000 bytes; 1 by
            default.

    Raises:
        UsageError: for a limit that is no number from 0 on; it names the limit.
    """

    __slots__ = ()

    def __new__(
        cls,
        seconds: Optional[float] = None,
        inferences: Optional[int] = None,
        megabytes: Optional[float] = None,
        output_megabytes: Optional[float] = 1.0,
    ) -> "Limits":
        """Check the limits and keep them."""
        return super().__new__(
            cls,
            None if seconds is None else checked_number("seconds", seconds, float),
            None if inferences is None else checked_number("inferences", inferences, int),
            None if megabytes is None else checked_number("megabytes", megabytes, float),
            None if output_megabytes is None else checked_number("output_megabytes", output_megabytes, float),
        )

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> "Limits":  # type: ignore[override]
        """Return limits of four values; ``_replace`` comes here."""
        return cls(*iterable)


NO_LIMITS = Limits(output_megabytes=None)


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
