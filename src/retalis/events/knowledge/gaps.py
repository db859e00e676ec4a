"""Gaps in memories: how far apart records are, and interpolating over that."""

from typing import Any, Callable, Dict, Optional, Tuple

from ...prolog.arithmetic import Number
from ...prolog.builtins import instant_of
from ...prolog.logic import Logic
from ...prolog.terms import SECOND, Term, from_seconds
from .memories import Memories
from .memory import WIDE, Memory
from .recorder import Instance
from .recording import Warn

LIMIT = "max_gap"
"""The flag."""

NOTED = 64
"""Wide gaps that were looked up and that nobody has interpolated over; the oldest are forgotten."""

FEWEST = 5
"""Other steps that a memory needs to have for one to be unusual."""

ANY = 1 << 100
"""Further apart than all instants."""


class Gaps:
    """Decides whether a program may interpolate between two instants, and warns where that is doubtful.

    Look-ups note gaps that may be too wide; only where ``datime_interpolate/4`` then takes both instants of such a
    gap is it looked at closely.

    Args:
        show: gives an id as text.
        warn: takes a warning.
    """

    def __init__(self, show: Callable[[Term], str], warn: Warn):
        self._show = show
        self._warn = warn
        self.most = ANY
        """How far apart two instants may be, in nanoseconds."""
        self.noted: Dict[Tuple[int, int], Tuple[Instance, ...]] = {}

    def limit(self, seconds: float) -> None:
        """Set how far apart two instants may be; -1 or 0 for any distance."""
        self.most = min(ANY, from_seconds(min(seconds, 1e18))) if seconds > 0 else ANY

    def clear(self) -> None:
        """Forget what was looked up."""
        self.noted.clear()

    def watch(self, instance: Instance) -> None:
        """Have the wide gaps of a memory noted."""

        def note(start: int, end: int) -> None:
            noted = self.noted
            before = noted.pop((start, end), ())
            noted[start, end] = before if instance in before else (*before, instance)
            if len(noted) > NOTED:
                del noted[next(iter(noted))]

        instance.memory.on_wide = note

    def weight(self, start: int, end: int, at: int) -> Optional[Number]:
        """Return the weight of the first of two instants at a third one; None where they are too far apart."""
        apart = end - start
        if apart > self.most or -apart > self.most:
            return None
        if self.noted and (start, end) in self.noted:
            self._interpolated(int(start), int(end))
        return (end - at) / apart if apart else 1

    def define(self, logic: Logic, memories: Memories) -> None:
        """Define the predicates."""

        def interpolate(first: Term, second: Term, at: Term) -> Any:
            return self.weight(instant_of(first), instant_of(second), instant_of(at))

        def gap(name: Term, at: Term) -> Optional[float]:
            instance, instant = memories.find(name), instant_of(at)
            if instance is None:
                return None
            before, after = instance.memory.at_or_before(instant), instance.memory.at_or_after(instant)
            return None if before is None or after is None else (int(after[2]) - int(before[2])) / SECOND

        logic.define_function("datime_interpolate", 4, interpolate).system = True
        logic.define_function("memory_gap", 3, gap)

    def _interpolated(self, start: int, end: int) -> None:
        for instance in self.noted.pop((start, end)):
            usual = usual_step(instance.memory, end - start)
            if usual is not None and end - start >= WIDE * usual:
                name = self._show(instance.id)
                self._warn(
                    f"memory {name}: a value is interpolated over a gap of {(end - start) / SECOND:.3g} s; its "
                    f"records are usually {usual / SECOND:.3g} s apart; where that should fail, set {LIMIT}",
                    ("gap", name),
                    once=True,
                )


def usual_step(memory: Memory, gap: int) -> Optional[float]:
    """Return the mean of a memory's steps besides a gap, or None where there are too few.

    Records of one instant are one, as those of several publishers may be.
    """
    ends = memory.ends
    others = sum(1 for before, after in zip(ends, ends[1:]) if after > before) - 1
    return (ends[-1] - ends[0] - gap) / others if others >= FEWEST else None
