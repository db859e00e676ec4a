"""What windows measure of the items that are in them: one class for each kind of aggregate, and one table of them."""

from fractions import Fraction
from typing import Any, Callable, Deque, Dict, Hashable, Iterator, List, NamedTuple, Optional, Protocol, Tuple

from ...prolog.terms import SECOND, Term, make_list, term_key
from .items import StreamItem
from .numbers import ExactSum, Lowest, Ranked, check_finite, check_ordered, deviation

Setting = Any
"""What a measure is set to, by its kind: a number, or what calls the program's predicates; mostly None."""
Members = Deque[StreamItem]
"""The items of a window in the order in which they came; some of them may be gone."""


def live(members: Members) -> Iterator[StreamItem]:
    """Yield those that are in the window, the oldest first."""
    return (item for item in members if not item.gone)


class WindowMeasure(Protocol):
    """A measure of the items in one window.

    `check` comes before an item is taken, so that one with a wrong value leaves nothing half done.

    Attributes:
        picky: whether it refuses some values.
        of_none: whether there is a result for no items.
        lists: whether its result looks at each of the items.
    """

    picky: bool
    of_none: bool
    lists: bool

    def check(self, item: StreamItem, /) -> None:
        """Refuse the value of an item.

        Raises:
            RuleError: where the measure cannot take it.
        """

    def add(self, item: StreamItem, /) -> None:
        """Take an item in."""

    def remove(self, item: StreamItem, /) -> None:
        """Take out an item that is gone."""

    def result(self, members: Members, number: int, /) -> Optional[Term]:
        """Return the result for so many items, one at least but for `of_none`; None where there is none."""


class _Plain:
    """A measure that is read off the items."""

    picky = False
    of_none = False
    lists = False

    def __init__(self, at: int, name: str, setting: Setting):
        self.at = at
        self.name = name
        self.setting = setting

    def check(self, item: StreamItem) -> None:
        """See `WindowMeasure.check`."""

    def add(self, item: StreamItem) -> None:
        """See `WindowMeasure.add`."""

    def remove(self, item: StreamItem) -> None:
        """See `WindowMeasure.remove`."""


class _Count(_Plain):
    of_none = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return number


class _Sum(_Plain):
    picky = True
    of_none = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.sum = ExactSum()

    def check(self, item: StreamItem) -> None:
        check_finite(item.values[self.at], self.name)

    def add(self, item: StreamItem) -> None:
        self.sum.change(item.values[self.at], 1)

    def remove(self, item: StreamItem) -> None:
        self.sum.change(item.values[self.at], -1)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.sum.over(1)


class _Average(_Sum):
    of_none = False

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.sum.over(number)


class _Deviation(_Sum):
    of_none = False

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.squares = ExactSum()

    def _square(self, item: StreamItem, by: int) -> None:
        over, under = item.values[self.at].as_integer_ratio()
        self.squares.change_fraction(over * over, 2 * (under.bit_length() - 1), by)

    def add(self, item: StreamItem) -> None:
        super().add(item)
        self._square(item, 1)

    def remove(self, item: StreamItem) -> None:
        super().remove(item)
        self._square(item, -1)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return deviation(self.sum, self.squares, number) if number > 1 else None


class _Least(_Plain):
    picky = True
    sign = 1

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.lowest = Lowest()

    def check(self, item: StreamItem) -> None:
        check_ordered(item.values[self.at], self.name)

    def add(self, item: StreamItem) -> None:
        self.lowest.add(self.sign * item.values[self.at], item)

    def remove(self, item: StreamItem) -> None:
        self.lowest.remove()

    def result(self, members: Members, number: int) -> Optional[Term]:
        top = self.lowest.top()
        return None if top is None else top[2].values[self.at]


class _Greatest(_Least):
    sign = -1


class _Quantile(_Plain):
    picky = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.ranked = Ranked(setting)

    def check(self, item: StreamItem) -> None:
        check_finite(item.values[self.at], self.name)

    def add(self, item: StreamItem) -> None:
        self.ranked.add(item.values[self.at], item)

    def remove(self, item: StreamItem) -> None:
        self.ranked.remove(item)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.ranked.value()


class _First(_Plain):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(live(members)).values[self.at]
        return value


class _Last(_Plain):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(item for item in reversed(members) if not item.gone).values[self.at]
        return value


class _List(_Plain):
    of_none = True
    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return make_list([item.values[self.at] for item in live(members)])


class _CountDistinct(_Plain):
    of_none = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.numbers: Dict[Hashable, int] = {}

    def add(self, item: StreamItem) -> None:
        key = term_key(item.values[self.at])
        self.numbers[key] = self.numbers.get(key, 0) + 1

    def remove(self, item: StreamItem) -> None:
        key = term_key(item.values[self.at])
        self.numbers[key] -= 1
        if not self.numbers[key]:
            del self.numbers[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        return len(self.numbers)


class _Alike:
    """The items of one value, in the order in which they came in; the first that is not gone is at ``at``."""

    __slots__ = ("items", "at", "live")

    def __init__(self) -> None:
        self.items: List[Tuple[int, StreamItem]] = []
        self.at = 0
        self.live = 0

    def add(self, order: int, item: StreamItem) -> None:
        self.items.append((order, item))
        self.live += 1

    def left(self) -> None:
        """Take note that one of them is gone."""
        self.live -= 1
        items = self.items
        if len(items) > 2 * self.live + 16:
            self.items = items = [one for one in items if not one[1].gone]
            self.at = 0
        while self.at < len(items) and items[self.at][1].gone:
            self.at += 1

    def first(self) -> Tuple[int, StreamItem]:
        """Return the oldest with its place among all that came in; there has to be one."""
        return self.items[self.at]


class _Distinct(_Plain):
    """The values that are different; looks at each of them once, however many items have it."""

    of_none = True
    lists = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.alike: Dict[Hashable, _Alike] = {}
        self._order = 0

    def add(self, item: StreamItem) -> None:
        self._order += 1
        self.alike.setdefault(term_key(item.values[self.at]), _Alike()).add(self._order, item)

    def remove(self, item: StreamItem) -> None:
        key = term_key(item.values[self.at])
        same = self.alike[key]
        same.left()
        if not same.live:
            del self.alike[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        firsts = sorted([same.first() for same in self.alike.values()], key=_place)
        return make_list([item.values[self.at] for _, item in firsts])


def _place(entry: Tuple[int, StreamItem]) -> int:
    return entry[0]


class _Rate(_Plain):
    """The number of items per second, rounded once.

    The seconds are those of the window (``setting``), else those between the first end and the last.
    """

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.seconds = Fraction(setting) if setting else None
        self.first, self.last = Lowest(), Lowest()

    def add(self, item: StreamItem) -> None:
        if self.seconds is None:
            self.first.add(item.end, item)
            self.last.add(-item.end, item)

    def remove(self, item: StreamItem) -> None:
        if self.seconds is None:
            self.first.remove()
            self.last.remove()

    def result(self, members: Members, number: int) -> Optional[Term]:
        if self.seconds is not None:
            return number * self.seconds.denominator / self.seconds.numerator
        low, high = self.first.top(), self.last.top()
        assert low is not None and high is not None  # there is an item
        span = high[2].end - low[2].end
        return (number - 1) * SECOND / span if span else None


class _Fold(_Plain):
    """A program's own measure: ``setting`` gives the result of the values, oldest first."""

    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        found: Optional[Term] = self.setting([item.values[self.at] for item in live(members)])
        return found


class MeasureKind(NamedTuple):
    """A kind of measure.

    Attributes:
        form: how rules write it; the last argument is what is measured.
        settings: how many arguments come before that.
        takes: whether it is of a value of each item.
        numeric: whether values have to be numbers.
        make: makes one from the place of its value among those of an item, its name, and what it is set to.
    """

    form: str
    settings: int
    takes: bool
    numeric: bool
    make: Callable[[int, str, Any], Any]


MEASURES: Dict[str, MeasureKind] = {
    "count": MeasureKind("count", 0, False, False, _Count),
    "sum": MeasureKind("sum(X)", 0, True, True, _Sum),
    "min": MeasureKind("min(X)", 0, True, True, _Least),
    "max": MeasureKind("max(X)", 0, True, True, _Greatest),
    "avg": MeasureKind("avg(X)", 0, True, True, _Average),
    "stddev": MeasureKind("stddev(X)", 0, True, True, _Deviation),
    "median": MeasureKind("median(X)", 0, True, True, lambda at, name, _: _Quantile(at, name, 0.5)),
    "quantile": MeasureKind("quantile(P, X)", 1, True, True, _Quantile),
    "first": MeasureKind("first(X)", 0, True, False, _First),
    "last": MeasureKind("last(X)", 0, True, False, _Last),
    "list": MeasureKind("list(X)", 0, True, False, _List),
    "distinct": MeasureKind("distinct(X)", 0, True, False, _Distinct),
    "count_distinct": MeasureKind("count_distinct(X)", 0, True, False, _CountDistinct),
    "rate": MeasureKind("rate", 0, False, False, _Rate),
    "fold": MeasureKind("fold(Init, Step, Result, X)", 3, True, False, _Fold),
}
"""By their names."""
