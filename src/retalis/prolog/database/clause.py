"""Clauses as predicates keep them."""

from typing import Optional, Sequence, Tuple

from ...foundation import LARGEST, Place
from ..compiler import KnownPredicate, key_of
from ..machine import Step
from ..terms import TRUE, Term, is_ground, is_larger

NEVER = 1 << 62
"""A generation that does not come."""


class Clause:
    """A clause of a predicate.

    Attributes:
        head, body: its term; the variables are its own and never bound.
        died: the generation that retracted it.
        keys: first-level key of each argument, None for variables.
        place: where it was read.
    """

    __slots__ = ("head", "body", "died", "keys", "ground", "fact", "code", "uses", "place", "predicate")

    def __init__(self, predicate: KnownPredicate, head: Term, body: Term, place: Optional[Place]):
        self.predicate = predicate
        self.head = head
        self.body = body
        self.died = NEVER
        self.place = place
        self.keys = tuple([key_of(arg) for arg in head[1:]]) if head.__class__ is tuple else ()
        self.fact = body is TRUE
        self.ground = self.fact and is_ground(head)
        self.code: Optional[Step] = None
        self.uses = 0

    @property
    def is_large(self) -> bool:
        """Whether it is so large that it is interpreted always; see `codegen.LARGEST`."""
        return is_larger((None, self.head, self.body), LARGEST)


def may_match(keys: Sequence[object], others: Tuple[object, ...]) -> bool:
    """Tell whether the first-level keys of a call and of a clause's head agree."""
    for key, other in zip(keys, others):
        if key is not other and key is not None and other is not None and key != other:
            return False
    return True
