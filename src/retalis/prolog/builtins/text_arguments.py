"""Conversion between text arguments and Python strings, and reading of terms from text.

A text is an atom, a string, a number, or a list of character codes or of characters. Each conversion checks the
length of a text before it is built, because one step of a goal could otherwise exceed its time or memory limit by
far.
"""

from typing import TYPE_CHECKING, Any, Callable, List, Optional, Sequence

from ...foundation.errors import SyntaxFault
from ...foundation.limit_checks import check_limits, in_checked_slices, with_limit_checks
from ..machine.arithmetic import Number
from ..machine.errors import (
    ERROR,
    PrologError,
    domain_error,
    instantiation_error,
    instantiation_or_type_error,
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
from .builtin_registry import ProgramMachine, deterministic

if TYPE_CHECKING:
    from typing_extensions import TypeGuard

MAX_CODE = 0x10FFFF
_LARGE_INTEGER = 10**300

MAX_TEXT_CHARACTERS = 33_000_000
"""Limit for the length of a text that a goal may create."""

_MIN_CHECKED_CHARACTERS = 1 << 15
"""Length of a text from which on its creation is charged to the goal's limits."""

MAX_NUMBER_CHARACTERS = 1 << 20
"""Limit for the length of a text that is parsed as a number; every valid number is shorter, also in base 2."""


def check_text_length(size: int, *parts: str) -> None:
    """Check the length of a text before it is created; the creation of a long text is charged to the goal's limits.

    Args:
        size: number of characters.
        parts: texts that it consists of. If all are ASCII, a character takes one byte, otherwise up to four.

    Raises:
        PrologError: a resource error if the text would be too long or exceed the goal's memory.
    """
    if size > _MIN_CHECKED_CHARACTERS:
        if size > MAX_TEXT_CHARACTERS:
            raise resource_error("memory")
        check_limits(size=size if all(map(str.isascii, parts)) else 4 * size)


def convert_each(make: Callable[[str], Term], parts: Sequence[str]) -> List[Term]:
    """Return a term for each part, such as a character of a text, and check the goal's limits meanwhile."""
    terms: List[Term] = []
    # The limits are checked after each bulk, since one step may convert a text of any length.
    for bulk in in_checked_slices(parts):
        terms += map(make, bulk)
    return terms


def join_texts(parts: Sequence[str], separator: str = "") -> str:
    """Return the concatenation of texts.

    Raises:
        PrologError: a resource error if the result would be too long.
    """
    check_text_length(sum(map(len, parts)) + len(separator) * len(parts), separator, *parts[:1])
    return separator.join(parts)


def number_text(value: Number) -> str:
    """Return the text of a number."""
    return write_term(value)


def constant_text(term: Term) -> Optional[str]:
    """Return the text of an atom, string or number, or None for any other term."""
    if term.__class__ is Atom:
        return term.name
    if term.__class__ is String:
        return term.text
    if term.__class__ is int:
        # `str` takes quadratic time and raises an error for long integers in recent versions of Python.
        return str(term) if -_LARGE_INTEGER < term < _LARGE_INTEGER else number_text(term)
    if term.__class__ is float:
        return number_text(term)
    return None


def text_of(term: Term, type_name: str = "text", numbers: bool = True) -> str:
    """Return the text of an argument: a constant, or a list of character codes or characters.

    Args:
        term: the argument; ``[]`` is the empty list.
        type_name: the expected type, for the error term.
        numbers: whether a number is accepted.

    Raises:
        PrologError: an instantiation error for an unbound argument, a type error for a term that is not a text.
    """
    term = deref(term)
    if term is NIL:
        return ""
    if term.__class__ is tuple:
        return _require_text_list(term, type_name)
    text = constant_text(term)
    if text is None:
        raise instantiation_error()
    if not numbers and term.__class__ in (int, float):
        raise type_error(type_name, term)
    return text


def whole_text(term: Term, type_name: str) -> str:
    """Return the text of an argument like `text_of`, but with the whole list as the culprit of a type error."""
    term = deref(term)
    if term.__class__ is tuple:
        text = _text_of_valid_list(term)
        if text is None:
            raise type_error(type_name, term)
        return text
    return text_of(term)


def is_text_list(term: Term) -> bool:
    """Return whether a term is a list of character codes or of characters."""
    return _text_of_valid_list(term) is not None


def _text_of_valid_list(term: Term) -> Optional[str]:
    try:
        return _require_text_list(term, "list")
    except PrologError:
        return None


def _require_text_list(term: Term, type_name: str) -> str:
    codes_or_chars, tail = list_parts(term)
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error(type_name, term)
    check_text_length(len(codes_or_chars))
    # A wrong item takes precedence over an unbound one or an unbound tail, as in SWI-Prolog.
    culprit = first_item_error(codes_or_chars)
    if culprit is not None:
        raise culprit
    if tail is not NIL:
        raise instantiation_error()
    text = []
    for bulk in in_checked_slices(codes_or_chars):
        items: List[Any] = [deref(item) for item in bulk]
        if any(item.__class__ is Var for item in items):
            raise instantiation_error()
        text.append("".join([chr(item) if item.__class__ is int else item.name for item in items]))
    return "".join(text)


def first_item_error(items: List[Term]) -> Optional[PrologError]:
    """Return the error for the first invalid item; the first bound item decides between codes and characters."""
    of_characters = None
    for bulk in in_checked_slices(items):
        for item in bulk:
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


def text_of_list(machine: ProgramMachine, term: Term, as_codes: bool) -> str:
    """Return the text of a list of character codes or characters, or of a string.

    Raises:
        PrologError: an instantiation error for a list with unbound parts, or a type error.
    """
    term = deref(term)
    if term.__class__ is String:
        return term.text
    if term.__class__ is not tuple and term is not NIL and term.__class__ is not Var:
        raise type_error("list", term)
    if is_iso(machine):
        _check_iso_items(list_parts(term)[0], as_codes)
    return text_of(term, "list")


def _check_iso_items(items: List[Term], as_codes: bool) -> None:
    """Raise the error of ISO 13211-1 for the first item that is not a character code or character."""
    first = deref(items[0]) if items else None
    # The type of the first item decides which error the others cause.
    are_codes = as_codes if first is None else first.__class__ is int
    for item in map(deref, with_limit_checks(items)):
        if item.__class__ is int and are_codes and not 0 <= item <= MAX_CODE:
            raise representation_error("character_code")
        is_part = item.__class__ is int if are_codes else item.__class__ is Atom and len(item.name) == 1
        if item.__class__ is not Var and not is_part:
            raise type_error("character_code" if as_codes else "character", item)


def check_text_list(term: Term) -> None:
    """Raise a type error for a term that cannot be unified with a list of character codes or characters."""
    term = deref(term)
    if term.__class__ in (Var, String):
        return
    elements, tail = list_parts(term)
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error("list", term)
    error = first_item_error(elements)
    if error is not None:
        raise error


def atomic_text(term: Term, type_name: str = "atomic") -> str:
    """Return the text of an atomic argument."""
    term = deref(term)
    text = constant_text(term)
    if text is None:
        raise instantiation_or_type_error(type_name, term)
    return text


def require_no_compound(term: Term, type_name: str) -> None:
    """Raise a type error for an output argument that is a compound term."""
    term = deref(term)
    if term.__class__ is tuple:
        raise type_error(type_name, term)


def codes(text: str) -> Term:
    """Return a text as a list of character codes."""
    return make_list(convert_each(ord, text))


def chars(text: str) -> Term:
    """Return a text as a list of characters."""
    return make_list(convert_each(atom, text))


def parse_number(text: str, operators: Operators) -> Optional[Term]:
    """Return the number that a text denotes, or None; leading white space and a sign are allowed."""
    stripped = text.lstrip()
    if len(stripped) > MAX_NUMBER_CHARACTERS:
        return None
    # The reader would also accept terms, comments, trailing white space and an end: they are excluded before and
    # after.
    body = stripped[1:] if stripped[:1] in ("-", "+") else stripped
    # Excludes most texts before the reader is called, which raises and formats an error for each.
    if not body or not (body[0].isdigit() or body[:3] in ("inf", "nan")) or body[-1].isspace():
        return None
    digits = body[3:] if body.startswith("0'") else body
    if "%" in digits or "/*" in digits:
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
    """Return the number that a text denotes.

    Raises:
        PrologError: a syntax error if it does not denote a number.
    """
    number = parse_number(text, operators)
    if number is None:
        raise syntax_error("illegal_number")
    return number


def make_text(like: str, text: str) -> Term:
    """Return a text as a term of the type ``like``: ``atom``, ``string``, ``codes`` or ``chars``."""
    if like == "atom":
        return atom(text)
    if like == "string":
        return String(text)
    return codes(text) if like == "codes" else chars(text)


def is_sink(sink: Term) -> "TypeGuard[CompoundTerm]":
    """Return whether a term is an output specification such as ``atom(A)`` or ``codes(Codes, Tail)``."""
    if sink.__class__ is not tuple:
        return False
    name = sink[0].name
    return (
        len(sink) == 2
        and name in ("atom", "string", "codes", "chars")
        or len(sink) == 3
        and name in ("codes", "chars")
    )


def fill_sink(machine: ProgramMachine, sink: CompoundTerm, text: str) -> bool:
    """Unify the argument of an output specification with a text."""
    value = make_text(sink[0].name, text)
    # A third argument makes the result a difference list.
    if len(sink) == 3:
        value = make_list(list_items(value) or [], sink[2])
    return unify(sink[1], value, machine.trail)


_EQUAL = functor("=", 2)
_SYNTAX = functor("syntax_error", 1)
_STRING_POSITION = functor("string", 2)
_QUOTES = {
    "double_quotes": ("codes", "chars", "atom", "string"),
    "back_quotes": ("codes", "chars", "string", "symbol_char"),
}
"""Values of the flags for quoted text."""


def read_flags(machine: ProgramMachine) -> ReadFlags:
    """Return the reader flags of a machine's program."""
    flags = machine.logic.flags
    return ReadFlags(
        double_quotes=atom_of(flags["double_quotes"]).name,
        back_quotes=atom_of(flags["back_quotes"]).name,
        iso=flags["iso"] is atom("true"),
    )


def parse(machine: ProgramMachine, text: str) -> Term:
    """Return the term that a text denotes.

    Raises:
        PrologError: a syntax error.
    """
    return read(machine, text).term


def read(machine: ProgramMachine, text: str, flags: Optional[ReadFlags] = None) -> ReadTerm:
    """Return the `ReadTerm` of a text; an empty text denotes ``end_of_file``."""
    flags = read_flags(machine) if flags is None else flags
    try:
        if not text.strip():
            text = "end_of_file"
        return read_term(text, machine.logic.operators, flags=flags, positions=False)
    except SyntaxFault as fault:
        # SWI-Prolog reports the position as an offset in the text, from 0.
        column = fault.place.column if fault.place is not None else 0
        raise PrologError(
            (ERROR, (_SYNTAX, atom(fault.message)), (_STRING_POSITION, atom(text), column - 1))
        ) from fault


def end_of_file(machine: ProgramMachine) -> ReadTerm:
    """Return the `ReadTerm` of the end of a text, ``end_of_file``."""
    return read(machine, "")


@deterministic("atom_to_term/3")
def atom_to_term(machine: ProgramMachine, text: Term, term: Term, bindings: Term) -> bool:
    """Read a term and the names of its variables from a text."""
    if deref(text).__class__ is Var:
        raise instantiation_error()
    source_text = text_of(text)
    partial_items(bindings)
    result = read(machine, source_text)
    names = make_list([(_EQUAL, atom(name), var) for name, var in result.names.items()])
    return machine.unify_all((term, result.term), (bindings, names))


@deterministic("read_term_from_atom/3")
def read_term_from_atom(machine: ProgramMachine, text: Term, term: Term, options: Term) -> bool:
    """Read a term from a text, with the options of ``read_term/2``."""
    return read_with_options(machine, text_of(text, numbers=False), term, options)


def read_with_options(machine: ProgramMachine, source_text: str, term: Term, options: Term) -> bool:
    """Unify a term with the one that a text denotes, and the output options of ``read_term/2`` with their values."""
    requested: List[CompoundTerm] = []
    for option in option_values(options):
        if option.__class__ is not tuple:
            raise type_error("option", option)
        requested.append(option)
    result = read(machine, source_text, flags_of(machine, requested))
    return unify(term, result.term, machine.trail) and unify_options(machine, result, requested)


def flags_of(machine: ProgramMachine, options: List[CompoundTerm]) -> ReadFlags:
    """Return the reader flags of the options, with those of the program as defaults."""
    flags = read_flags(machine)
    # Options of a read take precedence over the flags of the program.
    quotes = {"double_quotes": flags.double_quotes, "back_quotes": flags.back_quotes}
    for option in options:
        name = option[0].name
        if name in quotes:
            value = atom_of(option[1])
            if value.name not in _QUOTES[name]:
                raise domain_error(name, value)
            quotes[name] = value.name
    return flags._replace(double_quotes=quotes["double_quotes"], back_quotes=quotes["back_quotes"])


def unify_options(machine: ProgramMachine, result: ReadTerm, options: List[CompoundTerm]) -> bool:
    """Unify the arguments of the output options of ``read_term/2``."""
    for option in options:
        name = option[0].name
        if name == "variables":
            value = make_list(variables(result.term))
        elif name in ("variable_names", "bindings"):
            value = make_list([(_EQUAL, atom(text), var) for text, var in result.names.items()])
        elif name == "singletons":
            value = make_list([(_EQUAL, atom(text), result.names[text]) for text in result.singletons])
        else:
            continue
        if not unify(option[1], value, machine.trail):
            return False
    return True
