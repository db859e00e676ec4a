"""State of a Prolog system as plain data, for snapshots and checkpoints.

`KeptLogic` is the program: operators, declarations of tables, and clauses. `KeptValues` is the data that goals leave
behind: flags, global variables, counters, and answers of tables. Both are taken while no goal runs, and
contain no code: compiled code is generated again by the system that restores them.
"""

from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from ...foundation.errors import Place
from ..builtins.clause_predicates import declare_as
from ..builtins.global_state import flags_from
from ..builtins.tabling import tables_of
from ..database.clause_index import Clause
from ..database.predicate import Predicate
from ..terms.types import Functor, Term
from .prolog_system import PrologSystem

_COUNTED = ("counters", "flags", "flag", "gensym", "counters of events", "flags of events")
_MODULES, _METAS = "modules", "arguments of predicates"
"""Names of the built-ins' data in `PrologSystem.state` and in `KeptValues.counted`."""

KeptClauses = Tuple[Functor, Tuple[bool, bool, bool, bool], List[Tuple[Term, Term, Optional[Place]]]]
"""Predicate: functor; whether it is dynamic, discontiguous, multifile, defined; heads, bodies, places of clauses."""


class KeptLogic(NamedTuple):
    """Program of a Prolog system; `restore_logic` loads it.

    Attributes:
        operators: priority, type and name of each operator that differs from the standard ones, see
            `Operators.changes`.
        tabled: declarations of tabled predicates.
        predicates: predicates of the program.
        incremental: predicates whose clauses incremental tables depend on.
    """

    operators: List[Tuple[int, str, str]]
    tabled: List[Term]
    predicates: List[KeptClauses]
    incremental: List[Functor]


class KeptValues(NamedTuple):
    """Data that goals have left besides clauses, taken while no goal runs.

    Attributes:
        flags: Prolog flags.
        values: global variables.
        column: column of the output at which the next text is printed.
        counted: data that built-ins store by name, such as counters.
        answers: known answers of tabled predicates; those of incremental tables are computed again.
    """

    flags: Dict[str, Term]
    values: Dict[str, Term]
    column: int
    counted: Dict[str, Dict[Any, Any]]
    answers: Any


def keep_logic(logic: PrologSystem) -> KeptLogic:
    """Return the program of a Prolog system."""
    tables = tables_of(logic.machine)
    predicates = program_predicates(logic)
    return KeptLogic(
        logic.operators.changes(),
        tables.declarations(),
        [_clauses_of(predicate) for predicate in predicates],
        [predicate.functor for predicate in predicates if predicate.incremental],
    )


def keep_values(logic: PrologSystem) -> KeptValues:
    """Return the data that goals have left. No goal may be running."""
    modules = logic.database.modules
    counted = {name: dict(logic.state[name]) for name in _COUNTED if name in logic.state}
    if modules.table or modules.metas:
        counted.update({_MODULES: modules.to_data(), _METAS: dict(modules.metas)})
    return KeptValues(
        dict(logic.flags),
        dict(logic.globals),
        logic.column,
        counted,
        tables_of(logic.machine).snapshot(),
    )


def program_predicates(logic: PrologSystem) -> List[Predicate]:
    """Return the program's predicates, in the order of their definition."""
    predicates = logic.database.predicates.values()
    return [
        predicate
        for predicate in predicates
        if not predicate.library and predicate.tabled is None and not predicate.is_blank
    ]


def _clauses_of(predicate: Predicate) -> KeptClauses:
    clauses = [(clause.head, clause.body, clause.place) for clause in predicate.active_clauses()]
    return (
        predicate.functor,
        (predicate.dynamic, predicate.discontiguous, predicate.multifile, predicate.kind == "user"),
        clauses,
    )


def restore_logic(logic: PrologSystem, kept_logic: KeptLogic) -> None:
    """Load a program into a new Prolog system.

    Raises:
        PrologError: if the program is invalid, for instance if it defines a fixed predicate.
    """
    for priority, op_type, name in kept_logic.operators:
        logic.operators.add(priority, op_type, name)
    tables = tables_of(logic.machine)
    # Declarations first: they create the hidden predicates that hold the clauses of tabled ones.
    for declaration in kept_logic.tabled:
        declare_as(logic.machine, declaration)
    for functor in kept_logic.incremental:
        tables.observe(logic.database.writable(functor, "modify"))
    for functor, marks, clauses in kept_logic.predicates:
        predicate = logic.database.writable(functor, "modify")
        predicate.dynamic, predicate.discontiguous, predicate.multifile, is_user = marks
        predicate.kind = "user" if is_user else predicate.kind
        for head, body, place in clauses:
            predicate.add(Clause(predicate, head, body, place))


def restore_values(logic: PrologSystem, kept_values: KeptValues) -> None:
    """Load the data of goals into a Prolog system whose program has been restored."""
    logic.flags.update(flags_from(kept_values.flags))
    logic.globals.update(kept_values.values)
    logic.column = kept_values.column
    for name in _COUNTED:
        if name in kept_values.counted:
            logic.state.setdefault(name, {}).update(kept_values.counted[name])
    modules = logic.database.modules
    modules.restore(kept_values.counted.get(_MODULES, {}))
    modules.metas.update(kept_values.counted.get(_METAS, {}))
    tables_of(logic.machine).restore(kept_values.answers)
