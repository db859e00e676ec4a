"""Windows of steps, read from terms: ``steps([low, high(2, 5) where T > prev(T)])``."""

from typing import Any, Container, Iterator, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .pattern_tree import StepForm

MAX_STEPS = 100
"""How many steps a window has at most."""
_LATER, _UNTIL, _WHERE = functor("later", 1), functor("until", 1), functor("where", 2)
_STEPS = functor("steps", 1)
_GREEDY = "many"
_RELUCTANT = "reluctant"
_BACK = {functor("prev", 1): "prev", functor("first", 1): "first", functor("last", 1): "last"}
_BACK_TO = {functor("first", 2): "first", functor("last", 2): "last"}
_FORM = "Name, Name(N), Name(N, M), Name(N, many), with reluctant or until(Goal) behind the numbers"


class StepReader(Protocol):
    """What reads patterns, see `PatternReader`."""

    def goal(self, parent: CompoundTerm, number: int, operator: str) -> Term:
        """Return the goal that an argument of a term is."""

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        """Return an error at a term, or at an argument of it."""


class LookBack(NamedTuple):
    """A value of an earlier item that a condition asks for.

    Attributes:
        kind: of which item of the match: ``prev`` for the one before, ``first`` or ``last`` of a step.
        step: the step; any number for ``prev``.
        var: which of its variables.
        stands: the variable that stands for the value in the condition.
    """

    kind: str
    step: int
    var: Var
    stands: Var


class StepCondition(NamedTuple):
    """A part of a condition: it is asked where all that it looks back at is there.

    Attributes:
        goal: the goal, with variables in the place of what it looks back at.
        back: what these are.
    """

    goal: Term
    back: Tuple[LookBack, ...]


def read_steps(
    reader: StepReader, form: CompoundTerm, given: Set[Var]
) -> Tuple[Tuple[StepForm, ...], Tuple[Var, ...]]:
    """Return the steps of a window, and the variables of its pattern that their conditions look at.

    Args:
        reader: reads goals, and makes errors.
        form: the term of the window.
        given: the variables that the pattern gives values to.

    Raises:
        RuleError: where these are no steps, or such as never end.
    """
    items = list_items(form[1])
    if not items or len(items) > MAX_STEPS:
        raise reader.error(f"steps needs a list of 1 to {MAX_STEPS} steps", form, 1)
    steps = [_step(reader, deref(one), form) for one in items]
    names = [one.name for one in steps]
    for name in names:
        if names.count(name) > 1:
            raise reader.error(f"two steps are called {name}", form, 1)
    if not any(one.least for one in steps):
        raise reader.error("one step at least has to be there: all of these may be left out", form, 1)
    _check_ends(reader, steps, form)
    looked_at: List[Var] = []
    for at, one in enumerate(steps):
        for goal in one.goals:
            parts = conditions(goal, names, at, given)
            for back in (back for part in parts for back in part.back):
                if back.var not in given or back.step < 0:
                    raise _nothing_there(reader, back, names, form)
            mentioned = [*variables(goal), *(back.var for part in parts for back in part.back)]
            looked_at += [var for var in mentioned if var in given]
    return tuple(steps), tuple(dict.fromkeys(looked_at))


def _step(reader: StepReader, term: Any, form: CompoundTerm) -> StepForm:
    """Return the step that a term says."""
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
    return _counted(reader, inner, later, goal)


def _counted(reader: StepReader, term: CompoundTerm, later: bool, goal: Optional[Term]) -> StepForm:
    """Return the step that a term with numbers says."""
    args: List[Any] = [deref(one) for one in term[1:]]
    reluctant, until = False, None
    option = args[-1]
    if option.__class__ is Atom and option.name == _RELUCTANT:
        reluctant = True
    elif option.__class__ is tuple and option[0] is _UNTIL:
        until = reader.goal(option, 1, "until")
    if reluctant or until is not None:
        args.pop()
    least: Any = args[0] if args else None
    most: Any = args[-1] if args else None
    if len(args) == 2 and most.__class__ is Atom and most.name == _GREEDY:
        most = None
    if not 1 <= len(args) <= 2 or not _are_counts(least, most):
        raise reader.error(f"a step is {_FORM}, where N is not larger than M, and M at least 1", term)
    return StepForm(term[0].name, least, most, reluctant, later, goal, until)


def _are_counts(least: Any, most: Any) -> bool:
    if least.__class__ is not int or least < 0:
        return False
    return most is None or (most.__class__ is int and 1 <= most >= least)


def _check_ends(reader: StepReader, steps: Sequence[StepForm], form: CompoundTerm) -> None:
    """Refuse a step that goes on for ever, so that no match would ever be whole."""
    for at, one in enumerate(steps):
        if one.reluctant or one.until is not None:
            continue
        what = ""
        if one.most is None and one.goal is None:
            what = "a condition, a largest number" if not one.later else "a largest number"
        elif one.later and one.most != one.least and not any(other.least for other in steps[at + 1 :]):
            what = "a single number"  # else it would wait for more, which may never come
        if what:
            message = f"nothing ends the step {one.name}: give it {what}, reluctant, or until(Goal)"
            raise reader.error(message, form, 1)


def _nothing_there(reader: StepReader, back: LookBack, names: Sequence[str], form: CompoundTerm) -> RuleError:
    if back.step < 0:
        return reader.error(f"there is no such step to look back at; there are {', '.join(names)}", form, 1)
    return reader.error(f"{back.kind} needs a variable that the pattern gives a value", form, 1)


def conditions(goal: Term, names: Sequence[str], at: int, given: Container[Var]) -> List[StepCondition]:
    """Return the parts of a condition, and at what each of them looks back.

    What stands between commas is a part; those that share a variable of their own are one, with what is between them.

    Args:
        goal: the condition.
        names: those of the steps.
        at: the step whose condition it is.
        given: the variables that the pattern gives values to; others are the condition's own.
    """
    conjuncts = list(_conjuncts(goal))
    own = [[var for var in variables(one) if var not in given] for one in conjuncts]
    last = {var: place for place, mentioned in enumerate(own) for var in mentioned}
    parts: List[Term] = []
    end = -1
    for place, one in enumerate(conjuncts):
        if place > end:
            parts.append(one)
        else:
            parts[-1] = (COMMA, parts[-1], one)
        end = max([end, *(last[var] for var in own[place])])
    return [_looking_back(one, names, at) for one in parts]


def _conjuncts(goal: Term) -> Iterator[Term]:
    stack = [deref(goal)]
    while stack:
        one: Any = stack.pop()
        if one.__class__ is tuple and one[0] is COMMA:
            stack += [deref(one[2]), deref(one[1])]
        else:
            yield one


def _looking_back(goal: Term, names: Sequence[str], at: int) -> StepCondition:
    found: List[LookBack] = []

    def replaced(term: Term) -> Term:
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        back = _back(term, names, at)
        if back is None:
            return (term[0], *[replaced(one) for one in term[1:]])
        found.append(back)
        return back.stands

    return StepCondition(replaced(goal), tuple(found))


def _back(term: CompoundTerm, names: Sequence[str], at: int) -> Optional[LookBack]:
    """Return what a term looks back at, or None where it does not."""
    kind = _BACK.get(term[0])
    var: Any = deref(term[-1])
    if kind is not None and var.__class__ is Var:
        return LookBack(kind, at, var, Var())
    kind = _BACK_TO.get(term[0])
    name: Any = deref(term[1])
    if kind is None or name.__class__ is not Atom or var.__class__ is not Var:
        return None
    return LookBack(kind, names.index(name.name) if name.name in names else -1, var, Var())


def steps_term(steps: Sequence[StepForm]) -> Term:
    """Return the term that says a window of steps."""
    return _STEPS(make_list([step_term(one) for one in steps]))


def step_term(one: StepForm) -> Term:
    """Return the term that a step is written as."""
    args: List[Term] = [] if one.least == one.most == 1 else [one.least]
    if one.most != one.least:
        args.append(atom(_GREEDY) if one.most is None else one.most)
    extra: Optional[Term] = atom(_RELUCTANT) if one.reluctant else None
    if one.until is not None:
        extra = _UNTIL(one.until)
    if extra is not None:
        args = [*(args or [1]), extra]
    made: Term = functor(one.name, len(args))(*args) if args else atom(one.name)
    if one.goal is not None:
        made = _WHERE(made, one.goal)
    return _LATER(made) if one.later else made
