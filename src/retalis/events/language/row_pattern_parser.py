"""Parser of row patterns: ``steps([low, high(2, 5) where T > prev(T)])``.

A row pattern corresponds to MATCH_RECOGNIZE of SQL. A step is a pattern variable with a quantifier: ``high(2, 5)`` is
``HIGH{2,5}``, ``reluctant`` makes it reluctant, and its ``where`` goal is the DEFINE condition. ``prev(X)``,
``first(Step, X)`` and ``last(Step, X)`` are the navigation functions; the parser replaces each of them by a fresh
variable and records in a `RowNavigation` the value to bind it to.

A condition is split at its commas into parts (`conditions`), so that each part can be evaluated as soon as the rows
that it refers to exist.
"""

from typing import TYPE_CHECKING, Any, Container, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .pattern_tree import RowPatternStep

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

MAX_STEPS = 100
"""Maximum number of steps of a row pattern."""
_LATER, _UNTIL, _WHERE = functor("later", 1), functor("until", 1), functor("where", 2)
_STEPS = functor("steps", 1)
_GREEDY = "many"
_RELUCTANT = "reluctant"
_NAVIGATIONS = {functor("prev", 1): "prev", functor("first", 1): "first", functor("last", 1): "last"}
_STEP_NAVIGATIONS = {functor("first", 2): "first", functor("last", 2): "last"}
_STEP_NOTATION = "Name, Name(N), Name(N, M), Name(N, many), with reluctant or until(Goal) behind the numbers"


class RowNavigation(NamedTuple):
    """Navigation of a condition to a value in an earlier row.

    Attributes:
        kind: ``prev`` for the preceding row, ``first`` or ``last`` for a row of a step.
        step: number of the step; meaningless for ``prev``; -1 if there is no such step.
        var: variable of the pattern in that row.
        placeholder: variable that replaces the navigation in the condition.
    """

    kind: str
    step: int
    var: Var
    placeholder: Var


class StepCondition(NamedTuple):
    """Part of a condition; it is evaluated when all rows that it refers to exist.

    Attributes:
        goal: the goal, with a variable in place of each navigation.
        navigations: the navigations.
    """

    goal: Term
    navigations: Tuple[RowNavigation, ...]


def parse_row_pattern(
    reader: "PatternReader", form: CompoundTerm, pattern_variables: Set[Var]
) -> Tuple[Tuple[RowPatternStep, ...], Tuple[Var, ...]]:
    """Return the steps of a row pattern, and the variables of the pattern that their conditions use.

    Args:
        reader: reads goals, and creates errors with places.
        form: the term of the row pattern.
        pattern_variables: the variables that the event pattern binds.

    Raises:
        RuleError: if a step is malformed or can never end.
    """
    items = list_items(form[1])
    if not items or len(items) > MAX_STEPS:
        raise reader.error(f"steps needs a list of 1 to {MAX_STEPS} steps", form, 1)
    steps = [_parse_step(reader, deref(step), form) for step in items]
    names = [step.name for step in steps]
    for name in names:
        # Navigations refer to steps by name.
        if names.count(name) > 1:
            raise reader.error(f"two steps are called {name}", form, 1)
    # A match without any row would hold at every instant.
    if not any(step.min_count for step in steps):
        raise reader.error("at least one step must have a minimum above 0", form, 1)
    _require_ends(reader, steps, form)
    navigated_vars: List[Var] = []
    for number, step in enumerate(steps):
        for goal in step.goals:
            parts = conditions(goal, names, number, pattern_variables)
            for navigations in (navigations for part in parts for navigations in part.navigations):
                if navigations.var not in pattern_variables or navigations.step < 0:
                    raise _navigation_error(reader, navigations, names, form)
            mentioned = [
                *variables(goal),
                *(navigations.var for part in parts for navigations in part.navigations),
            ]
            navigated_vars += [var for var in mentioned if var in pattern_variables]
    return tuple(steps), tuple(dict.fromkeys(navigated_vars))


def _parse_step(reader: "PatternReader", term: Any, form: CompoundTerm) -> RowPatternStep:
    """Return the step that a term denotes."""
    unwrapped, later = term, False
    goal: Optional[Term] = None
    while unwrapped.__class__ is tuple and unwrapped[0] in (_LATER, _WHERE):
        if unwrapped[0] is _WHERE and goal is None:
            goal = reader.goal(unwrapped, 2, "where")
        elif unwrapped[0] is _LATER and not later and deref(unwrapped[1]).__class__ in (Atom, tuple):
            later = True
        else:
            break
        unwrapped = deref(unwrapped[1])
    if unwrapped.__class__ is Atom:
        return RowPatternStep(unwrapped.name, 1, 1, False, later, goal, None)
    if unwrapped.__class__ is not tuple or unwrapped[0] in (_WHERE, _UNTIL):
        raise reader.error(f"a step is {_STEP_NOTATION}; and Step where Goal, later(Step)", form, 1)
    return _quantified_step(reader, unwrapped, later, goal)


def _quantified_step(
    reader: "PatternReader", term: CompoundTerm, later: bool, goal: Optional[Term]
) -> RowPatternStep:
    """Return the step that a term with a quantifier denotes."""
    arguments: List[Any] = [deref(argument) for argument in term[1:]]
    reluctant, until = False, None
    option = arguments[-1]
    if option.__class__ is Atom and option.name == _RELUCTANT:
        reluctant = True
    elif option.__class__ is tuple and option[0] is _UNTIL:
        until = reader.goal(option, 1, "until")
    if reluctant or until is not None:
        arguments.pop()
    minimum: Any = arguments[0] if arguments else None
    maximum: Any = arguments[-1] if arguments else None
    if len(arguments) == 2 and maximum.__class__ is Atom and maximum.name == _GREEDY:
        maximum = None
    if not 1 <= len(arguments) <= 2 or not _are_counts(minimum, maximum):
        raise reader.error(
            f"a step is {_STEP_NOTATION}, where N is not larger than M, and M at least 1", term
        )
    return RowPatternStep(term[0].name, minimum, maximum, reluctant, later, goal, until)


def _are_counts(minimum: Any, maximum: Any) -> bool:
    if minimum.__class__ is not int or minimum < 0:
        return False
    return maximum is None or (maximum.__class__ is int and 1 <= maximum >= minimum)


def _require_ends(reader: "PatternReader", steps: Sequence[RowPatternStep], form: CompoundTerm) -> None:
    """Reject a step without an end, which would never complete a match."""
    for number, step in enumerate(steps):
        if step.reluctant or step.until is not None:
            continue
        missing = ""
        if step.max_count is None and step.goal is None:
            missing = "a condition, a largest number" if not step.skips_rows else "a largest number"
        elif (
            step.skips_rows
            and step.max_count != step.min_count
            and not any(later_step.min_count for later_step in steps[number + 1 :])
        ):
            # With ``skips_rows``, an optional further row could still arrive at any time, so the match would never be
            # final.
            # Else it would wait for more, which may never come.
            missing = "a single number"
        if missing:
            message = f"nothing ends the step {step.name}: give it {missing}, reluctant, or until(Goal)"
            raise reader.error(message, form, 1)


def _navigation_error(
    reader: "PatternReader", navigation: RowNavigation, names: Sequence[str], form: CompoundTerm
) -> RuleError:
    if navigation.step < 0:
        return reader.error(f"unknown step; the steps are {', '.join(names)}", form, 1)
    return reader.error(f"{navigation.kind} needs a variable that the pattern binds", form, 1)


def conditions(
    goal: Term, names: Sequence[str], step: int, pattern_variables: Container[Var]
) -> List[StepCondition]:
    """Return the parts of a condition, each with its navigations.

    Conjuncts that share a variable local to the condition form one part, together with the conjuncts between them.

    Args:
        goal: the condition.
        names: names of the steps.
        step: number of the step that has the condition.
        pattern_variables: variables that the event pattern binds; all others are local to the condition.
    """
    conjuncts = list(_split_conjunction(goal))
    free_variables = [
        [var for var in variables(conjunct) if var not in pattern_variables] for conjunct in conjuncts
    ]
    last_use = {var: position for position, used in enumerate(free_variables) for var in used}
    parts: List[Term] = []
    end = -1
    for position, conjunct in enumerate(conjuncts):
        # A local variable is bound in one conjunct and used in another one, so both must be solved as one goal.
        if position > end:
            parts.append(conjunct)
        else:
            parts[-1] = (COMMA, parts[-1], conjunct)
        end = max([end, *(last_use[var] for var in free_variables[position])])
    return [_replace_navigations(conjunct, names, step) for conjunct in parts]


def _split_conjunction(goal: Term) -> Iterator[Term]:
    stack = [deref(goal)]
    while stack:
        goal_part: Any = stack.pop()
        if goal_part.__class__ is tuple and goal_part[0] is COMMA:
            # Left conjunct last, so that it is popped first.
            stack += [deref(goal_part[2]), deref(goal_part[1])]
        else:
            yield goal_part


def _replace_navigations(goal: Term, names: Sequence[str], step: int) -> StepCondition:
    navigations: List[RowNavigation] = []

    def replace(term: Term) -> Term:
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        navigation = _parse_navigation(term, names, step)
        if navigation is None:
            return (term[0], *[replace(arg) for arg in term[1:]])
        navigations.append(navigation)
        return navigation.placeholder

    return StepCondition(replace(goal), tuple(navigations))


def _parse_navigation(term: CompoundTerm, names: Sequence[str], step: int) -> Optional[RowNavigation]:
    """Return the navigation that a term denotes, or None."""
    kind = _NAVIGATIONS.get(term[0])
    var: Any = deref(term[-1])
    if kind is not None and var.__class__ is Var:
        return RowNavigation(kind, step, var, Var())
    kind = _STEP_NAVIGATIONS.get(term[0])
    name: Any = deref(term[1])
    if kind is None or name.__class__ is not Atom or var.__class__ is not Var:
        return None
    return RowNavigation(kind, names.index(name.name) if name.name in names else -1, var, Var())


def steps_term(steps: Sequence[RowPatternStep]) -> Term:
    """Return the term of a row pattern."""
    return _STEPS(make_list([step_term(step) for step in steps]))


def step_term(step: RowPatternStep) -> Term:
    """Return the term of a step."""
    arguments: List[Term] = [] if step.min_count == step.max_count == 1 else [step.min_count]
    if step.max_count != step.min_count:
        arguments.append(atom(_GREEDY) if step.max_count is None else step.max_count)
    ending: Optional[Term] = atom(_RELUCTANT) if step.reluctant else None
    if step.until is not None:
        ending = _UNTIL(step.until)
    if ending is not None:
        arguments = [*(arguments or [1]), ending]
    term: Term = functor(step.name, len(arguments))(*arguments) if arguments else atom(step.name)
    if step.goal is not None:
        term = _WHERE(term, step.goal)
    return _LATER(term) if step.skips_rows else term
