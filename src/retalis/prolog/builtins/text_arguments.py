"""Text arguments: atoms, strings, numbers, lists of codes or characters, as Python strings and back.

Reading terms from text.
"""

from typing import TYPE_CHECKING, Any, Callable, List, Optional, Sequence

from ...foundation.cancellation import in_bulks, look, watched
from ...foundation.errors import SyntaxFault
from ..machine.arithmetic import Number
from ..machine.errors import (
    ERROR,
    PrologError,
    domain_error,
    instantiation_error,
    representation_error,
    resource_error,
    syntax_error,
    type_error,
)
from ..syntax.operators import Operators
from ..syntax.term_reader import ReadTerm, read_term
from ..syntax.term_writer import write_term
from ..syntax.tokenizer import ReadFlags
from ..terms.list_terms import list_items, list_parts, make_list
from ..terms.term_traversal import variables
from ..terms.types import NIL, Atom, CompoundTerm, String, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import atom_of, is_iso, option_values, partial_items
from .builtin_registry import Machine, deterministic

if TYPE_CHECKING:
    from typing_extensions import TypeGuard

MAX_CODE = 0x10FFFF
_LARGE_INTEGER = 10**300

MAX_TEXT_CHARACTERS = 33_000_000
"""Characters of the longest text that a goal may make."""

_LOOK_FROM = 1 << 15

MAX_NUMBER_CHARACTERS = 1 << 20
"""Characters of the longest text that is read as a number: it has more digits than any, in base 2 as well."""


def long_text(size: int, *parts: str) -> None:
    """Check the length of a text that is about to be made; where it is long, look at the goal's limits.

    Args:
        size: characters of the text.
        parts: texts that it is made of, by which the bytes of a character are known.

    Raises:
        PrologError: a resource error where the text would be too long, or the goal has no room for it.
    """
    if size > _LOOK_FROM:
        if size > MAX_TEXT_CHARACTERS:
            raise resource_error("memory")
        look(size=size if all(map(str.isascii, parts)) else 4 * size)


def each(make: Callable[[str], Term], parts: Sequence[str]) -> List[Term]:
    """Return what is made of each part, of a character of a text say; look at the goal's limits meanwhile."""
    made: List[Term] = []
    for some in in_bulks(parts):
        made += map(make, some)
    return made


def joined(parts: Sequence[str], between: str = "") -> str:
    """Return texts joined, unless they are too long together."""
    long_text(sum(map(len, parts)) + len(between) * len(parts), between, *parts[:1])
    return between.join(parts)


def number_text(value: Number) -> str:
    """Return a number as it is written."""
    return write_term(value)


def constant_text(term: Term) -> Optional[str]:
    """Return the text of an atom, string or number; None for anything else."""
    if term.__class__ is Atom:
        return term.name
    if term.__class__ is String:
        return term.text
    if term.__class__ is int:
        return str(term) if -_LARGE_INTEGER < term < _LARGE_INTEGER else number_text(term)
    if term.__class__ is float:
        return number_text(term)
    return None


def text_of(term: Term, kind: str = "text", numbers: bool = True) -> str:
    """Return the text of an argument: a constant, or a list of codes or characters.

    Args:
        term: the argument; ``[]`` is the empty list.
        kind: the type that an error names.
        numbers: a number is a text.

    Raises:
        PrologError: an instantiation error where it is not bound, a type error where it is not a text.
    """
    term = deref(term)
    if term is NIL:
        return ""
    if term.__class__ is tuple:
        return _checked_list(term, kind)
    found = constant_text(term)
    if found is None:
        raise instantiation_error()
    if not numbers and term.__class__ in (int, float):
        raise type_error(kind, term)
    return found


def whole_text(term: Term, kind: str) -> str:
    """Do what `text_of` does, but name the whole argument as the culprit."""
    term = deref(term)
    if term.__class__ is tuple:
        text = _good_list_text(term)
        if text is None:
            raise type_error(kind, term)
        return text
    return text_of(term)


def is_text_list(term: Term) -> bool:
    """Tell whether a term is a list of codes or of characters."""
    return _good_list_text(term) is not None


def _good_list_text(term: Term) -> Optional[str]:
    try:
        return _checked_list(term, "list")
    except PrologError:
        return None


def _checked_list(term: Term, kind: str) -> str:
    found, tail = list_parts(term)
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error(kind, term)
    long_text(len(found))
    culprit = wrong_item(found)
    if culprit is not None:
        raise culprit
    if tail is not NIL:
        raise instantiation_error()
    text = []
    for some in in_bulks(found):
        items: List[Any] = [deref(item) for item in some]
        if any(item.__class__ is Var for item in items):
            raise instantiation_error()
        text.append("".join([chr(item) if item.__class__ is int else item.name for item in items]))
    return "".join(text)


def wrong_item(items: List[Term]) -> Optional[PrologError]:
    """Return the error for the first item that is not a code among codes, or no character among characters."""
    of_characters = None
    for some in in_bulks(items):
        for item in some:
            item = deref(item)
            if item.__class__ is Var:
                continue
            is_character = item.__class__ is Atom and len(item.name) == 1
            is_code = item.__class__ is int and 0 <= item <= MAX_CODE
            if of_characters is None:
                of_characters = is_character
            if not (is_character if of_characters else is_code):
                return type_error("character" if of_characters else "character_code", item)
    return None


def parts_text(machine: Machine, term: Term, as_codes: bool) -> str:
    """Return the text of an argument that has to be a list of codes or characters; strings are taken too.

    Raises:
        PrologError: an instantiation error for a list that is not wholly bound; type errors.
    """
    term = deref(term)
    if term.__class__ is String:
        return term.text
    if term.__class__ is not tuple and term is not NIL and term.__class__ is not Var:
        raise type_error("list", term)
    if is_iso(machine):
        _check_standard(list_parts(term)[0], as_codes)
    return text_of(term, "list")


def _check_standard(items: List[Term], as_codes: bool) -> None:
    """Raise the standard's error for an item that is none of a list of codes, or of characters."""
    first = deref(items[0]) if items else None
    are_codes = as_codes if first is None else first.__class__ is int
    for item in map(deref, watched(items)):
        if item.__class__ is int and are_codes and not 0 <= item <= MAX_CODE:
            raise representation_error("character_code")
        is_part = item.__class__ is int if are_codes else item.__class__ is Atom and len(item.name) == 1
        if item.__class__ is not Var and not is_part:
            raise type_error("character_code" if as_codes else "character", item)


def check_parts(term: Term) -> None:
    """Raise the error for what cannot become a list of codes or characters."""
    term = deref(term)
    if term.__class__ in (Var, String):
        return
    found, tail = list_parts(term)
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error("list", term)
    error = wrong_item(found)
    if error is not None:
        raise error


def atomic_text(term: Term, kind: str = "atomic") -> str:
    """Return the text of an argument that has to be a constant."""
    term = deref(term)
    found = constant_text(term)
    if found is None:
        if term.__class__ is Var:
            raise instantiation_error()
        raise type_error(kind, term)
    return found


def no_compound(term: Term, kind: str) -> None:
    """Raise a type error for a result that is given and is not a constant."""
    term = deref(term)
    if term.__class__ is tuple:
        raise type_error(kind, term)


def codes(text: str) -> Term:
    """Return a text as a list of codes."""
    return make_list(each(ord, text))


def chars(text: str) -> Term:
    """Return a text as a list of characters."""
    return make_list(each(atom, text))


def parse_number(text: str, operators: Operators) -> Optional[Term]:
    """Return the number that a text is, with white space before it and a sign allowed; None for no number."""
    stripped = text.lstrip()
    if len(stripped) > MAX_NUMBER_CHARACTERS:
        return None
    body = stripped[1:] if stripped[:1] in ("-", "+") else stripped
    if not body or not (body[0].isdigit() or body[:3] in ("inf", "nan")) or body[-1].isspace():
        return None
    after = body[3:] if body.startswith("0'") else body
    if "%" in after or "/*" in after:  # a comment is no part of a number
        return None
    try:
        term = read_term(body, operators, positions=False).term
    except SyntaxFault:
        return None
    if term.__class__ is Atom and term.name in ("inf", "nan"):
        term = float(term.name)
    if term.__class__ not in (int, float) or body.rstrip(".") != body:
        return None
    return -term if stripped[0] == "-" else term


def number_or_error(text: str, operators: Operators) -> Term:
    """Return the number that a text is.

    Raises:
        PrologError: a syntax error where it is none.
    """
    found = parse_number(text, operators)
    if found is None:
        raise syntax_error("illegal_number")
    return found


def make_text(like: str, text: str) -> Term:
    """Return a text as an atom, string, codes or chars."""
    if like == "atom":
        return atom(text)
    if like == "string":
        return String(text)
    return codes(text) if like == "codes" else chars(text)


def is_sink(sink: Term) -> "TypeGuard[CompoundTerm]":
    """Tell whether a term asks for text: ``atom(A)``, ..., also ``codes(Cs,Tail)`` and ``chars(Cs,Tail)``."""
    if sink.__class__ is not tuple:
        return False
    name = sink[0].name
    return (
        len(sink) == 2
        and name in ("atom", "string", "codes", "chars")
        or len(sink) == 3
        and name in ("codes", "chars")
    )


def fill_sink(machine: Machine, sink: CompoundTerm, text: str) -> bool:
    """Unify the text of a sink."""
    found = make_text(sink[0].name, text)
    if len(sink) == 3:
        found = make_list(list_items(found) or [], sink[2])
    return unify(sink[1], found, machine.trail)


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
