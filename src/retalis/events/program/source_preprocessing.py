"""Conditional compilation: ``:- if(Goal)``, ``elif``, ``else`` and ``endif`` of a file.

What a program has its terms and goals replaced by while it is read: ``term_expansion/2``, ``goal_expansion/2``.
"""

from typing import Callable, Dict, List, Optional, Tuple

from ...foundation.errors import Place, RuleError
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import COMMA, Atom, Functor, Term, Var, deref, functor

_IF, _ELIF = functor("if", 1), functor("elif", 1)
_ELSE, _ENDIF = functor("else", 0), functor("endif", 0)

Holds = Callable[[Term, Optional[Place]], bool]


class _Branch:
    """An ``if`` that is open."""

    __slots__ = ("place", "outside", "counts", "chosen", "last")

    def __init__(self, place: Optional[Place], outside: bool):
        self.place = place
        self.outside = outside
        """Whether what stands around it counts."""
        self.counts = False
        """Whether what stands in the branch that is open counts."""
        self.chosen = False
        """Whether one of its branches has counted."""
        self.last = False
        """Whether that is the branch of ``else``."""

    def choose(self, holds: bool) -> None:
        self.counts = self.outside and holds and not self.chosen
        self.chosen |= self.counts


class ConditionalCompilation:
    """The ``if`` directives of a file that are open, the outer ones first.

    Args:
        holds: tells whether the goal of an ``if`` at a place is true.
    """

    def __init__(self, holds: Holds):
        self._holds = holds
        self._open: List[_Branch] = []

    @property
    def skip(self) -> bool:
        """Whether what follows does not count."""
        return bool(self._open) and not self._open[-1].counts

    def take(self, goal: Term, place: Optional[Place]) -> bool:
        """Return whether a directive is one of these, and follow it.

        Raises:
            RuleError: where no ``if`` is open that it belongs to.
        """
        goal = deref(goal)
        key = goal[0] if goal.__class__ is tuple else goal.functor if isinstance(goal, Atom) else None
        if goal.__class__ is tuple and key is _IF:
            branch = _Branch(place, not self.skip)
            self._open.append(branch)
            branch.choose(branch.outside and self._holds(goal[1], place))
        elif goal.__class__ is tuple and key is _ELIF:
            branch = self._innermost("elif", place)
            branch.choose(branch.outside and not branch.chosen and self._holds(goal[1], place))
        elif key is _ELSE:
            branch = self._innermost("else", place)
            branch.choose(True)
            branch.last = True
        elif key is _ENDIF:
            self._innermost("endif", place, closes=True)
            self._open.pop()
        else:
            return False
        return True

    def unclosed(self) -> List[RuleError]:
        """Return an error for each ``if`` that no ``endif`` closes."""
        return [RuleError("this if has no endif", branch.place) for branch in self._open]

    def _innermost(self, name: str, place: Optional[Place], closes: bool = False) -> _Branch:
        if not self._open:
            raise RuleError(f"there is no if before this {name}", place)
        if self._open[-1].last and not closes:
            raise RuleError(f"there is an else before this {name}", place)
        return self._open[-1]


_TERM, _GOAL = functor("term_expansion", 2), functor("goal_expansion", 2)
_NECK, _SINGLE_SIDED = functor(":-", 2), functor("=>", 2)
_DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))

_MAX_EXPANSIONS = 1000
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


class TermExpansion:
    """Replaces terms and goals as the program says that is being loaded."""

    def __init__(self, logic: PrologSystem):
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
            if times > _MAX_EXPANSIONS:
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
