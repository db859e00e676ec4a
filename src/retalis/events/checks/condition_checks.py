"""Checks of conditions: comparisons that never hold, names in arithmetic, and arithmetic that is not evaluated.

The goals that must hold together are grouped into conjunctions. In each of them, the comparisons of a variable with
numbers are intersected to one interval; an empty interval means that the conjunction never holds. The conditions of
the parts of a pattern that each match contains share their intervals, because a variable has one value in a match.
"""

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Set, Tuple, Union

from ...foundation.errors import RuleError
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.types import Atom, CompoundTerm, Functor, Term, Var, deref, functor, functor_of
from ..language.called_predicates import conjunctions
from ..language.pattern_parser import PlaceLookup, no_place
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    InstantPattern,
    KleenePattern,
    NotPattern,
    NotPrecededPattern,
    PairPattern,
    Pattern,
    RatePattern,
    WithinPattern,
    children,
)
from ..language.rule_heads import event_raised_by
from .program_model import ProgramModel, SourceRule, Subterm, subterms, wrap_term

NUMERIC_COMPARISONS = frozenset(functor(name, 2) for name in ("<", ">", "=<", ">=", "=:=", "=\\="))
ALTERNATIVES = frozenset((functor("or", 2), functor("\\/", 2), functor(";", 2), functor("->", 2)))
"""Operators with alternatives: a variable may be bound in another one."""

IS = functor("is", 2)
_IRREFLEXIVE = frozenset(functor(name, 2) for name in ("<", ">", "\\==", "\\=", "@<", "@>"))
"""Comparisons that never hold for equal terms; ``X =\\= X`` holds for nan."""

_EVALUATING_FORMS = {
    functor(name, 2): evaluating
    for name, evaluating in (("==", "=:="), ("\\==", "=\\="), ("=", "is"), ("\\=", "=\\="))
}
"""Comparisons of terms, each with the one that evaluates."""

_ARITHMETIC = frozenset(functor(name, 2) for name in ("+", "-", "*", "/", "//", "mod", "**"))
_PAIRS = frozenset(functor(name, 2) for name in ("-", "/"))
"""Operators of arithmetic that also write pairs, such as ``Key-Value`` and ``Name/Arity``."""

_STEPS = frozenset(functor(name, 2) for name in ("+", "-", "*", "/"))


class Conjunction(NamedTuple):
    """Goals that must hold together, with the rule or clause that contains them.

    Attributes:
        is_clause: whether the source is a clause; a rule otherwise.
        names: names of variables.
        bounds: numbers that earlier comparisons of each variable allow; other conditions of a match may share it.
        failure: consequence of a goal that always fails, or "" if it may be intended.
    """

    goals: List[Subterm]
    source: Term
    is_clause: bool
    names: Mapping[Var, str]
    bounds: "Dict[Var, _Interval]"
    failure: str = ""


def find_impossible_conditions(program: ProgramModel) -> Iterator[RuleError]:
    """Yield goals of rules and clauses that never hold, or that compare a value with unevaluated arithmetic."""
    for conjunction in conjunctions_of(program):
        for goal in conjunction.goals:
            if conjunction.failure and goal.key in _FAILURES:
                yield RuleError(f"{goal.key.name} {conjunction.failure}", goal.place)
            if goal.term.__class__ is not tuple or len(goal.term) != 3:
                continue
            problem = (
                _explain_equal_sides(program, goal, conjunction)
                or _explain_assignment(program, goal, conjunction)
                or _explain_unevaluated(program, goal, conjunction)
                or _explain_empty_interval(program, goal, conjunction)
            )
            if problem:
                yield RuleError(problem, goal.place)
            else:
                yield from _find_names_in_arithmetic(goal, conjunction)


def conjunctions_of(program: ProgramModel) -> Iterator[Conjunction]:
    """Yield the goals of rules and clauses that must hold together."""
    for rule in program.rules:
        names = program.names_in(rule)
        for node, bounds in _conditions_with_bounds(rule.definition.pattern):
            # The first group has the goals that must hold; the others are parts of alternatives and negations.
            for index, goals in enumerate(_place_goals(wrap_term(node.goal), 1, rule.place_of)):
                failure = "" if index else _consequence_of_failure(rule, node)
                yield Conjunction(goals, rule.definition.term, False, names, {} if index else bounds, failure)
    for clause in program.clauses:
        for goals in _place_goals(clause.parent, clause.position, clause.place_of):
            yield Conjunction(goals, clause.parent, True, program.names, {})


def _consequence_of_failure(rule: SourceRule, node: Union[ConditionPattern, ActionPattern]) -> str:
    """Return the consequence if the goal of ``do`` always fails, or "" if the rule has no event or is disabled."""
    head = event_raised_by(rule.definition.head)
    key = None if head is None else functor_of(head)
    if not isinstance(node, ActionPattern) or key is None or key.name in _NO_EVENTS:
        return ""
    return (
        f"ends the goal, so that {key} never happens: to run the goal without an event, write the head null"
    )


_FAILURES = frozenset((functor("fail", 0), functor("false", 0)))
_NO_EVENTS = ("null", "null_event")


def _conditions_with_bounds(
    pattern: Pattern,
) -> "Iterator[Tuple[Union[ConditionPattern, ActionPattern], Dict[Var, _Interval]]]":
    """Yield the conditions and actions of a pattern in the order of the text, with the bounds that they share."""
    visited: List[Tuple[Pattern, Dict[Var, _Interval]]] = []
    stack: List[Tuple[Pattern, Dict[Var, _Interval]]] = [(pattern, {})]
    while stack:
        node, bounds = stack.pop()
        visited.append((node, bounds))
        for index, child in enumerate(children(node)):
            # Each match contains these parts, with one value for each variable.
            is_shared = isinstance(node, _SHARING) or (isinstance(node, _PARTLY_SHARING) and index == 0)
            stack.append((child, bounds if is_shared else {}))
    # A part was visited before its operands, and these from right to left.
    for node, bounds in reversed(visited):
        if isinstance(node, ConditionPattern):
            yield node, bounds
        elif isinstance(node, ActionPattern):
            yield node, {}


_SHARING = (PairPattern, ConditionPattern, WithinPattern, ActionPattern, RatePattern, InstantPattern)
_PARTLY_SHARING = (NotPattern, AbsencePattern, NotPrecededPattern, KleenePattern, AggregatePattern)
"""Nodes whose first operand is part of each match; the second is negated, or need not be there."""


def _place_goals(parent: CompoundTerm, position: int, place_of: PlaceLookup) -> Iterator[List[Subterm]]:
    for group in conjunctions(parent, position):
        yield [Subterm(goal.term, goal.parent, goal.position, place_of) for goal in group]


def _show(program: ProgramModel, term: Term, conjunction: Conjunction) -> str:
    return program.brief(term, conjunction.names)


def _explain_equal_sides(program: ProgramModel, goal: Subterm, conjunction: Conjunction) -> str:
    if goal.key not in _IRREFLEXIVE:
        return ""
    left, right = goal.term[1], goal.term[2]
    # `term_key` compares terms up to the names of their variables.
    if term_key(left) != term_key(right) or list(variables(left)) != list(variables(right)):
        return ""
    return f"{_show(program, goal.term, conjunction)} never holds: both sides are the same"


def _explain_assignment(program: ProgramModel, goal: Subterm, conjunction: Conjunction) -> str:
    """Return the finding for ``N is N + 1``, or ""."""
    variable, expression = deref(goal.term[1]), deref(goal.term[2])
    if goal.key is not IS or variable.__class__ is not Var or expression.__class__ is not tuple:
        return ""
    if expression[0] not in _STEPS or all(deref(operand) is not variable for operand in expression[1:]):
        return ""
    name = _show(program, variable, conjunction)
    return (
        f"{_show(program, goal.term, conjunction)} never changes {name}: a variable keeps its value, and the goal "
        f"holds only if both sides are equal; give the result another name, as in New is "
        f"{_show(program, expression, conjunction)}"
    )


def _explain_unevaluated(program: ProgramModel, goal: Subterm, conjunction: Conjunction) -> str:
    """Return the finding for a comparison of terms with an expression, such as ``F = T * 1.8``, or ""."""
    evaluating = _EVALUATING_FORMS.get(goal.key) if goal.key is not None else None
    if evaluating is None:
        return ""
    for position, other_position in ((1, 2), (2, 1)):
        value: Any = deref(goal.term[position])
        expression: Any = deref(goal.term[other_position])
        if value.__class__ not in (Var, int, float) or not _is_arithmetic(expression):
            continue
        may_be_pair = expression[0] in _PAIRS and _operators_in(expression) <= _PAIRS
        # ``Pair = Key-Value`` is common in clauses, and in rules without numbers.
        if may_be_pair and (conjunction.is_clause or (evaluating == "is" and not _has_number(expression))):
            continue
        # ``F = T * 2, F > 80`` works: arithmetic evaluates the term that F is bound to.
        if evaluating == "is" and value.__class__ is Var and not _is_used_as_term(value, goal, conjunction):
            continue
        shown_value, shown = (_show(program, term, conjunction) for term in (value, expression))
        if evaluating == "is":
            evaluating = "is" if value.__class__ is Var else "=:="
        name = goal.term[0].name
        return f"{name} does not evaluate {shown}: write {shown_value} {evaluating} {shown}"
    return ""


def _is_arithmetic(term: Any) -> bool:
    """Return whether a term is an expression of numbers and variables."""
    if term.__class__ is not tuple or term[0] not in _ARITHMETIC:
        return False
    stack: List[Any] = [term]
    while stack:
        part: Any = stack.pop()
        if part.__class__ is tuple:
            if part[0] not in EVALUABLE:
                return False
            stack += [deref(argument) for argument in part[1:]]
        elif part.__class__ not in (Var, int, float):
            return False
    return True


def _operators_in(expression: Term) -> Set[Functor]:
    return {
        part.term[0] for part in subterms(wrap_term(expression), 1, no_place) if part.term.__class__ is tuple
    }


def _has_number(expression: Term) -> bool:
    return any(part.term.__class__ in (int, float) for part in subterms(wrap_term(expression), 1, no_place))


def _is_used_as_term(variable: Var, goal: Subterm, conjunction: Conjunction) -> bool:
    """Return whether a variable occurs outside of a goal and of arithmetic."""
    total = _count(variable, conjunction.source) - _count(variable, goal.term)
    evaluated = 0
    for part in subterms(wrap_term(conjunction.source), 1, no_place):
        if part.key in NUMERIC_COMPARISONS:
            evaluated += _count(variable, part.term)
        elif part.key is IS:
            evaluated += _count(variable, part.term[2])
    return total > evaluated


def _count(variable: Var, term: Term) -> int:
    return sum(part.term is variable for part in subterms(wrap_term(term), 1, no_place))


class _Interval:
    """Numbers that the comparisons of a variable allow.

    Attributes:
        goals: the conjunction with the first of these comparisons.
    """

    def __init__(self, goals: List[Subterm]) -> None:
        self.goals = goals
        self._low: Tuple[float, bool] = (float("-inf"), False)
        self._high: Tuple[float, bool] = (float("inf"), False)

    def restrict(self, operator: str, number: float) -> bool:
        """Intersect with ``X operator number``; return whether the interval is not empty."""
        # The second element states whether a lower bound is excluded, or an upper one included, so that the stricter
        # one of two lower bounds is the greater tuple, and of two upper bounds the smaller one.
        if operator in (">", ">=", "=:="):
            self._low = max(self._low, (number, operator == ">"))
        if operator in ("<", "=<", "=:="):
            self._high = min(self._high, (number, operator != "<"))
        low, is_low_excluded = self._low
        high, is_high_included = self._high
        return low < high or (low == high and not is_low_excluded and is_high_included)


_MIRRORED = {"<": ">", ">": "<", "=<": ">=", ">=": "=<", "=:=": "=:="}


def _explain_empty_interval(program: ProgramModel, goal: Subterm, conjunction: Conjunction) -> str:
    """Return the finding for a comparison that excludes all numbers that earlier ones allow, or ""."""
    if goal.key not in NUMERIC_COMPARISONS or goal.key is None or goal.key.name not in _MIRRORED:
        return ""
    left, right = deref(goal.term[1]), deref(goal.term[2])
    operator = goal.key.name
    if right.__class__ is Var:
        left, right, operator = right, left, _MIRRORED[operator]
    if not isinstance(left, Var) or not isinstance(right, (int, float)):
        return ""
    interval = conjunction.bounds.get(left)
    if interval is None:
        interval = conjunction.bounds[left] = _Interval(conjunction.goals)
    if interval.restrict(operator, right):
        return ""
    name = _show(program, left, conjunction)
    advice = (
        "alternatives are joined with ;"
        if interval.goals is conjunction.goals
        else f"{name} has one value in the whole rule, so give another value another name, such as {name}2"
    )
    return (
        f"{_show(program, goal.term, conjunction)} never holds together with the comparisons of {name} before it; "
        f"{advice}"
    )


def _find_names_in_arithmetic(goal: Subterm, conjunction: Conjunction) -> Iterator[RuleError]:
    """Yield names in arithmetic that are no numbers: a lower-case variable, or a text that is compared."""
    if goal.key in NUMERIC_COMPARISONS:
        operands = [
            Subterm(deref(goal.term[position]), goal.term, position, goal.place_of) for position in (1, 2)
        ]
    elif goal.key is IS:
        operands = [Subterm(deref(goal.term[2]), goal.term, 2, goal.place_of)]
    else:
        return
    while operands:
        operand = operands.pop(0)
        term = operand.term
        if term.__class__ is tuple and term[0] in EVALUABLE:
            operands += [
                Subterm(deref(term[position]), term, position, goal.place_of)
                for position in range(1, len(term))
            ]
        if (
            not isinstance(term, Atom)
            or term.functor in EVALUABLE
            or term.name in ("[]", "nan", "inf", "infinite")
        ):
            continue
        capital = f"{term.name[:1].upper()}{term.name[1:]}"
        hint = (
            f"did you mean the variable {capital}?"
            if any(conjunction.names.get(var) == capital for var in variables(conjunction.source))
            else "a variable begins with a capital letter, and names are compared with == or @<"
        )
        yield RuleError(f"{term.name} is not a number: {hint}", operand.place)
