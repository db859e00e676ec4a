"""Checks of memories: unknown names, wrong records, and tables that become stale.

A table stores answers. If it reads memories, states or dynamic predicates, its answers become stale when these
change. `find_stale_tables` propagates reads along the call graph, from the predicates that read to their callers:
once for tables that are not incremental, and once for incremental ones, which are not notified of changes in a
dynamic predicate without the property ``incremental``. Each edge is followed once, so the time is linear in the size
of the program.
"""

from collections import deque
from typing import Any, Dict, FrozenSet, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import Place, RuleError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.list_terms import conjuncts, list_items, list_parts
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, Functor, Term, Var, deref, functor
from ...prolog.terms.unification import may_unify
from ..knowledge.transform_predicates import TRANSFORM_PREDICATES
from ..language.called_predicates import calls
from ..language.rule_heads import SYNCHRONIZED
from ..language.state_parser import HOLDS, queried_state
from .predicate_checks import ASSERTING_PREDICATES, RETRACTING_PREDICATES, key_of_clause
from .program_model import ProgramModel, Subterm, key_of, subterms, wrap_term

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
        ("newest_matching", 4),
        ("prev_matching", 5),
        ("next_inf_matching", 5),
        ("next_matching", 6),
    )
)


RECORD_READS = frozenset(key for key in MEMORY_READS if not key.name.startswith("memory_"))
POSE_CHAIN = functor("pose_chain", 3)


def find_unknown_memories(program: ProgramModel) -> Iterator[RuleError]:
    """Yield memories that are read but not created by any goal."""
    names = [deref(memory.term[4]) for memory in program.memories]
    known_names: Set[str] = {name.name for name in names if isinstance(name, Atom)}
    # A memory whose name is computed at run time may be any of those that are read.
    if any(not isinstance(name, Atom) for name in names):
        return
    reported = set(known_names)
    for subterm in program.all_subterms():
        for name in _memory_names_in(subterm):
            if name.name not in reported:
                reported.add(name.name)
                yield RuleError(
                    f"there is no memory {name.name} yet{did_you_mean(name.name, known_names, 0.6)}",
                    subterm.place,
                )


def find_record_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield queries for records that a memory does not have, and memory names in a wrong position."""
    records = _records_by_memory(program)
    # A memory whose name is computed at run time may be the queried one.
    if None in records:
        return
    sizes = {
        getattr(deref(memory.term[4]), "name", None): deref(memory.term[5]) for memory in program.memories
    }
    for subterm in program.all_subterms():
        term: Any = subterm.term
        if term.__class__ is not tuple:
            continue
        if term[0] in RECORD_READS and sizes.get(getattr(deref(term[1]), "name", "")) == 0:
            text = f"memory {program.logic.brief(term[1])} keeps 0 records: give memorize a size of 1 or more"
            yield RuleError(text, subterm.place)
        elif term[0] in SYNCHRONIZED:
            yield from _find_reversed_pairs(subterm, records)
        elif term[0] in RECORD_READS:
            name, record = deref(term[1]), deref(term[2])
            if isinstance(name, Atom):
                candidates = records.get(name.name, [record])
                # Variables of the query and of the records may take any value.
                if not any(may_unify(candidate, record) for candidate in candidates):
                    expected = _format_briefly(program, candidates[0])
                    queried = _format_briefly(program, record)
                    text = f"no record of memory {name.name} is {queried}: they are {expected}"
                    yield RuleError(text, subterm.place_of(term, 2))
            elif name.__class__ is not Var and isinstance(record, Atom) and record.name in records:
                text = f"the memory comes first: {term[0].name}({record.name}, {_format_briefly(program, name)}, ...)"
                yield RuleError(text, subterm.place)


def find_empty_memories(program: ProgramModel) -> Iterator[RuleError]:
    """Yield memories of size 0 that no goal reads; `find_record_mismatches` yields the goals that read one."""
    read_names = {
        getattr(deref(subterm.term[1]), "name", None)
        for subterm in program.all_subterms()
        if subterm.key in RECORD_READS and subterm.term.__class__ is tuple
    }
    for memory in program.memories:
        if deref(memory.term[5]) == 0 and getattr(deref(memory.term[4]), "name", None) not in read_names:
            text = f"memory {program.logic.brief(memory.term[4])} keeps 0 records: write a size of 1 or more"
            yield RuleError(f"{memory.prefix}{text}", memory.place_of(memory.term, 5))


def _format_briefly(program: ProgramModel, term: Term) -> str:
    return program.logic.brief(term, {var: program.names.get(var, "_") for var in variables(term)})


def _records_by_memory(program: ProgramModel) -> Dict[Optional[str], List[Term]]:
    """Return the records of each memory by its name; the key None stands for names that are computed at run time."""
    records: Dict[Optional[str], List[Term]] = {}
    for memory in program.memories:
        name = deref(memory.term[4])
        records.setdefault(name.name if isinstance(name, Atom) else None, []).append(memory.output_term)
    return records


def _find_reversed_pairs(subterm: Subterm, records: Dict[Optional[str], List[Term]]) -> Iterator[RuleError]:
    """Yield pairs ``[Time, Memory]`` of a synchronized query, whose order must be ``[Memory, Time]``."""
    for item in list_items(subterm.term[3]) or ():
        pair = list_items(item)
        if pair is not None and len(pair) == 2:
            name = deref(pair[1])
            if isinstance(name, Atom) and name.name in records:
                yield RuleError(f"the memory comes before its time: [{name.name}, T]", subterm.place)


def _memory_names_in(subterm: Subterm) -> Iterator[Atom]:
    """Yield the names of the memories that a goal reads."""
    term: Any = subterm.term
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
    incremental = {key for key in tables if _is_incremental(program, key)}

    # A dynamic table is stale if its own clauses change.
    for key in changed_predicates.intersection(tables):
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
        f"incremental{dynamic_advice}; where it is meant so, :- table {key} as opaque"
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
        if key_of(clause.head) in run_time_predicates:
            yield from subterms(clause.parent, clause.position, clause.place_of)
    for rule in program.rules:
        yield from subterms(wrap_term(rule.definition.term), 1, rule.place_of)


def _run_time_predicates(program: ProgramModel) -> Set[Functor]:
    """Return the predicates that rules reach, and those without a caller, which external queries may call.

    All others are called by directives and goal files only: their changes are complete before the first event.
    """
    callees: Dict[Functor, Set[Functor]] = {}
    for clause in program.clauses:
        head_key = key_of(clause.head)
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
        head_key = key_of(clause.head)
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
    key = key_of(goal)
    # ``clause(Head, Body)`` reads the clauses of the predicate of its head.
    if key is _CLAUSE:
        key = key_of(goal[1])
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
    """Return the callers of each predicate."""
    callers: Dict[Functor, List[Functor]] = {}
    for clause in program.clauses:
        head_key = key_of(clause.head)
        if head_key is not None:
            for call in calls(clause.parent, clause.position):
                key = key_of(call.term)
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
