"""Checks of memories and states: unknown names, wrong records, and memories without records."""

from typing import Any, Dict, Iterator, List, Optional, Set

from ...foundation.errors import RuleError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.list_terms import list_items, list_parts
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import Atom, Term, Var, deref, functor
from ...prolog.terms.unification import may_unify
from ..language.rule_heads import SYNCHRONIZED
from ..language.state_parser import queried_state
from .program_model import FunctorSuggestions, ProgramModel, Subterm

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


def find_undeclared_states(program: ProgramModel) -> Iterator[RuleError]:
    """Yield states that goals query but nothing declares."""
    declared_functors = [state.form.functor for state in program.states]
    suggestions = FunctorSuggestions()
    for subterm in program.calls():
        key = queried_state(subterm.term)
        if key is None or key in declared_functors or not program.logic.is_system_predicate(subterm.term[0]):
            continue
        suggestion = suggestions.suggest(key, declared_functors)
        hint = (
            f"; did you mean {suggestion}?"
            if suggestion
            else ": state(S, from(Event), until(Event)) declares one"
        )
        yield RuleError(f"there is no state {key}{hint}", subterm.place)


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
