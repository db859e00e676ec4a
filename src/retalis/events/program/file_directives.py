"""Directives of event files: execution with the position of the failing goal, and declarations of events."""

from typing import Any, Iterable, List, Mapping, Optional, Tuple

from ...foundation.errors import Errors, RuleError, UsageError
from ...foundation.source_places import Place
from ...prolog.machine.errors import PrologError
from ...prolog.machine.machine import Machine
from ...prolog.syntax.operators import DECLARE_EVENT
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.types import COMMA, TRUE, Atom, CompoundTerm, Term, Var, deref, functor
from ..language.called_predicates import calls
from ..language.event_declarations import (
    STRICTLY,
    UNDECLARED,
    Declarations,
    VariableTypes,
    has_alternatives,
    parse_declarations,
)
from ..language.pattern_parser import EventTerm, PlaceLookup

_MARKER = functor("$goal", 1)
_CALLABLE = (tuple, Atom, Var)

Goals = List[Tuple[Term, Optional[Place]]]
"""Goals of a directive, each with its place."""


def directive_goals(directive: Term, place_of: PlaceLookup) -> Goals:
    """Return the goals of a directive that are called in sequence, each with its position."""
    goals: Goals = []
    stack: List[Tuple[Any, int]] = [(directive, 1)]
    while stack:
        parent, position = stack.pop()
        goal = deref(parent[position])
        if goal.__class__ is tuple and goal[0] is COMMA:
            stack += [(goal, 2), (goal, 1)]
        else:
            goals.append((goal, place_of(parent, position)))
    return goals


class Directives:
    """Runs directives.

    Before each goal of a conjunction, a marker goal records the index of the goal. So the place of a goal that fails
    or raises an error is known without inspecting the machine. The marker is deterministic, so it leaves no choice
    point. An error on backtracking is attributed to the goal that was called last.
    """

    def __init__(self, logic: PrologSystem):
        self._logic = logic
        self._last_index = 0
        self._goal_count = 0
        logic.define("$goal", 1, self._record_goal)

    def run(self, goal: Term, goals: Goals, place: Optional[Place]) -> Optional[RuleError]:
        """Run a directive; return a warning if it fails, with the position of the last goal that was called.

        Raises:
            RuleError: the error that a goal raised, with its position.
        """
        # Saved for nested directives: a goal may load a file.
        outer_state = self._last_index, self._goal_count
        goal, goals = (
            self._logic.resolve_file_goal(goal),
            [(self._logic.resolve_file_goal(part), goal_place) for part, goal_place in goals],
        )
        invalid_indexes = [index for index, (part, _) in enumerate(goals) if not _is_callable(part)]
        # A conjunction with a part that is not callable raises an error that shows all of it, markers included.
        uses_markers = len(goals) > 1 and not invalid_indexes
        self._last_index, self._goal_count = invalid_indexes[0] if invalid_indexes else 0, len(goals)
        try:
            if self._logic.once(_with_markers([part for part, _ in goals]) if uses_markers else goal, goal):
                return None
            return RuleError("this directive fails", goals[self._last_index][1] or place)
        except PrologError as error:
            goal_place = goals[self._last_index][1] or place
            raise RuleError(f"this directive raises an error: {error.message}", goal_place) from error
        finally:
            self._last_index, self._goal_count = outer_state

    def _record_goal(self, machine: Machine, index_term: Term) -> bool:
        goal_index = deref(index_term)
        if not isinstance(goal_index, int) or not 0 <= goal_index < self._goal_count:
            # A program has called the marker by its name.
            return False
        self._last_index = goal_index
        return True


def _is_callable(goal: Term) -> bool:
    return all(call.term.__class__ in _CALLABLE for call in calls((_MARKER, goal), 1))


def _with_markers(goals: List[Term]) -> Term:
    """Return the conjunction of goals with a marker before each."""
    result: Optional[Term] = None
    for index in range(len(goals) - 1, -1, -1):
        following_goals = goals[index] if result is None else (COMMA, goals[index], result)
        result = (COMMA, (_MARKER, index), following_goals)
    return result or TRUE


_SET_FLAG = functor("set_etalis_flag", 2)


class FileDeclarations:
    """Declarations of events during the check of a file: each applies from its position on.

    Args:
        declarations: declarations at the beginning of the file; None to check nothing.
        errors: receives events that do not match.
    """

    def __init__(self, declarations: Optional[Declarations], errors: Errors):
        self._declarations = declarations
        self._errors = errors

    def apply(self, goals: Goals, place_of: PlaceLookup) -> None:
        """Apply the declarations of a directive to the rest of the file.

        Raises:
            RuleError: if a declaration is invalid or contradicts an earlier one.
        """
        # The directive has not run yet, so declarations and the flag are taken from its goals.
        declarations = self._declarations
        for goal, _ in () if declarations is None else goals:
            if declarations is None or goal.__class__ is not tuple:
                continue
            if goal[0] is DECLARE_EVENT:
                for declaration, place in parse_declarations(goal, place_of):
                    try:
                        declarations.add(declaration)
                    except UsageError as error:
                        raise RuleError(error.message, place) from error
            elif goal[0] is _SET_FLAG and deref(goal[1]) is UNDECLARED:
                declarations.set_strict(deref(goal[2]) is STRICTLY)

    def check_events(
        self,
        events: Iterable[EventTerm],
        term: CompoundTerm,
        names: Mapping[Var, str],
        place_of: PlaceLookup,
        place: Optional[Place],
    ) -> None:
        """Check events in a rule, clause or directive, with its variables, against the declarations."""
        if self._declarations:
            variable_types = VariableTypes(names, reports_clashes=not has_alternatives(term))
            for error in self._declarations.find_errors(
                events, lambda part, position=0: place_of(part, position) or place, variable_types
            ):
                self._errors.append(error)
