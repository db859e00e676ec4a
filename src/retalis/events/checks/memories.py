"""Memories that are read or waited for, and not there."""

from typing import Any, Dict, Iterator, List, Optional, Set

from ...foundation import RuleError
from ...prolog.terms import Atom, Term, Var, deref, functor, list_items, list_parts, may_unify, variables
from ..language import SYNCHRONIZED
from .near import meant
from .overview import Overview
from .written import Inner

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


def unknown_memories(program: Overview) -> Iterator[RuleError]:
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


def wrong_records(program: Overview) -> Iterator[RuleError]:
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


def _shown(program: Overview, term: Term) -> str:
    return program.logic.brief(term, {var: program.names.get(var, "_") for var in variables(term)})


def _records(program: Overview) -> Dict[Optional[str], List[Term]]:
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
