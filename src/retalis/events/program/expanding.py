"""What a program has its terms and goals replaced by while it is read: ``term_expansion/2``, ``goal_expansion/2``."""

from typing import Dict, List, Optional, Tuple

from ...foundation import RuleError
from ...prolog.logic import Logic
from ...prolog.terms import COMMA, Functor, Term, Var, deref, functor, list_items

_TERM, _GOAL = functor("term_expansion", 2), functor("goal_expansion", 2)
_NECK, _SINGLE_SIDED = functor(":-", 2), functor("=>", 2)
_DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))

_MOST = 1000
"""Times that a goal is replaced: one that is replaced by itself would be so forever."""

_INSIDE: Dict[Functor, Tuple[int, ...]] = {
    COMMA: (1, 2),
    **dict.fromkeys((functor(name, 2) for name in (";", "|", "->", "*->", "forall")), (1, 2)),
    **dict.fromkeys((functor(name, 1) for name in ("\\+", "call", "once", "ignore")), (1,)),
    functor("findall", 3): (2,),
    functor("findall", 4): (2,),
    functor("aggregate_all", 3): (2,),
    functor("bagof", 3): (2,),
    functor("setof", 3): (2,),
    functor("catch", 3): (1, 3),
}
"""Control predicates, and which of their arguments are goals."""


class Expansion:
    """Replaces terms and goals as the program says that is being loaded."""

    def __init__(self, logic: Logic):
        self._logic = logic

    def terms(self, term: Term) -> Optional[List[Term]]:
        """Return what stands in the place of a term; None where that is the term itself.

        Raises:
            PrologError: what the program's predicate raises.
        """
        if not self._is_there(_TERM):
            return None
        result = Var()
        if not self._logic.once((_TERM, term, result)):
            return None
        found = deref(result)
        items = list_items(found)
        return [found] if items is None else [deref(item) for item in items]

    def goals(self, term: Term) -> Term:
        """Return a clause or directive with the goals in it replaced.

        Raises:
            PrologError: what the program's predicate raises.
            RuleError: where a goal is replaced again and again.
        """
        term = deref(term)
        if term.__class__ is not tuple or not self._is_there(_GOAL):
            return term
        if term[0] is _NECK or term[0] is _SINGLE_SIDED:
            body = self._goal(term[2])
            return term if body is term[2] else (term[0], term[1], body)
        if term[0] in _DIRECTIVES:
            goal = self._goal(term[1])
            return term if goal is term[1] else (term[0], goal)
        return term

    def _is_there(self, key: Functor) -> bool:
        predicate = self._logic.database.predicates.get(key)
        return predicate is not None and not predicate.library and len(predicate) > 0

    def _goal(self, given: Term) -> Term:
        """Return a goal with all goals in it replaced, or the very object where none is."""
        goal, times = deref(given), 0
        while goal.__class__ is not Var:
            result = Var()
            if not self._logic.once((_GOAL, goal, result)):
                break
            times += 1
            if times > _MOST:
                raise RuleError(f"goal_expansion/2 goes on and on with {self._logic.brief(goal)}")
            goal = deref(result)
        inside = _INSIDE.get(goal[0]) if goal.__class__ is tuple else None
        if inside is None or goal.__class__ is not tuple:
            return goal if times else given
        parts = list(goal)
        for at in inside:
            parts[at] = self._goal(parts[at])
        changed = any(new is not old for new, old in zip(parts, goal))
        return tuple(parts) if changed else goal if times else given
