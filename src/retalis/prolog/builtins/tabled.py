"""Tabled predicates: their declarations, and forgetting what their tables hold."""

from typing import Dict, Optional

from ..machine import Frame
from ..terms import SLASH, Functor, Term, Values, copy, deref, functor
from .arguments import indicator_of
from .clauses import declared
from .modes import Mode, modes_of
from .program import Machine
from .registry import control, deterministic
from .tabling import tables_of


@deterministic("table/1")
def table_declaration(machine: Machine, which: Term) -> bool:
    """Declare predicates tabled."""
    for item in declared(machine.logic.database.modules.names_of(which)):
        if item.__class__ is tuple and item[0].name == ":" and len(item) == 3:
            item = deref(item[2])
        declare_as(machine, item)
    return True


def declare_as(machine: Machine, item: Term) -> None:
    """Make the predicate tabled that ``Name/Arity`` names, or a term that has the modes of its arguments."""
    item = deref(item)
    if item.__class__ is tuple and item[0] is not SLASH:
        key, modes = modes_of(item)
    else:
        key, modes = indicator_of(item), {}
    declare(machine, key, modes)
    tables_of(machine).declared.setdefault(key, copy(item))


def declare(machine: Machine, key: Functor, modes: Dict[int, Mode]) -> None:
    """Make a predicate tabled: its clauses go to a hidden predicate that the tables call."""
    database = machine.logic.database
    if database.predicate(key).tabled is not None:
        return
    predicate = database.writable(key, "modify")
    hidden = database.predicate(functor(f"{key.name} tabled", key.arity))
    for clause in list(predicate.live()):
        hidden.add(clause)
    tables = tables_of(machine)
    predicate.table(hidden, tables.moded_caller(predicate, modes) if modes else tables.caller(predicate))
    database.forget()


@control("abolish_all_tables/0")
def abolish_all_tables(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Forget the answers of all tabled predicates."""
    tables = tables_of(machine)
    if not tables.active:
        tables.clear()
    return after
