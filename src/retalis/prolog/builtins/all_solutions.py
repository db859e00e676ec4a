"""All solutions of a goal: bagof, setof, aggregate_all (findall and forall are control)."""

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
from .builtin_registry import Machine, control
from .list_predicates import sort_by, sort_unique
from .term_comparison import is_variant

_HAT = functor("^", 2)
_MAX, _MIN = EVALUABLE[functor("max", 2)], EVALUABLE[functor("min", 2)]


def _strip(machine: Machine, goal: Term) -> Tuple[Term, List[Term]]:
    """Return the goal inside ``Var^Goal`` and the terms before the hats."""
    bound = []
    goal = deref(goal)
    while goal.__class__ is tuple and (goal[0] is _HAT or goal[0] is COLON):
        if goal[0] is _HAT:
            bound.append(goal[1])
            goal = deref(goal[2])
        else:
            goal = deref(machine.logic.database.modules.hatted(goal))
    return goal, bound


def _grouped(sort: bool) -> Callable[[Machine, Values, Frame], Optional[Frame]]:
    def run(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        template, goal, result = args
        if is_iso(machine):
            partial_items(result)
        inner, bound = _strip(machine, goal)
        if inner.__class__ is Var:
            raise instantiation_error()
        local = set(variables((COMMA, template, *bound)))
        free = [var for var in variables(inner) if var not in local]
        witness = make_list(free)

        def finish(items: List[Term]) -> Term:
            return make_list(sort_unique(items) if sort else items)

        if not free:

            def done(found: List[Term]) -> Optional[Frame]:
                return after if found and unify(result, finish(found), machine.trail) else None

            return machine.logic.control.collect(inner, template, done)

        def done_grouped(found: List[Term]) -> Optional[Frame]:
            groups = _groups(found)
            return _enumerate(
                machine, witness, result, [(key, finish(items)) for key, items in groups], 0, after
            )

        return machine.logic.control.collect(inner, (MINUS, witness, template), done_grouped)

    return run


def _groups(found: List[Any]) -> List[Tuple[Term, List[Term]]]:
    """Group ``Witness-Template`` pairs by variants of the witness, in the standard order of witnesses."""
    for pair in found:  # so that variants keep the order in which they were found
        for var in variables(pair[1]):
            serial(var)
    groups: List[Tuple[Term, List[Term]]] = []
    for _, pair in sort_by(found, [pair[1] for pair in found]):
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


def _enumerate(
    machine: Machine, witness: Term, result: Term, groups: List[Tuple[Term, Term]], at: int, after: Frame
) -> Optional[Frame]:
    while at < len(groups):
        mark = len(machine.trail)
        key, items = groups[at]
        at += 1
        if machine.unify_all((witness, key), (result, items)):
            if at < len(groups):
                machine.choices.append((_NEXT, machine, witness, result, groups, at, after, mark))
            return after
    return None


_NEXT = Code("bagof", lambda entry: _enumerate(*entry[1:7]))

control("bagof/3")(_grouped(False))
control("setof/3")(_grouped(True))


# Solutions in portions


@control("findnsols/4", "findnsols/5")
def findnsols(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Collect solutions in lists of a length; the next ones on backtracking."""
    count = natural(args[0])
    result = args[3]
    tail = args[4] if len(args) == 5 else NIL
    partial_items(result)
    pair = copy((MINUS, args[1], args[2]))  # the goal goes on later: what it binds meanwhile is its own
    found: List[Term] = []
    height = len(machine.choices)
    machine.choices.append((_REST, machine, found, result, tail, after, len(machine.trail)))
    collect = (_PORTION, machine, height, found, pair[1], count, result, tail, after)
    return machine.logic.control.call(pair[2], collect)


def _portion(frame: Frame) -> Optional[Frame]:
    machine: Machine
    found: List[Term]
    after: Frame
    _, machine, height, found, template, count, result, tail, after = frame
    found.append(copy(template))
    if len(found) < count:
        return None
    items = make_list(found, tail)
    found.clear()
    if len(machine.choices) == height + 1:  # there are no more
        machine.choices.pop()
    return after if unify(result, items, machine.trail) else None


def _rest(entry: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, found, result, tail, after, _ = entry
    return after if unify(result, make_list(found, tail), machine.trail) else None


_PORTION = Code("findnsols", _portion)
_REST = Code("findnsols", _rest, True)


# Aggregates

Finish = Callable[[List[Term]], Optional[Term]]
"""What makes the result of an aggregate from the collected terms; None where there is none."""

_COUNT = atom("count")
_WITH_WITNESS = {functor("max", 2): 1, functor("min", 2): -1}
_R = functor("r", 2)


def _total(values: List[Term]) -> Term:
    total: Term = 0
    for value in values:
        total = add(total, value)
    return total


@control("aggregate_all/4", locked=False)
def aggregate_all_distinct(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Aggregate over the solutions that differ in a discriminator (or in what is aggregated)."""
    spec, discriminator, goal, result = deref(args[0]), args[1], args[2], args[3]
    finish, template = _aggregate(spec)

    def done(found: List[Term]) -> Optional[Frame]:
        pairs: List[Any] = sort_unique(found)
        value = finish([pair[2] for pair in pairs])
        return after if value is not None and unify(result, value, machine.trail) else None

    inner, _ = _strip(machine, goal)
    return machine.logic.control.collect(inner, (MINUS, discriminator, template), done)


@control("aggregate_all/3", locked=False)
def aggregate_all(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Aggregate over all solutions: count, count(T), sum(E), max(E), min(E), max(E,W), min(E,W), bag(T), set(T)."""
    spec, goal, result = deref(args[0]), args[1], args[2]
    finish, template = _aggregate(spec)

    def done(found: List[Term]) -> Optional[Frame]:
        value = finish(found)
        return after if value is not None and unify(result, value, machine.trail) else None

    inner, _ = _strip(machine, goal)
    return machine.logic.control.collect(inner, template, done)


def _aggregate(given: Term) -> Tuple[Finish, Term]:
    """Return what makes the result of an aggregate from the collected terms, and what to collect."""
    spec = deref(given)
    if spec is _COUNT:
        return len, spec
    if spec.__class__ is Var:
        raise instantiation_error()
    if spec.__class__ is Atom:
        raise domain_error("aggregate_template", spec)
    if spec.__class__ is not tuple:
        raise type_error("aggregate_template", spec)
    key = spec[0]
    finish = _FINISHES.get(key)
    if finish is not None:
        return finish, spec[1]
    if key in _WITH_WITNESS:
        return _witness(key, _WITH_WITNESS[key]), (_R, spec[1], spec[2])
    return _several(key, [_aggregate(part) for part in spec[1:]])


def _several(key: Functor, parts: List[Tuple[Finish, Term]]) -> Tuple[Finish, Term]:
    """Return the aggregate of a term whose arguments are aggregates."""

    def finish(found: List[Term]) -> Optional[Term]:
        values = [part(column) for (part, _), column in zip(parts, _columns(found, len(parts)))]
        return None if any(value is None for value in values) else (key, *values)

    return finish, (key, *[template for _, template in parts])


def _columns(found: List[Any], count: int) -> List[List[Term]]:
    return [[item[at] for item in found] for at in range(1, count + 1)]


def _extreme(better: Callable[..., Number]) -> Finish:
    def finish(found: List[Term]) -> Optional[Term]:
        value: Optional[Number] = None
        for item in found:
            number = evaluate(item)
            value = number if value is None else better(value, number)
        return value

    return finish


def _witness(key: Functor, sign: int) -> Finish:
    def finish(found: List[Any]) -> Optional[Term]:
        best: Optional[Tuple[Number, Term]] = None
        for _, item, witness in found:
            item = deref(item)
            if item.__class__ is not int and item.__class__ is not float:
                raise type_error("number", item)
            if best is None or (item > best[0] if sign > 0 else item < best[0]):
                best = item, witness
        return None if best is None else (key, *best)

    return finish


_FINISHES: Dict[Functor, Finish] = {
    functor("count", 1): len,
    functor("sum", 1): _total,
    functor("bag", 1): make_list,
    functor("set", 1): lambda found: make_list(sort_unique(found)),
    functor("max", 1): _extreme(_MAX),
    functor("min", 1): _extreme(_MIN),
}
