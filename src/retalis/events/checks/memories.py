"""Memories that are read or waited for, and not there."""

from typing import Any, Iterator, List, Set

from ...foundation import RuleError
from ...prolog.terms import Atom, Term, deref, functor, list_items
from ..language import SYNCHRONIZED
from .near import meant
from .overview import Overview
from .written import Inner

_READS = frozenset(
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


def _memories_in(inner: Inner) -> Iterator[Atom]:
    term: Any = inner.term
    if term.__class__ is not tuple:
        return
    names: List[Term] = [term[1]] if term[0] in _READS else []
    if term[0] in SYNCHRONIZED:
        names = [pair[0] for pair in map(list_items, list_items(term[3]) or ()) if pair]
    for name in map(deref, names):
        if isinstance(name, Atom):
            yield name
