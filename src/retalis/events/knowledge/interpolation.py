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
from .memory import WIDE_STEP_FACTOR, Memory, MemoryInstance, Warn
from .memory_registry import MemoryInstances

MAX_GAP_FLAG = "max_gap"
"""Name of the flag."""

MAX_NOTED_GAPS = 64
"""Maximum number of wide gaps that are noted; the oldest are forgotten."""

MIN_OTHER_STEPS = 5
"""Minimum number of other steps in a memory for one step to be called unusual."""

UNLIMITED_GAP = 1 << 100
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
        self.most = UNLIMITED_GAP
        """Largest distance of two instants that is allowed, in ns."""
        self.noted: Dict[Tuple[int, int], Tuple[MemoryInstance, ...]] = {}

    def limit(self, seconds: float) -> None:
        """Set the largest distance in seconds; -1 or 0 for any distance."""
        self.most = min(UNLIMITED_GAP, from_seconds(min(seconds, 1e18))) if seconds > 0 else UNLIMITED_GAP

    def clear(self) -> None:
        """Remove all noted gaps."""
        self.noted.clear()

    def watch(self, instance: MemoryInstance) -> None:
        """Note the wide gaps of a memory from now on."""

        def note(start: int, end: int) -> None:
            noted = self.noted
            # Removing and inserting the entry again moves it to the end: the dictionary is in order of last use.
            before = noted.pop((start, end), ())
            noted[start, end] = before if instance in before else (*before, instance)
            if len(noted) > MAX_NOTED_GAPS:
                del noted[next(iter(noted))]

        instance.memory.on_wide = note

    def weight(self, start: int, end: int, instant: int) -> Optional[Number]:
        """Return the weight of the first of two instants at a third one; None if they are too far apart."""
        apart = end - start
        # The instants may be given in either order.
        if apart > self.most or -apart > self.most:
            return None
        if self.noted and (start, end) in self.noted:
            self._interpolated(int(start), int(end))
        return (end - instant) / apart if apart else 1

    def define(self, logic: PrologSystem, memories: MemoryInstances) -> None:
        """Define the predicates."""

        def interpolate(first: Term, second: Term, time: Term) -> Any:
            return self.weight(instant_of(first), instant_of(second), instant_of(time))

        def gap(name: Term, time: Term) -> Optional[float]:
            instance, instant = memories.find(name), instant_of(time)
            if instance is None:
                return None
            before, after = instance.memory.at_or_before(instant), instance.memory.at_or_after(instant)
            return None if before is None or after is None else (int(after[2]) - int(before[2])) / SECOND

        logic.define_function("datime_interpolate", 4, interpolate).system = True
        logic.define_function("memory_gap", 3, gap)

    def _interpolated(self, start: int, end: int) -> None:
        for instance in self.noted.pop((start, end)):
            usual = usual_step(instance.memory, end - start)
            if usual is not None and end - start >= WIDE_STEP_FACTOR * usual:
                name = self._show(instance.id)
                self._warn(
                    f"memory {name}: a value is interpolated over a gap of {(end - start) / SECOND:.3g} s; its "
                    f"records are usually {usual / SECOND:.3g} s apart; where that should fail, set {MAX_GAP_FLAG}",
                    ("gap", name),
                    once=True,
                )


def usual_step(memory: Memory, gap: int) -> Optional[float]:
    """Return the mean step of a memory without a gap, in ns; None if there are too few steps.

    Records with the same end count as one, because several publishers may have sent them.
    """
    ends = memory.ends
    step_count = sum(1 for before, after in zip(ends, ends[1:]) if after > before) - 1
    return (ends[-1] - ends[0] - gap) / step_count if step_count >= MIN_OTHER_STEPS else None


_FUSED_GOALS = (
    functor("prev", 5),
    functor("next_inf", 5),
    functor("datime_interpolate", 4),
    functor("interpolate_quaternion", 6),
)

RecordLayout = Tuple[Functor, int, int]
"""Layout of a record pattern: its functor, and the positions of position and rotation among its variables."""

IDENTITY_POSE: Pose = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)


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
        look = logic.database.predicate(_FUSED_GOALS[0])
        if look.functional is not None:
            look.functional = look.functional._replace(joins=self.joins)

    def product(self, links: Term, time: Term) -> Optional[Term]:
        """Return the product of poses and memory ids; None if a memory has no pose.

        Raises:
            PrologError: an instantiation, type or domain error for other arguments.
        """
        instant = int(instant_of(time))
        items = list_items(links)
        if items is None:
            raise instantiation_error() if deref(links).__class__ is Var else type_error("list", links)
        value: Optional[Pose] = None
        # The product is from left to right, as in a chain of frames: each pose is relative to the frame before it.
        for link in items:
            link_pose = self._pose(link if link.__class__ is Atom else deref(link), instant)
            if link_pose is None:
                return None
            value = link_pose if value is None else compose(value, link_pose)
        return shown_pose(value or IDENTITY_POSE)

    def _pose(self, link: Term, instant: int) -> Optional[Pose]:
        if link is NIL or (link.__class__ is tuple and link[0] is CONS):
            return pose(link)
        if link.__class__ is Var:
            raise instantiation_error()
        instance = self._memories.find(link)
        records = None if instance is None else instance.memory.around(instant)
        if records is None:
            return None
        (before, _, start), (after, _, end) = records
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
        if tuple(goal[0] for goal in goals) != _FUSED_GOALS:
            return None
        (
            (_, name, first, *before_args),
            (_, other_name, second, *after_args),
            (_, *weighed),
            (_, v1, q1, v2, q2, listed, result),
        ) = goals
        fraction = deref(weighed[-1])
        # The goals must be connected exactly as in the documented sequence; any other use of a variable needs the
        # plain goals.
        if list_items(listed) != [fraction] or deref(name) is not deref(other_name):
            return None
        same = [
            (weighed[0], before_args[0]),
            (weighed[1], after_args[0]),
            (weighed[2], before_args[2]),
            (weighed[2], after_args[2]),
        ]
        if any(deref(left) is not deref(right) for left, right in same):
            return None
        form, second_form = _layout(first, v1, q1, counts), _layout(second, v2, q2, counts)
        between = [deref(term) for term in (before_args[0], after_args[0], fraction, v1, q1, v2, q2)]
        # Each intermediate variable occurs twice: where it is computed and where it is used. A third use would see
        # it unbound.
        if form is None or form != second_form or any(counts.get(var) != 2 for var in between):
            return None
        if len(set(between)) < len(between) or any(
            counts.get(deref(term)) != 1 for term in (before_args[1], after_args[1])
        ):
            return None
        return JoinedGoals(len(_FUSED_GOALS), self._between(*form), (name, weighed[2]), result)

    def _between(self, key: Functor, position: int, rotation: int) -> Callable[[Term, Term], Optional[Term]]:
        """Return the function that computes the pose between two records of a layout."""
        find, weigh = self._memories.find, self._gaps.weight

        def pose_between(name: Term, time: Term) -> Optional[Term]:
            instance = find(name)
            if instance is None:
                return None
            instant = instant_of(time)
            records = instance.memory.around(instant)
            if records is None:
                return None
            (before, start, _), (after, end, _) = records
            first_record: Any = deref(before)
            second_record: Any = deref(after)
            if not (
                first_record.__class__ is second_record.__class__ is tuple
                and first_record[0] is second_record[0] is key
            ):
                return None
            weight = weigh(start, end, instant)
            if weight is None:
                return None
            first, second = (
                pose_of(first_record[position], first_record[rotation]),
                pose_of(second_record[position], second_record[rotation]),
            )
            return shown_pose(interpolate(first, second, weight))

        return pose_between


def _layout(
    record: Term, position: Term, rotation: Term, counts: Mapping[Any, int]
) -> Optional[RecordLayout]:
    """Return the layout of a record pattern; None if other arguments must unify, too."""
    term: Any = deref(record)
    if term.__class__ is not tuple:
        return None
    items = [deref(item) for item in term]
    wanted = deref(position), deref(rotation)
    if any(item not in wanted and counts.get(item) != 1 for item in items[1:]):
        return None
    if any(items.count(item) != 1 for item in wanted):
        return None
    return term[0], items.index(wanted[0]), items.index(wanted[1])


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
