"""State of a Prolog system as plain data, for snapshots and checkpoints.

`ProgramSnapshot` is the program: operators, declarations of tables, and clauses. `ValuesSnapshot` has the values that
goals have stored: flags, global variables, counters, and answers of tables. Both are created while no goal runs, and
contain no code: compiled code is generated again by the system that restores them.
"""

from typing import Any, Dict, List, NamedTuple, Optional, Union

from ...foundation.source_places import Place
from ...serialization.state_fields import record_of
from ...serialization.stored_field_types import (
    ANYTHING,
    BOOLEAN,
    CALLABLE_TERM,
    COUNT,
    FUNCTOR,
    KEY,
    TERM,
    TEXT,
    FieldType,
    PlainType,
    compact_record_of,
    integer,
    invalid_value,
    mapping_of,
    one_of,
    optional,
    sequence_of,
    with_path,
)
from ..builtins.clause_predicates import declare_tabled
from ..builtins.flags_operators_modules import restored_flags
from ..builtins.tabling import StoredTable, tables_of
from ..database.module_system import ModuleSnapshot
from ..database.predicate import Predicate
from ..syntax.operators import TYPES, OperatorChange
from ..terms.types import Functor, Term
from .prolog_system import PrologSystem

_SAVED_STATE_KEYS = ("counters", "flags", "flag", "gensym", "counters of events", "flags of events")
"""Keys of `PrologSystem.state` whose values are saved, under the same keys, in `ValuesSnapshot.builtin_state`."""

_MODULES, _META_ARGUMENTS = "modules", "arguments of predicates"
"""Keys of `ValuesSnapshot.builtin_state` for the data of the module system."""


def _check_argument_kind(value: object) -> Union[str, int]:
    return value if isinstance(value, str) else integer(0, 100).check(value)


class PredicateProperties(NamedTuple):
    """Properties of a predicate.

    Attributes:
        is_dynamic: whether it is dynamic.
        is_dynamic_by_goal: whether it is dynamic only because a goal has asserted or retracted clauses.
        is_discontiguous: whether it is declared discontiguous.
        is_multifile: whether it is declared multifile.
        is_user_defined: whether the program defines it; otherwise it is known only by its declaration.
    """

    is_dynamic: bool
    is_dynamic_by_goal: bool
    is_discontiguous: bool
    is_multifile: bool
    is_user_defined: bool


class StoredClause(NamedTuple):
    """Clause of a predicate.

    Attributes:
        place: its place in a file, or None.
    """

    head: Term
    body: Term
    place: Optional[Place]


class PredicateSnapshot(NamedTuple):
    """Predicate with its clauses."""

    functor: Functor
    properties: PredicateProperties
    clauses: List[StoredClause]


PLACE = compact_record_of(
    Place,
    source=TEXT,
    line=COUNT,
    column=COUNT,
    text=TEXT,
    before=COUNT,
)
CLAUSES = sequence_of(
    compact_record_of(
        StoredClause,
        head=CALLABLE_TERM,
        body=TERM,
        place=optional(PLACE),
    )
)
_PREDICATE_FIELDS = compact_record_of(
    PredicateSnapshot,
    functor=FUNCTOR,
    properties=compact_record_of(
        PredicateProperties,
        is_dynamic=BOOLEAN,
        is_dynamic_by_goal=BOOLEAN,
        is_discontiguous=BOOLEAN,
        is_multifile=BOOLEAN,
        is_user_defined=BOOLEAN,
    ),
    clauses=CLAUSES,
)


def _check_predicate(value: object) -> PredicateSnapshot:
    predicate = _PREDICATE_FIELDS.check(value)
    for head, body, _ in predicate.clauses:
        arity = len(head) - 1 if isinstance(head, tuple) else 0
        # A clause in the wrong predicate would be called with missing arguments.
        if arity != predicate.functor.arity:
            raise invalid_value(head, f"a clause of {predicate.functor}")
        if body.__class__ in (int, float):
            raise invalid_value(body, "the body of a clause")
    return predicate


class ProgramSnapshot(NamedTuple):
    """Program of a Prolog system, which `restore_program` loads into another system.

    Attributes:
        operators: priority, type and name of each operator that differs from the standard ones, see
            `Operators.changes`.
        table_declarations: declarations of tabled predicates.
        observed_predicates: predicates whose clauses incremental tables depend on.
        empty_dynamic: functors without clauses that goals have made dynamic.
    """

    operators: List[OperatorChange]
    table_declarations: List[Term]
    predicates: List[PredicateSnapshot]
    observed_predicates: List[Functor]
    empty_dynamic: List[Functor]


PROGRAM = record_of(
    ProgramSnapshot,
    operators=sequence_of(
        compact_record_of(
            OperatorChange,
            priority=integer(0, 1200),
            type=one_of(*TYPES),
            name=TEXT,
        )
    ),
    table_declarations=sequence_of(TERM),
    predicates=sequence_of(PlainType("a predicate with its clauses", _check_predicate)),
    observed_predicates=sequence_of(FUNCTOR),
    empty_dynamic=sequence_of(FUNCTOR),
)


class ValuesSnapshot(NamedTuple):
    """Values that goals have stored, without clauses.

    Attributes:
        flags: Prolog flags.
        column: column of the output at which the next text is printed.
        builtin_state: data of built-in predicates by key: counters, flags of the event language, and modules.
        table_answers: known answers of tabled predicates; those of incremental tables are computed again.
    """

    flags: Dict[str, Term]
    global_variables: Dict[str, Term]
    column: int
    builtin_state: Dict[str, Dict[Any, Any]]
    table_answers: List[StoredTable]


_BUILTIN_STATE: Dict[str, FieldType[Any]] = {
    "counters": mapping_of(TEXT, integer()),
    "flags": mapping_of(TEXT, TERM),
    "flag": mapping_of(TEXT, TERM),
    "gensym": mapping_of(TEXT, COUNT),
    "counters of events": mapping_of(KEY, integer()),
    "flags of events": mapping_of(KEY, TERM),
    _MODULES: mapping_of(
        TEXT,
        compact_record_of(
            ModuleSnapshot,
            exports=sequence_of(FUNCTOR),
            imports=sequence_of(FUNCTOR),
            own_names=sequence_of(TEXT),
            import_names=sequence_of(TEXT),
        ),
    ),
    _META_ARGUMENTS: mapping_of(
        FUNCTOR, sequence_of(PlainType("the kind of an argument", _check_argument_kind), tuple)
    ),
}
"""Types of `ValuesSnapshot.builtin_state` by key."""


def _check_builtin_state(value: object) -> Dict[str, Dict[Any, Any]]:
    """Check data of built-in predicates by key; a key without data is omitted."""
    data_by_key = mapping_of(TEXT, ANYTHING).check(value)
    for name in data_by_key:
        if name not in _BUILTIN_STATE:
            raise invalid_value(name, "a kind of state of built-in predicates")
    return {name: with_path(name, _BUILTIN_STATE[name].check)(data) for name, data in data_by_key.items()}


VALUES = record_of(
    ValuesSnapshot,
    flags=mapping_of(TEXT, TERM),
    global_variables=mapping_of(TEXT, TERM),
    column=COUNT,
    builtin_state=FieldType(
        "data of built-in predicates",
        lambda context: _check_builtin_state,
        lambda data_by_key, graph: [
            [name, _BUILTIN_STATE[name].encode(data)] for name, data in data_by_key.items()
        ],
    ),
    table_answers=sequence_of(
        compact_record_of(
            StoredTable,
            key=KEY,
            answers=sequence_of(sequence_of(TERM, tuple)),
            has_ground_answers=BOOLEAN,
        )
    ),
)


def snapshot_program(logic: PrologSystem) -> ProgramSnapshot:
    """Return the program of a Prolog system."""
    tables = tables_of(logic.machine)
    predicates = program_predicates(logic)
    return ProgramSnapshot(
        logic.operators.changes(),
        tables.declarations(),
        [_snapshot_predicate(predicate) for predicate in predicates],
        [predicate.functor for predicate in predicates if predicate.is_incremental],
        [
            *logic.database.empty_dynamic,
            *(key for key, predicate in logic.database.predicates.items() if predicate.is_forgettable),
        ],
    )


def snapshot_values(logic: PrologSystem) -> ValuesSnapshot:
    """Return the values that goals have stored. No goal may be running."""
    modules = logic.database.modules
    builtin_state = {name: dict(logic.state[name]) for name in _SAVED_STATE_KEYS if name in logic.state}
    if modules.modules or modules.declared_kinds_of:
        builtin_state.update({_MODULES: modules.snapshot(), _META_ARGUMENTS: dict(modules.declared_kinds_of)})
    return ValuesSnapshot(
        dict(logic.flags),
        dict(logic.globals),
        logic.column,
        builtin_state,
        tables_of(logic.machine).snapshot(),
    )


def program_predicates(logic: PrologSystem) -> List[Predicate]:
    """Return the program's predicates, in the order of their definition, without those that have no contents."""
    predicates = logic.database.predicates.values()
    return [
        predicate
        for predicate in predicates
        if not predicate.is_library_predicate
        and predicate.hidden_predicate is None
        and not predicate.is_undeclared
        and not predicate.is_forgettable
    ]


def _snapshot_predicate(predicate: Predicate) -> PredicateSnapshot:
    clauses = [StoredClause(clause.head, clause.body, clause.place) for clause in predicate.active_clauses()]
    return PredicateSnapshot(
        predicate.functor,
        PredicateProperties(
            predicate.dynamic,
            predicate.is_dynamic_by_goal,
            predicate.discontiguous,
            predicate.multifile,
            predicate.kind == "user",
        ),
        clauses,
    )


def restore_program(logic: PrologSystem, program: ProgramSnapshot) -> None:
    """Load a program into a new Prolog system.

    Raises:
        PrologError: if the program is invalid, for instance if it defines a fixed predicate.
    """
    for priority, op_type, name in program.operators:
        logic.operators.add(priority, op_type, name)
    tables = tables_of(logic.machine)
    # Declarations first: they create the hidden predicates that hold the clauses of tabled ones.
    for declaration in program.table_declarations:
        declare_tabled(logic.machine, declaration)
    for key in program.observed_predicates:
        tables.observe(logic.database.writable(key))
    for key, properties, clauses in program.predicates:
        predicate = logic.database.writable(key)
        (
            predicate.dynamic,
            predicate.is_dynamic_by_goal,
            predicate.discontiguous,
            predicate.multifile,
            is_user_defined,
        ) = properties
        predicate.kind = "user" if is_user_defined else predicate.kind
        for head, body, place in clauses:
            predicate.add(logic.create_clause(predicate, head, body, place))
    logic.database.empty_dynamic.update(dict.fromkeys(program.empty_dynamic))


def restore_values(logic: PrologSystem, snapshot: ValuesSnapshot) -> None:
    """Load stored values into a Prolog system whose program has been restored."""
    logic.flags.update(restored_flags(snapshot.flags))
    logic.globals.update(snapshot.global_variables)
    logic.start_line(snapshot.column)
    for name in _SAVED_STATE_KEYS:
        if name in snapshot.builtin_state:
            logic.state.setdefault(name, {}).update(snapshot.builtin_state[name])
    modules = logic.database.modules
    modules.restore(snapshot.builtin_state.get(_MODULES, {}))
    modules.declared_kinds_of.update(snapshot.builtin_state.get(_META_ARGUMENTS, {}))
    tables_of(logic.machine).restore(snapshot.table_answers)
