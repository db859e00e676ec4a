"""Global variables, flags, operators, counters: what outlives a goal.

Modules as predicates: their declaration, what arguments are goals, and names in front of goals.

Directives of other Prologs: what they declare needs nothing done here, or is done as a goal.
"""

from typing import Dict, List, Optional, Tuple

from ...foundation.errors import UsageError
from ..database.module_system import declared_kinds, indicated
from ..machine.errors import (
    domain_error,
    existence_error,
    instantiation_error,
    permission_error,
    representation_error,
    type_error,
)
from ..machine.machine import LAST
from ..syntax.operators import Operators
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
from .argument_checks import atom_of, integer, is_iso, items
from .builtin_registry import Machine, Solutions, control, deterministic, nondeterministic
from .clause_predicates import declared
from .clause_translation import translate_rule


def default_flags() -> Dict[str, Term]:
    """Return the Prolog flags with their values at start."""
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


_CHANGEABLE: Dict[str, Tuple[str, ...]] = {
    "debug": ("on", "off", "true", "false"),
    "unknown": ("error", "fail", "warning"),
    "double_quotes": ("codes", "chars", "atom", "string"),
    "back_quotes": ("codes", "chars", "string", "symbol_char"),
    "iso": ("true", "false"),
    "occurs_check": ("false",),
    "char_conversion": ("on", "off"),
}


def flags_from(kept: Dict[str, Term]) -> Dict[str, Term]:
    """Return flags that were kept, with the values at start of those that were not.

    Raises:
        UsageError: for a value that the flag does not take.
    """
    found = default_flags()
    for name, value in kept.items():
        allowed = _CHANGEABLE.get(name, ())
        changed = value.__class__ is not found.get(name, value).__class__ or value != found.get(name, value)
        if name in found and changed and not (isinstance(value, Atom) and value.name in allowed):
            raise UsageError(f"the flag {name} has a value that it does not take")
        found[name] = value
    return found


@deterministic("set_prolog_flag/2")
def set_prolog_flag(machine: Machine, flag: Term, value: Term) -> bool:
    """Set a flag."""
    name, value = atom_of(flag), deref(value)
    if value.__class__ is Var:
        raise instantiation_error()
    machine.logic.require_flags(name)
    flags = machine.logic.flags
    allowed = _CHANGEABLE.get(name.name)
    if allowed is None:
        if name.name in flags and name.name in default_flags():
            raise permission_error("modify", "flag", name)
        if name.name not in flags and is_iso(machine):
            raise domain_error("prolog_flag", name)
        value = copy(value)  # of another Prolog: kept, and nothing here asks for it
    elif value.__class__ is not Atom or value.name not in allowed:
        raise domain_error("flag_value", (functor("+", 2), name, value))
    flags[name.name] = value
    return True


@deterministic("unknown/2")
def unknown(machine: Machine, old: Term, new: Term) -> bool:
    """Give and set what a call of a predicate that nobody has defined does."""
    before = machine.logic.flags["unknown"]
    if not machine.unify(old, before):
        return False
    return deref(new) is deref(before) or set_prolog_flag(machine, atom("unknown"), new)


@deterministic("create_prolog_flag/3")
def create_prolog_flag(machine: Machine, flag: Term, value: Term, options: Term) -> bool:
    """Make a flag of the program's own."""
    name = atom_of(flag)
    machine.logic.require_flags(name)
    machine.logic.flags[name.name] = copy(value)
    return True


@nondeterministic("current_prolog_flag/2")
def current_prolog_flag(machine: Machine, flag: Term, value: Term) -> Solutions:
    """Enumerate flags."""
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
    for name, known in list(flags.items()):
        if machine.unify_all((flag, atom(name)), (value, known)):
            yield None


# Operators


_SPECIFIERS = ("xfx", "xfy", "yfx", "fy", "fx", "xf", "yf")


@deterministic("op/3")
def op(machine: Machine, priority: Term, kind: Term, names: Term) -> bool:
    """Define operators."""
    value = integer(priority)
    name_of_kind = atom_of(kind).name
    if not 0 <= value <= 1200:
        raise domain_error("operator_priority", value)
    if name_of_kind not in _SPECIFIERS:
        raise domain_error("operator_specifier", atom(name_of_kind))
    names = deref(names)
    found = [] if names is NIL else items(names) if names.__class__ is tuple and names[0] is CONS else [names]
    in_list = found != [names]
    for item in found:
        item = deref(item)
        if item.__class__ is tuple and item[0].name == ":":
            item = deref(item[2])
        name = _operator_name(item, value, name_of_kind, machine.logic.operators, in_list)
        if len(name_of_kind) == 3 and is_iso(machine) and name in machine.logic.operators.postfix:
            raise permission_error("create", "operator", item)
        try:
            machine.logic.operators.add(value, name_of_kind, name)
        except UsageError as fault:
            raise domain_error("operator", item) from fault
    return True


def _operator_name(term: Term, priority: int, kind: str, operators: Operators, in_list: bool) -> str:
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ is not Atom:
        raise type_error("atom" if in_list else "list", term)
    name: str = term.name
    if name == ",":
        raise permission_error("modify", "operator", term)
    if name == "|" and (priority < 1001 and priority or len(kind) != 3):
        raise permission_error("create", "operator", term)
    if term is NIL or name == "{}":
        raise permission_error("create", "operator", term)
    if len(kind) == 2 and kind[0] != "f" and name in operators.infix:
        raise permission_error("create", "operator", term)
    return name


@nondeterministic("current_op/3")
def current_op(machine: Machine, priority: Term, kind: Term, name: Term) -> Solutions:
    """Enumerate operators."""
    priority, kind, name = deref(priority), deref(kind), deref(name)
    if priority.__class__ is not Var and (priority.__class__ is not int or not 0 <= priority <= 1200):
        raise domain_error("operator_priority", priority)
    if kind.__class__ not in (Var, Atom) and not is_iso(machine):
        raise type_error("atom", kind)
    if kind.__class__ is not Var and (kind.__class__ is not Atom or kind.name not in _SPECIFIERS):
        raise domain_error("operator_specifier", kind)
    if name.__class__ not in (Var, Atom):
        raise type_error("atom", name)
    for found_priority, found_kind, found_name in list(machine.logic.operators):
        if name.__class__ is Atom and name.name != found_name:
            continue
        if machine.unify_all((priority, found_priority), (kind, atom(found_kind)), (name, atom(found_name))):
            yield None


# Conversions of characters


@deterministic("char_conversion/2")
def char_conversion(machine: Machine, char: Term, other: Term) -> bool:
    """Take two characters; nothing is converted when a program is read."""
    _character(char)
    _character(other)
    return True


@nondeterministic("current_char_conversion/2")
def current_char_conversion(machine: Machine, char: Term, other: Term) -> Solutions:
    """Give each character itself."""
    given = deref(char) if deref(char).__class__ is not Var else deref(other)
    if given.__class__ is not Var:
        _character(given)
        if machine.unify_all((char, given), (other, given)):
            yield LAST
        return
    for code in range(256):
        if machine.unify_all((char, atom(chr(code))), (other, atom(chr(code)))):
            yield None


def _character(term: Term) -> None:
    if len(atom_of(term).name) != 1:
        raise representation_error("character")


# Global variables


class _RestoreValue:
    """Trail entry that gives a global variable its old value back."""

    __slots__ = ("values", "name", "old")

    def __init__(self, values: Dict[str, Term], name: str):
        self.values = values
        self.name = name
        self.old = values.get(name)

    @property
    def ref(self) -> None:
        return None

    @ref.setter
    def ref(self, value: None) -> None:
        if self.old is None:
            self.values.pop(self.name, None)
        else:
            self.values[self.name] = self.old


def _key(name: Term) -> str:
    name = deref(name)
    if name.__class__ is int:
        return f"\0{name}"
    return atom_of(name).name


@deterministic("nb_setval/2")
def nb_setval(machine: Machine, name: Term, value: Term) -> bool:
    """Set a global variable to a copy of a term; backtracking does not undo it."""
    machine.logic.globals[atom_of(name).name] = copy(value)
    return True


@deterministic("b_setval/2")
def b_setval(machine: Machine, name: Term, value: Term) -> bool:
    """Set a global variable; backtracking undoes it."""
    values = machine.logic.globals
    key = atom_of(name).name
    machine.trail.append(_RestoreValue(values, key))
    values[key] = deref(value)
    return True


@deterministic("nb_getval/2", "b_getval/2")
def getval(machine: Machine, name: Term, value: Term) -> bool:
    """Look a global variable up."""
    key = atom_of(name).name
    values = machine.logic.globals
    if key not in values:
        raise existence_error("variable", deref(name))
    return unify(value, values[key], machine.trail)


# Counters and flags as the original's programs use them


@deterministic("incCounter/1", locked=False)
def inc_counter(machine: Machine, name: Term) -> bool:
    """Add one to a counter."""
    counters = machine.logic.state.setdefault("counters", {})
    key = _key(name)
    counters[key] = counters.get(key, 0) + 1
    return True


@deterministic("resetCounter/1", locked=False)
def reset_counter(machine: Machine, name: Term) -> bool:
    """Set a counter to zero."""
    machine.logic.state.setdefault("counters", {})[_key(name)] = 0
    return True


@deterministic("counter/2", locked=False)
def counter(machine: Machine, name: Term, value: Term) -> bool:
    """Look a counter up."""
    return unify(value, machine.logic.state.get("counters", {}).get(_key(name), 0), machine.trail)


@deterministic("set_flag/2", locked=False)
def set_flag(machine: Machine, name: Term, value: Term) -> bool:
    """Set a flag of the program."""
    machine.logic.state.setdefault("flags", {})[_key(name)] = copy(value)
    return True


@deterministic("get_flag/2", locked=False)
def get_flag(machine: Machine, name: Term, value: Term) -> bool:
    """Look a flag of the program up; ``nil`` where it is not set."""
    return unify(value, machine.logic.state.get("flags", {}).get(_key(name), atom("nil")), machine.trail)


@control("halt/0", "halt/1")
def halt(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Refuse: a program may not end the process it runs in."""
    if args:
        integer(args[0])
    raise permission_error("halt", "process", TRUE)


_USER = atom("user")
_OP, _GRAMMAR_NAME = functor("op", 3), functor("//", 2)


@deterministic("module/2")
def module(machine: Machine, name: Term, exports: Term) -> bool:
    """Begin a module: its other predicates get names of their own for the rest of the file."""
    keys: List[Functor] = []
    wrong: List[Term] = []
    for item in items(exports):
        one = deref(item)
        if isinstance(one, tuple) and one[0] is _OP:
            op(machine, one[1], one[2], one[3])
            continue
        key = indicated(one) if isinstance(one, tuple) and one[0] in (SLASH, _GRAMMAR_NAME) else None
        if key is None:
            wrong.append(one)
        else:
            keys.append(key)
    if not machine.logic.database.modules.begin(atom_of(name).name, keys):
        machine.logic.message(
            "warning", "Warning: a file of event rules is no module: what it defines has its plain names\n"
        )
    if wrong:  # it is one all the same
        raise (
            instantiation_error()
            if wrong[0].__class__ is Var
            else type_error("predicate_indicator", wrong[0])
        )
    return True


@deterministic("module/3")
def module_of_dialect(machine: Machine, name: Term, exports: Term, _: Term) -> bool:
    """Begin a module of another Prolog."""
    return module(machine, name, exports)


@deterministic("meta_predicate/1")
def meta_predicate(machine: Machine, heads: Term) -> bool:
    """Declare which arguments are goals: those of a module mean its own predicates there."""
    modules = machine.logic.database.modules
    for item in declared(modules.names_of(heads)):
        if item.__class__ is Var:
            raise instantiation_error()
        if item.__class__ is tuple:
            modules.metas[item[0]] = declared_kinds(tuple(map(deref, item[1:])))
    return True


@deterministic("strip_module/3")
def strip_module(machine: Machine, term: Term, name: Term, plain: Term) -> bool:
    """Take a term apart into its module and the rest."""
    found: Term = _USER
    rest = deref(term)
    while rest.__class__ is tuple and rest[0] is COLON and deref(rest[1]).__class__ is not Var:
        found, rest = deref(rest[1]), deref(rest[2])
    return unify(name, found, machine.trail) and unify(plain, rest, machine.trail)


@nondeterministic("current_module/1")
def current_module(machine: Machine, name: Term) -> Solutions:
    """Enumerate the modules."""
    for one in ["user", *machine.logic.database.modules.table]:
        if machine.unify(name, atom(one)):
            yield None


_GRAMMAR = functor("-->", 2)
_MAIN = atom("main")
_TIMES = ("now", "after_load", "restore", "restore_state", "program", "main")


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
def declaration(machine: Machine, given: Term) -> bool:
    """Take a declaration that changes nothing here."""
    if deref(given).__class__ is Var:
        raise instantiation_error()
    return True


@control("initialization/1")
def initialization(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal; in a file it is called when that has been loaded, which who loads it sees to."""
    return machine.logic.control.call(args[0], after)


@control("initialization/2")
def initialization_at(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal, but for one that would be the main goal of a program."""
    when = deref(args[1])
    if when.__class__ is Var:
        raise instantiation_error()
    if not isinstance(when, Atom) or when.name not in _TIMES:
        raise domain_error("initialization_type", when)
    return after if when is _MAIN else machine.logic.control.call(args[0], after)


@deterministic("dcg_translate_rule/2")
def dcg_translate_rule(machine: Machine, rule: Term, clause: Term) -> bool:
    """Translate a grammar rule."""
    rule = deref(rule)
    if rule.__class__ is Var:
        raise instantiation_error()
    if rule.__class__ is not tuple or rule[0] is not _GRAMMAR:
        return False
    return machine.unify(clause, translate_rule(rule))


@deterministic("expand_term/2")
def expand_term(machine: Machine, term: Term, expanded: Term) -> bool:
    """Expand a term as when a file is loaded: what ``term_expansion/2`` says, and grammar rules."""
    term = deref(term)
    key = functor("term_expansion", 2)
    predicate = machine.logic.database.predicates.get(key)
    if term.__class__ is not Var and predicate is not None and not predicate.library and len(predicate):
        result = Var()
        if machine.logic.once((key, term, result)):
            term = deref(result)
    if term.__class__ is tuple and term[0] is _GRAMMAR:
        term = translate_rule(term)
    return machine.unify(expanded, term)
