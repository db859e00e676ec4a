"""Text arguments: atoms, strings, numbers, lists of codes or characters, as Python strings and back."""

from typing import Any, Optional

from ...errors import SyntaxFault
from ...syntax import read_term, write_term
from ...terms import CONS, NIL, Atom, String, Term, Var, atom, deref, list_parts, make_list
from ..faults import instantiation_error, representation_error, syntax_error, type_error

LARGEST_CODE = 0x10FFFF
_LONG = 10**300


def number_text(value: Any) -> str:
    """Return a number as it is written."""
    return write_term(value)


def constant_text(term: Term) -> Optional[str]:
    """Return the text of an atom, string or number; None for anything else."""
    kind = term.__class__
    if kind is Atom:
        return term.name  # type: ignore[no-any-return]
    if kind is String:
        return term.text  # type: ignore[no-any-return]
    if kind is int:
        return str(term) if -_LONG < term < _LONG else number_text(term)
    if kind is float:
        return number_text(term)
    return None


def text_of(term: Term, kind: str = "atomic") -> str:
    """Return the text of an argument: a constant, or a list of codes or characters.

    Raises:
        PrologError: an instantiation error where it is not bound, a type error where it is no text.
    """
    term = deref(term)
    found = constant_text(term)
    if found is None:
        if term.__class__ is Var:
            raise instantiation_error()
        found = list_text(term)
        if found is None:
            raise type_error(kind, term)
    elif term is NIL:
        return "" if kind in ("list", "codes") else "[]"
    return found


def list_text(term: Term) -> Optional[str]:
    """Return the text of a list of codes or of characters; None for what is none.

    Raises:
        PrologError: an instantiation error for a list that is not wholly bound.
    """
    out = []
    partial = False
    found, tail = list_parts(term)
    for item in found:
        item = deref(item)
        if item.__class__ is int:
            if not 0 <= item <= LARGEST_CODE:
                raise representation_error("character_code")
            out.append(chr(item))
        elif item.__class__ is Atom and len(item.name) == 1:
            out.append(item.name)
        elif item.__class__ is Var:
            partial = True
        else:
            return None
    if tail.__class__ is Var or (partial and tail is NIL):
        raise instantiation_error()
    return "".join(out) if tail is NIL else None


def parts_text(term: Term, as_codes: bool) -> str:
    """Return the text of an argument that has to be a list of codes or characters; strings are taken too.

    Raises:
        PrologError: an instantiation error for a list that is not wholly bound; type errors.
    """
    term = deref(term)
    if term.__class__ is String:
        return term.text  # type: ignore[no-any-return]
    first = deref(term[1]) if term.__class__ is tuple and term[0] is CONS else None
    are_codes = as_codes if first is None else first.__class__ is int
    for item in list_parts(term)[0]:
        item = deref(item)
        if item.__class__ is not Var:
            is_part = item.__class__ is int if are_codes else item.__class__ is Atom and len(item.name) == 1
            if not is_part:
                raise type_error("character_code" if as_codes else "character", item)
    found = list_text(term)
    if found is None:
        raise type_error("list", term)
    return found


def atomic_text(term: Term) -> str:
    """Return the text of an argument that has to be a constant."""
    term = deref(term)
    found = constant_text(term)
    if found is None:
        if term.__class__ is Var:
            raise instantiation_error()
        raise type_error("atomic", term)
    return found


def codes(text: str) -> Term:
    """Return a text as a list of codes."""
    return make_list([ord(char) for char in text])


def chars(text: str) -> Term:
    """Return a text as a list of characters."""
    return make_list([atom(char) for char in text])


def parse_number(text: str, operators: Any) -> Optional[Term]:
    """Return the number that a text is, with white space before it and a sign allowed; None for no number."""
    stripped = text.lstrip()
    body = stripped[1:] if stripped[:1] in ("-", "+") else stripped
    if not body or not (body[0].isdigit() or body[:3] in ("inf", "nan")) or body[-1].isspace():
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


def number_or_error(text: str, operators: Any) -> Term:
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
