"""Preprocessing of source files: conditional compilation, and expansion of terms and goals.

Conditional compilation (``:- if(Goal)``, ``elif``, ``else``, ``endif``) skips terms before they are checked. Term
expansion calls the program's ``term_expansion/2`` for each term and ``goal_expansion/2`` for each goal in clauses and
directives, as in SWI-Prolog (manual, "Program transformation"). Both need predicates that the program has defined
before.
"""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import require_acyclic
from ...prolog.terms.types import COMMA, Atom, Functor, Term, Var, deref, functor

_IF, _ELIF = functor("if", 1), functor("elif", 1)
_ELSE, _ENDIF = functor("else", 0), functor("endif", 0)

ConditionTest = Callable[[Term, Optional[Place]], bool]


class _IfDirective:
    """An open ``if`` directive."""

    __slots__ = ("place", "is_outer_compiled", "is_compiled", "was_chosen", "is_else")

    def __init__(self, place: Optional[Place], is_outer_compiled: bool):
        self.place = place
        self.is_outer_compiled = is_outer_compiled
        """True if the surrounding text is compiled."""
        self.is_compiled = False
        """True if the current branch is compiled."""
        self.was_chosen = False
        """True if a branch has been compiled."""
        self.is_else = False
        """True in the branch of ``else``."""

    def enter_branch(self, condition_holds: bool) -> None:
        self.is_compiled = self.is_outer_compiled and condition_holds and not self.was_chosen
        self.was_chosen |= self.is_compiled


class ConditionalCompilation:
    """The open ``if`` directives of a file, outermost first.

    Args:
        condition_holds: returns whether the goal of an ``if`` at a position succeeds.
    """

    def __init__(self, condition_holds: ConditionTest):
        self._condition_holds = condition_holds
        self._open_directives: List[_IfDirective] = []

    @property
    def is_skipping(self) -> bool:
        """True if the following terms are skipped."""
        return bool(self._open_directives) and not self._open_directives[-1].is_compiled

    def process(self, goal: Term, place: Optional[Place]) -> bool:
        """Process a directive if it belongs to conditional compilation; return whether it does.

        Raises:
            RuleError: if no ``if`` is open.
        """
        goal = deref(goal)
        key = goal[0] if goal.__class__ is tuple else goal.functor if isinstance(goal, Atom) else None
        if goal.__class__ is tuple and key is _IF:
            directive = _IfDirective(place, not self.is_skipping)
            self._open_directives.append(directive)
            # Conditions in skipped text are not called: their predicates may not exist.
            directive.enter_branch(directive.is_outer_compiled and self._condition_holds(goal[1], place))
        elif goal.__class__ is tuple and key is _ELIF:
            directive = self._innermost_directive("elif", place)
            is_candidate = directive.is_outer_compiled and not directive.was_chosen
            directive.enter_branch(is_candidate and self._condition_holds(goal[1], place))
        elif key is _ELSE:
            directive = self._innermost_directive("else", place)
            directive.enter_branch(True)
            directive.is_else = True
        elif key is _ENDIF:
            # `endif` may follow `else`, which `elif` and a second `else` may not.
            self._innermost_directive("endif", place, closes=True)
            self._open_directives.pop()
        else:
            return False
        return True

    def unclosed_errors(self) -> List[RuleError]:
        """Return an error for each ``if`` without ``endif``."""
        return [RuleError("this if has no endif", directive.place) for directive in self._open_directives]

    def _innermost_directive(self, name: str, place: Optional[Place], closes: bool = False) -> _IfDirective:
        if not self._open_directives:
            raise RuleError(f"there is no if before this {name}", place)
        if self._open_directives[-1].is_else and not closes:
            raise RuleError(f"there is an else before this {name}", place)
        return self._open_directives[-1]


_TERM_EXPANSION, _GOAL_EXPANSION = functor("term_expansion", 2), functor("goal_expansion", 2)
_NECK, _SINGLE_SIDED = functor(":-", 2), functor("=>", 2)
_DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))

_MAX_EXPANSIONS = 1000
"""Maximum number of expansions of a goal, of a goal in the result and so on. A goal whose expansion contains itself
would be expanded forever."""

_GOAL_POSITIONS: Dict[Functor, Tuple[int, ...]] = {
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
"""Control predicates with the numbers of their arguments that are goals."""


class TermExpansion:
    """Expands terms and goals by the predicates of the program that is being loaded."""

    def __init__(self, logic: PrologSystem):
        self._logic = logic

    def expand_term(self, term: Term) -> Optional[List[Term]]:
        """Return the expansion of a term; None if there is none.

        Raises:
            PrologError: the error of the program's predicate.
        """
        if not self._is_defined(_TERM_EXPANSION):
            return None
        result = Var()
        if not self._logic.once((_TERM_EXPANSION, term, result)):
            return None
        expansion = deref(result)
        items = list_items(expansion)
        return [expansion] if items is None else [deref(item) for item in items]

    def expand_goals(self, term: Term) -> Term:
        """Return a clause or directive with expanded goals.

        Raises:
            PrologError: the error of the program's predicate.
            RuleError: if an expansion does not end.
            TermTooLarge: if a goal contains itself.
        """
        term = deref(term)
        if term.__class__ is not tuple or not self._is_defined(_GOAL_EXPANSION):
            return term
        if term[0] is _NECK or term[0] is _SINGLE_SIDED:
            body = self._expand_goal(term[2])
            # The identical object is returned if nothing was expanded: the positions of its parts are known by
            # identity.
            return term if body is term[2] else (term[0], term[1], body)
        if term[0] in _DIRECTIVES:
            goal = self._expand_goal(term[1])
            return term if goal is term[1] else (term[0], goal)
        return term

    def _is_defined(self, key: Functor) -> bool:
        predicate = self._logic.database.predicates.get(key)
        return predicate is not None and not predicate.is_library_predicate and len(predicate) > 0

    def _expand_goal(self, original: Term) -> Term:
        """Return a goal with all inner goals expanded, or the identical object if none was.

        Raises:
            RuleError: if an expansion does not end.
            TermTooLarge: if a goal contains itself, so that its inner goals have no end.
        """
        require_acyclic(original)
        # A stack, because the goals of a long body are nested in each other.
        stack = [self._start_expansion(original, 0)]
        while True:
            innermost = stack[-1]
            if innermost.goal_positions:
                argument = innermost.arguments[innermost.goal_positions[-1]]
                stack.append(self._start_expansion(argument, innermost.expansion_count))
                continue
            stack.pop()
            if not stack:
                return innermost.result()
            outer = stack[-1]
            outer.arguments[outer.goal_positions.pop()] = innermost.result()

    def _start_expansion(self, original: Term, expansion_count: int) -> "_ExpandedGoal":
        """Return a goal that is expanded itself, before its inner goals are.

        Args:
            original: the goal.
            expansion_count: number of expansions whose result contains the goal, which is limited.
        """
        goal, outer_count = deref(original), expansion_count
        # Expanded until there is no further expansion, as in SWI-Prolog.
        while goal.__class__ is not Var:
            result = Var()
            if not self._logic.once((_GOAL_EXPANSION, goal, result)):
                break
            expansion_count += 1
            if expansion_count > _MAX_EXPANSIONS:
                raise RuleError(
                    f"goal_expansion/2 does not end: it goes on expanding {self._logic.brief(goal)}"
                )
            require_acyclic(result)
            goal = deref(result)
        return _ExpandedGoal(original if expansion_count == outer_count else goal, goal, expansion_count)


class _ExpandedGoal:
    """A goal whose inner goals are being expanded.

    Args:
        unchanged: the result if no inner goal is changed.
        goal: the goal, dereferenced.
        expansion_count: number of expansions that have led to it.

    Attributes:
        arguments: functor and arguments, in which expanded goals replace inner goals; empty if it has none.
        goal_positions: positions of the inner goals that are not expanded yet, the first one last.
    """

    __slots__ = ("_unchanged", "_parts", "expansion_count", "arguments", "goal_positions")

    def __init__(self, unchanged: Term, goal: Term, expansion_count: int):
        self._unchanged = unchanged
        positions = _GOAL_POSITIONS.get(goal[0], ()) if isinstance(goal, tuple) else ()
        self._parts: Tuple[Any, ...] = goal if isinstance(goal, tuple) and positions else ()
        self.expansion_count = expansion_count
        self.arguments: List[Any] = list(self._parts)
        self.goal_positions = list(reversed(positions))

    def result(self) -> Term:
        """Return the goal with its expanded inner goals."""
        is_changed = any(new is not old for new, old in zip(self.arguments, self._parts))
        return tuple(self.arguments) if is_changed else self._unchanged
