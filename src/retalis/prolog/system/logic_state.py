"""What a program's logic knows, as data: its clauses, and all that outlives a goal."""

from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.errors import Place
from ..builtins.clause_predicates import declare_as
from ..builtins.global_state import flags_from
from ..builtins.recorded_database import records_of
from ..builtins.tabling import tables_of
from ..database.clause_index import Clause
from ..database.predicate import Predicate
from ..syntax.operators import Operators
from ..terms.types import Functor, Term
from .prolog_system import PrologSystem

_COUNTED = ("counters", "flags", "flag", "gensym", "counters of events", "flags of events")
_MODULES, _METAS = "modules", "arguments of predicates"
"""What built-ins keep by name."""

KeptClauses = Tuple[Functor, Tuple[bool, bool, bool, bool], List[Tuple[Term, Term, Optional[Place]]]]
"""A predicate: whether it is dynamic, discontiguous, multifile, defined; its clauses: heads, bodies, places."""


class KeptLogic(NamedTuple):
    """What the program says: `restore_logic` makes a logic of it.

    Attributes:
        operators: priorities, types and names of all operators.
        tabled: how tabled predicates were declared.
        predicates: the program's.
        incremental: those of them whose clauses incremental tables depend on.
    """

    operators: Tuple[Sequence[int], Sequence[str], Sequence[str]]
    tabled: List[Term]
    predicates: List[KeptClauses]
    incremental: List[Functor]


class KeptValues(NamedTuple):
    """What goals have left beside clauses; what is being done at the time is no part of it.

    Attributes:
        flags: Prolog's.
        values: the global variables.
        column: where what the program prints stands in its line.
        counted: what built-ins keep by name.
        records: of the recorded database.
        answers: of tabled predicates, as far as they are known; those of incremental tables are found anew.
    """

    flags: Dict[str, Term]
    values: Dict[str, Term]
    column: int
    counted: Dict[str, Dict[Any, Any]]
    records: Any
    answers: Any


def keep_logic(logic: PrologSystem) -> KeptLogic:
    """Return what a program says."""
    tables = tables_of(logic.machine)
    predicates = program_predicates(logic)
    priorities, types, names = zip(*logic.operators)
    return KeptLogic(
        (priorities, types, names),
        tables.declarations(),
        [_kept(one) for one in predicates],
        [one.functor for one in predicates if one.incremental],
    )


def keep_values(logic: PrologSystem) -> KeptValues:
    """Return what goals have left, while none runs."""
    modules = logic.database.modules
    counted = {name: dict(logic.state[name]) for name in _COUNTED if name in logic.state}
    if modules.table or modules.metas:
        counted.update({_MODULES: modules.kept(), _METAS: dict(modules.metas)})
    return KeptValues(
        dict(logic.flags),
        dict(logic.globals),
        logic.column,
        counted,
        records_of(logic.machine).kept(),
        tables_of(logic.machine).kept(),
    )


def program_predicates(logic: PrologSystem) -> List[Predicate]:
    """Return the predicates whose clauses are kept, in their order."""
    every = logic.database.predicates.values()
    return [one for one in every if not one.library and one.tabled is None and not one.is_blank]


def _kept(one: Predicate) -> KeptClauses:
    clauses = [(clause.head, clause.body, clause.place) for clause in one.live()]
    return one.functor, (one.dynamic, one.discontiguous, one.multifile, one.kind == "user"), clauses


def restore_logic(logic: PrologSystem, kept: KeptLogic) -> None:
    """Have a new logic have the program of another one.

    Raises:
        PrologError: where it says something that no program can.
    """
    _restore_operators(logic.operators, kept.operators)
    tables = tables_of(logic.machine)
    for declaration in kept.tabled:
        declare_as(logic.machine, declaration)
    for functor in kept.incremental:
        tables.observe(logic.database.writable(functor, "modify"))
    for functor, marks, clauses in kept.predicates:
        predicate = logic.database.writable(functor, "modify")
        predicate.dynamic, predicate.discontiguous, predicate.multifile, there = marks
        predicate.kind = "user" if there else predicate.kind
        for head, body, place in clauses:
            predicate.add(Clause(predicate, head, body, place))


def restore_values(logic: PrologSystem, kept: KeptValues) -> None:
    """Have a logic with the program of another one know what goals had left there."""
    logic.flags.update(flags_from(kept.flags))
    logic.globals.update(kept.values)
    logic.column = kept.column
    for name in _COUNTED:
        if name in kept.counted:
            logic.state.setdefault(name, {}).update(kept.counted[name])
    modules = logic.database.modules
    modules.restore(kept.counted.get(_MODULES, {}))
    modules.metas.update(kept.counted.get(_METAS, {}))
    records_of(logic.machine).restore(kept.records)
    tables_of(logic.machine).restore(kept.answers)


def _restore_operators(
    operators: Operators, kept: Tuple[Sequence[int], Sequence[str], Sequence[str]]
) -> None:
    """Have a table have these operators and no others."""
    priorities, types, names = kept
    wanted = dict(zip(zip(types, names), priorities))
    there = {(kind, name): priority for priority, kind, name in operators}
    for kind, name in there:
        if (kind, name) not in wanted:
            operators.add(0, kind, name)
    for (kind, name), priority in wanted.items():
        if there.get((kind, name)) != priority:
            operators.add(priority, kind, name)
