"""Steps that the items of a group may take: so many that pass the same tests, then so many that pass others.

A window of steps: matches in which the items of a group take one step after the other.

All ways that a match may go on are followed at once, the preferred ones first. Ways that no further item can tell
apart are one, so that nothing is tried again. The time for an item grows with the number of ways. Two limits bound
it: one start has at most `MAX_WAYS_PER_START` ways, and the length of a window, which its rule limits, counts ways.

If the interval of a match is bounded, ways that began too long ago are dropped at the next item of their group, and
the whole group when it has been idle for that time: then all of its ways began before that.
"""

from collections import OrderedDict, deque
from typing import Any, Callable, Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple, Union

from ...prolog.terms.types import Values
from .accumulators import Accumulator
from .stream_elements import NEVER, KeyedOperator, KnownState, StreamElement, StreamOutput
from .windows import MAX_TRACKED_ITEMS, measured

LookedBack = Sequence[StreamElement]
"""The items that a condition looks back at."""
Marks = Tuple[Optional[StreamElement], ...]
"""The item at each mark of a match, or None where there is none yet."""
SCANNING = -1
"""The step of a way in which no match has begun."""


class StepTest(NamedTuple):
    """A part of a condition on an item.

    Attributes:
        back: at which of the marks of a match it looks; it is not asked where one of these is not there yet.
        holds: tells whether it holds for an item and those.
    """

    back: Tuple[int, ...]
    holds: Callable[[StreamElement, LookedBack], bool]


class RowPatternVariable(NamedTuple):
    """So many items that pass the same tests.

    Attributes:
        least: how many, at least.
        most: how many, at most; None for any number.
        reluctant: whether as few as possible are taken, not as many.
        later: whether items that fit nowhere are passed over before each of its own.
        tests: what its items have to pass.
        until: its end: it takes no item that passes these, and none after such a one.
    """

    least: int
    most: Optional[int]
    reluctant: bool
    later: bool
    tests: Tuple[StepTest, ...]
    until: Tuple[StepTest, ...]


class StepTransitions(NamedTuple):
    """What may come next in a match.

    Attributes:
        steps: the steps that may take the next item, the preferred first.
        ends: whether the match may end instead.
        left: the steps again, where each of them and of ``blocking`` passes over what fits nowhere; else None.
        blocking: the steps that could take the next item but are less preferred than the end. They never take one,
            because the match ends first; an item that one of them would take is not passed over.
    """

    steps: Tuple[int, ...]
    ends: bool
    left: Optional[Tuple[int, ...]]
    blocking: Tuple[int, ...]


class StepNavigation(NamedTuple):
    """An item of a match that conditions look back at: its last one, or the first or last of a step."""

    kind: str
    step: int


_NOTHING = StepTransitions((), False, (), ())


class RowPatternNFA:
    """What is the same for all matches of some steps.

    Args:
        steps: the steps, of which one at least has to take an item.
        marks: what conditions look back at.
    """

    def __init__(self, steps: Sequence[RowPatternVariable], marks: Sequence[StepNavigation]):
        self.steps = tuple(steps)
        self.marks = tuple(marks)
        self._table = [
            [[self._listed(at, enough, more) for more in (False, True)] for enough in (False, True)]
            for at in range(len(steps))
        ]
        self._begin = self._from(0)
        self._last = [self._from(at + 1).ends for at in range(len(steps))]
        self._sure = [all(one.later and not one.until for one in self.steps[at:]) for at in range(len(steps))]

    def choices(self, at: int, count: int) -> StepTransitions:
        """Return what may come after a step has taken so many."""
        if at == SCANNING:
            return self._begin
        step = self.steps[at]
        more = step.most is None or count < step.most
        return self._table[at][count >= step.least][more]

    def counted(self, at: int, count: int) -> int:
        """Return how many a step has taken, as far as that makes a difference."""
        step = self.steps[at]
        return min(count, step.least) if step.most is None else count

    def is_sure(self, choices: Tuple[int, ...]) -> bool:
        """Tell whether a match that has these choices cannot fail any more, however long it takes."""
        return self._sure[min(choices)]

    def meaning(self, at: int, count: int) -> Union[int, StepTransitions]:
        """Return what a count means for what comes.

        Of two ways in a step that turns out a match when it has taken enough, and that have the same choices, the one
        that has taken more turns it out first: for these it is the choices.
        """
        return self.choices(at, count) if self._last[at] else count

    def marked(self, marks: Marks, at: int, item: StreamElement) -> Marks:
        """Return the marks of a match of which a step takes an item."""
        found = []
        for mark, before in zip(self.marks, marks):
            here = mark.kind == "prev" or (mark.step == at and (mark.kind == "last" or before is None))
            found.append(item if here else before)
        return tuple(found)

    def _listed(self, at: int, enough: bool, more: bool) -> StepTransitions:
        """Return as `choices`, for a step that has taken enough and may take more."""
        further = self._from(at + 1) if enough else _NOTHING
        steps, blocking = further.steps, further.blocking
        if more and not self.steps[at].reluctant:
            steps = (at, *steps)
        elif more and further.ends:
            blocking = (*blocking, at)
        elif more:
            steps = (*steps, at)
        return self._choices(steps, further.ends, blocking)

    def _from(self, at: int) -> StepTransitions:
        """Return as `choices`, before a step has taken anything."""
        if at == len(self.steps):
            return self._choices((), True, ())
        return self._listed(at, self.steps[at].least == 0, True)

    def _choices(self, steps: Tuple[int, ...], ends: bool, blocking: Tuple[int, ...]) -> StepTransitions:
        # Passing over an item removes the steps that are not `later`; without any, nothing changes.
        same = all(self.steps[at].later for at in (*steps, *blocking))
        return StepTransitions(steps, ends, steps if same else None, blocking)


def passes(tests: Sequence[StepTest], marks: Marks, item: StreamElement) -> bool:
    """Tell whether an item passes all tests that are asked."""
    for back, holds in tests:
        looked_at = [one for one in (marks[at] for at in back) if one is not None]
        if len(looked_at) == len(back) and not holds(item, looked_at):
            return False
    return True


def ends(tests: Sequence[StepTest], marks: Marks, item: StreamElement) -> bool:
    """Tell whether an item is one at which a step is over: some test is asked, and all that are hold."""
    asked = [one for one in tests if all(marks[at] is not None for at in one.back)]
    return bool(asked) and passes(asked, marks, item)


MAX_WAYS_PER_START = 100
"""Largest number of ways that are followed from one start; the preferred ones stay."""

_Refusing = Callable[[StreamElement], None]
"""Refuses an item whose value a measure cannot take."""
_Pairs = Tuple[Tuple[StreamElement, int], ...]
"""Items, and the steps that have taken them."""


class _Taken(NamedTuple):
    """The items of a match, the newest first."""

    item: StreamElement
    step: int
    before: "Optional[_Taken]"


class _Whole(NamedTuple):
    """A match that is whole: its items, and the order of the first. It is given on when no preferred way is left."""

    taken: _Taken
    start: int


class ComputationState:
    """A way in which the items so far may be taken.

    Attributes:
        step: the step of its last item.
        count: how many that step has taken, as far as that makes a difference.
        left: after an item was passed over the steps that may still take one; else None.
        marks: the items that conditions look back at.
        taken: the items of the match that has begun.
        start: the order of the first of these.
        begun: the instant at which the first of these starts.
        after: how many matches of its group came before that one, since there was one that waited.
    """

    __slots__ = ("step", "count", "left", "marks", "taken", "start", "begun", "after")

    def __init__(
        self,
        step: int,
        count: int,
        left: Optional[Tuple[int, ...]],
        marks: Marks,
        taken: Optional[_Taken],
        start: int,
        begun: int,
        after: int,
    ):
        self.step = step
        self.count = count
        self.left = left
        self.marks = marks
        self.taken = taken
        self.start = start
        self.begun = begun
        self.after = after

    def key(self, counted: Hashable) -> Hashable:
        """Return what tells it from other ways by what comes; ``counted`` is what its count means for that."""
        return (self.step, counted, self.left, tuple([id(one) for one in self.marks]))


class PartitionState:
    """The items of one group that are held, and how its matches go on.

    A match ends what is less preferred than it. So each way comes after all matches after which those before it come,
    and one queue is enough for the matches that wait.

    Attributes:
        items: those that some way or match holds, and such as others have held since the oldest of them.
        ways: the ways that are followed, the preferred first.
        whole: the matches that wait, the oldest first: those after which the last way comes, but not the first one.
        counted: the number of ways that the window has counted for this group.
        since: the clock at its last item.
    """

    __slots__ = ("items", "ways", "whole", "counted", "since")

    def __init__(self, ways: List[ComputationState]):
        self.items: Deque[StreamElement] = deque()
        self.ways = ways
        self.counted = 0
        self.since = NEVER
        self.whole: Deque[_Whole] = deque()

    def go_on(self, ways: List[ComputationState], whole: Optional[_Whole] = None) -> List[_Whole]:
        """Go on in some ways, and return the matches that are decided; the last way comes after one that is new."""
        known = ways[-1].after - (whole is not None)
        for _ in range(self.ways[-1].after - known):
            self.whole.pop()
        if whole is not None:
            self.whole.append(whole)
        self.ways = ways
        return [self.whole.popleft() for _ in range(len(self.whole) - self.waiting())]

    def waiting(self) -> int:
        """Return how many matches wait for one that is preferred."""
        return self.ways[-1].after - self.ways[0].after

    def oldest(self) -> Optional[int]:
        """Return the order of the oldest item that is held."""
        held = [way.start for way in self.ways if way.taken is not None]
        if self.whole:
            held.append(self.whole[0].start)
        return min(held, default=None)


class _Onward:
    """How a group goes on with an item.

    Attributes:
        ways: its ways, the preferred first.
        seen: the largest counts of these, by their keys.
        whole: the match that the item has made whole; the last way comes after it.
        start: the order of the first item of the newest way.
        alternatives: the number of ways that have that start. An earlier start is preferred, so they are adjacent.
    """

    __slots__ = ("ways", "seen", "whole", "start", "alternatives")

    def __init__(self) -> None:
        self.ways: List[ComputationState] = []
        self.seen: Dict[Hashable, int] = {}
        self.whole: Optional[_Whole] = None
        self.start = 0
        self.alternatives = 0

    def holds(self, item: StreamElement) -> bool:
        """Tell whether the item is held."""
        return self.whole is not None or any(
            way.taken is not None and way.taken.item is item for way in self.ways
        )


class RowPatternWindow(KeyedOperator):
    """Gives on matches of steps, which do not overlap. See `StreamOperator`.

    Args:
        make: makes the measures of a match.
        scopes: for each of them the step that it looks at, or None for all.
        plan: the steps.
    """

    KEY_BYTES, ITEM_BYTES = 1600, 1100

    def __init__(
        self,
        make: Callable[[], Sequence[Accumulator]],
        scopes: Sequence[Optional[int]],
        plan: RowPatternNFA,
    ):
        super().__init__()
        self.make = make
        self.scopes = scopes
        self.plan = plan
        self._checks: List[_Refusing] = []
        self._checks_of: List[List[_Refusing]] = [[] for _ in plan.steps]
        for measure, scope in zip(make(), scopes):
            if measure.picky:
                (self._checks if scope is None else self._checks_of[scope]).append(measure.check)
        self.states: OrderedDict[Hashable, PartitionState] = OrderedDict()
        self._number = 0
        self._ways = 0
        self._order = 0
        self._end = NEVER

    def __len__(self) -> int:
        """Return the number of items, or of ways where that is larger."""
        return max(self._number, self._ways)

    def _scanning(self, after: int = 0) -> ComputationState:
        return ComputationState(SCANNING, 0, None, (None,) * len(self.plan.marks), None, 0, 0, after)

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        for check in self._checks:
            check(item)
        clock, end, span, idle = self.clock, item.end, self._longest, self._idle
        if clock < end and (end <= self.newest_allowed or not self._is_ahead(end)):
            clock = end
        group = self.states.get(item.key)
        if group is None or (idle is not None and group.since < clock - idle):
            group = PartitionState([self._scanning()])
        ways = group.ways if span is None else self._in_time(group, clock - span)
        meter = self.meter
        if meter is not None and meter(len(ways)):
            return []
        item.order = self._order + 1
        onward = self._go_on(ways, item)  # conditions may refuse it: nothing has changed until here
        self._order += 1
        self.clock, self._end = clock, end
        if idle is not None:
            self._forget_idle()
        group.since = clock
        if onward.holds(item):
            self._number += 1
            group.items.append(item)
        found = group.go_on(onward.ways, onward.whole)
        self._set(group, item.key)
        return self._outputs(found)

    def _in_time(self, group: PartitionState, before: int) -> List[ComputationState]:
        """Return the ways of a group without those that began before an instant."""
        if all(way.begun >= before or way.taken is None for way in group.ways):
            return group.ways
        left = [way for way in group.ways if way.begun >= before or way.taken is None]
        return self._with_scanning(left, group)

    def _with_scanning(self, ways: List[ComputationState], group: PartitionState) -> List[ComputationState]:
        """Return ways that are left of a group, with the way in which no match has begun."""
        if not ways or ways[-1].step != SCANNING:
            ways.append(self._scanning(group.ways[-1].after))
        return ways

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: of the least recently used group, ways of its oldest item.

        Matches that have waited for these are given on.
        """
        key, group = next(iter(self.states.items()))
        oldest = group.items[0].order
        left = [way for way in group.ways if way.taken is None or way.start != oldest]
        found = group.go_on(self._with_scanning(left, group))
        self._set(group, key)
        return self._outputs(found)

    def _forget(self, key: Hashable) -> None:
        """Drop a group with its items and ways; matches that wait in it are lost."""
        group = self.states.pop(key)
        self._number -= len(group.items)
        self._ways -= group.counted

    def _set(self, group: PartitionState, key: Hashable) -> None:
        """Note a group that has gone on; items that are held no more are forgotten."""
        first = group.oldest()
        ways = 0 if first is None else len(group.ways) - (group.ways[-1].step == SCANNING)
        self._ways += ways - group.counted
        group.counted = ways
        if first is not None:
            if key in self.states:
                self.states.move_to_end(key)
            else:
                self.states[key] = group
                if len(self.states) > self._most_keys:
                    self._make_room()
            while group.items[0].order < first:
                group.items.popleft()
                self._number -= 1
        else:
            self._number -= len(group.items)
            self.states.pop(key, None)

    # ---- one item ------------------------------------------------------------------------------------

    def _go_on(self, ways: Sequence[ComputationState], item: StreamElement) -> _Onward:
        """Return how ways go on with an item."""
        onward = _Onward()
        for way in ways:
            takers, passing = self._takers(way, item)
            for at in takers:
                if self._takes(way, at, item, onward):
                    return onward
            if way.step == SCANNING:
                onward.ways.append(way)
            elif not takers and passing:
                further = ComputationState(
                    way.step, way.count, passing, way.marks, way.taken, way.start, way.begun, way.after
                )
                if self._add(further, onward) and self.plan.is_sure(passing):
                    return onward
        return onward

    def _takers(self, way: ComputationState, item: StreamElement) -> Tuple[List[int], Tuple[int, ...]]:
        """Return the steps that take an item, and those that may take a later one if none does."""
        steps = self.plan.steps
        choices = self.plan.choices(way.step, way.count)
        asked = choices.steps if way.left is None else way.left
        open_ones = [at for at in asked if not (steps[at].until and ends(steps[at].until, way.marks, item))]
        takers = [at for at in open_ones if passes(steps[at].tests, way.marks, item)]
        passing = tuple([at for at in open_ones if steps[at].later])
        if not takers and passing:
            for at in choices.blocking:
                # A reluctant step has no `until`; after an item was passed over, only `later` steps can come next.
                if (way.left is None or steps[at].later) and passes(steps[at].tests, way.marks, item):
                    return takers, ()
        return takers, passing

    def _takes(self, way: ComputationState, at: int, item: StreamElement, onward: _Onward) -> bool:
        """Add the way in which a step takes an item; tell whether no way that is less preferred matters then."""
        for check in self._checks_of[at]:
            check(item)
        plan = self.plan
        count = plan.counted(at, way.count + 1 if way.step == at else 1)
        taken = _Taken(item, at, way.taken)
        start, begun = (item.order, item.start) if way.taken is None else (way.start, way.begun)
        choices, whole, left, _ = plan.choices(at, count)
        if choices:  # where all pass items over, they are left as after one that is passed over
            marks = plan.marked(way.marks, at, item)
            added = self._add(
                ComputationState(at, count, left, marks, taken, start, begun, way.after), onward
            )
            if added and not whole and plan.is_sure(choices):
                return True
        if whole:
            onward.whole = _Whole(taken, start)
            onward.ways.append(self._scanning(way.after + 1))
        return whole

    def _add(self, way: ComputationState, onward: _Onward) -> bool:
        """Add a way, unless one that is preferred turns out a match whenever it does; tell if either is there."""
        key = way.key(self.plan.meaning(way.step, way.count))
        if onward.seen.get(key, -1) >= way.count:
            return True
        if way.start != onward.start:
            onward.start, onward.alternatives = way.start, 0
        if onward.alternatives >= MAX_WAYS_PER_START:
            self.crowded += 1
            return False
        onward.alternatives += 1
        onward.seen[key] = way.count
        onward.ways.append(way)
        return True

    # ---- what is given on ----------------------------------------------------------------------------

    def _outputs(self, decided: Sequence[_Whole]) -> List[StreamOutput]:
        outputs = [self._output(one) for one in decided]
        return [output for output in outputs if output is not None]

    def _output(self, whole: _Whole) -> Optional[StreamOutput]:
        """Return what is given on for a match; None where a measure has no result."""
        pairs = _in_order(whole.taken)
        meter = self.meter
        if meter is not None and meter(len(pairs)):
            return None
        items = [item for item, _ in pairs]
        start = min(item.start for item in items)
        end = max(self._end, *(item.end for item in items))
        named = tuple(items[-MAX_TRACKED_ITEMS:]) if self.tracked else (items[-1],)
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
        """See `StreamOperator.kept`: the items of each group, and by their orders its ways and matches that wait."""
        groups = [
            (
                group.since,
                list(group.items),
                tuple([_numbers(way) for way in group.ways]),
                tuple([_orders(_in_order(one.taken)) for one in group.whole]),
            )
            for group in self.states.values()
        ]
        return (self.late, self._order, self.clock, groups)

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`: where items are missing, those that are left are taken again."""
        self.late, self._order, self.clock, groups = kept
        self.states.clear()
        self._number = self._ways = 0
        for since, items, ways, whole in groups:
            if items:
                self._restore_group(since, items, ways, whole)

    def _restore_group(
        self,
        since: int,
        items: List[StreamElement],
        ways: Sequence[Tuple[object, ...]],
        whole: Sequence[Sequence[Tuple[int, int]]],
    ) -> None:
        known = {item.order: item for item in items}
        group = PartitionState([self._scanning()])
        group.since = since
        for item in items:
            item.file()
            group.items.append(item)
        self._number += len(items)
        try:
            group.whole.extend(_Whole(_taken_of(one, known), one[0][0]) for one in whole)
            group.ways = [self._way_of(way, known) for way in ways]
            sound = len(group.whole) == group.waiting()
        except KeyError:
            sound = False
        if not sound:  # items are missing, or an interrupt came between one and the other
            group.whole.clear()
            group.ways = [self._scanning()]
            for item in items:
                onward = self._go_on(group.ways, item)
                group.go_on(onward.ways, onward.whole)
        self._set(group, items[0].key)

    def _way_of(self, numbers: Tuple[Any, ...], known: Dict[int, StreamElement]) -> ComputationState:
        """Return a way of which `_numbers` has told."""
        step, count, left, marks, pairs, after = numbers
        found = tuple([None if order is None else known[order] for order in marks])
        if not pairs:
            return ComputationState(step, count, left, found, None, 0, 0, after)
        order = pairs[0][0]
        return ComputationState(
            step, count, left, found, _taken_of(pairs, known), order, known[order].start, after
        )


def _taken_of(pairs: Sequence[Tuple[int, int]], known: Dict[int, StreamElement]) -> _Taken:
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


def _numbers(way: ComputationState) -> Tuple[Any, ...]:
    """Return what a way knows, with the orders of items in their place."""
    marks = tuple([None if one is None else one.order for one in way.marks])
    return (way.step, way.count, way.left, marks, _orders(_in_order(way.taken)), way.after)


def _orders(pairs: _Pairs) -> Tuple[Tuple[int, int], ...]:
    return tuple([(item.order, step) for item, step in pairs])
