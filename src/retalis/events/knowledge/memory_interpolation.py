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

from ...prolog.builtins.pose_predicates import (
    Pose,
    compose,
    interpolate,
    lazy_pose_term,
    parse_pose,
    parse_pose_parts,
)
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
"""Maximum number of wide gaps that are noted; the oldest are dropped."""

MIN_OTHER_STEPS = 5
"""Minimum number of other steps in a memory for one step to be called unusual."""

UNLIMITED_GAP = 1 << 100
"""Larger than the distance of any two instants, in ns."""


class MemoryGaps:
    """Gaps between records of memories: the limit for interpolation, and warnings about unusually wide gaps.

    Look-ups note gaps that may be too wide. A noted gap is examined when ``datime_interpolate/4`` receives its two
    ends.

    Attributes:
        max_distance: largest distance in ns of two instants between which a program may interpolate.
        noted_gaps: by start and end, the memories with a gap there, in the order in which they were noted last.
    """

    def __init__(self, show: Callable[[Term], str], warn: Warn):
        self._show = show
        self._warn = warn
        self.max_distance = UNLIMITED_GAP
        self.noted_gaps: Dict[Tuple[int, int], Tuple[MemoryInstance, ...]] = {}

    def set_limit(self, seconds: float) -> None:
        """Set the largest distance in seconds; -1 or 0 for any distance."""
        self.max_distance = (
            min(UNLIMITED_GAP, from_seconds(min(seconds, 1e18))) if seconds > 0 else UNLIMITED_GAP
        )

    def clear(self) -> None:
        """Remove all noted gaps."""
        self.noted_gaps.clear()

    def note_gap(self, instance: MemoryInstance, start: int, end: int) -> None:
        """Note a wide gap of a memory."""
        gaps = self.noted_gaps
        # The entry is removed and inserted again, so that it moves to the end of the dictionary.
        instances = gaps.pop((start, end), ())
        gaps[start, end] = instances if instance in instances else (*instances, instance)
        if len(gaps) > MAX_NOTED_GAPS:
            del gaps[next(iter(gaps))]

    def interpolation_weight(self, start: int, end: int, instant: int) -> Optional[Number]:
        """Return the weight of a record at ``start`` in the interpolation with one at ``end``.

        It falls from 1 to 0 as ``instant`` moves from ``start`` to ``end``; None if these are too far apart.
        """
        distance = end - start
        # The instants may be given in either order.
        if distance > self.max_distance or -distance > self.max_distance:
            return None
        if self.noted_gaps and (start, end) in self.noted_gaps:
            self._warn_if_unusual(int(start), int(end))
        # At a distance of 0, both records are at the same instant, and the first one is taken.
        return (end - instant) / distance if distance else 1

    def define_predicates(self, logic: PrologSystem, memories: MemoryInstances) -> None:
        """Define ``datime_interpolate/4`` and ``memory_gap/3``."""

        def interpolate(first: Term, second: Term, time: Term) -> Optional[Number]:
            return self.interpolation_weight(instant_of(first), instant_of(second), instant_of(time))

        def gap(name: Term, time: Term) -> Optional[float]:
            instance, instant = memories.find(name), instant_of(time)
            if instance is None:
                return None
            earlier_record, later_record = (
                instance.memory.at_or_before(instant),
                instance.memory.at_or_after(instant),
            )
            return (
                None
                if earlier_record is None or later_record is None
                else (int(later_record[2]) - int(earlier_record[2])) / SECOND
            )

        logic.define_function("datime_interpolate", 4, interpolate).is_protected = True
        logic.define_function("memory_gap", 3, gap)

    def _warn_if_unusual(self, start: int, end: int) -> None:
        for instance in self.noted_gaps.pop((start, end)):
            mean_step = mean_step_without_gap(instance.memory, end - start)
            if mean_step is not None and end - start >= WIDE_STEP_FACTOR * mean_step:
                name = self._show(instance.id)
                self._warn(
                    f"memory {name}: a value is interpolated over a gap of {(end - start) / SECOND:.3g} s; its "
                    f"records are usually {mean_step / SECOND:.3g} s apart; if that should "
                    f"fail, set {MAX_GAP_FLAG}",
                    ("gap", name),
                    once=True,
                )


def mean_step_without_gap(memory: Memory, gap: int) -> Optional[float]:
    """Return the mean step of a memory without a gap, in ns; None if there are too few steps.

    Records with the same end count as one, because several publishers may have sent them.
    """
    ends = memory.ends
    step_count = sum(1 for previous, current in zip(ends, ends[1:]) if current > previous) - 1
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
    """Products of given poses and of poses that are interpolated between records of memories.

    Args:
        gaps: decides over which gaps there is no pose.
    """

    def __init__(self, memories: MemoryInstances, gaps: MemoryGaps):
        self._memories = memories
        self._gaps = gaps

    def define_predicates(self, logic: PrologSystem) -> None:
        """Define ``pose_chain(Links, T, Pose)``, and register the fusion of look-ups with interpolation."""
        logic.define_function("pose_chain", 3, self.multiply_poses)
        predicate = logic.database.predicate(_FUSED_GOALS[0])
        if predicate.functional_modes is not None:
            predicate.functional_modes = predicate.functional_modes._replace(joins=self.fuse_goals)

    def multiply_poses(self, links: Term, time: Term) -> Optional[Term]:
        """Return the product of the poses in a list; None if a memory has no pose at the time.

        Args:
            links: poses, and ids of memories, which stand for their interpolated poses.
            time: the time of the interpolation.

        Raises:
            PrologError: an instantiation, type or domain error for other arguments.
        """
        instant = int(instant_of(time))
        items = list_items(links)
        if items is None:
            raise instantiation_error() if deref(links).__class__ is Var else type_error("list", links)
        chain_pose: Optional[Pose] = None
        # The product is from left to right, as in a chain of frames: each pose is relative to the frame before it.
        for link in items:
            link_pose = self._find_pose_of_link(link if link.__class__ is Atom else deref(link), instant)
            if link_pose is None:
                return None
            chain_pose = link_pose if chain_pose is None else compose(chain_pose, link_pose)
        return lazy_pose_term(chain_pose or IDENTITY_POSE)

    def _find_pose_of_link(self, link: Term, instant: int) -> Optional[Pose]:
        if link is NIL or (link.__class__ is tuple and link[0] is CONS):
            return parse_pose(link)
        if link.__class__ is Var:
            raise instantiation_error()
        instance = self._memories.find(link)
        records = None if instance is None else instance.memory.around(instant)
        if records is None:
            return None
        (earlier_record, _, start), (later_record, _, end) = records
        distance = end - start
        if not distance:
            return pose_of_record(earlier_record)
        # `interpolation_weight` checks the same, but calling it each time takes 7 % of the time of a look-up.
        may_be_wide = self._gaps.noted_gaps or distance > self._gaps.max_distance
        if may_be_wide and self._gaps.interpolation_weight(start, end, instant) is None:
            return None
        return interpolate(
            pose_of_record(earlier_record), pose_of_record(later_record), (end - instant) / distance
        )

    def fuse_goals(
        self, goals: Sequence[CompoundTerm], occurrence_counts: Mapping[Any, int]
    ) -> Optional[JoinedGoals]:
        """Return the fused form of the goals that look up two records and interpolate; None if they cannot be fused.

        They are fused only if no other goal of the clause uses the records and their timestamps, and both records
        are looked up in one memory with the same pattern.

        Args:
            goals: consecutive goals of a clause.
            occurrence_counts: number of occurrences in the clause, by variable.
        """
        if tuple(goal[0] for goal in goals) != _FUSED_GOALS:
            return None
        (
            (_, name, first_record, *before_args),
            (_, second_name, second_record, *after_args),
            (_, *weight_args),
            (_, position1, rotation1, position2, rotation2, fractions, result),
        ) = goals
        fraction = deref(weight_args[-1])
        # The outputs of each goal must be the inputs of the next ones, as in the documented sequence; any other use
        # of a variable needs the plain goals.
        if list_items(fractions) != [fraction] or deref(name) is not deref(second_name):
            return None
        equal_terms = [
            (weight_args[0], before_args[0]),
            (weight_args[1], after_args[0]),
            (weight_args[2], before_args[2]),
            (weight_args[2], after_args[2]),
        ]
        if any(deref(first) is not deref(second) for first, second in equal_terms):
            return None
        first_layout, second_layout = (
            _find_record_layout(first_record, position1, rotation1, occurrence_counts),
            _find_record_layout(second_record, position2, rotation2, occurrence_counts),
        )
        intermediate = [
            deref(term)
            for term in (before_args[0], after_args[0], fraction, position1, rotation1, position2, rotation2)
        ]
        # Each intermediate variable occurs twice: where it is computed and where it is used. The fused form does not
        # bind it, so a third occurrence would find it unbound.
        if (
            first_layout is None
            or first_layout != second_layout
            or any(occurrence_counts.get(var) != 2 for var in intermediate)
        ):
            return None
        if len(set(intermediate)) < len(intermediate) or any(
            occurrence_counts.get(deref(term)) != 1 for term in (before_args[1], after_args[1])
        ):
            return None
        return JoinedGoals(
            len(_FUSED_GOALS), self._compile_pose_lookup(*first_layout), (name, weight_args[2]), result
        )

    def _compile_pose_lookup(
        self, key: Functor, position: int, rotation: int
    ) -> Callable[[Term, Term], Optional[Term]]:
        """Return the function that computes the pose between two records of a layout."""
        find, weight_of = self._memories.find, self._gaps.interpolation_weight

        def interpolated_pose(name: Term, time: Term) -> Optional[Term]:
            instance = find(name)
            if instance is None:
                return None
            instant = instant_of(time)
            records = instance.memory.around(instant)
            if records is None:
                return None
            (earlier_term, start, _), (later_term, end, _) = records
            first_record: Any = deref(earlier_term)
            second_record: Any = deref(later_term)
            if not (
                first_record.__class__ is second_record.__class__ is tuple
                and first_record[0] is second_record[0] is key
            ):
                return None
            weight = weight_of(start, end, instant)
            if weight is None:
                return None
            first_pose, second_pose = (
                parse_pose_parts(first_record[position], first_record[rotation]),
                parse_pose_parts(second_record[position], second_record[rotation]),
            )
            return lazy_pose_term(interpolate(first_pose, second_pose, weight))

        return interpolated_pose


def _find_record_layout(
    record: Term, position: Term, rotation: Term, occurrence_counts: Mapping[Any, int]
) -> Optional[RecordLayout]:
    """Return the layout of a record pattern; None if arguments other than position and rotation are used, too."""
    term: Any = deref(record)
    if term.__class__ is not tuple:
        return None
    items = [deref(item) for item in term]
    pose_terms = deref(position), deref(rotation)
    if any(item not in pose_terms and occurrence_counts.get(item) != 1 for item in items[1:]):
        return None
    if any(items.count(item) != 1 for item in pose_terms):
        return None
    return term[0], items.index(pose_terms[0]), items.index(pose_terms[1])


def pose_of_record(record: Term) -> Pose:
    """Return the pose of a record ``Name(Position, Rotation)`` or ``[Position, Rotation]``.

    Raises:
        PrologError: a type error for other records.
    """
    try:
        name, position, rotation = record  # type: ignore[misc]
    except (TypeError, ValueError):
        return parse_pose(record)
    return parse_pose(record) if name is CONS else parse_pose_parts(position, rotation)
