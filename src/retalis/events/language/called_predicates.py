"""Static analysis of goals in rules: called predicates, and warnings about unknown ones.

The analysis descends into control constructs and meta-predicates with a known meaning (`_GOAL_POSITIONS`).
Predicates that any goal of the program could define by ``assert`` and the like are never reported.
"""

from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import UndefinedPredicate
from ...foundation.source_places import Place
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, CompoundTerm, Functor, Term, Var, deref, functor

_GOAL_POSITIONS: Dict[Functor, Tuple[int, ...]] = {
    COMMA: (1, 2),
    functor(";", 2): (1, 2),
    functor("->", 2): (1, 2),
    functor("*->", 2): (1, 2),
    functor("\\+", 1): (1,),
    functor(":", 2): (2,),
    functor("call", 1): (1,),
    functor("once", 1): (1,),
    functor("ignore", 1): (1,),
    functor("forall", 2): (1, 2),
    functor("findall", 3): (2,),
    functor("findall", 4): (2,),
    functor("aggregate_all", 3): (2,),
    functor("catch", 3): (1, 3),
}
"""Positions of the arguments that are goals."""

_DATABASE_UPDATES = frozenset(
    (
        *[
            functor(name, 1)
            for name in ("assert", "asserta", "assertz", "retract", "retractall", "dynamic", "db")
        ],
        functor("dynamic", 2),
    )
)
_AS = functor("as", 2)
_INTERVAL_PREDICATES = frozenset((functor("t1", 1), functor("t2", 1)))
_CONJUNCTIONS = frozenset((COMMA, functor("call", 1), functor("once", 1)))
_CUT = functor("!", 0)
_NECK = functor(":-", 2)
_LIST_FUNCTORS = frozenset((COMMA, CONS))


_MAX_HINTS = 50
"""Maximum number of unknown predicates in one program for which similar names are searched."""


class Subgoal(NamedTuple):
    """Goal inside a goal, and its position: argument ``position`` of ``parent``."""

    term: Term
    parent: CompoundTerm
    position: int


def calls(parent: CompoundTerm, position: int) -> Iterator[Subgoal]:
    """Yield the calls of the goal in an argument of a term; control constructs are replaced by their goals."""
    stack = [Subgoal(deref(parent[position]), parent, position)]
    while stack:
        call = stack.pop()
        term = call.term
        positions = _GOAL_POSITIONS.get(term[0]) if term.__class__ is tuple else None
        if positions is None or term.__class__ is not tuple:
            yield call
        else:
            stack += [Subgoal(deref(term[position]), term, position) for position in reversed(positions)]


def conjunctions(parent: CompoundTerm, position: int) -> Iterator[List[Subgoal]]:
    """Yield the groups of goals that must all have a solution: the goal in an argument of a term, and nested goals.

    The goals of a control construct other than a conjunction begin groups of their own.
    """
    starts = [Subgoal(deref(parent[position]), parent, position)]
    while starts:
        stack, group = [starts.pop()], []
        while stack:
            goal = stack.pop()
            term = goal.term
            positions = _GOAL_POSITIONS.get(term[0]) if term.__class__ is tuple else None
            if positions is None or term.__class__ is not tuple:
                group.append(goal)
                continue
            parts = [Subgoal(deref(term[position]), term, position) for position in reversed(positions)]
            if term[0] is COMMA:
                stack += parts
            else:
                starts += parts
        yield group


def required_interval_calls(parent: CompoundTerm, position: int) -> List[Subgoal]:
    """Return the calls of ``t1/1`` and ``t2/1`` that a goal, an argument of a term, needs for a solution."""
    interval_calls: List[Subgoal] = []
    stack = [Subgoal(deref(parent[position]), parent, position)]
    while stack:
        call = stack.pop()
        term = call.term
        # Only goals that always run are followed: a call in one branch of ``;`` or below ``\+`` may never run.
        if term.__class__ is tuple and term[0] in _CONJUNCTIONS:
            stack += [
                Subgoal(deref(term[position]), term, position) for position in range(len(term) - 1, 0, -1)
            ]
        elif term.__class__ is tuple and term[0] in _INTERVAL_PREDICATES:
            interval_calls.append(call)
    return interval_calls


class PredicateCall(NamedTuple):
    """Call of a predicate that may be undefined.

    Attributes:
        place: position of the call, or None.
        caller: name of the caller, for a call without a place.
        advice: the intended call, if it is known.
        module: module that qualifies the call, or None.
    """

    key: Functor
    place: Optional[Place]
    caller: str = ""
    advice: str = ""
    module: Optional[Term] = None


def calls_in_goals(conditions: Term, caller: str) -> List[PredicateCall]:
    """Return the calls of the goals in a list."""
    predicate_calls: List[PredicateCall] = []
    for goal in list_items(conditions) or ():
        for call in calls((CONS, goal), 1):
            if isinstance(call.term, Atom):
                predicate_calls.append(PredicateCall(call.term.functor, None, caller))
            elif isinstance(call.term, tuple):
                predicate_calls.append(PredicateCall(call.term[0], None, caller))
    return predicate_calls


def undefined_call_warnings(
    logic: PrologSystem, predicate_calls: List[PredicateCall], terms: Callable[[], List[Term]]
) -> Iterator[UndefinedPredicate]:
    """Yield a warning for each called predicate that is undefined and that no goal in ``terms`` can define."""
    missing = [call for call in predicate_calls if call.key is not _CUT and not is_defined(logic, call)]
    if not missing:
        return
    # The search through all terms of the program is slow, so it happens only if a predicate is undefined.
    defined_later = _dynamic_predicates(terms())
    hints_left = _MAX_HINTS
    for call in missing:
        key, place, caller, advice, module = call
        if key not in defined_later and _UNKNOWN_PREDICATE not in defined_later:
            # Each predicate is reported once, at its first call.
            defined_later.add(key)
            # The search for similar names compares with all predicates, so only the first ones get a hint.
            hints_left -= 1
            if not advice and hints_left >= 0:
                definition = "define it in the module" if module else f"define it, or write :- dynamic {key}."
                advice = logic.undefined_procedures.suggest(key) or definition
            hint = f"; {advice}" if advice else ""
            prefix = f"{caller}: " if caller else ""
            yield UndefinedPredicate(f"{prefix}there is no predicate {key} yet{hint}", place, call)


def is_defined(logic: PrologSystem, call: PredicateCall) -> bool:
    """Return whether the predicate of a call is defined."""
    modules = logic.database.modules
    module = None if call.module is None else modules.find_module(call.module)
    return logic.defines(call.key if module is None else modules.resolve(module, call.key))


_UNKNOWN_PREDICATE: Any = object()
"""Marker among functors: a goal adds a predicate that cannot be determined statically."""


def _dynamic_predicates(terms: List[Term]) -> Set[Functor]:
    """Return the functors of predicates that goals in terms add; `_UNKNOWN_PREDICATE` for unknown ones."""
    dynamic: Set[Functor] = set()
    stack = list(terms)
    while stack:
        term = deref(stack.pop())
        if term.__class__ is not tuple:
            continue
        if term[0] in _DATABASE_UPDATES:
            dynamic |= _denoted_predicates(deref(term[1]))
        stack.extend(term[1:])
    return dynamic


def _denoted_predicates(term: Term) -> Set[Functor]:
    heads: Set[Functor] = set()
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple and item[0] in _LIST_FUNCTORS:
            stack += item[1:]
        elif item.__class__ is tuple and (item[0] is _NECK or item[0] is _AS):
            stack.append(item[1])
        elif item.__class__ is tuple and item[0] is SLASH:
            name, arity = deref(item[1]), deref(item[2])
            heads.add(
                functor(name.name, arity)
                if isinstance(name, Atom) and isinstance(arity, int)
                else _UNKNOWN_PREDICATE
            )
        elif item.__class__ is Var:
            # ``assertz(X)`` with a variable can define any predicate.
            heads.add(_UNKNOWN_PREDICATE)
        elif item.__class__ is Atom:
            heads.add(item.functor)
        elif item.__class__ is tuple:
            heads.add(item[0])
    return heads
