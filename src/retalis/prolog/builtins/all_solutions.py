"""Predicates that collect all solutions of a goal: ``bagof/3``, ``setof/3``, ``findnsols``, ``aggregate_all``.

``findall/3`` and ``forall/2`` are control constructs of the compiler. ``bagof/3`` collects ``Witness-Template``
pairs, where the witness holds the free variables of the goal, sorts them by the witness, and returns one solution
for each group of witnesses that are variants of each other (ISO 13211-1, 8.10.2).
"""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ..machine.arithmetic import EVALUABLE, Number, add, evaluate
from ..machine.errors import domain_error, instantiation_error, type_error
from ..machine.machine import Code
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, variables
from ..terms.types import (
    COLON,
    COMMA,
    MINUS,
    NIL,
    Atom,
    Frame,
    Functor,
    Term,
    Values,
    Var,
    atom,
    deref,
    functor,
    serial,
)
from ..terms.unification import unify
from .argument_checks import is_iso, natural, partial_items
from .builtin_registry import ProgramMachine, control
from .list_predicates import sort_by, sort_unique
from .term_tests_and_arithmetic import is_variant

_HAT = functor("^", 2)
_MAX, _MIN = EVALUABLE[functor("max", 2)], EVALUABLE[functor("min", 2)]


def _strip_quantifiers(machine: ProgramMachine, goal: Term) -> Tuple[Term, List[Term]]:
    """Return the goal inside ``Var^Goal``, and the terms on the left of each ``^``."""
    quantified = []
    goal = deref(goal)
    while goal.__class__ is tuple and (goal[0] is _HAT or goal[0] is COLON):
        if goal[0] is _HAT:
            quantified.append(goal[1])
            goal = deref(goal[2])
        else:
            goal = deref(machine.logic.database.modules.resolve_quantified_goal(goal))
    return goal, quantified


def _grouped_solutions(sort: bool) -> Callable[[ProgramMachine, Values, Frame], Optional[Frame]]:
    """Return the implementation of ``setof/3`` if ``sort``, otherwise of ``bagof/3``."""

    def run(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
        template, goal, result = args
        # ISO 13211-1 requires the check of the result before the goal runs; SWI-Prolog omits it.
        if is_iso(machine):
            partial_items(result)
        # Variables of the template and those quantified by `^` are local: they do not distinguish groups.
        inner_goal, quantified = _strip_quantifiers(machine, goal)
        # Checked before the free variables are collected: an unbound goal would be its own free variable.
        if inner_goal.__class__ is Var:
            raise instantiation_error()
        local_vars = set(variables((COMMA, template, *quantified)))
        free_vars = [var for var in variables(inner_goal) if var not in local_vars]
        witness = make_list(free_vars)

        def make_group(items: List[Term]) -> Term:
            return make_list(sort_unique(items) if sort else items)

        if not free_vars:
            # Without free variables there is one group, so the sort by witnesses is not needed.

            def unify_group(solutions: List[Term]) -> Optional[Frame]:
                return (
                    continuation
                    if solutions and unify(result, make_group(solutions), machine.trail)
                    else None
                )

            return machine.logic.control.collect(inner_goal, template, unify_group)

        def enumerate_groups(solutions: List[Term]) -> Optional[Frame]:
            groups = _group_by_witness(solutions)
            return _enumerate_groups(
                machine,
                witness,
                result,
                [(key, make_group(items)) for key, items in groups],
                0,
                continuation,
            )

        return machine.logic.control.collect(inner_goal, (MINUS, witness, template), enumerate_groups)

    return run


def _group_by_witness(pairs: List[Any]) -> List[Tuple[Term, List[Term]]]:
    """Group ``Witness-Template`` pairs by variants of the witness, in the standard order of witnesses."""
    # Variables are numbered before the sort, so that variant witnesses keep the order in which they were found.
    for pair in pairs:
        for var in variables(pair[1]):
            serial(var)
    groups: List[Tuple[Term, List[Term]]] = []
    # Sorting does not make all variants adjacent, since variables sort by age. The search ends at the nearest ground
    # witness, because no ground term lies between two variants with variables in the standard order.
    for _, pair in sort_by(pairs, [pair[1] for pair in pairs]):
        for key, items in reversed(groups):
            if is_variant(key, pair[1]):
                unify(key, pair[1], [])
                items.append(pair[2])
                break
            if not variables(key):
                groups.append((pair[1], [pair[2]]))
                break
        else:
            groups.append((pair[1], [pair[2]]))
    return groups


def _enumerate_groups(
    machine: ProgramMachine,
    witness: Term,
    result: Term,
    groups: List[Tuple[Term, Term]],
    position: int,
    continuation: Frame,
) -> Optional[Frame]:
    """Return a solution for each group from ``position`` on whose witness and list unify."""
    while position < len(groups):
        mark = len(machine.trail)
        key, items = groups[position]
        position += 1
        if machine.unify_all((witness, key), (result, items)):
            # The last group leaves no choice point, so a goal with a single group is determinate.
            if position < len(groups):
                machine.choices.append(
                    (_NEXT_GROUP, machine, witness, result, groups, position, continuation, mark)
                )
            return continuation
    return None


_NEXT_GROUP = Code("bagof", lambda entry: _enumerate_groups(*entry[1:-1]))

control("bagof/3")(_grouped_solutions(False))
control("setof/3")(_grouped_solutions(True))


# Solutions in lists of limited length


@control("findnsols/4", "findnsols/5")
def findnsols(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Collect solutions in lists of ``N`` items; backtracking returns the next list."""
    count = natural(args[0])
    result = args[3]
    tail = args[4] if len(args) == 5 else NIL
    partial_items(result)
    # The goal is resumed after the first list has been returned. The copy keeps the bindings that it makes separate
    # from those of the continuation.
    _, template, goal = copy((MINUS, args[1], args[2]))
    solutions: List[Term] = []
    base = len(machine.choices)
    machine.choices.append(
        (_REMAINING_SOLUTIONS, machine, solutions, result, tail, continuation, len(machine.trail))
    )
    collect_frame = (
        _COLLECT_SOLUTION,
        machine,
        base,
        solutions,
        template,
        count,
        result,
        tail,
        continuation,
    )
    return machine.logic.control.call(goal, collect_frame)


def _collect_solution(frame: Frame) -> Optional[Frame]:
    """Add a solution to the current list of ``findnsols``, and return the list when it is full."""
    machine: ProgramMachine
    solutions: List[Term]
    continuation: Frame
    _, machine, base, solutions, template, count, result, tail, continuation = frame
    solutions.append(copy(template))
    # Failing makes the goal search for the next solution of the same list.
    if len(solutions) < count:
        return None
    items = make_list(solutions, tail)
    solutions.clear()
    # Only the choice point of this predicate is left, so the goal has no more solutions.
    if len(machine.choices) == base + 1:
        machine.choices.pop()
    return continuation if unify(result, items, machine.trail) else None


def _remaining_solutions(entry: Frame) -> Optional[Frame]:
    """Return the last list of ``findnsols``, when the goal has no more solutions."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, solutions, result, tail, continuation, _ = entry
    return continuation if unify(result, make_list(solutions, tail), machine.trail) else None


_COLLECT_SOLUTION = Code("findnsols", _collect_solution)
_REMAINING_SOLUTIONS = Code("findnsols", _remaining_solutions, True)


# Aggregates

AggregateComputation = Callable[[List[Term]], Optional[Term]]
"""Function that computes an aggregate from the collected terms; it returns None if the aggregate has no value."""

_COUNT = atom("count")
_WITNESS_SIGNS = {functor("max", 2): 1, functor("min", 2): -1}
"""Sign of the comparison for ``max(X, Witness)`` and ``min(X, Witness)``."""

# Any functor of arity 2 would do: the pair is only taken apart by `_extremum_with_witness`.
_WITNESS_PAIR = functor("r", 2)


def _sum(values: List[Term]) -> Term:
    total: Term = 0
    for value in values:
        total = add(total, value)
    return total


@control("aggregate_all/4", is_protected=False)
def aggregate_all_distinct(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Aggregate over the solutions with distinct pairs of discriminator and template."""
    spec, discriminator, goal, result = deref(args[0]), args[1], args[2], args[3]
    compute_aggregate, template = _parse_aggregate(spec)

    def unify_aggregate(solutions: List[Term]) -> Optional[Frame]:
        # Sorting removes duplicates, and does so by discriminator and template together, as in SWI-Prolog.
        distinct: List[Any] = sort_unique(solutions)
        value = compute_aggregate([pair[2] for pair in distinct])
        return continuation if value is not None and unify(result, value, machine.trail) else None

    inner_goal, _ = _strip_quantifiers(machine, goal)
    return machine.logic.control.collect(inner_goal, (MINUS, discriminator, template), unify_aggregate)


@control("aggregate_all/3", is_protected=False)
def aggregate_all(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Aggregate over all solutions.

    The aggregates are count, count(T), sum(E), max(E), min(E), max(E,W), min(E,W), bag(T), set(T), or a compound of
    these such as r(count, max(X)).
    """
    spec, goal, result = deref(args[0]), args[1], args[2]
    compute_aggregate, template = _parse_aggregate(spec)

    def unify_aggregate(solutions: List[Term]) -> Optional[Frame]:
        value = compute_aggregate(solutions)
        return continuation if value is not None and unify(result, value, machine.trail) else None

    inner_goal, _ = _strip_quantifiers(machine, goal)
    return machine.logic.control.collect(inner_goal, template, unify_aggregate)


def _parse_aggregate(term: Term) -> Tuple[AggregateComputation, Term]:
    """Return the function that computes an aggregate, and the template to collect."""
    spec = deref(term)
    if spec is _COUNT:
        return len, spec
    if spec.__class__ is Var:
        raise instantiation_error()
    if spec.__class__ is Atom:
        raise domain_error("aggregate_template", spec)
    if spec.__class__ is not tuple:
        raise type_error("aggregate_template", spec)
    key = spec[0]
    compute_aggregate = _AGGREGATES.get(key)
    if compute_aggregate is not None:
        return compute_aggregate, spec[1]
    if key in _WITNESS_SIGNS:
        return _extremum_with_witness(key, _WITNESS_SIGNS[key]), (_WITNESS_PAIR, spec[1], spec[2])
    return _compound_aggregate(key, [_parse_aggregate(part_spec) for part_spec in spec[1:]])


def _compound_aggregate(
    key: Functor, parts: List[Tuple[AggregateComputation, Term]]
) -> Tuple[AggregateComputation, Term]:
    """Return the aggregate of a compound specification such as ``r(count, max(X))``."""

    def compute_aggregate(solutions: List[Term]) -> Optional[Term]:
        values = [part(column) for (part, _), column in zip(parts, _columns(solutions, len(parts)))]
        # One part without a value, such as `max` of no solutions, makes the whole aggregate fail.
        return None if any(value is None for value in values) else (key, *values)

    return compute_aggregate, (key, *[template for _, template in parts])


def _columns(solutions: List[Any], count: int) -> List[List[Term]]:
    return [[item[column] for item in solutions] for column in range(1, count + 1)]


def _extremum(choose: Callable[..., Number]) -> AggregateComputation:
    def compute_aggregate(terms: List[Term]) -> Optional[Term]:
        value: Optional[Number] = None
        for item in terms:
            number = evaluate(item)
            value = number if value is None else choose(value, number)
        return value

    return compute_aggregate


def _extremum_with_witness(key: Functor, sign: int) -> AggregateComputation:
    def compute_aggregate(terms: List[Any]) -> Optional[Term]:
        best: Optional[Tuple[Number, Term]] = None
        for _, item, witness in terms:
            item = deref(item)
            # Unlike `max(X)`, the form with a witness does not evaluate expressions, as in SWI-Prolog.
            if item.__class__ is not int and item.__class__ is not float:
                raise type_error("number", item)
            if best is None or (item > best[0] if sign > 0 else item < best[0]):
                best = item, witness
        return None if best is None else (key, *best)

    return compute_aggregate


_AGGREGATES: Dict[Functor, AggregateComputation] = {
    functor("count", 1): len,
    functor("sum", 1): _sum,
    functor("bag", 1): make_list,
    functor("set", 1): lambda solutions: make_list(sort_unique(solutions)),
    functor("max", 1): _extremum(_MAX),
    functor("min", 1): _extremum(_MIN),
}
