"""Stamps as numbers: what arithmetic works with where an operand is a ``datime`` or ``[Sec,NSec]``.

They are numbers of seconds since the epoch like any other, and remember the instant, as the resolution of a double
near the present is 2.4e-7 s: two of them subtract and compare to the nanosecond. They live within one evaluation
only: `plain` makes the number that a program sees.
"""

from typing import Any, Tuple, Union

from ...foundation import UsageError
from ..terms import SECOND, timestamps


class _InstantNumber:
    """What both kinds of numbers have in common."""

    __slots__ = ()

    instant: int
    plain: Union[int, float]

    def _beside(self, other: Any) -> Tuple[Any, Any]:
        """Return what to compare: instants of two stamps, else numbers."""
        if isinstance(other, _InstantNumber):
            return self.instant, other.instant
        return self.plain, other

    def __lt__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one < another

    def __le__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one <= another

    def __gt__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one > another

    def __ge__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one >= another

    def __eq__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one == another

    def __ne__(self, other: Any) -> Any:
        one, another = self._beside(other)
        return one != another

    def __hash__(self) -> int:
        return hash(self.plain)

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, _InstantNumber):
            return (self.instant - other.instant) / SECOND
        if self.plain.__class__ is int and other.__class__ is int:
            return self.plain - other
        try:
            return (self.instant - timestamps.from_seconds(other)) / SECOND
        except (UsageError, OverflowError):  # an infinity, or an integer beyond all floats
            return float(self.plain) - other

    def __rsub__(self, other: Any) -> Any:
        return -self.__sub__(other)


class WholeInstant(_InstantNumber, int):
    """A stamp of whole seconds: an integer."""

    @property
    def plain(self) -> int:  # type: ignore[override]
        """The number itself."""
        return int(self)

    @property
    def instant(self) -> int:  # type: ignore[override]
        """Nanoseconds since the epoch."""
        return int(self) * SECOND

    def __truediv__(self, divisor: Any) -> Any:
        if divisor.__class__ is int and not int(self) % divisor:
            return int(self) // divisor  # as `/` of integers does
        return int(self) / divisor


class SplitInstant(_InstantNumber, float):
    """A stamp with parts of a second: a float, and the instant that it is nearest to."""

    instant: int

    @property
    def plain(self) -> float:  # type: ignore[override]
        """The number itself."""
        return float(self)


def of_instant(instant: int) -> Union[int, float]:
    """Return an instant as a number of seconds since the epoch that remembers it."""
    whole, rest = divmod(int(instant), SECOND)
    if not rest:
        return WholeInstant(whole)
    number = SplitInstant(timestamps.to_seconds(instant))
    number.instant = int(instant)
    return number


def is_instant_number(value: object) -> bool:
    """Tell whether a number is one that remembers an instant."""
    return isinstance(value, _InstantNumber)


def plain(value: Any) -> Any:
    """Return a number as programs see it."""
    return value.plain if isinstance(value, _InstantNumber) else value
