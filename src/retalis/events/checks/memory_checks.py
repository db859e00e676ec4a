"""Memories that are read or waited for, and not there.

Tables that keep answers although the memories, states or clauses that they read change.

Reads are followed through the calls in the clauses of the program, from the predicates that read to
those that call them: once for tables that are not incremental, and once more for incremental ones, which learn
nothing of a dynamic predicate that is not declared so. Each step is taken once: the time is linear in the program's
size.
"""

from collections import deque
from typing import Any, Dict, FrozenSet, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import Place, RuleError
from ...prolog.terms.list_terms import conjuncts, list_items, list_parts
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, Functor, Term, Var, deref, functor
from ...prolog.terms.unification import may_unify
from ..language.goal_analysis import calls
from ..language.rule_parser import SYNCHRONIZED
from ..language.state_parser import HOLDS, asked_state
from .predicate_checks import ADDS, RETRACTS, key_of_clause
from .program_model import Inner, ProgramModel, held, inners, key_of, meant

MEMORY_READS = frozenset(
    functor(name, arity)
    for name, arity in (
        ("prev", 5),
        ("prev_binary", 5),
        ("next", 6),
        ("next_binary", 6),
        ("next_inf", 5),
        ("access_mem", 3),
        ("memory_size", 2),
        ("memory_counter", 2),
        ("memory_gap", 3),
        *(("newest_matching", 4), ("prev_matching", 5), ("next_inf_matching", 5), ("next_matching", 6)),
    )
)


_LOOKS = frozenset(key for key in MEMORY_READS if not key.name.startswith("memory_"))
POSE_CHAIN = functor("pose_chain", 3)


def unknown_memories(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the memories that are read and that are not there, nor made by a goal."""
    names = [deref(kept.term[4]) for kept in program.memories]
    known: Set[str] = {name.name for name in names if isinstance(name, Atom)}
    if any(not isinstance(name, Atom) for name in names):  # which ones are made is known only then
        return
    said = set(known)
    for inner in program.calls():
        for name in _memories_in(inner):
            if name.name not in said:
                said.add(name.name)
                yield RuleError(
                    f"there is no memory {name.name} yet{meant(name.name, known, 0.6)}", inner.place
                )


def wrong_records(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the look-ups of records that no memory of that id has, and ids that stand in the wrong place."""
    records = _records(program)
    if None in records:
        return
    for inner in program.calls():
        term: Any = inner.term
        if term.__class__ is not tuple:
            continue
        if term[0] in SYNCHRONIZED:
            yield from _turned_round(inner, records)
        elif term[0] in _LOOKS:
            name, record = deref(term[1]), deref(term[2])
            if isinstance(name, Atom):
                kept = records.get(name.name, [record])
                if not any(may_unify(one, record) for one in kept):
                    shown = _shown(program, kept[0])
                    text = f"no record of memory {name.name} is {_shown(program, record)}: they are {shown}"
                    yield RuleError(text, inner.spot(term, 2))
            elif name.__class__ is not Var and isinstance(record, Atom) and record.name in records:
                text = f"the memory comes first: {term[0].name}({record.name}, {_shown(program, name)}, ...)"
                yield RuleError(text, inner.place)


def _shown(program: ProgramModel, term: Term) -> str:
    return program.logic.brief(term, {var: program.names.get(var, "_") for var in variables(term)})


def _records(program: ProgramModel) -> Dict[Optional[str], List[Term]]:
    """Return the records of each memory by its name; the name None where some are known only when they are made."""
    found: Dict[Optional[str], List[Term]] = {}
    for kept in program.memories:
        name = deref(kept.term[4])
        found.setdefault(name.name if isinstance(name, Atom) else None, []).append(kept.made)
    return found


def _turned_round(inner: Inner, records: Dict[Optional[str], List[Term]]) -> Iterator[RuleError]:
    """Yield the memories of a query that stand where their times belong."""
    for item in list_items(inner.term[3]) or ():
        pair = list_items(item)
        if pair is not None and len(pair) == 2:
            name = deref(pair[1])
            if isinstance(name, Atom) and name.name in records:
                yield RuleError(f"the memory comes before its time: [{name.name}, T]", inner.place)


def _memories_in(inner: Inner) -> Iterator[Atom]:
    term: Any = inner.term
    if term.__class__ is not tuple:
        return
    names: List[Term] = [term[1]] if term[0] in MEMORY_READS else []
    if term[0] in SYNCHRONIZED:
        names = [pair[0] for pair in map(list_items, list_items(term[3]) or ()) if pair]
    elif term[0] is POSE_CHAIN:
        names = list_parts(term[1])[0]
    for name in map(deref, names):
        if isinstance(name, Atom):
            yield name


_TABLE, _DYNAMIC, _AS = functor("table", 1), functor("dynamic", 1), functor("as", 2)
_CLAUSE = functor("clause", 2)
_ABOLISH = functor("abolish_all_tables", 0)


class _Dependency(NamedTuple):
    """Something that a predicate reads: its name in a warning, and its functor if it is a dynamic predicate."""

    shown: str
    dynamic: Optional[Functor] = None


class _Declared(NamedTuple):
    """The place of a declaration, and the names of its options."""

    place: Optional[Place]
    options: Set[str]


def stale_tables(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the tables that read what changes and are never evaluated again."""
    tables = _declared(program, _TABLE)
    if not tables:
        return
    running = list(_running(program))
    if any(inner.key is _ABOLISH for inner in running):
        return  # a program that abolishes its tables decides itself when they are evaluated again
    changed = {key for inner in running for key in _changed_by(inner)}
    reads = _reads(program, changed)
    callers = _callers(program)
    incremental = {key for key in tables if _is_incremental(program, key)}

    for key in changed.intersection(tables):
        reads.setdefault(key, _Dependency("clauses of its own"))
    found = _spread(reads, callers, ())
    for key, declared in tables.items():
        if key in found and key not in incremental and "opaque" not in declared.options:
            yield RuleError(_not_incremental(program, key, found[key]), declared.place)

    # Of what an incremental table calls through one that is not incremental it learns nothing, as said for that one.
    untracked = _untracked(program, reads)
    found = _spread(untracked, callers, [key for key in tables if key not in incremental])
    for key in incremental:
        if key in found:
            yield RuleError(
                f"incremental table {key} reads {found[key].shown}, and does not notice changes: "
                f"write :- dynamic {found[key].dynamic} as incremental",
                tables[key].place,
            )


def _not_incremental(program: ProgramModel, key: Functor, read: _Dependency) -> str:
    also = ""
    if read.dynamic is not None and not _is_incremental(program, read.dynamic):
        also = f" and :- dynamic {read.dynamic} as incremental"
    return (
        f"table {key} reads {read.shown}, and keeps its answers when that changes: write :- table {key} as "
        f"incremental{also}; where it is meant so, :- table {key} as opaque"
    )


def _untracked(program: ProgramModel, reads: Dict[Functor, _Dependency]) -> Dict[Functor, _Dependency]:
    """Return the reads of dynamic predicates that are not incremental, nor declared opaque."""
    meant = {key for key, declared in _declared(program, _DYNAMIC).items() if "opaque" in declared.options}
    return {
        key: read
        for key, read in reads.items()
        if read.dynamic is not None
        and read.dynamic not in meant
        and not _is_incremental(program, read.dynamic)
    }


def _is_incremental(program: ProgramModel, key: Functor) -> bool:
    predicate = program.logic.database.predicates.get(key)
    return predicate is not None and predicate.incremental


def _declared(program: ProgramModel, key: Functor) -> Dict[Functor, _Declared]:
    """Return what directives declare by ``table/1`` or ``dynamic/1``."""
    found: Dict[Functor, _Declared] = {}
    for goal in program.goals:
        for call in calls(goal.parent, goal.number):
            term: Any = deref(call.term)
            if term.__class__ is tuple and term[0] is key:
                place = Inner(term, call.parent, call.number, goal.spot).place
                for one, options in _items(term[1]):
                    before = found.setdefault(one, _Declared(place, set()))
                    before.options.update(options)
    return found


def _items(term: Term) -> Iterator[Tuple[Functor, FrozenSet[str]]]:
    """Yield the functors that a declaration names, each with the names of its options."""
    stack: List[Tuple[Any, FrozenSet[str]]] = [(deref(term), frozenset())]
    while stack:
        item, options = stack.pop()
        if item.__class__ is not tuple:
            continue
        if item[0] is CONS or item[0] is COMMA:
            stack += [(deref(item[2]), options), (deref(item[1]), options)]
        elif item[0] is _AS:
            names = [one.name for one in conjuncts(item[2]) if isinstance(one, Atom)]
            stack.append((deref(item[1]), options.union(names)))
        elif item[0] is SLASH:
            name, arity = deref(item[1]), deref(item[2])
            if isinstance(name, Atom) and isinstance(arity, int):
                yield functor(name.name, arity), options
        else:  # a head with modes
            yield item[0], options


# What changes


def _running(program: ProgramModel) -> Iterator[Inner]:
    """Yield the terms in goals that may be called when the program has been loaded."""
    running = _called_later(program)
    for clause in program.clauses:
        if key_of(clause.head) in running:
            yield from inners(clause.parent, clause.number, clause.spot)
    for rule in program.rules:
        yield from inners(held(rule.definition.term), 1, rule.spot)


def _called_later(program: ProgramModel) -> Set[Functor]:
    """Return the predicates that rules lead to, or that nothing calls: queries from outside may.

    The others are called by directives and goal files only: their changes are over before the first event.
    """
    named: Dict[Functor, Set[Functor]] = {}
    for clause in program.clauses:
        own = key_of(clause.head)
        if own is not None:
            named.setdefault(own, set()).update(_named(inners(clause.parent, clause.number, clause.spot)))
    elsewhere = {key for goal in program.goals for key in _named(inners(goal.parent, goal.number, goal.spot))}
    elsewhere.update(key for own, keys in named.items() for key in keys if key is not own)
    waiting = [key for key in named if key not in elsewhere]
    for rule in program.rules:
        waiting += _named(inners(held(rule.definition.term), 1, rule.spot))
    found: Set[Functor] = set()
    while waiting:
        key = waiting.pop()
        if key not in found:
            found.add(key)
            waiting += named.get(key, ())
    return found


def _named(terms: Iterable[Inner]) -> Iterator[Functor]:
    return (inner.key for inner in terms if inner.key is not None)


def _changed_by(inner: Inner) -> Iterator[Functor]:
    """Yield the predicate whose clauses a goal adds or removes."""
    term = inner.term
    if term.__class__ is tuple and (term[0] in ADDS or term[0] in RETRACTS):
        key = key_of_clause(term[1])
        if key is not None:
            yield key


# What is read


def _reads(program: ProgramModel, changed: Set[Functor]) -> Dict[Functor, _Dependency]:
    """Return something that changes for each predicate whose clauses read that themselves."""
    found: Dict[Functor, _Dependency] = {}
    for clause in program.clauses:
        own = key_of(clause.head)
        if own is None or own in found:
            continue
        for call in calls(clause.parent, clause.number):
            read = _read_by(program, call.term, changed)
            if read is not None:
                found[own] = read
                break
    return found


def _read_by(program: ProgramModel, term: Any, changed: Set[Functor]) -> Optional[_Dependency]:
    """Return what a goal reads that changes."""
    goal: Any = deref(term)
    key = key_of(goal)
    if key is _CLAUSE:
        key = key_of(goal[1])
    if key is None:
        return None
    if key in changed:
        return _Dependency(f"{key}, which the program changes", key)
    if goal.__class__ is not tuple or not program.logic.is_of_system(key):
        return None
    if key in MEMORY_READS or key is POSE_CHAIN:
        name: Any = deref(goal[1])
        return _Dependency(
            f"memory {name.name}" if isinstance(name, Atom) and key is not POSE_CHAIN else "memories"
        )
    if key in HOLDS:
        state = asked_state(goal)
        return _Dependency("states" if state is None else f"state {state}")
    return None


def _callers(program: ProgramModel) -> Dict[Functor, List[Functor]]:
    """Return by each predicate those whose clauses call it."""
    found: Dict[Functor, List[Functor]] = {}
    for clause in program.clauses:
        own = key_of(clause.head)
        if own is not None:
            for call in calls(clause.parent, clause.number):
                key = key_of(call.term)
                if key is not None:
                    found.setdefault(key, []).append(own)
    return found


def _spread(
    reads: Dict[Functor, _Dependency], callers: Dict[Functor, List[Functor]], ends: Iterable[Functor]
) -> Dict[Functor, _Dependency]:
    """Return what predicates read by themselves or by what they call, but not through those at which it ends."""
    found = dict(reads)
    closed = set(ends)
    waiting = deque(found)
    while waiting:
        key = waiting.popleft()
        if key in closed:
            continue
        for caller in callers.get(key, ()):
            if caller not in found:
                found[caller] = found[key]
                waiting.append(caller)
    return found
