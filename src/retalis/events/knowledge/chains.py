"""Chains of poses: where something is at an instant, over several memories of transforms."""

from typing import Optional

from ...prolog.builtins import Pose, compose, instant_of, interpolate, pose, pose_of, shown_pose
from ...prolog.logic import Logic
from ...prolog.machine import instantiation_error, type_error
from ...prolog.terms import CONS, NIL, Atom, Term, Var, deref, list_items
from .gaps import Gaps
from .memories import Memories

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
        """Define ``pose_chain(Links, T, Pose)``."""
        logic.define_function("pose_chain", 3, self.product)

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
