"""Clauses as predicates keep them, and what tells whether a call matches one."""

from typing import Any, Dict, List, Optional, Sequence, Tuple

from ...foundation import LARGEST, Place
from ..compiler import KnownPredicate, key_of
from ..machine import Frame, Step
from ..terms import TRUE, Term, Trail, Var, copy, is_ground, is_larger, unify

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


def keys_of(frame: Frame, position: Optional[int]) -> Optional[List[object]]:
    """Return the keys of a call's arguments; None where only that at ``position`` has one."""
    for at in range(1, len(frame) - 1):
        if at - 1 != position and key_of(frame[at]) is not None:
            return [key_of(arg) for arg in frame[1:-1]]
    return None


def match_head(frame: Frame, clause: Clause, fresh: Dict[Var, Term], trail: Trail) -> bool:
    """Unify a call with a clause's head; ``fresh`` gets what the clause's variables stand for.

    A variable of the clause becomes a name for the argument, as in compiled clauses: the caller's variable
    is bound to nothing, and stays the older one.
    """
    head: Any = clause.head
    for at in range(1, len(frame) - 1):
        pattern: Term = head[at]
        if pattern.__class__ is Var:
            known = fresh.get(pattern)
            if known is None:
                fresh[pattern] = frame[at]
                continue
            pattern = known
        elif pattern.__class__ is tuple and not clause.ground:
            pattern = copy(pattern, fresh)
        if not unify(pattern, frame[at], trail):
            return False
    return True
