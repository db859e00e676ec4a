"""Predicates on the state of a program: flags, operators, global variables, counters, modules, term expansion.

Values set by these predicates survive the goal that sets them, except for ``b_setval/2``, which backtracking undoes.
The module also defines directives of other Prolog systems that have no effect here.
"""

from typing import Dict, List, Optional, Tuple

from ...foundation.errors import UsageError
from ..database.module_system import functor_of_indicator, parse_meta_declaration
from ..machine.errors import (
    domain_error,
    existence_error,
    instantiation_error,
    instantiation_or_type_error,
    permission_error,
    representation_error,
    type_error,
)
from ..machine.machine import LAST
from ..syntax.operators import Operators
from ..syntax.term_writer import write_term
from ..terms.term_traversal import copy
from ..terms.types import (
    COLON,
    CONS,
    FALSE,
    NIL,
    SLASH,
    TRUE,
    Atom,
    Frame,
    Functor,
    Term,
    Values,
    Var,
    atom,
    deref,
    functor,
)
from ..terms.unification import unify
from .argument_checks import atom_of, bound, integer, is_iso, items
from .builtin_registry import ProgramMachine, Solutions, control, deterministic, nondeterministic
from .clause_predicates import declared_items
from .grammar_and_ssu_rules import translate_rule


def default_flags() -> Dict[str, Term]:
    """Return the Prolog flags with their initial values."""
    return {
        "bounded": FALSE,
        "max_integer": (1 << 63) - 1,
        "min_integer": -(1 << 63),
        "max_tagged_integer": (1 << 60) - 1,
        "min_tagged_integer": -(1 << 60),
        "max_arity": atom("unbounded"),
        "integer_rounding_function": atom("toward_zero"),
        "debug": atom("off"),
        "unknown": atom("error"),
        "double_quotes": atom("string"),
        "back_quotes": atom("codes"),
        "iso": FALSE,
        "occurs_check": FALSE,
        "prefer_rationals": FALSE,
        "char_conversion": atom("off"),
        "dialect": atom("retalis"),
        "version": 90000,
    }


_CHANGEABLE_FLAGS: Dict[str, Tuple[str, ...]] = {
    "debug": ("on", "off", "true", "false"),
    "unknown": ("error", "fail", "warning"),
    "double_quotes": ("codes", "chars", "atom", "string"),
    "back_quotes": ("codes", "chars", "string", "symbol_char"),
    "iso": ("true", "false"),
    "occurs_check": ("false",),
    "char_conversion": ("on", "off"),
}
"""Flags that goals may change, with their values."""


def restored_flags(stored_flags: Dict[str, Term]) -> Dict[str, Term]:
    """Return the initial flags, updated with stored values.

    Raises:
        UsageError: if a stored value is not valid for its flag.
    """
    flags = default_flags()
    for name, value in stored_flags.items():
        allowed = _CHANGEABLE_FLAGS.get(name, ())
        is_changed = value.__class__ is not flags.get(name, value).__class__ or value != flags.get(
            name, value
        )
        # A stored value is only accepted if the program could have set it.
        if name in flags and is_changed and not (isinstance(value, Atom) and value.name in allowed):
            raise UsageError(
                f"Prolog flag '{name}': the stored value '{write_term(value)}' is not valid: "
                f"expected {' or '.join(allowed) or 'the initial value'}"
            )
        flags[name] = value
    return flags


@deterministic("set_prolog_flag/2")
def set_prolog_flag(machine: ProgramMachine, flag: Term, value: Term) -> bool:
    """Set a Prolog flag."""
    name, value = atom_of(flag), bound(value)
    # Goals of services and of the dashboard may not change flags, which affect the whole program.
    machine.logic.require_flags(name)
    flags = machine.logic.flags
    allowed = _CHANGEABLE_FLAGS.get(name.name)
    if allowed is None:
        if name.name in flags and name.name in default_flags():
            raise permission_error("modify", "flag", name)
        if name.name not in flags and is_iso(machine):
            raise domain_error("prolog_flag", name)
        # A flag of another Prolog system: it is stored for the program, but has no effect.
        value = copy(value)
    elif value.__class__ is not Atom or value.name not in allowed:
        raise domain_error("flag_value", (functor("+", 2), name, value))
    flags[name.name] = value
    return True


@deterministic("unknown/2")
def unknown(machine: ProgramMachine, old: Term, new: Term) -> bool:
    """Return and set the flag ``unknown``, the action for calls of undefined predicates."""
    old_flag = machine.logic.flags["unknown"]
    if not machine.unify(old, old_flag):
        return False
    return deref(new) is deref(old_flag) or set_prolog_flag(machine, atom("unknown"), new)


@deterministic("create_prolog_flag/3")
def create_prolog_flag(machine: ProgramMachine, flag: Term, value: Term, options: Term) -> bool:
    """Create a flag of the program."""
    name = atom_of(flag)
    machine.logic.require_flags(name)
    machine.logic.flags[name.name] = copy(value)
    return True


@nondeterministic("current_prolog_flag/2")
def current_prolog_flag(machine: ProgramMachine, flag: Term, value: Term) -> Solutions:
    """Enumerate the Prolog flags."""
    flag = deref(flag)
    flags = machine.logic.flags
    if flag.__class__ is Atom:
        if flag.name not in flags and is_iso(machine):
            raise domain_error("prolog_flag", flag)
        if flag.name in flags and machine.unify(value, flags[flag.name]):
            yield LAST
        return
    if flag.__class__ is not Var:
        raise type_error("atom", flag)
    for name, flag_value in list(flags.items()):
        if machine.unify_all((flag, atom(name)), (value, flag_value)):
            yield None


# Operators


_OPERATOR_TYPES = ("xfx", "xfy", "yfx", "fy", "fx", "xf", "yf")


@deterministic("op/3")
def op(machine: ProgramMachine, priority: Term, op_type: Term, names: Term) -> bool:
    """Define or remove operators."""
    value = integer(priority)
    type_name = atom_of(op_type).name
    if not 0 <= value <= 1200:
        raise domain_error("operator_priority", value)
    if type_name not in _OPERATOR_TYPES:
        raise domain_error("operator_specifier", atom(type_name))
    names = deref(names)
    targets = (
        [] if names is NIL else items(names) if names.__class__ is tuple and names[0] is CONS else [names]
    )
    # The error for an invalid name depends on whether it was given in a list.
    is_in_list = targets != [names]
    for item in targets:
        item = deref(item)
        # Operators are global, so the module of a name is ignored.
        if item.__class__ is tuple and item[0].name == ":":
            item = deref(item[2])
        name = _checked_operator_name(item, value, type_name, machine.logic.operators, is_in_list)
        # ISO 13211-1, 6.3.4.3: an atom cannot be an infix and a postfix operator.
        if len(type_name) == 3 and is_iso(machine) and name in machine.logic.operators.postfix:
            raise permission_error("create", "operator", item)
        try:
            machine.logic.operators.add(value, type_name, name)
        except UsageError as fault:
            raise domain_error("operator", item) from fault
    return True


def _checked_operator_name(
    term: Term, priority: int, op_type: str, operators: Operators, is_in_list: bool
) -> str:
    """Return the name of a new operator, or raise the error if no such operator may be defined."""
    if term.__class__ is not Atom:
        raise instantiation_or_type_error("atom" if is_in_list else "list", term)
    name: str = term.name
    # ISO 13211-1, 8.14.3.3 and its second corrigendum, for the comma, the bar, `[]` and `{}`.
    if name == ",":
        raise permission_error("modify", "operator", term)
    if name == "|" and (priority < 1001 and priority or len(op_type) != 3):
        raise permission_error("create", "operator", term)
    if term is NIL or name == "{}":
        raise permission_error("create", "operator", term)
    if len(op_type) == 2 and op_type[0] != "f" and name in operators.infix:
        raise permission_error("create", "operator", term)
    return name


@nondeterministic("current_op/3")
def current_op(machine: ProgramMachine, priority: Term, op_type: Term, name: Term) -> Solutions:
    """Enumerate the operators."""
    priority, op_type, name = deref(priority), deref(op_type), deref(name)
    if priority.__class__ is not Var and (priority.__class__ is not int or not 0 <= priority <= 1200):
        raise domain_error("operator_priority", priority)
    if op_type.__class__ not in (Var, Atom) and not is_iso(machine):
        raise type_error("atom", op_type)
    if op_type.__class__ is not Var and (
        op_type.__class__ is not Atom or op_type.name not in _OPERATOR_TYPES
    ):
        raise domain_error("operator_specifier", op_type)
    if name.__class__ not in (Var, Atom):
        raise type_error("atom", name)
    # The goal may change the table between two solutions, so it is copied.
    for defined_priority, defined_type, defined_name in list(machine.logic.operators):
        if name.__class__ is Atom and name.name != defined_name:
            continue
        if machine.unify_all(
            (priority, defined_priority), (op_type, atom(defined_type)), (name, atom(defined_name))
        ):
            yield None


# Character conversion


@deterministic("char_conversion/2")
def char_conversion(machine: ProgramMachine, char: Term, converted: Term) -> bool:
    """Check two characters; the predicate has no effect, as characters are never converted."""
    _check_character(char)
    _check_character(converted)
    return True


@nondeterministic("current_char_conversion/2")
def current_char_conversion(machine: ProgramMachine, char: Term, converted: Term) -> Solutions:
    """Enumerate the character conversions: each character is converted to itself."""
    character = deref(char) if deref(char).__class__ is not Var else deref(converted)
    if character.__class__ is not Var:
        _check_character(character)
        if machine.unify_all((char, character), (converted, character)):
            yield LAST
        return
    for code in range(256):
        if machine.unify_all((char, atom(chr(code))), (converted, atom(chr(code)))):
            yield None


def _check_character(term: Term) -> None:
    if len(atom_of(term).name) != 1:
        raise representation_error("character")


# Global variables


class _GlobalVariableTrailEntry:
    """Trail entry that restores the previous value of a global variable.

    Undoing the trail sets ``ref`` of each entry to None, which makes variables unbound; here, it sets the old value.
    """

    __slots__ = ("values", "name", "old_value")

    def __init__(self, values: Dict[str, Term], name: str):
        self.values = values
        self.name = name
        self.old_value = values.get(name)

    @property
    def ref(self) -> None:
        return None

    @ref.setter
    def ref(self, value: None) -> None:
        if self.old_value is None:
            self.values.pop(self.name, None)
        else:
            self.values[self.name] = self.old_value


def _counter_key(name: Term) -> str:
    """Return the key of a counter or flag in the state of the program, by its name: an atom or an integer."""
    name = deref(name)
    # An integer and an atom of the same digits are different keys; the null character keeps them apart.
    if name.__class__ is int:
        return f"\0{name}"
    return atom_of(name).name


@deterministic("nb_setval/2")
def nb_setval(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Set a global variable to a copy of a term, without undoing it on backtracking."""
    machine.logic.globals[atom_of(name).name] = copy(value)
    return True


@deterministic("b_setval/2")
def b_setval(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Set a global variable until backtracking."""
    values = machine.logic.globals
    key = atom_of(name).name
    machine.trail.append(_GlobalVariableTrailEntry(values, key))
    values[key] = deref(value)
    return True


@deterministic("nb_getval/2", "b_getval/2")
def getval(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Unify with the value of a global variable."""
    key = atom_of(name).name
    values = machine.logic.globals
    if key not in values:
        raise existence_error("variable", deref(name))
    return unify(value, values[key], machine.trail)


# Counters and flags of the original Retalis


@deterministic("incCounter/1", is_protected=False)
def inc_counter(machine: ProgramMachine, name: Term) -> bool:
    """Increment a counter."""
    counters = machine.logic.state.setdefault("counters", {})
    key = _counter_key(name)
    counters[key] = counters.get(key, 0) + 1
    return True


@deterministic("resetCounter/1", is_protected=False)
def reset_counter(machine: ProgramMachine, name: Term) -> bool:
    """Set a counter to zero."""
    machine.logic.state.setdefault("counters", {})[_counter_key(name)] = 0
    return True


@deterministic("counter/2", is_protected=False)
def counter(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Unify with the value of a counter."""
    return unify(value, machine.logic.state.get("counters", {}).get(_counter_key(name), 0), machine.trail)


@deterministic("set_flag/2", is_protected=False)
def set_flag(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Set a flag of the program."""
    machine.logic.state.setdefault("flags", {})[_counter_key(name)] = copy(value)
    return True


@deterministic("get_flag/2", is_protected=False)
def get_flag(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Unify with a flag of the program, or ``nil`` if it is not set."""
    return unify(
        value, machine.logic.state.get("flags", {}).get(_counter_key(name), atom("nil")), machine.trail
    )


@control("halt/0", "halt/1")
def halt(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Raise a permission error: a program may not end the process that it runs in."""
    if args:
        integer(args[0])
    raise permission_error("halt", "process", TRUE)


_USER = atom("user")
_OP, _GRAMMAR_INDICATOR = functor("op", 3), functor("//", 2)


@deterministic("module/2")
def module(machine: ProgramMachine, name: Term, exports: Term) -> bool:
    """Begin a module: predicates that it does not export get local names for the rest of the file."""
    keys: List[Functor] = []
    invalid: List[Term] = []
    for item in items(exports):
        export = deref(item)
        # Operators in the export list are defined for the importing program too.
        if isinstance(export, tuple) and export[0] is _OP:
            op(machine, export[1], export[2], export[3])
            continue
        key = (
            functor_of_indicator(export)
            if isinstance(export, tuple) and export[0] in (SLASH, _GRAMMAR_INDICATOR)
            else None
        )
        if key is None:
            invalid.append(export)
        else:
            keys.append(key)
    if not machine.logic.database.modules.begin_module(atom_of(name).name, keys):
        machine.logic.message(
            "warning",
            "Warning: module/2 has no effect in a file of event rules: its predicates keep their plain names\n",
        )
    # The module is declared all the same, so that the rest of the file does not cause more errors.
    if invalid:
        raise (
            instantiation_error()
            if invalid[0].__class__ is Var
            else type_error("predicate_indicator", invalid[0])
        )
    return True


@deterministic("module/3")
def module_of_dialect(machine: ProgramMachine, name: Term, exports: Term, _: Term) -> bool:
    """Begin a module of another Prolog system."""
    return module(machine, name, exports)


@deterministic("meta_predicate/1")
def meta_predicate(machine: ProgramMachine, heads: Term) -> bool:
    """Declare which arguments of predicates are goals: in a module they are called with its local names."""
    modules = machine.logic.database.modules
    for item in declared_items(modules.resolve_declared_indicators(heads)):
        if item.__class__ is Var:
            raise instantiation_error()
        if item.__class__ is tuple:
            modules.declared_kinds_of[item[0]] = parse_meta_declaration(tuple(map(deref, item[1:])))
    return True


@deterministic("strip_module/3")
def strip_module(machine: ProgramMachine, term: Term, name: Term, plain: Term) -> bool:
    """Split a term into its module qualification and the plain term."""
    qualifier: Term = _USER
    plain_term = deref(term)
    while (
        plain_term.__class__ is tuple and plain_term[0] is COLON and deref(plain_term[1]).__class__ is not Var
    ):
        qualifier, plain_term = deref(plain_term[1]), deref(plain_term[2])
    return unify(name, qualifier, machine.trail) and unify(plain, plain_term, machine.trail)


@nondeterministic("current_module/1")
def current_module(machine: ProgramMachine, name: Term) -> Solutions:
    """Enumerate the modules of the program."""
    for module_name in ["user", *machine.logic.database.modules.modules]:
        if machine.unify(name, atom(module_name)):
            yield None


_GRAMMAR_RULE = functor("-->", 2)
_MAIN = atom("main")
_INITIALIZATION_TIMES = ("now", "after_load", "restore", "restore_state", "program", "main")


@deterministic(
    "style_check/1",
    "no_style_check/1",
    "mode/1",
    "license/1",
    "encoding/1",
    "noprofile/1",
    "non_terminal/1",
    "expects_dialect/1",
)
def declaration(machine: ProgramMachine, specification: Term) -> bool:
    """Accept a declaration that has no effect."""
    if deref(specification).__class__ is Var:
        raise instantiation_error()
    return True


@control("initialization/1")
def initialization(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal. In a file the loader calls it after the file has been loaded."""
    return machine.logic.control.call(args[0], continuation)


@control("initialization/2")
def initialization_at(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal, unless its time is ``main``: the process does not belong to the program."""
    time = bound(args[1])
    if not isinstance(time, Atom) or time.name not in _INITIALIZATION_TIMES:
        raise domain_error("initialization_type", time)
    return continuation if time is _MAIN else machine.logic.control.call(args[0], continuation)


@deterministic("dcg_translate_rule/2")
def dcg_translate_rule(machine: ProgramMachine, rule: Term, clause: Term) -> bool:
    """Translate a grammar rule."""
    rule = bound(rule)
    if rule.__class__ is not tuple or rule[0] is not _GRAMMAR_RULE:
        return False
    return machine.unify(clause, translate_rule(rule))


@deterministic("expand_term/2")
def expand_term(machine: ProgramMachine, term: Term, expanded: Term) -> bool:
    """Expand a term by the program's ``term_expansion/2`` and the translation of grammar rules, as on loading."""
    term = deref(term)
    key = functor("term_expansion", 2)
    predicate = machine.logic.database.predicates.get(key)
    # An unbound term would unify with the first argument of every expansion rule.
    if (
        term.__class__ is not Var
        and predicate is not None
        and not predicate.is_library_predicate
        and len(predicate)
    ):
        result = Var()
        if machine.logic.once((key, term, result)):
            term = deref(result)
    if term.__class__ is tuple and term[0] is _GRAMMAR_RULE:
        term = translate_rule(term)
    return machine.unify(expanded, term)
