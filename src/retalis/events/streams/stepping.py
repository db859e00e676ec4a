"""A window of steps: matches in which the items of a group take one step after the other.

All ways that a match may go on are followed at once, the preferred ones first, and those that cannot be told apart by
what comes are one. So an item takes the same time however many came before it, and nothing is tried again.
"""

from collections import OrderedDict, deque
from typing import Any, Callable, Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...prolog.terms import Values
from .groups import MOST_NAMED, measured
from .items import KnownState, StreamItem, StreamOutput
from .measures import WindowMeasure
from .steps import SCANNING, Marks, StepPlan, ends, passes

MOST_WAYS = 100
"""How many ways of one group are followed at once: those that are preferred."""

_Pairs = Tuple[Tuple[StreamItem, int], ...]
"""Items, and the steps that have taken them."""


class _Taken(NamedTuple):
    """The items of a match, the newest first."""

    item: StreamItem
    step: int
    before: "Optional[_Taken]"


class _Whole(NamedTuple):
    """A match that is whole: its items, and the order of the first. It is given on when no preferred way is left."""

    taken: _Taken
    start: int


class StepWay:
    """A way in which the items so far may be taken.

    Attributes:
        step: the step of its last item.
        count: how many that step has taken, as far as that makes a difference.
        left: after an item was passed over the steps that may still take one; else None.
        marks: the items that conditions look back at.
        taken: the items of the match that has begun.
        start: the order of the first of these.
        whole: the matches before that one which are not given on yet, the oldest first.
    """

    __slots__ = ("step", "count", "left", "marks", "taken", "start", "whole")

    def __init__(
        self,
        step: int,
        count: int,
        left: Optional[Tuple[int, ...]],
        marks: Marks,
        taken: Optional[_Taken],
        start: int,
        whole: Tuple[_Whole, ...],
    ):
        self.step = step
        self.count = count
        self.left = left
        self.marks = marks
        self.taken = taken
        self.start = start
        self.whole = whole

    def oldest(self) -> Optional[int]:
        """Return the order of the oldest item that it holds."""
        if self.whole:
            return self.whole[0].start
        return self.start if self.taken is not None else None

    def holds(self, item: StreamItem) -> bool:
        """Tell whether the newest item that it holds is this one."""
        if self.taken is not None:
            return self.taken.item is item
        return bool(self.whole) and self.whole[-1].taken.item is item

    def key(self, counted: Hashable) -> Hashable:
        """Return what tells it from other ways by what comes; ``counted`` is what its count means for that."""
        return (self.step, counted, self.left, tuple([id(one) for one in self.marks]))


class StepGroup:
    """The items of one group that some way holds, and such as others have held since the oldest of them."""

    __slots__ = ("items", "ways")

    def __init__(self, ways: List[StepWay]):
        self.items: Deque[StreamItem] = deque()
        self.ways = ways


class SteppedWindow:
    """Gives on matches of steps, which do not overlap. See `StreamOperator`.

    Args:
        make: makes the measures of a match.
        scopes: for each of them the step that it looks at, or None for all.
        plan: the steps.
        crowded: is called where there are more ways than are followed.
    """

    def __init__(
        self,
        make: Callable[[], Sequence[WindowMeasure]],
        scopes: Sequence[Optional[int]],
        plan: StepPlan,
        crowded: Callable[[], None],
    ):
        self.make = make
        self.scopes = scopes
        self.plan = plan
        self._crowded = crowded
        self._checks = [measure.check for measure in make() if measure.picky]
        self._groups: OrderedDict[Hashable, StepGroup] = OrderedDict()  # whose oldest is found at once
        self._number = 0
        self._order = 0
        self.tracked = False
        self.allowed: Callable[[], int] = lambda: 1 << 64
        self.next: Optional[int] = None
        self.late = 0

    def __len__(self) -> int:
        return self._number

    def _scanning(self, whole: Tuple[_Whole, ...] = ()) -> StepWay:
        return StepWay(SCANNING, 0, None, (None,) * len(self.plan.marks), None, 0, whole)

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        for check in self._checks:
            check(item)
        group = self._groups.get(item.key)
        if group is None:
            group = StepGroup([self._scanning()])
        item.order = self._order + 1
        ways = self._go_on(group.ways, item)  # conditions may refuse it: nothing has changed until here
        self._order += 1
        if any(way.holds(item) for way in ways):
            self._number += 1
            group.items.append(item)
        found = self._decided(ways)
        self._set(group, item.key, ways)
        outputs = [self._output(one, item) for one in found]
        return [output for output in outputs if output is not None]

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`: the clock decides nothing."""
        return []

    def drop_oldest(self) -> None:
        """See `StreamOperator.drop_oldest`: the match of the oldest group that holds its oldest item goes."""
        key, group = next(iter(self._groups.items()))
        oldest = group.items[0].order
        left = [way for way in group.ways if way.oldest() != oldest]
        if not left or left[-1].step != SCANNING:
            left.append(self._scanning())
        self._set(group, key, left)

    def _set(self, group: StepGroup, key: Hashable, ways: List[StepWay]) -> None:
        """Have a group go on in some ways; items that none of them holds are forgotten."""
        group.ways = ways
        held = [oldest for oldest in (way.oldest() for way in ways) if oldest is not None]
        if held:
            self._groups[key] = group
            first = min(held)
            while group.items[0].order < first:
                group.items.popleft()
                self._number -= 1
        else:
            self._number -= len(group.items)
            self._groups.pop(key, None)

    # ---- one item ------------------------------------------------------------------------------------

    def _go_on(self, ways: Sequence[StepWay], item: StreamItem) -> List[StepWay]:
        """Return how ways go on with an item, the preferred first."""
        found: List[StepWay] = []
        seen: Dict[Hashable, int] = {}
        for way in ways:
            takers, passing = self._takers(way, item)
            for at in takers:
                if self._takes(way, at, item, found, seen):
                    return found
            if way.step == SCANNING:
                found.append(way)
            elif not takers and passing:
                further = StepWay(way.step, way.count, passing, way.marks, way.taken, way.start, way.whole)
                if self._add(further, found, seen) and self.plan.is_sure(passing):
                    return found
        return found

    def _takers(self, way: StepWay, item: StreamItem) -> Tuple[List[int], Tuple[int, ...]]:
        """Return the steps that take an item, and those that may take a later one if none does."""
        steps = self.plan.steps
        choices = self.plan.choices(way.step, way.count).steps if way.left is None else way.left
        open_ones = [at for at in choices if not (steps[at].until and ends(steps[at].until, way.marks, item))]
        takers = [at for at in open_ones if passes(steps[at].tests, way.marks, item)]
        return takers, tuple([at for at in open_ones if steps[at].later])

    def _takes(
        self, way: StepWay, at: int, item: StreamItem, found: List[StepWay], seen: Dict[Hashable, int]
    ) -> bool:
        """Add the way in which a step takes an item; tell whether no way that is less preferred matters then."""
        plan = self.plan
        count = plan.counted(at, way.count + 1 if way.step == at else 1)
        taken = _Taken(item, at, way.taken)
        start = item.order if way.taken is None else way.start
        choices, whole, left = plan.choices(at, count)
        if choices:  # where all pass items over, they are left as after one that is passed over
            marks = plan.marked(way.marks, at, item)
            added = self._add(StepWay(at, count, left, marks, taken, start, way.whole), found, seen)
            if added and not whole and plan.is_sure(choices):
                return True
        if whole:
            found.append(self._scanning((*way.whole, _Whole(taken, start))))
        return whole

    def _add(self, way: StepWay, found: List[StepWay], seen: Dict[Hashable, int]) -> bool:
        """Add a way, unless one that is preferred turns out a match whenever it does; tell if either is there."""
        key = way.key(self.plan.meaning(way.step, way.count))
        if seen.get(key, -1) >= way.count:
            return True
        if len(found) >= MOST_WAYS:
            self._crowded()
            return False
        seen[key] = way.count
        found.append(way)
        return True

    @staticmethod
    def _decided(ways: Sequence[StepWay]) -> Tuple[_Whole, ...]:
        """Take the matches of the preferred way from all ways, and return these: a match ends what is less preferred.

        So each way begins with the matches of those before it.
        """
        found = ways[0].whole
        if found:
            for way in ways:
                way.whole = way.whole[len(found) :]
        return found

    # ---- what is given on ----------------------------------------------------------------------------

    def _output(self, whole: _Whole, deciding: StreamItem) -> Optional[StreamOutput]:
        """Return what is given on for a match; None where a measure has no result."""
        pairs = _in_order(whole.taken)
        items = [item for item, _ in pairs]
        start = min(item.start for item in items)
        end = max(deciding.end, *(item.end for item in items))
        named = tuple(items[-MOST_NAMED:]) if self.tracked else (items[-1],)
        found, error = measured(lambda: self._results(pairs))
        return None if found is None else StreamOutput(named, start, end, found, error)

    def _results(self, pairs: _Pairs) -> Optional[Values]:
        """Return the results of the measures of a match; None where one has none."""
        found = []
        for measure, scope in zip(self.make(), self.scopes):
            members = deque([item for item, step in pairs if scope is None or step == scope])
            for item in members:
                measure.add(item)
            result = measure.result(members, len(members)) if members or measure.of_none else None
            if result is None:
                return None
            found.append(result)
        return tuple(found)

    # ---- what lasts ----------------------------------------------------------------------------------

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`: the items of each group, and its ways by their orders."""
        groups = [
            (list(group.items), tuple([_numbers(way) for way in group.ways]))
            for group in self._groups.values()
        ]
        return (self.late, self._order, groups)

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`: where items are missing, those that are left are taken again."""
        self.late, self._order, groups = kept
        self._groups, self._number = OrderedDict(), 0
        for items, ways in groups:
            if items:
                self._restore_group(items, ways)

    def _restore_group(self, items: List[StreamItem], ways: Sequence[Tuple[object, ...]]) -> None:
        known = {item.order: item for item in items}
        group = StepGroup([])
        for item in items:
            item.file()
            group.items.append(item)
        self._number += len(items)
        try:
            found = [self._way_of(way, known) for way in ways]
        except KeyError:
            found = [self._scanning()]
            for item in items:
                found = self._go_on(found, item)
                self._decided(found)
        self._set(group, items[0].key, found)

    def _way_of(self, numbers: Tuple[Any, ...], known: Dict[int, StreamItem]) -> StepWay:
        """Return a way of which `_numbers` has told."""
        step, count, left, marks, pairs, whole = numbers
        found = tuple([None if order is None else known[order] for order in marks])
        wholes = tuple([_Whole(_taken_of(one, known), one[0][0]) for one in whole])
        if not pairs:
            return StepWay(step, count, left, found, None, 0, wholes)
        return StepWay(step, count, left, found, _taken_of(pairs, known), pairs[0][0], wholes)


def _taken_of(pairs: Sequence[Tuple[int, int]], known: Dict[int, StreamItem]) -> _Taken:
    """Return the items of a match by their orders."""
    found: Optional[_Taken] = None
    for order, step in pairs:
        found = _Taken(known[order], step, found)
    assert found is not None  # a match has an item at least
    return found


def _in_order(taken: Optional[_Taken]) -> _Pairs:
    """Return the items of a match, the oldest first."""
    found = []
    while taken is not None:
        found.append((taken.item, taken.step))
        taken = taken.before
    return tuple(reversed(found))


def _numbers(way: StepWay) -> Tuple[Any, ...]:
    """Return what a way knows, with the orders of items in their place."""
    marks = tuple([None if one is None else one.order for one in way.marks])
    whole = tuple([_orders(_in_order(one.taken)) for one in way.whole])
    return (way.step, way.count, way.left, marks, _orders(_in_order(way.taken)), whole)


def _orders(pairs: _Pairs) -> Tuple[Tuple[int, int], ...]:
    return tuple([(item.order, step) for item, step in pairs])
