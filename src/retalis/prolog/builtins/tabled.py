"""Tabled predicates: their declarations, and forgetting what their tables hold."""

from typing import Dict, Optional

from ..database import functor_of
from ..machine import Frame, domain_error, indicator
from ..terms import SLASH, Functor, Term, Values, conjuncts, copy, deref, functor
from .arguments import callable_of, indicator_of
from .clauses import declare_dynamic, declared_with_options
from .modes import Mode, modes_of
from .program import Machine
from .registry import control, deterministic
from .tabling import AS, tables_of

_IGNORED = {
    "subsumptive": "each variant of a call has a table of its own",
    "shared": "goals run in one thread",
    "lazy": "declare it incremental",
    "monotonic": "declare it incremental",
    "max_answers": "all answers are kept",
    "answer_abstract": "answers of any size are kept",
    "subgoal_abstract": "calls of any size have tables",
}
"""Options of SWI-Prolog that have no effect, and what is so instead."""

_WITH_ARGUMENT = ("max_answers", "answer_abstract", "subgoal_abstract")


@deterministic("table/1")
def table_declaration(machine: Machine, which: Term) -> bool:
    """Declare predicates tabled; ``as incremental`` has their tables depend on what they read."""
    for item, options in declared_with_options(machine.logic.database.modules.names_of(which)):
        if item.__class__ is tuple and item[0].name == ":" and len(item) == 3:
            item = deref(item[2])
        declare_as(machine, item, options)
    return True


def declare_as(machine: Machine, item: Term, options: Values = ()) -> None:
    """Make the predicate tabled that ``Name/Arity`` names, or a term that has the modes of its arguments.

    Args:
        machine: of the program.
        item: what is declared.
        options: those of ``as``: later declarations add theirs.

    Raises:
        PrologError: where it names no predicate, or there is no such mode or option.
    """
    item = deref(item)
    if item.__class__ is tuple and item[0] is AS:
        declare_as(machine, item[1], (*options, *conjuncts(item[2])))
        return
    if item.__class__ is tuple and item[0] is not SLASH:
        key, modes = modes_of(item)
    else:
        key, modes = indicator_of(item), {}
    names = [_option(machine, key, option) for option in options]
    declare(machine, key, modes)
    tables = tables_of(machine)
    tables.declared.setdefault(key, copy(item))
    predicate = machine.logic.database.predicate(key)
    if "dynamic" in names:
        declare_dynamic(machine, indicator(key), set())
    incremental = "incremental" in names or (predicate.incremental and "opaque" not in names)
    if incremental != predicate.incremental:
        predicate.incremental = incremental
        machine.logic.database.changes += 1
        tables.clear()
    if incremental:  # clauses of the predicate itself may be added and removed, too
        tables.observe(predicate.with_clauses)


def _option(machine: Machine, key: Functor, option: Term) -> str:
    """Return the name of an option; warn of one that has no effect."""
    option = callable_of(option)
    found = functor_of(option)
    name = found.name
    if found.arity != (name in _WITH_ARGUMENT) or name not in (*_IGNORED, *_OPTIONS):
        raise domain_error("table_option", option)
    if name in _IGNORED:
        text = f"Warning: table {key} as {machine.logic.show(option)}: the option has no effect: {_IGNORED[name]}\n"
        machine.logic.message("warning", text)
    return name


_OPTIONS = ("incremental", "opaque", "variant", "dynamic")


def declare(machine: Machine, key: Functor, modes: Dict[int, Mode]) -> None:
    """Make a predicate tabled: its clauses go to a hidden predicate that the tables call."""
    database = machine.logic.database
    if database.predicate(key).tabled is not None:
        return
    predicate = database.writable(key, "modify")
    hidden = database.predicate(functor(f"{key.name} tabled", key.arity))
    for clause in list(predicate.live()):
        hidden.add(clause)
    hidden.dynamic, hidden.discontiguous, hidden.multifile = (
        predicate.dynamic,
        predicate.discontiguous,
        predicate.multifile,
    )
    tables = tables_of(machine)
    if predicate.incremental:  # a dynamic predicate: what it was declared holds for its clauses
        predicate.incremental = False
        tables.observe(hidden)
    predicate.table(hidden, tables.moded_caller(predicate, modes) if modes else tables.caller(predicate))
    database.forget()


@control("abolish_all_tables/0")
def abolish_all_tables(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Forget the answers of all tabled predicates."""
    tables_of(machine).clear()
    return after
