"""Parser of row patterns: ``steps([low, high(2, 5) where T > prev(T)])``.

A row pattern corresponds to MATCH_RECOGNIZE of SQL. A step is a pattern variable with a quantifier: ``high(2, 5)`` is
``HIGH{2,5}``, ``reluctant`` makes it reluctant, and its ``where`` goal is the DEFINE condition. ``prev(X)``,
``first(Step, X)`` and ``last(Step, X)`` are the navigation functions; the parser replaces each of them by a fresh
variable and records in a `LookBack` the value to bind it to.

A condition is split at its commas into parts (`conditions`), so that each part can be evaluated as soon as the rows
that it refers to exist.
"""

from typing import TYPE_CHECKING, Any, Container, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .pattern_tree import StepForm

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

MAX_STEPS = 100
"""Maximum number of steps of a row pattern."""
_LATER, _UNTIL, _WHERE = functor("later", 1), functor("until", 1), functor("where", 2)
_STEPS = functor("steps", 1)
_GREEDY = "many"
_RELUCTANT = "reluctant"
_NAVIGATION = {functor("prev", 1): "prev", functor("first", 1): "first", functor("last", 1): "last"}
_STEP_NAVIGATION = {functor("first", 2): "first", functor("last", 2): "last"}
_FORM = "Name, Name(N), Name(N, M), Name(N, many), with reluctant or until(Goal) behind the numbers"


class LookBack(NamedTuple):
    """Navigation of a condition to a value in an earlier row.

    Attributes:
        kind: ``prev`` for the preceding row, ``first`` or ``last`` for a row of a step.
        step: number of the step; meaningless for ``prev``; -1 if there is no such step.
        var: variable of the pattern in that row.
        stands: variable that replaces the navigation in the condition.
    """

    kind: str
    step: int
    var: Var
    stands: Var


class StepCondition(NamedTuple):
    """Part of a condition; it is evaluated when all rows that it refers to exist.

    Attributes:
        goal: the goal, with a variable in place of each navigation.
        back: the navigations.
    """

    goal: Term
    back: Tuple[LookBack, ...]


def read_steps(
    reader: "PatternReader", form: CompoundTerm, given: Set[Var]
) -> Tuple[Tuple[StepForm, ...], Tuple[Var, ...]]:
    """Return the steps of a row pattern, and the variables of the pattern that their conditions use.

    Args:
        reader: reads goals, and creates errors with places.
        form: the term of the row pattern.
        given: the variables that the event pattern binds.

    Raises:
        RuleError: if a step is malformed or can never end.
    """
    items = list_items(form[1])
    if not items or len(items) > MAX_STEPS:
        raise reader.error(f"steps needs a list of 1 to {MAX_STEPS} steps", form, 1)
    steps = [_step(reader, deref(step), form) for step in items]
    names = [step.name for step in steps]
    for name in names:
        # Navigations refer to steps by name.
        if names.count(name) > 1:
            raise reader.error(f"two steps are called {name}", form, 1)
    # A match without any row would hold at every instant.
    if not any(step.least for step in steps):
        raise reader.error("at least one step must have a minimum above 0", form, 1)
    _check_ends(reader, steps, form)
    looked_at: List[Var] = []
    for number, step in enumerate(steps):
        for goal in step.goals:
            parts = conditions(goal, names, number, given)
            for back in (back for part in parts for back in part.back):
                if back.var not in given or back.step < 0:
                    raise _navigation_error(reader, back, names, form)
            mentioned = [*variables(goal), *(back.var for part in parts for back in part.back)]
            looked_at += [var for var in mentioned if var in given]
    return tuple(steps), tuple(dict.fromkeys(looked_at))


def _step(reader: "PatternReader", term: Any, form: CompoundTerm) -> StepForm:
    """Return the step that a term denotes."""
    inner, later = term, False
    goal: Optional[Term] = None
    while inner.__class__ is tuple and inner[0] in (_LATER, _WHERE):
        if inner[0] is _WHERE and goal is None:
            goal = reader.goal(inner, 2, "where")
        elif inner[0] is _LATER and not later and deref(inner[1]).__class__ in (Atom, tuple):
            later = True
        else:
            break
        inner = deref(inner[1])
    if inner.__class__ is Atom:
        return StepForm(inner.name, 1, 1, False, later, goal, None)
    if inner.__class__ is not tuple or inner[0] in (_WHERE, _UNTIL):
        raise reader.error(f"a step is {_FORM}; and Step where Goal, later(Step)", form, 1)
    return _quantified_step(reader, inner, later, goal)


def _quantified_step(
    reader: "PatternReader", term: CompoundTerm, later: bool, goal: Optional[Term]
) -> StepForm:
    """Return the step that a term with a quantifier denotes."""
    args: List[Any] = [deref(arg) for arg in term[1:]]
    reluctant, until = False, None
    option = args[-1]
    if option.__class__ is Atom and option.name == _RELUCTANT:
        reluctant = True
    elif option.__class__ is tuple and option[0] is _UNTIL:
        until = reader.goal(option, 1, "until")
    if reluctant or until is not None:
        args.pop()
    minimum: Any = args[0] if args else None
    maximum: Any = args[-1] if args else None
    if len(args) == 2 and maximum.__class__ is Atom and maximum.name == _GREEDY:
        maximum = None
    if not 1 <= len(args) <= 2 or not _are_counts(minimum, maximum):
        raise reader.error(f"a step is {_FORM}, where N is not larger than M, and M at least 1", term)
    return StepForm(term[0].name, minimum, maximum, reluctant, later, goal, until)


def _are_counts(minimum: Any, maximum: Any) -> bool:
    if minimum.__class__ is not int or minimum < 0:
        return False
    return maximum is None or (maximum.__class__ is int and 1 <= maximum >= minimum)


def _check_ends(reader: "PatternReader", steps: Sequence[StepForm], form: CompoundTerm) -> None:
    """Reject a step without an end, which would never complete a match."""
    for number, step in enumerate(steps):
        if step.reluctant or step.until is not None:
            continue
        missing = ""
        if step.most is None and step.goal is None:
            missing = "a condition, a largest number" if not step.later else "a largest number"
        elif (
            step.later
            and step.most != step.least
            and not any(later_step.least for later_step in steps[number + 1 :])
        ):
            # With ``later``, an optional further row could still arrive at any time, so the match would never be
            # final.
            # Else it would wait for more, which may never come.
            missing = "a single number"
        if missing:
            message = f"nothing ends the step {step.name}: give it {missing}, reluctant, or until(Goal)"
            raise reader.error(message, form, 1)


def _navigation_error(
    reader: "PatternReader", back: LookBack, names: Sequence[str], form: CompoundTerm
) -> RuleError:
    if back.step < 0:
        return reader.error(f"unknown step; the steps are {', '.join(names)}", form, 1)
    return reader.error(f"{back.kind} needs a variable that the pattern binds", form, 1)


def conditions(goal: Term, names: Sequence[str], step: int, given: Container[Var]) -> List[StepCondition]:
    """Return the parts of a condition, each with its navigations.

    Conjuncts that share a variable local to the condition form one part, together with the conjuncts between them.

    Args:
        goal: the condition.
        names: names of the steps.
        step: number of the step that has the condition.
        given: variables that the event pattern binds; all others are local to the condition.
    """
    conjuncts = list(_conjuncts(goal))
    own = [[var for var in variables(conjunct) if var not in given] for conjunct in conjuncts]
    last = {var: position for position, mentioned in enumerate(own) for var in mentioned}
    parts: List[Term] = []
    end = -1
    for position, conjunct in enumerate(conjuncts):
        # A local variable is bound in one conjunct and used in another one, so both must be solved as one goal.
        if position > end:
            parts.append(conjunct)
        else:
            parts[-1] = (COMMA, parts[-1], conjunct)
        end = max([end, *(last[var] for var in own[position])])
    return [_with_navigations(conjunct, names, step) for conjunct in parts]


def _conjuncts(goal: Term) -> Iterator[Term]:
    stack = [deref(goal)]
    while stack:
        goal_part: Any = stack.pop()
        if goal_part.__class__ is tuple and goal_part[0] is COMMA:
            # Left conjunct last, so that it is popped first.
            stack += [deref(goal_part[2]), deref(goal_part[1])]
        else:
            yield goal_part


def _with_navigations(goal: Term, names: Sequence[str], step: int) -> StepCondition:
    navigations: List[LookBack] = []

    def replaced(term: Term) -> Term:
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        back = _navigation(term, names, step)
        if back is None:
            return (term[0], *[replaced(arg) for arg in term[1:]])
        navigations.append(back)
        return back.stands

    return StepCondition(replaced(goal), tuple(navigations))


def _navigation(term: CompoundTerm, names: Sequence[str], step: int) -> Optional[LookBack]:
    """Return the navigation that a term denotes, or None."""
    kind = _NAVIGATION.get(term[0])
    var: Any = deref(term[-1])
    if kind is not None and var.__class__ is Var:
        return LookBack(kind, step, var, Var())
    kind = _STEP_NAVIGATION.get(term[0])
    name: Any = deref(term[1])
    if kind is None or name.__class__ is not Atom or var.__class__ is not Var:
        return None
    return LookBack(kind, names.index(name.name) if name.name in names else -1, var, Var())


def steps_term(steps: Sequence[StepForm]) -> Term:
    """Return the term of a row pattern."""
    return _STEPS(make_list([step_term(step) for step in steps]))


def step_term(step: StepForm) -> Term:
    """Return the term of a step."""
    args: List[Term] = [] if step.least == step.most == 1 else [step.least]
    if step.most != step.least:
        args.append(atom(_GREEDY) if step.most is None else step.most)
    extra: Optional[Term] = atom(_RELUCTANT) if step.reluctant else None
    if step.until is not None:
        extra = _UNTIL(step.until)
    if extra is not None:
        args = [*(args or [1]), extra]
    term: Term = functor(step.name, len(args))(*args) if args else atom(step.name)
    if step.goal is not None:
        term = _WHERE(term, step.goal)
    return _LATER(term) if step.later else term
