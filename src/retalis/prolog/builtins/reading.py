"""Reading terms from text."""

from typing import List, Optional

from ...foundation import SyntaxFault
from ..machine import ERROR, PrologError, domain_error, instantiation_error, type_error
from ..syntax import ReadFlags, ReadTerm, read_term
from ..terms import CompoundTerm, String, Term, Var, atom, deref, functor, make_list, unify, variables
from .arguments import atom_of, option_values, partial_items
from .program import Machine
from .registry import deterministic
from .text import text_of

_EQUAL = functor("=", 2)
_SYNTAX = functor("syntax_error", 1)
_POSITION = functor("string", 2)
_QUOTES = {
    "double_quotes": ("codes", "chars", "atom", "string"),
    "back_quotes": ("codes", "chars", "string", "symbol_char"),
}
"""What the text in quotes may become."""


def read_flags(machine: Machine) -> ReadFlags:
    """Return how quotes read, by the program's flags."""
    flags = machine.logic.flags
    return ReadFlags(
        double_quotes=atom_of(flags["double_quotes"]).name,
        back_quotes=atom_of(flags["back_quotes"]).name,
        iso=flags["iso"] is atom("true"),
    )


def parse(machine: Machine, text: str) -> Term:
    """Return the term that a text is.

    Raises:
        PrologError: a syntax error.
    """
    return read(machine, text).term


def read(machine: Machine, text: str, flags: Optional[ReadFlags] = None) -> ReadTerm:
    """Return the `ReadTerm` of a text; of one without a term, that of ``end_of_file``."""
    flags = read_flags(machine) if flags is None else flags
    try:
        if not text.strip():
            text = "end_of_file"
        return read_term(text, machine.logic.operators, flags=flags, positions=False)
    except SyntaxFault as fault:
        column = fault.place.column if fault.place is not None else 0
        raise PrologError(
            (ERROR, (_SYNTAX, atom(fault.message)), (_POSITION, atom(text), column - 1))
        ) from fault


def nothing(machine: Machine) -> ReadTerm:
    """Return what is read at the end of a text."""
    return read(machine, "")


@deterministic("term_string/2")
def term_string(machine: Machine, term: Term, text: Term) -> bool:
    """Relate a term with its text as a string."""
    given = deref(text)
    if given.__class__ is not Var:
        return unify(term, parse(machine, text_of(given)), machine.trail)
    return unify(text, String(machine.logic.show(term)), machine.trail)


@deterministic("term_string/3")
def term_string_options(machine: Machine, term: Term, text: Term, options: Term) -> bool:
    """Do what ``term_string/2`` does."""
    return term_string(machine, term, text)


@deterministic("atom_to_term/3")
def atom_to_term(machine: Machine, text: Term, term: Term, bindings: Term) -> bool:
    """Read a term and its variables' names from a text."""
    if deref(text).__class__ is Var:
        raise instantiation_error()
    whole = text_of(text)
    partial_items(bindings)
    found = read(machine, whole)
    names = make_list([(_EQUAL, atom(name), var) for name, var in found.names.items()])
    return machine.unify_all((term, found.term), (bindings, names))


@deterministic("read_term_from_atom/3")
def read_term_from_atom(machine: Machine, text: Term, term: Term, options: Term) -> bool:
    """Read a term from a text."""
    whole = text_of(text, numbers=False)
    asked: List[CompoundTerm] = []
    for option in option_values(options):
        if option.__class__ is not tuple:
            raise type_error("option", option)
        asked.append(option)
    found = read(machine, whole, flags_of(machine, asked))
    return unify(term, found.term, machine.trail) and unify_options(machine, found, asked)


def flags_of(machine: Machine, options: List[CompoundTerm]) -> ReadFlags:
    """Return how quotes read: by the options, else by the program's flags."""
    flags = read_flags(machine)
    quotes = {"double_quotes": flags.double_quotes, "back_quotes": flags.back_quotes}
    for option in options:
        name = option[0].name
        if name in quotes:
            how = atom_of(option[1])
            if how.name not in _QUOTES[name]:
                raise domain_error(name, how)
            quotes[name] = how.name
    return flags._replace(double_quotes=quotes["double_quotes"], back_quotes=quotes["back_quotes"])


def unify_options(machine: Machine, found: ReadTerm, options: List[CompoundTerm]) -> bool:
    """Unify what the options of ``read_term`` ask for."""
    for option in options:
        name = option[0].name
        if name == "variables":
            value = make_list(variables(found.term))
        elif name in ("variable_names", "bindings"):
            value = make_list([(_EQUAL, atom(text), var) for text, var in found.names.items()])
        elif name == "singletons":
            value = make_list([(_EQUAL, atom(text), found.names[text]) for text in found.singletons])
        else:
            continue
        if not unify(option[1], value, machine.trail):
            return False
    return True
