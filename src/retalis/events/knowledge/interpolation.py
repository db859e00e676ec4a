"""Interpolation between records of memories: limits for gaps, and chains of transforms.

A program reads the records before and after an instant and interpolates between them. This is wrong if the records
are too far apart, for example because a sensor was silent. `MemoryGaps` enforces the flag ``max_gap``, and warns
once for each memory if a value is interpolated over a gap that is much wider than the usual step of its records. The
check costs little: a look-up only notes a wide gap, and the mean step is computed only if the program then
interpolates over that gap.

`TransformChains` defines ``pose_chain/3``, the product of poses and of the interpolated transforms of several
memories at one instant, as tf2 does for a chain of frames. It also supplies the Prolog compiler with one function
for the goal sequence ``prev, next_inf, datime_interpolate, interpolate_quaternion`` (goal fusion).
"""

from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

from ...prolog.builtins.pose_predicates import Pose, compose, interpolate, pose, pose_of, shown_pose
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.compiler.clause_nodes import JoinedGoals
from ...prolog.machine.arithmetic import Number
from ...prolog.machine.errors import instantiation_error, type_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.timestamps import SECOND, from_seconds
from ...prolog.terms.types import CONS, NIL, Atom, CompoundTerm, Functor, Term, Var, deref, functor
from .memory import WIDE, Memory, MemoryInstance, Warn
from .memory_instances import MemoryInstances

LIMIT = "max_gap"
"""Name of the flag."""

NOTED = 64
"""Maximum number of wide gaps that are noted; the oldest are forgotten."""

FEWEST = 5
"""Minimum number of other steps in a memory for one step to be called unusual."""

ANY = 1 << 100
"""Larger than the distance of any two instants, in ns."""


class MemoryGaps:
    """Decides whether a program may interpolate between two instants, and warns about unusually wide gaps.

    Look-ups note gaps that may be too wide. A noted gap is examined when ``datime_interpolate/4`` receives its two
    ends.

    Args:
        show: returns an id as text.
        warn: receives warnings.
    """

    def __init__(self, show: Callable[[Term], str], warn: Warn):
        self._show = show
        self._warn = warn
        self.most = ANY
        """Largest distance of two instants that is allowed, in ns."""
        self.noted: Dict[Tuple[int, int], Tuple[MemoryInstance, ...]] = {}

    def limit(self, seconds: float) -> None:
        """Set the largest distance in seconds; -1 or 0 for any distance."""
        self.most = min(ANY, from_seconds(min(seconds, 1e18))) if seconds > 0 else ANY

    def clear(self) -> None:
        """Remove all noted gaps."""
        self.noted.clear()

    def watch(self, instance: MemoryInstance) -> None:
        """Note the wide gaps of a memory from now on."""

        def note(start: int, end: int) -> None:
            noted = self.noted
            before = noted.pop((start, end), ())
            noted[start, end] = before if instance in before else (*before, instance)
            if len(noted) > NOTED:
                del noted[next(iter(noted))]

        instance.memory.on_wide = note

    def weight(self, start: int, end: int, at: int) -> Optional[Number]:
        """Return the weight of the first of two instants at a third one; None if they are too far apart."""
        apart = end - start
        if apart > self.most or -apart > self.most:
            return None
        if self.noted and (start, end) in self.noted:
            self._interpolated(int(start), int(end))
        return (end - at) / apart if apart else 1

    def define(self, logic: PrologSystem, memories: MemoryInstances) -> None:
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
    """Return the mean step of a memory without a gap, in ns; None if there are too few steps.

    Records with the same end count as one, because several publishers may have sent them.
    """
    ends = memory.ends
    others = sum(1 for before, after in zip(ends, ends[1:]) if after > before) - 1
    return (ends[-1] - ends[0] - gap) / others if others >= FEWEST else None


_STEPS = (
    functor("prev", 5),
    functor("next_inf", 5),
    functor("datime_interpolate", 4),
    functor("interpolate_quaternion", 6),
)

Form = Tuple[Functor, int, int]
"""Layout of a record pattern: its functor, and the positions of position and rotation among its variables."""

NOWHERE: Pose = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)


class TransformChains:
    """Products of poses and of the poses that memories have at an instant.

    Args:
        memories: the memories.
        gaps: decides over which gaps there is no pose.
    """

    def __init__(self, memories: MemoryInstances, gaps: MemoryGaps):
        self._memories = memories
        self._gaps = gaps

    def define(self, logic: PrologSystem) -> None:
        """Define ``pose_chain(Links, T, Pose)``, and register the fusion of look-ups with interpolation."""
        logic.define_function("pose_chain", 3, self.product)
        look = logic.database.predicate(_STEPS[0])
        if look.functional is not None:
            look.functional = look.functional._replace(joins=self.joins)

    def product(self, links: Term, at: Term) -> Optional[Term]:
        """Return the product of poses and memory ids; None if a memory has no pose.

        Raises:
            PrologError: an instantiation, type or domain error for other arguments.
        """
        instant = int(instant_of(at))
        items = list_items(links)
        if items is None:
            raise instantiation_error() if deref(links).__class__ is Var else type_error("list", links)
        value: Optional[Pose] = None
        for link in items:
            here = self._pose(link if link.__class__ is Atom else deref(link), instant)
            if here is None:
                return None
            value = here if value is None else compose(value, here)
        return shown_pose(value or NOWHERE)

    def _pose(self, link: Term, instant: int) -> Optional[Pose]:
        if link is NIL or (link.__class__ is tuple and link[0] is CONS):
            return pose(link)
        if link.__class__ is Var:
            raise instantiation_error()
        instance = self._memories.find(link)
        found = None if instance is None else instance.memory.around(instant)
        if found is None:
            return None
        (before, _, start), (after, _, end) = found
        apart = end - start
        if not apart:
            return pose_of_record(before)
        # The condition is rarely true; calling `weight` each time would take 7 % of the time.
        doubtful = self._gaps.noted or apart > self._gaps.most
        if doubtful and self._gaps.weight(start, end, instant) is None:
            return None
        return interpolate(pose_of_record(before), pose_of_record(after), (end - instant) / apart)

    def joins(self, goals: Sequence[CompoundTerm], counts: Mapping[Any, int]) -> Optional[JoinedGoals]:
        """Return the fused form of the goals that look up two records and interpolate; None if they cannot be fused.

        They are fused only if no other goal of the clause uses the records and their time stamps, and both records
        are looked up in one memory with the same pattern.
        """
        if tuple(goal[0] for goal in goals) != _STEPS:
            return None
        (
            (_, name, first, *one),
            (_, other, second, *two),
            (_, *weighed),
            (_, v1, q1, v2, q2, listed, found),
        ) = goals
        fraction = deref(weighed[-1])
        if list_items(listed) != [fraction] or deref(name) is not deref(other):
            return None
        same = [(weighed[0], one[0]), (weighed[1], two[0]), (weighed[2], one[2]), (weighed[2], two[2])]
        if any(deref(left) is not deref(right) for left, right in same):
            return None
        form, again = _form(first, v1, q1, counts), _form(second, v2, q2, counts)
        between = [deref(term) for term in (one[0], two[0], fraction, v1, q1, v2, q2)]
        if form is None or form != again or any(counts.get(var) != 2 for var in between):
            return None
        if len(set(between)) < len(between) or any(counts.get(deref(term)) != 1 for term in (one[1], two[1])):
            return None
        return JoinedGoals(len(_STEPS), self._between(*form), (name, weighed[2]), found)

    def _between(self, key: Functor, position: int, rotation: int) -> Callable[[Term, Term], Optional[Term]]:
        """Return the function that computes the pose between two records of a layout."""
        find, weigh = self._memories.find, self._gaps.weight

        def pose_between(name: Term, at: Term) -> Optional[Term]:
            instance = find(name)
            if instance is None:
                return None
            instant = instant_of(at)
            found = instance.memory.around(instant)
            if found is None:
                return None
            (before, start, _), (after, end, _) = found
            one: Any = deref(before)
            two: Any = deref(after)
            if not (one.__class__ is two.__class__ is tuple and one[0] is two[0] is key):
                return None
            weight = weigh(start, end, instant)
            if weight is None:
                return None
            first, second = pose_of(one[position], one[rotation]), pose_of(two[position], two[rotation])
            return shown_pose(interpolate(first, second, weight))

        return pose_between


def _form(record: Term, position: Term, rotation: Term, counts: Mapping[Any, int]) -> Optional[Form]:
    """Return the layout of a record pattern; None if other arguments must unify, too."""
    found: Any = deref(record)
    if found.__class__ is not tuple:
        return None
    items = [deref(item) for item in found]
    wanted = deref(position), deref(rotation)
    if any(item not in wanted and counts.get(item) != 1 for item in items[1:]):
        return None
    if any(items.count(item) != 1 for item in wanted):
        return None
    return found[0], items.index(wanted[0]), items.index(wanted[1])


def pose_of_record(record: Term) -> Pose:
    """Return the pose of a record ``Name(Position, Rotation)`` or ``[Position, Rotation]``.

    Raises:
        PrologError: a type error for other records.
    """
    try:
        name, position, rotation = record  # type: ignore[misc]
    except (TypeError, ValueError):
        return pose(record)
    return pose(record) if name is CONS else pose_of(position, rotation)
