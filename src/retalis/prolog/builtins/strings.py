"""Strings: conversions and parts."""

from typing import Callable, Dict, Iterator, List, Optional

from ...foundation import BULK, in_bulks, look, watched
from ..machine import LAST, domain_error, existence_error, instantiation_error, type_error
from ..terms import NIL, Atom, String, Term, Var, atom, deref, functor, is_ground, make_list, unify
from .arguments import integer_or_var, partial_items
from .atoms import halves
from .program import Machine, Outcome, Solutions
from .registry import deterministic, nondeterministic
from .text import (
    atomic_text,
    chars,
    check_parts,
    codes,
    constant_text,
    each,
    fill_sink,
    is_sink,
    is_text_list,
    joined,
    long_text,
    number_text,
    parse_number,
    parts_text,
    text_of,
    whole_text,
)

_OFTEN = len(BULK) - 1


@deterministic("string_length/2")
def string_length(machine: Machine, text: Term, length: Term) -> bool:
    """Give the number of characters of a text."""
    size = len(text_of(text))
    integer_or_var(length)
    return unify(length, size, machine.trail)


def _converter(to_parts: Callable[[str], Term]) -> Callable[[Machine, Term, Term], bool]:
    def run(machine: Machine, text: Term, parts: Term) -> bool:
        if deref(text).__class__ is not Var:
            whole, given = text_of(text), deref(parts)
            if given is not NIL and given.__class__ not in (Var, tuple):
                return whole == constant_text(given)
            return unify(parts, to_parts(whole), machine.trail)
        return unify(text, String(parts_text(machine, parts, True)), machine.trail)

    return run


deterministic("string_chars/2")(_converter(chars))
deterministic("string_codes/2")(_converter(codes))


def _is_no_text(term: Term) -> bool:
    term = deref(term)
    return term.__class__ is tuple and not is_text_list(term)


@deterministic("atom_string/2")
def atom_string(machine: Machine, name: Term, text: Term) -> bool:
    """Relate the text of an atom or a number with a string."""
    if deref(name).__class__ is Var:
        return unify(name, atom(whole_text(text, "string")), machine.trail)
    if deref(text).__class__ is Var:
        return unify(text, String(whole_text(name, "atom")), machine.trail)
    if _is_no_text(name) != _is_no_text(text):
        return False
    return whole_text(text, "string") == whole_text(name, "atom")


@deterministic("string_to_atom/2")
def string_to_atom(machine: Machine, text: Term, name: Term) -> bool:
    """Do what ``atom_string/2`` does."""
    return atom_string(machine, name, text)


@deterministic("number_string/2")
def number_string(machine: Machine, number: Term, text: Term) -> bool:
    """Relate a number with its string; fails where the text is not a number."""
    number = deref(number)
    if number.__class__ not in (Var, int, float):
        raise type_error("number", number)
    check_parts(text)
    if is_ground(text):
        found = parse_number(parts_text(machine, text, True).strip(), machine.logic.operators)
        return found is not None and unify(number, found, machine.trail)
    if not isinstance(number, (int, float)):
        raise instantiation_error()
    return unify(text, String(number_text(number)), machine.trail)


@deterministic("text_to_string/2")
def text_to_string(machine: Machine, text: Term, result: Term) -> bool:
    """Give the string of an atom, string, or list of codes or characters."""
    found = text_of(text, numbers=False)
    given = deref(result)
    if given.__class__ is Atom:
        return given.name == found
    return unify(result, String(found), machine.trail)


def _wanted_code(term: Term) -> Term:
    """Return the code that is looked for in a text: it may be given as a character."""
    term = deref(term)
    if term.__class__ is Var or (term.__class__ is int and term >= 0):
        return term
    if term.__class__ is Atom or term.__class__ is String or is_text_list(term):
        text = text_of(term)
        if len(text) == 1:
            return ord(text)
    raise type_error("character", term)


@nondeterministic("string_code/3")
def string_code(machine: Machine, index: Term, text: Term, code: Term) -> Outcome:
    """Relate the characters' codes with their positions from 1."""
    at = integer_or_var(index)
    whole = text_of(text, numbers=False)
    if at is None:
        return _codes(machine, index, whole, _wanted_code(code))
    if at < 0:
        raise domain_error("not_less_than_zero", at)
    return 0 < at <= len(whole) and unify(code, ord(whole[at - 1]), machine.trail)


def _codes(machine: Machine, index: Term, whole: str, wanted: Term) -> Solutions:
    for at, char in enumerate(whole, 1):
        if machine.unify_all((index, at), (wanted, ord(char))):
            yield LAST if at == len(whole) else None


@nondeterministic("text_concat/3")
def text_concat(machine: Machine, left: Term, right: Term, whole: Term) -> Outcome:
    """Relate two texts with the text that they make together: a string where one of them is."""
    given = [deref(term) for term in (left, right, whole)]
    make: Callable[[str], Term] = String if any(term.__class__ is String for term in given) else atom
    start, end, text = (None if term.__class__ is Var else text_of(term) for term in given)
    if start is not None and end is not None:
        long_text(len(start) + len(end), start, end)
        return unify(whole, make(start + end), machine.trail) if text is None else text == start + end
    if text is None:
        raise instantiation_error()
    long_text(len(text))
    if start is not None:
        return text.startswith(start) and unify(right, make(text[len(start) :]), machine.trail)
    if end is not None:
        return text.endswith(end) and unify(left, make(text[: len(text) - len(end)]), machine.trail)
    return halves(machine, left, right, text, make)


@deterministic("split_string/4")
def split_string(machine: Machine, text: Term, separators: Term, pad: Term, parts: Term) -> bool:
    """Split a text at any of the separators and strip the pad characters from each part."""
    whole, between, strip = (text_of(given, numbers=False) for given in (text, separators, pad))
    between, strip = _different(between), _different(strip)
    long_text(len(whole), whole)
    partial_items(parts)
    return unify(parts, make_list(each(String, list(_split(whole, between, strip)))), machine.trail)


def _different(text: str) -> str:
    """Return each character of a text once."""
    return text if len(text) < 2 else "".join(dict.fromkeys(watched(text)))


def _split(text: str, separators: str, pad: str) -> Iterator[str]:
    """Yield the parts of a text; separators that are pad characters too count once, and not at the ends."""
    text = _strip(text, pad)
    start = 0
    for at, char in enumerate(text):
        if not at & _OFTEN:
            look()
        if at >= start and char in separators:
            yield _strip(text[start:at], pad)
            start = at + 1
            while char in pad and text[start] in pad:  # what is left does not end with one
                start += 1
    yield _strip(text[start:], pad)


def _strip(text: str, pad: str) -> str:
    return text.strip(pad) if pad else text


@deterministic("normalize_space/2")
def normalize_space(machine: Machine, sink: Term, text: Term) -> bool:
    """Unify a text with runs of white space made one blank."""
    sink = deref(sink)
    if sink.__class__ is Var:
        raise instantiation_error()
    if not is_sink(sink):
        raise existence_error("stream", sink) if sink.__class__ is Atom else type_error("output", sink)
    return fill_sink(machine, sink, joined(_words(atomic_text(text)), " "))


def _words(text: str) -> List[str]:
    """Return what stands between white space."""
    words: List[str] = []
    whole = True  # the last word ends where a piece ends
    for piece in in_bulks(text):
        found = piece.split()
        if not whole and found and not piece[0].isspace():
            words[-1] += found.pop(0)
        words += found
        whole = piece[-1:].isspace()  # the only piece of an empty text is empty
    return words


# Characters

_CLASSES: Dict[str, Callable[[str], bool]] = {
    "alnum": str.isalnum,
    "alpha": str.isalpha,
    "csym": lambda char: char.isalnum() or char == "_",
    "csymf": lambda char: char.isalpha() or char == "_",
    "prolog_var_start": lambda char: char.isupper() or char == "_",
    "prolog_atom_start": lambda char: char.isalpha() and not char.isupper(),
    "prolog_identifier_continue": lambda char: char.isalnum() or char == "_",
    "prolog_symbol": lambda char: char in "#$&*+-./:<=>?@\\^~",
    "ascii": lambda char: ord(char) < 128,
    "white": lambda char: char in " \t",
    "cntrl": lambda char: ord(char) < 32 or 127 <= ord(char) < 160,
    "space": str.isspace,
    "end_of_line": lambda char: char in "\n\v\f\r",
    "lower": str.islower,
    "upper": str.isupper,
    "punct": lambda char: char > " " and char != "\x7f" and not char.isalnum() and not char.isspace(),
    "graph": lambda char: char > " " and char != "\x7f" and not char.isspace(),
    "print": lambda char: char >= " " and char != "\x7f",
    "period": lambda char: char in ".?!",
    "quote": lambda char: char in "'\"`",
    "paren": lambda char: char in "()[]{}",
    "digit": lambda char: char.isdigit(),
    "newline": lambda char: char == "\n",
}


_PARAMETRIC = ("digit", "xdigit", "to_lower", "to_upper", "upper", "lower")


def _of_code(term: Term) -> Optional[str]:
    term = deref(term)
    if term.__class__ is Var:
        return None
    if term.__class__ is int:
        if not 0 <= term <= 0x10FFFF:
            raise domain_error("character", term)
        return chr(term)
    text = constant_text(term)
    if text is None or len(text) != 1:
        raise type_error("character", term)
    return text


def _char_type(as_code: bool) -> Callable[[Machine, Term, Term], Outcome]:
    def wrap(char: str) -> Term:
        return ord(char) if as_code else atom(char)

    def run(machine: Machine, char: Term, kind: Term) -> Outcome:
        kind = deref(kind)
        _check_type(kind)
        given = _of_code(char)
        if given is None and kind.__class__ is Var:
            raise instantiation_error()
        if given is None or kind.__class__ is Var:
            return enumerate_(machine, char, kind, given)
        found = next(_types(given, kind, wrap), None)
        return found is not None and unify(kind, found, machine.trail)

    def enumerate_(machine: Machine, char: Term, kind: Term, given: Optional[str]) -> Solutions:
        for one in [given] if given is not None else map(chr, range(256)):
            for found in _types(one, kind, wrap):
                pairs = [(kind, found)]
                if given is None:
                    pairs.append((char, wrap(one)))
                if machine.unify_all(*pairs):
                    yield None

    return run


def _changed(char: str, changed: str) -> str:
    """Return a character in the other case, or itself where it has no single one."""
    return changed if len(changed) == 1 else char


def _check_type(kind: Term) -> None:
    """Raise a type error for what is not a type of characters."""
    if kind.__class__ is tuple and len(kind) == 2 and kind[0].name in _PARAMETRIC:
        return
    if kind.__class__ is not Var and (kind.__class__ is not Atom or kind.name not in _CLASSES):
        raise type_error("char_type", kind)


def _types(char: str, kind: Term, wrap: Callable[[str], Term]) -> Iterator[Term]:
    """Yield the types of a character that may be the one asked for."""
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else None
    for plain, test in _CLASSES.items():
        if (name is None or (plain == name and kind.__class__ is Atom)) and test(char):
            yield atom(plain)
    if kind.__class__ is Atom:
        return
    if name in (None, "digit") and char.isdigit() and char.isascii():
        yield (functor("digit", 1), ord(char) - 48)
    if name in (None, "xdigit") and char in "0123456789abcdefABCDEF":
        yield (functor("xdigit", 1), int(char, 16))
    if name in (None, "to_lower"):
        yield (functor("to_lower", 1), wrap(_changed(char, char.upper())))
    if name in (None, "to_upper"):
        yield (functor("to_upper", 1), wrap(_changed(char, char.lower())))
    if name in (None, "upper") and char.isupper():
        yield (functor("upper", 1), wrap(char.lower()[0]))
    if name in (None, "lower") and char.islower():
        yield (functor("lower", 1), wrap(char.upper()[0]))


nondeterministic("char_type/2")(_char_type(False))
nondeterministic("code_type/2")(_char_type(True))
