"""Steps that the items of a group may take: so many that pass the same tests, then so many that pass others."""

from typing import Callable, NamedTuple, Optional, Sequence, Tuple, Union

from .items import StreamItem

LookedBack = Sequence[StreamItem]
"""The items that a condition looks back at."""
Marks = Tuple[Optional[StreamItem], ...]
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
    holds: Callable[[StreamItem, LookedBack], bool]


class WindowStep(NamedTuple):
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


class Choices(NamedTuple):
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


class StepMark(NamedTuple):
    """An item of a match that conditions look back at: its last one, or the first or last of a step."""

    kind: str
    step: int


_NOTHING = Choices((), False, (), ())


class StepPlan:
    """What is the same for all matches of some steps.

    Args:
        steps: the steps, of which one at least has to take an item.
        marks: what conditions look back at.
    """

    def __init__(self, steps: Sequence[WindowStep], marks: Sequence[StepMark]):
        self.steps = tuple(steps)
        self.marks = tuple(marks)
        self._table = [
            [[self._listed(at, enough, more) for more in (False, True)] for enough in (False, True)]
            for at in range(len(steps))
        ]
        self._begin = self._from(0)
        self._last = [self._from(at + 1).ends for at in range(len(steps))]
        self._sure = [all(one.later and not one.until for one in self.steps[at:]) for at in range(len(steps))]

    def choices(self, at: int, count: int) -> Choices:
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

    def meaning(self, at: int, count: int) -> Union[int, Choices]:
        """Return what a count means for what comes.

        Of two ways in a step that turns out a match when it has taken enough, and that have the same choices, the one
        that has taken more turns it out first: for these it is the choices.
        """
        return self.choices(at, count) if self._last[at] else count

    def marked(self, marks: Marks, at: int, item: StreamItem) -> Marks:
        """Return the marks of a match of which a step takes an item."""
        found = []
        for mark, before in zip(self.marks, marks):
            here = mark.kind == "prev" or (mark.step == at and (mark.kind == "last" or before is None))
            found.append(item if here else before)
        return tuple(found)

    def _listed(self, at: int, enough: bool, more: bool) -> Choices:
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

    def _from(self, at: int) -> Choices:
        """Return as `choices`, before a step has taken anything."""
        if at == len(self.steps):
            return self._choices((), True, ())
        return self._listed(at, self.steps[at].least == 0, True)

    def _choices(self, steps: Tuple[int, ...], ends: bool, blocking: Tuple[int, ...]) -> Choices:
        # Passing over an item removes the steps that are not `later`; without any, nothing changes.
        same = all(self.steps[at].later for at in (*steps, *blocking))
        return Choices(steps, ends, steps if same else None, blocking)


def passes(tests: Sequence[StepTest], marks: Marks, item: StreamItem) -> bool:
    """Tell whether an item passes all tests that are asked."""
    for back, holds in tests:
        looked_at = [one for one in (marks[at] for at in back) if one is not None]
        if len(looked_at) == len(back) and not holds(item, looked_at):
            return False
    return True


def ends(tests: Sequence[StepTest], marks: Marks, item: StreamItem) -> bool:
    """Tell whether an item is one at which a step is over: some test is asked, and all that are hold."""
    asked = [one for one in tests if all(marks[at] is not None for at in one.back)]
    return bool(asked) and passes(asked, marks, item)
