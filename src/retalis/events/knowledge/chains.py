"""Chains of poses: where something is at an instant, over several memories of transforms."""

from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

from ...prolog.builtins import Pose, compose, instant_of, interpolate, pose, pose_of, shown_pose
from ...prolog.compiler import JoinedGoals
from ...prolog.logic import Logic
from ...prolog.machine import instantiation_error, type_error
from ...prolog.terms import (
    CONS,
    NIL,
    Atom,
    CompoundTerm,
    Functor,
    Term,
    Var,
    deref,
    functor,
    list_items,
)
from .gaps import Gaps
from .memories import Memories

_STEPS = (
    functor("prev", 5),
    functor("next_inf", 5),
    functor("datime_interpolate", 4),
    functor("interpolate_quaternion", 6),
)

Form = Tuple[Functor, int, int]
"""How a record is looked for: its functor, and where position and rotation stand, among variables."""

NOWHERE: Pose = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)


class Chains:
    """Gives the products of poses, and of those that memories have at an instant.

    Args:
        memories: where those are.
        gaps: tells over which gaps there is no pose.
    """

    def __init__(self, memories: Memories, gaps: Gaps):
        self._memories = memories
        self._gaps = gaps

    def define(self, logic: Logic) -> None:
        """Define ``pose_chain(Links, T, Pose)``, and join the goals that interpolate between two look-ups."""
        logic.define_function("pose_chain", 3, self.product)
        look = logic.database.predicate(_STEPS[0])
        if look.functional is not None:
            look.functional = look.functional._replace(joins=self.joins)

    def product(self, links: Term, at: Term) -> Optional[Term]:
        """Return the product of links, which are poses and ids of memories; None where a memory has no pose.

        Raises:
            PrologError: an instantiation, type or domain error where they are neither.
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
        doubtful = self._gaps.noted or apart > self._gaps.most  # seldom: a call each time took 7 % of all
        if doubtful and self._gaps.weight(start, end, instant) is None:
            return None
        return interpolate(pose_of_record(before), pose_of_record(after), (end - instant) / apart)

    def joins(self, goals: Sequence[CompoundTerm], counts: Mapping[Any, int]) -> Optional[JoinedGoals]:
        """Return what the goals are that look up what was before and after an instant, and interpolate.

        They are joined where nothing else in the clause looks at the records and their stamps, and both
        records are looked for in one memory, in one form.
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
        """Return the function that gives the pose between two records of a form."""
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
    """Return how a record is looked for; None where more than the two has to fit."""
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
        PrologError: a type error where it is neither.
    """
    try:
        name, position, rotation = record  # type: ignore[misc]
    except (TypeError, ValueError):
        return pose(record)
    return pose(record) if name is CONS else pose_of(position, rotation)
