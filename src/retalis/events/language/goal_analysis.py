"""What the goals of rules call, looked at before they run."""

from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Set

from ...foundation.errors import Place, RuleError
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, CompoundTerm, Functor, Term, Var, deref, functor

_GOALS_IN = {
    functor(name, arity): places
    for name, arity, places in (
        (",", 2, (1, 2)),
        (";", 2, (1, 2)),
        ("->", 2, (1, 2)),
        ("*->", 2, (1, 2)),
        ("\\+", 1, (1,)),
        (":", 2, (2,)),
        ("call", 1, (1,)),
        ("once", 1, (1,)),
        ("ignore", 1, (1,)),
        ("forall", 2, (1, 2)),
        ("findall", 3, (2,)),
        ("findall", 4, (2,)),
        ("aggregate_all", 3, (2,)),
        ("catch", 3, (1, 3)),
    )
}
_CHANGES = frozenset(
    (
        *[
            functor(name, 1)
            for name in ("assert", "asserta", "assertz", "retract", "retractall", "dynamic", "db")
        ],
        functor("dynamic", 2),
    )
)
_AS = functor("as", 2)
_INTERVAL = frozenset((functor("t1", 1), functor("t2", 1)))
_FOR_GOALS = frozenset((COMMA, functor("call", 1), functor("once", 1)))
_CUT = functor("!", 0)
_NECK = functor(":-", 2)
_SEVERAL = frozenset((COMMA, CONS))


_MAX_HINTS = 50
"""Unknown predicates of one program for which known ones of nearly the same name are looked for among all."""


class Subgoal(NamedTuple):
    """A goal inside a goal, and where it stands: in which term, as which argument."""

    term: Term
    parent: CompoundTerm
    number: int


def calls(parent: CompoundTerm, number: int) -> Iterator[Subgoal]:
    """Yield what a goal, an argument of a term, calls: itself, or what its control constructs call."""
    stack = [Subgoal(deref(parent[number]), parent, number)]
    while stack:
        call = stack.pop()
        term = call.term
        places = _GOALS_IN.get(term[0]) if term.__class__ is tuple else None
        if places is None or term.__class__ is not tuple:
            yield call
        else:
            stack += [Subgoal(deref(term[at]), term, at) for at in reversed(places)]


def asking_interval(parent: CompoundTerm, number: int) -> List[Subgoal]:
    """Return the calls of ``t1/1`` and ``t2/1`` without which a goal, an argument of a term, has no solution."""
    found: List[Subgoal] = []
    stack = [Subgoal(deref(parent[number]), parent, number)]
    while stack:
        call = stack.pop()
        term = call.term
        if term.__class__ is tuple and term[0] in _FOR_GOALS:
            stack += [Subgoal(deref(term[at]), term, at) for at in range(len(term) - 1, 0, -1)]
        elif term.__class__ is tuple and term[0] in _INTERVAL:
            found.append(call)
    return found


class Unknown(NamedTuple):
    """A call of a predicate that may not be there.

    Attributes:
        key: of the predicate.
        place: where the call is, or None.
        caller: who calls it, where there is no place.
        advice: what was probably meant.
        module: by whose name it is called, if by any.
    """

    key: Functor
    place: Optional[Place]
    caller: str = ""
    advice: str = ""
    module: Optional[Term] = None


def called_by(conditions: Term, caller: str) -> List[Unknown]:
    """Return what the goals in a list call."""
    found: List[Unknown] = []
    for goal in list_items(conditions) or ():
        for call in calls((CONS, goal), 1):
            if isinstance(call.term, Atom):
                found.append(Unknown(call.term.functor, None, caller))
            elif isinstance(call.term, tuple):
                found.append(Unknown(call.term[0], None, caller))
    return found


def unknown_calls(
    logic: PrologSystem, found: List[Unknown], terms: Callable[[], List[Term]]
) -> Iterator[RuleError]:
    """Yield a warning for each predicate that is called and not there, and that no goal in ``terms`` can add."""
    missing = [one for one in found if one.key is not _CUT and not _is_there(logic, one)]
    if not missing:
        return
    added = _added(terms())
    hints = _MAX_HINTS
    for key, place, caller, advice, _ in missing:
        if key not in added and _ANY not in added:
            added.add(key)
            hints -= 1
            meant = logic.similar(key) if hints >= 0 and not advice else []
            hint = f"; did you mean {' or '.join(meant)}?" if meant else ""
            hint = f"; {advice}" if advice else hint
            who = f"{caller}: " if caller else ""
            yield RuleError(f"{who}there is no predicate {key} yet{hint}", place)


def _is_there(logic: PrologSystem, call: Unknown) -> bool:
    modules = logic.database.modules
    module = None if call.module is None else modules.named(call.module)
    return logic.defines(call.key if module is None else modules.resolve(module, call.key))


_ANY: Any = object()
"""Stands among functors for any: what a goal adds cannot be seen."""


def _added(terms: List[Term]) -> Set[Functor]:
    """Return the functors of the predicates that goals in terms add, and `_ANY` where that cannot be seen."""
    found: Set[Functor] = set()
    stack = list(terms)
    while stack:
        term = deref(stack.pop())
        if term.__class__ is not tuple:
            continue
        if term[0] in _CHANGES:
            found |= _heads(deref(term[1]))
        stack.extend(term[1:])
    return found


def _heads(term: Term) -> Set[Functor]:
    """Return what a term names: a predicate or clause, or several."""
    found: Set[Functor] = set()
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple and item[0] in _SEVERAL:
            stack += item[1:]
        elif item.__class__ is tuple and (item[0] is _NECK or item[0] is _AS):
            stack.append(item[1])
        elif item.__class__ is tuple and item[0] is SLASH:
            name, arity = deref(item[1]), deref(item[2])
            found.add(
                functor(name.name, arity) if isinstance(name, Atom) and isinstance(arity, int) else _ANY
            )
        elif item.__class__ is Var:
            found.add(_ANY)
        elif item.__class__ is Atom:
            found.add(item.functor)
        elif item.__class__ is tuple:
            found.add(item[0])
    return found
