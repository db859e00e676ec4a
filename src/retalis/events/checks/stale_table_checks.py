"""Checks of tables that become stale.

A table stores answers. If it reads memories, states or dynamic predicates, its answers become stale when these
change. `find_stale_tables` propagates reads along the call graph, from the predicates that read to their callers:
once for tables that are not incremental, and once for incremental ones, which are not notified of changes in a
dynamic predicate without the property ``incremental``. Each edge is followed once, so the time is linear in the size
of the program.
"""

from collections import deque
from typing import Any, Dict, FrozenSet, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.terms.list_terms import conjuncts
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, Functor, Term, deref, functor, functor_of
from ..knowledge.transform_predicates import TRANSFORM_PREDICATES
from ..language.called_predicates import calls
from ..language.state_parser import HOLDS, queried_state
from .memory_and_state_checks import MEMORY_READS, POSE_CHAIN
from .predicate_checks import ASSERTING_PREDICATES, RETRACTING_PREDICATES, key_of_clause
from .program_model import ProgramModel, Subterm, subterms, wrap_term

_TABLE, _DYNAMIC, _AS = functor("table", 1), functor("dynamic", 1), functor("as", 2)
_CLAUSE = functor("clause", 2)
_ABOLISH = functor("abolish_all_tables", 0)


class _ChangingData(NamedTuple):
    """Data that change at run time and that a predicate reads.

    Attributes:
        text: name of the data in a warning.
        dynamic: functor of the dynamic predicate, if the data are its clauses.
    """

    text: str
    dynamic: Optional[Functor] = None


class _PredicateDeclaration(NamedTuple):
    """Declaration by ``table/1`` or ``dynamic/1``: its place, and the names of its options."""

    place: Optional[Place]
    options: Set[str]


def find_stale_tables(program: ProgramModel) -> Iterator[RuleError]:
    """Yield tables that read changing data and are never evaluated again."""
    tables = _find_declarations(program, _TABLE)
    if not tables:
        return
    run_time_subterms = list(_run_time_subterms(program))
    if any(subterm.key is _ABOLISH for subterm in run_time_subterms):
        # The program controls the evaluation of its tables itself.
        return
    changed_predicates = {key for subterm in run_time_subterms for key in _find_changed_predicates(subterm)}
    reads = _direct_reads(program, changed_predicates)
    callers = _callers_by_predicate(program)
    # A dictionary and not a set, so that warnings have the order of the declarations.
    incremental = dict.fromkeys(key for key in tables if _is_incremental(program, key))

    # A dynamic table is stale if its own clauses change.
    for key in tables:
        if key in changed_predicates:
            reads.setdefault(key, _ChangingData("clauses of its own"))
    readers = _propagate_reads(reads, callers, ())
    for key, declaration in tables.items():
        if key in readers and key not in incremental and "opaque" not in declaration.options:
            yield RuleError(_explain_stale_table(program, key, readers[key]), declaration.place)

    # Changes below a table that is not incremental do not reach the incremental tables above it. The lower table has
    # its own warning, so reads are not propagated beyond it.
    untracked = _reads_of_untracked_predicates(program, reads)
    readers = _propagate_reads(untracked, callers, [key for key in tables if key not in incremental])
    for key in incremental:
        if key in readers:
            yield RuleError(
                f"incremental table {key} reads {readers[key].text}, and does not notice changes: "
                f"write :- dynamic {readers[key].dynamic} as incremental",
                tables[key].place,
            )


def _explain_stale_table(program: ProgramModel, key: Functor, data: _ChangingData) -> str:
    dynamic_advice = ""
    if data.dynamic is not None and not _is_incremental(program, data.dynamic):
        dynamic_advice = f" and :- dynamic {data.dynamic} as incremental"
    return (
        f"table {key} reads {data.text}, and keeps its answers when that changes: write :- table {key} as "
        f"incremental{dynamic_advice}; if this is intended, write :- table {key} as opaque"
    )


def _reads_of_untracked_predicates(
    program: ProgramModel, reads: Dict[Functor, _ChangingData]
) -> Dict[Functor, _ChangingData]:
    """Return the reads of dynamic predicates that are neither incremental nor declared opaque."""
    opaque = {
        key
        for key, declaration in _find_declarations(program, _DYNAMIC).items()
        if "opaque" in declaration.options
    }
    return {
        key: data
        for key, data in reads.items()
        if data.dynamic is not None
        and data.dynamic not in opaque
        and not _is_incremental(program, data.dynamic)
    }


def _is_incremental(program: ProgramModel, key: Functor) -> bool:
    predicate = program.logic.database.predicates.get(key)
    return predicate is not None and predicate.is_incremental


def _find_declarations(program: ProgramModel, key: Functor) -> Dict[Functor, _PredicateDeclaration]:
    """Return the declarations that directives make by ``table/1`` or ``dynamic/1``."""
    declarations: Dict[Functor, _PredicateDeclaration] = {}
    for goal in program.goals:
        for call in calls(goal.parent, goal.position):
            term: Any = deref(call.term)
            if term.__class__ is tuple and term[0] is key:
                place = Subterm(term, call.parent, call.position, goal.place_of).place
                for declared_key, options in _declared_items(term[1]):
                    declaration = declarations.setdefault(declared_key, _PredicateDeclaration(place, set()))
                    declaration.options.update(options)
    return declarations


def _declared_items(term: Term) -> Iterator[Tuple[Functor, FrozenSet[str]]]:
    """Yield the functors in a declaration, each with the names of its options."""
    stack: List[Tuple[Any, FrozenSet[str]]] = [(deref(term), frozenset())]
    while stack:
        item, options = stack.pop()
        if item.__class__ is not tuple:
            continue
        if item[0] is CONS or item[0] is COMMA:
            stack += [(deref(item[2]), options), (deref(item[1]), options)]
        elif item[0] is _AS:
            names = [option.name for option in conjuncts(item[2]) if isinstance(option, Atom)]
            stack.append((deref(item[1]), options.union(names)))
        elif item[0] is SLASH:
            name, arity = deref(item[1]), deref(item[2])
            if isinstance(name, Atom) and isinstance(arity, int):
                yield functor(name.name, arity), options
        else:
            # A head whose arguments are modes, as in ``path(_, _, min)``.
            yield item[0], options


def _run_time_subterms(program: ProgramModel) -> Iterator[Subterm]:
    """Yield the subterms of goals that may be called after the program has been loaded."""
    run_time_predicates = _run_time_predicates(program)
    for clause in program.clauses:
        if functor_of(clause.head) in run_time_predicates:
            yield from subterms(clause.parent, clause.position, clause.place_of)
    for rule in program.rules:
        yield from subterms(wrap_term(rule.definition.term), 1, rule.place_of)


def _run_time_predicates(program: ProgramModel) -> Set[Functor]:
    """Return the predicates that rules reach, and those without a caller, which external queries may call.

    All others are called by directives and goal files only: their changes are complete before the first event.
    """
    callees: Dict[Functor, Set[Functor]] = {}
    for clause in program.clauses:
        head_key = functor_of(clause.head)
        if head_key is not None:
            callees.setdefault(head_key, set()).update(
                _functors_of(subterms(clause.parent, clause.position, clause.place_of))
            )
    called_keys = {
        key
        for goal in program.goals
        for key in _functors_of(subterms(goal.parent, goal.position, goal.place_of))
    }
    # A predicate that calls only itself still needs a first caller.
    called_keys.update(key for head_key, keys in callees.items() for key in keys if key is not head_key)
    # A predicate without a caller in the program exists for queries from outside.
    pending = [key for key in callees if key not in called_keys]
    for rule in program.rules:
        pending += _functors_of(subterms(wrap_term(rule.definition.term), 1, rule.place_of))
    reached: Set[Functor] = set()
    while pending:
        key = pending.pop()
        if key not in reached:
            reached.add(key)
            pending += callees.get(key, ())
    return reached


def _functors_of(terms: Iterable[Subterm]) -> Iterator[Functor]:
    return (subterm.key for subterm in terms if subterm.key is not None)


def _find_changed_predicates(subterm: Subterm) -> Iterator[Functor]:
    """Yield the predicate to which a goal adds clauses, or from which it removes them."""
    term = subterm.term
    if term.__class__ is tuple and (term[0] in ASSERTING_PREDICATES or term[0] in RETRACTING_PREDICATES):
        key = key_of_clause(term[1])
        if key is not None:
            yield key


def _direct_reads(program: ProgramModel, changed_predicates: Set[Functor]) -> Dict[Functor, _ChangingData]:
    """Return an example of the changing data that each predicate reads itself; other predicates have no entry."""
    reads: Dict[Functor, _ChangingData] = {}
    for clause in program.clauses:
        head_key = functor_of(clause.head)
        if head_key is None or head_key in reads:
            continue
        for call in calls(clause.parent, clause.position):
            data = _data_read_by_goal(program, call.term, changed_predicates)
            if data is not None:
                reads[head_key] = data
                break
    return reads


def _data_read_by_goal(
    program: ProgramModel, term: Any, changed_predicates: Set[Functor]
) -> Optional[_ChangingData]:
    """Return the changing data that a goal reads, or None."""
    goal: Any = deref(term)
    key = functor_of(goal)
    # ``clause(Head, Body)`` reads the clauses of the predicate of its head.
    if key is _CLAUSE:
        key = functor_of(goal[1])
    if key is None:
        return None
    if key in changed_predicates:
        return _ChangingData(f"{key}, which the program changes", key)
    if goal.__class__ is not tuple or not program.logic.is_system_predicate(key):
        return None
    if key in MEMORY_READS or key is POSE_CHAIN:
        name: Any = deref(goal[1])
        return _ChangingData(
            f"memory {name.name}" if isinstance(name, Atom) and key is not POSE_CHAIN else "memories"
        )
    if key in TRANSFORM_PREDICATES:
        return _ChangingData("transforms")
    if key in HOLDS:
        state = queried_state(goal)
        return _ChangingData("states" if state is None else f"state {state}")
    return None


def _callers_by_predicate(program: ProgramModel) -> Dict[Functor, List[Functor]]:
    callers: Dict[Functor, List[Functor]] = {}
    for clause in program.clauses:
        head_key = functor_of(clause.head)
        if head_key is not None:
            for call in calls(clause.parent, clause.position):
                key = functor_of(call.term)
                if key is not None:
                    callers.setdefault(key, []).append(head_key)
    return callers


def _propagate_reads(
    reads: Dict[Functor, _ChangingData], callers: Dict[Functor, List[Functor]], barriers: Iterable[Functor]
) -> Dict[Functor, _ChangingData]:
    """Return the data that each predicate reads itself or by its calls.

    Reads of predicates in ``barriers`` are not propagated to their callers.
    """
    readers = dict(reads)
    barrier_keys = set(barriers)
    pending = deque(readers)
    while pending:
        key = pending.popleft()
        # Breadth first, so that the warning names the data with the shortest chain of calls.
        if key in barrier_keys:
            continue
        for caller in callers.get(key, ()):
            if caller not in readers:
                readers[caller] = readers[key]
                pending.append(caller)
    return readers
