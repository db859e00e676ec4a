"""Predicates on clauses and declarations: ``assertz/1``, ``retract/1``, ``clause/2``, ``dynamic/1``, ``table/1``.

Goals that enumerate clauses follow the logical update view (ISO 13211-1, 7.5.4): the clauses are those at the time of
the call, whatever is added or removed meanwhile. A tabled predicate consists of two: its clauses belong to a hidden
predicate, which the tables call, and the predicate itself returns the answers of the tables.
"""

from typing import Callable, Dict, Iterator, List, Optional, Set, Tuple

from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from ..compiler.clause_nodes import CONTROL
from ..compiler.predicate_code import key_of
from ..database.clause_index import NEVER_RETRACTED, Clause, may_match
from ..database.goal_terms import functor_of
from ..database.predicate import Predicate
from ..machine.errors import domain_error, indicator, instantiation_error, permission_error, type_error
from ..machine.machine import LAST
from ..terms.list_terms import conjuncts
from ..terms.term_traversal import copy
from ..terms.types import (
    COMMA,
    CONS,
    NIL,
    SLASH,
    Atom,
    Frame,
    Functor,
    Term,
    Trail,
    Values,
    Var,
    atom,
    deref,
    functor,
)
from ..terms.unification import undo, unify
from .argument_checks import callable_of, indicator_of, is_iso, is_true, items, option_values
from .builtin_registry import Outcome, ProgramMachine, Solutions, control, deterministic, nondeterministic
from .tabling import AS, Mode, parse_moded_head, tables_of

_NECK = functor(":-", 2)


def _require_access(machine: ProgramMachine, key: Functor, action: str, object_type: str) -> Predicate:
    """Return the predicate that holds the clauses of a functor, for a goal that changes or reads them.

    Args:
        machine: the machine of the program.
        key: the functor.
        action: ``modify`` or ``access``.
        object_type: type of the object in the error term.

    Raises:
        PrologError: a permission error if goals may not do this.
    """
    predicate: Predicate = machine.logic.database.predicate(key)
    # Predicates of libraries may be read but not modified, except for dynamic ones; built-ins neither.
    if key in CONTROL or (
        predicate.is_library_predicate
        and (predicate.is_protected or action == "modify")
        and not predicate.dynamic
    ):
        raise permission_error(action, object_type, indicator(key))
    return predicate if predicate.hidden_predicate is None else predicate.hidden_predicate


def _assert_predicate(first: bool) -> Callable[[ProgramMachine, Term], bool]:
    """Return ``asserta/1`` if ``first``, otherwise ``assertz/1``."""

    def run(machine: ProgramMachine, term: Term) -> bool:
        logic = machine.logic
        clause = logic.add_clause(term, first=first, asserted=True)
        predicate = clause.predicate
        # A predicate that is created by an assertion is dynamic, one that was loaded from a file stays static.
        if not predicate.is_compiled and len(predicate) == 1:
            predicate.make_dynamic(by_goal=True)
        return True

    return run


def _strip_module(term: Term) -> Term:
    """Return a clause without its module qualification."""
    term = deref(term)
    while term.__class__ is tuple and term[0].name == ":" and len(term) == 3:
        term = deref(term[2])
    return term


deterministic("assertz/1", "assert/1")(_assert_predicate(False))
deterministic("asserta/1")(_assert_predicate(True))


def _split_clause(machine: ProgramMachine, term: Term) -> Tuple[Term, Term]:
    """Return the head and the body of a clause that is searched for."""
    modules = machine.logic.database.modules
    term = modules.resolve_searched_clause(term)
    if term.__class__ is tuple and term[0] is _NECK:
        return modules.resolve_searched_clause(term[1]), term[2]
    return term, atom("true")


def _head_functor(head: Term) -> Functor:
    if head.__class__ is Var:
        raise instantiation_error()
    if head.__class__ is tuple:
        key: Functor = head[0]
        return key
    if head.__class__ is Atom:
        return head.functor
    raise type_error("callable", head)


def _candidate_clauses(predicate: Predicate, head: Term) -> Iterator[Clause]:
    """Yield the current clauses whose heads may match."""
    # Tables that are being evaluated depend on these clauses.
    if predicate.is_incremental:
        predicate.report_read()
    frame = (None, *head[1:], None) if head.__class__ is tuple else (None, None)
    # Clauses are filtered by the keys of all arguments, beyond the index that `select` uses, before they are copied.
    keys = [key_of(arg) for arg in frame[1:-1]]
    generation = predicate.database.generation
    clauses, _ = predicate.select(frame)
    # By position: the list grows if a clause is added meanwhile, and those beyond its present length are not visible.
    for index in range(len(clauses)):
        clause = clauses[index]
        if clause.retracted_at > generation and may_match(keys, clause.keys):
            yield clause


@nondeterministic("retract/1")
def retract(machine: ProgramMachine, term: Term) -> Outcome:
    """Remove the first clause that unifies, and further ones on backtracking."""
    head, body = _split_clause(machine, term)
    predicate = _require_access(machine, _head_functor(head), "modify", "static_procedure")
    return _enumerate_clauses(machine, predicate, head, body, predicate.remove)


BodyConversion = Callable[[Term], Term]
"""Function that converts a clause body to the form that is unified, with names local to its module."""


def _enumerate_clauses(
    machine: ProgramMachine,
    predicate: Predicate,
    head: Term,
    body: Term,
    on_match: Optional[Callable[[Clause], object]],
) -> Outcome:
    """Enumerate the clauses that unify with a head and a body, and call ``on_match`` for each of them."""
    clauses = list(_candidate_clauses(predicate, head))
    trail, modules = machine.trail, machine.logic.database.modules
    is_qualified = on_match is None and modules.plain_functor(predicate.functor) is not None
    convert_body: BodyConversion = modules.display_form if is_qualified else _unchanged
    if len(clauses) > 1:
        return _enumerate_matching(trail, clauses, head, body, on_match, convert_body)
    return bool(clauses) and _unify_clause(trail, clauses[0], head, body, on_match, convert_body)


def _unchanged(body: Term) -> Term:
    return body


def _enumerate_matching(
    trail: Trail,
    clauses: List[Clause],
    head: Term,
    body: Term,
    on_match: Optional[Callable[[Clause], object]],
    convert_body: BodyConversion,
) -> Solutions:
    last = clauses[-1]
    for clause in clauses:
        # A failed unification may have bound variables, which the next clause must not see.
        mark = len(trail)
        if _unify_clause(trail, clause, head, body, on_match, convert_body):
            yield LAST if clause is last else None
        else:
            undo(trail, mark)


def _unify_clause(
    trail: Trail,
    clause: Clause,
    head: Term,
    body: Term,
    on_match: Optional[Callable[[Clause], object]],
    convert_body: BodyConversion,
) -> bool:
    clause_head, clause_body = _rename_variables(clause)
    if not unify(clause_head, head, trail) or not unify(convert_body(clause_body), body, trail):
        return False
    # A clause that another goal has removed meanwhile is a solution all the same, by the logical update view.
    if on_match is not None and clause.retracted_at == NEVER_RETRACTED:
        on_match(clause)
    return True


def _rename_variables(clause: Clause) -> Tuple[Term, Term]:
    """Return the head and the body of a clause with new variables."""
    # A ground clause needs no copy.
    if clause.is_ground_fact:
        return clause.head, clause.body
    new_vars: Dict[Var, Term] = {}
    return copy(clause.head, new_vars), copy(clause.body, new_vars)


@deterministic("retractall/1")
def retractall(machine: ProgramMachine, head: Term) -> bool:
    """Remove all clauses whose heads unify; a predicate that is not defined becomes dynamic."""
    head = machine.logic.database.modules.resolve_searched_clause(head)
    key = _head_functor(head)
    predicate = _require_access(machine, key, "modify", "static_procedure")
    # As in SWI-Prolog, later calls of an undefined predicate fail then, instead of raising an error.
    if not predicate.is_defined:
        predicate.make_dynamic(by_goal=True)
        machine.logic.database.count_change()
        return True
    trail = machine.trail
    mark = len(trail)
    # The list is complete before the first removal (logical update view).
    for clause in list(_candidate_clauses(predicate, head)):
        if unify(head, clause.head if clause.is_ground_fact else copy(clause.head), trail):
            predicate.remove(clause)
        undo(trail, mark)
    return True


@nondeterministic("clause/2")
def clause_of(machine: ProgramMachine, head: Term, body: Term) -> Outcome:
    """Enumerate the clauses of a predicate that unify with a head and a body."""
    head = machine.logic.database.modules.resolve_searched_clause(head)
    key = _head_functor(head)
    body = deref(body)
    if body.__class__ not in (Var, Atom, tuple):
        raise type_error("callable", body)
    predicate = _require_access(machine, key, "access", "private_procedure")
    return _enumerate_clauses(machine, predicate, head, body, None)


@deterministic("abolish/1")
def abolish(machine: ProgramMachine, term: Term) -> bool:
    """Remove all clauses and properties of a predicate."""
    key = indicator_of(machine.logic.database.modules.resolve_declared_indicators(term))
    predicate = _require_access(machine, key, "modify", "static_procedure")
    if predicate.is_defined and not predicate.dynamic and machine.logic.flags["iso"] is atom("true"):
        raise permission_error("modify", "static_procedure", indicator(key))
    predicate.abolish()
    return True


@deterministic("abolish/2")
def abolish_named(machine: ProgramMachine, name: Term, arity: Term) -> bool:
    """Remove all clauses and properties of a predicate."""
    return abolish(machine, (SLASH, name, arity))


def declared_items(term: Term) -> Iterator[Term]:
    """Yield the items of a declaration, which may be nested in lists and conjunctions."""
    return (item for item, _ in declared_items_with_options(term))


def declared_items_with_options(term: Term) -> Iterator[Tuple[Term, Values]]:
    """Yield the items of a declaration, each with its options after ``as``."""
    stack: List[Tuple[Term, Values]] = [(term, ())]
    visited_count = 0
    while stack:
        # A list of a million names is one inference.
        visited_count += 1
        if visited_count % len(STEPS_PER_ROUND) == 0:
            check_limits()
        item, options = stack.pop()
        item = deref(item)
        if item.__class__ is tuple and item[0] is COMMA:
            # Reversed, because the stack returns the last item first.
            stack += [(conjunct, options) for conjunct in reversed(list(conjuncts(item)))]
        elif item.__class__ is tuple and item[0] is CONS:
            stack += ((item[2], options), (item[1], options))
        elif item.__class__ is tuple and item[0] is AS:
            stack.append((item[1], (*options, *conjuncts(item[2]))))
        elif item is not NIL:
            yield item, options


def _declaration_predicate(attribute: str) -> Callable[[ProgramMachine, Term], bool]:
    """Return a predicate that sets an attribute of the predicates that it declares."""

    def run(machine: ProgramMachine, term: Term) -> bool:
        for item in declared_items(machine.logic.database.modules.resolve_declared_indicators(term)):
            predicate = machine.logic.database.writable(indicator_of(item))
            setattr(predicate, attribute, True)
            machine.logic.database.count_change()
        return True

    return run


@deterministic("dynamic/1", "thread_local/1")
def dynamic(machine: ProgramMachine, term: Term) -> bool:
    """Declare predicates dynamic; with ``as incremental``, incremental tables depend on their clauses."""
    for item, options in declared_items_with_options(
        machine.logic.database.modules.resolve_declared_indicators(term)
    ):
        declare_dynamic(machine, item, set(map(_parse_dynamic_option, options)))
    return True


@deterministic("dynamic/2")
def dynamic_with_options(machine: ProgramMachine, names: Term, options: Term) -> bool:
    """Declare the predicates of a list dynamic, with the options of SWI-Prolog; unknown ones are ignored."""
    chosen_options: Set[str] = set()
    for option in option_values(options):
        if (
            option.__class__ is tuple
            and len(option) == 2
            and option[0].name in _DYNAMIC_OPTIONS
            and is_true(option[1])
        ):
            chosen_options.add(option[0].name)
    for item in items(machine.logic.database.modules.resolve_declared_indicators(names)):
        declare_dynamic(machine, item, chosen_options)
    return True


_DYNAMIC_OPTIONS = frozenset(("incremental", "discontiguous", "multifile"))
"""Options of ``dynamic`` that have an effect."""

_INEFFECTIVE_DYNAMIC_OPTIONS = frozenset(("opaque", "volatile", "shared", "local", "abstract"))
"""Options of SWI-Prolog without effect here: they concern threads, saved states, or restate the default."""


def _parse_dynamic_option(option: Term) -> str:
    """Return the name of an option of ``dynamic ... as``, or raise a domain error."""
    key = _head_functor(option)
    # Only `abstract` has an argument.
    if key.name not in _DYNAMIC_OPTIONS | _INEFFECTIVE_DYNAMIC_OPTIONS or key.arity != (
        key.name == "abstract"
    ):
        raise domain_error("predicate_option", option)
    return key.name


def declare_dynamic(machine: ProgramMachine, item: Term, options: Set[str]) -> None:
    """Declare the predicate of an indicator dynamic."""
    database = machine.logic.database
    predicate = database.writable(indicator_of(item))
    predicate.make_dynamic()
    predicate.discontiguous |= "discontiguous" in options
    predicate.multifile |= "multifile" in options
    database.count_change()
    if "incremental" in options:
        tables_of(machine).observe(predicate)


deterministic("discontiguous/1")(_declaration_predicate("discontiguous"))
deterministic("multifile/1")(_declaration_predicate("multifile"))
deterministic("module_transparent/1", "volatile/1", "public/1")(lambda machine, term: True)


@nondeterministic("current_predicate/1")
def current_predicate(machine: ProgramMachine, term: Term) -> Solutions:
    """Enumerate the program's predicates with clauses; a complete indicator may also denote a built-in predicate."""
    modules = machine.logic.database.modules
    term = _strip_module(modules.resolve_declared_indicators(term))
    if term.__class__ is Var:
        term = (SLASH, Var(), Var())
    if term.__class__ is not tuple or term[0] is not SLASH:
        raise type_error("predicate_indicator", term)
    name, arity = deref(term[1]), deref(term[2])
    for part, type_name, classes in ((name, "atom", (Var, Atom)), (arity, "integer", (Var, int))):
        if part.__class__ not in classes:
            raise type_error(type_name, part) if is_iso(machine) else type_error("predicate_indicator", term)
    database = machine.logic.database
    if name.__class__ is Atom and arity.__class__ is int:
        predicate = database.predicates.get(functor(name.name, arity))
        if predicate is not None and _is_current(predicate, is_iso(machine)):
            yield LAST
        return
    # The goal may define predicates between two solutions, so the table is copied.
    for key, predicate in list(database.predicates.items()):
        has_clauses = predicate.kind == "user" and not predicate.is_library_predicate and len(predicate)
        if (
            has_clauses
            and modules.plain_functor(key) is None
            and machine.unify_all((name, atom(key.name)), (arity, key.arity))
        ):
            yield None


def _is_current(predicate: Predicate, iso: bool) -> bool:
    """Return whether a predicate has clauses, or is built in and the flag ``iso`` is not set."""
    predicate.report_read()
    if predicate.kind == "undefined":
        return False
    return bool(len(predicate)) or predicate.kind != "user" and not iso


@control("garbage_collect/0", "prompt/2")
def do_nothing(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Do nothing; the predicate exists for compatibility."""
    return continuation


_INEFFECTIVE_OPTIONS = {
    "subsumptive": "each variant of a call has a table of its own",
    "shared": "goals run in one thread",
    "lazy": "declare it incremental",
    "monotonic": "declare it incremental",
    "max_answers": "all answers are kept",
    "answer_abstract": "answers of any size are kept",
    "subgoal_abstract": "calls of any size have tables",
}
"""Options of SWI-Prolog without effect, with the explanation for the warning."""

_OPTIONS_WITH_ARGUMENT = ("max_answers", "answer_abstract", "subgoal_abstract")


@deterministic("table/1")
def table_declaration(machine: ProgramMachine, specification: Term) -> bool:
    """Declare predicates tabled; with ``as incremental``, their tables depend on the data that they read."""
    for item, options in declared_items_with_options(
        machine.logic.database.modules.resolve_declared_indicators(specification)
    ):
        if item.__class__ is tuple and item[0].name == ":" and len(item) == 3:
            item = deref(item[2])
        declare_tabled(machine, item, options)
    return True


def declare_tabled(machine: ProgramMachine, item: Term, options: Values = ()) -> None:
    """Declare the predicate of an indicator, or of a head with argument modes, tabled.

    Args:
        machine: the machine of the program.
        item: the indicator or head, possibly with options after ``as``.
        options: options that apply to it from an enclosing declaration.

    Raises:
        PrologError: for a term that is not an indicator or head, an unknown mode or an unknown option.
    """
    item = deref(item)
    if item.__class__ is tuple and item[0] is AS:
        declare_tabled(machine, item[1], (*options, *conjuncts(item[2])))
        return
    if item.__class__ is tuple and item[0] is not SLASH:
        key, modes = parse_moded_head(item)
    else:
        key, modes = indicator_of(item), {}
    option_names = [_table_option(machine, key, option) for option in options]
    _make_tabled(machine, key, modes)
    tables = tables_of(machine)
    tables.declarations_by_functor.setdefault(key, copy(item))
    predicate = machine.logic.database.predicate(key)
    if "dynamic" in option_names:
        declare_dynamic(machine, indicator(key), set())
    is_incremental = "incremental" in option_names or (
        predicate.is_incremental and "opaque" not in option_names
    )
    if is_incremental != predicate.is_incremental:
        predicate.is_incremental = is_incremental
        machine.logic.database.count_change()
        tables.clear()
    # The clauses of a tabled dynamic predicate may change too.
    if is_incremental:
        tables.observe(predicate.clause_owner)


def _table_option(machine: ProgramMachine, key: Functor, option: Term) -> str:
    """Return the name of a table option, and log a warning for one without effect."""
    option = callable_of(option)
    option_key = functor_of(option)
    name = option_key.name
    if option_key.arity != (name in _OPTIONS_WITH_ARGUMENT) or name not in (
        *_INEFFECTIVE_OPTIONS,
        *_TABLE_OPTIONS,
    ):
        raise domain_error("table_option", option)
    if name in _INEFFECTIVE_OPTIONS:
        reason, text = _INEFFECTIVE_OPTIONS[name], machine.logic.show(option)
        machine.logic.message(
            "warning", f"Warning: table {key} as {text}: the option has no effect: {reason}\n"
        )
    return name


_TABLE_OPTIONS = ("incremental", "opaque", "variant", "dynamic")


def _make_tabled(machine: ProgramMachine, key: Functor, modes: Dict[int, Mode]) -> None:
    """Declare a predicate tabled, and move its clauses to a hidden predicate that the tables call."""
    database = machine.logic.database
    if database.predicate(key).hidden_predicate is not None:
        return
    predicate = database.writable(key)
    # The name contains a space, so that a program does not define the hidden predicate by accident.
    hidden = database.predicate(functor(f"{key.name} tabled", key.arity))
    for clause in list(predicate.active_clauses()):
        hidden.add(clause)
    hidden.dynamic, hidden.discontiguous, hidden.multifile = (
        predicate.dynamic,
        predicate.discontiguous,
        predicate.multifile,
    )
    tables = tables_of(machine)
    # Before, the flag was that of a dynamic predicate, so it applies to the clauses, which have moved.
    if predicate.is_incremental:
        predicate.is_incremental = False
        tables.observe(hidden)
    predicate.set_tabled(hidden, tables.moded_caller(predicate, modes) if modes else tables.caller(predicate))
    database.discard_compiled_code()


@control("abolish_all_tables/0")
def abolish_all_tables(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Remove the answers of all tabled predicates."""
    tables_of(machine).clear()
    return continuation
