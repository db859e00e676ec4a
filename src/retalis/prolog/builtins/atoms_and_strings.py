"""Predicates on atoms, strings and characters: conversion, concatenation, substrings and character types.

Predicates of atoms and of strings share an implementation, which is passed the constructor of the result (`atom` or
`String`). Errors are those of SWI-Prolog, or of ISO 13211-1 if the flag ``iso`` is set.
"""

from typing import Callable, Dict, Iterator, List, Optional, Tuple

from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, in_checked_slices, with_limit_checks
from ..machine.errors import (
    domain_error,
    existence_error,
    instantiation_error,
    instantiation_or_type_error,
    representation_error,
    type_error,
)
from ..machine.machine import LAST
from ..terms.list_terms import list_items, make_list
from ..terms.term_traversal import is_ground
from ..terms.types import NIL, Atom, String, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import atom_of, bound, integer_or_var, is_iso, items, partial_items
from .builtin_registry import Outcome, ProgramMachine, Solutions, deterministic, nondeterministic
from .text_arguments import (
    MAX_CODE,
    atomic_text,
    chars,
    check_text_length,
    check_text_list,
    codes,
    constant_text,
    convert_each,
    fill_sink,
    is_sink,
    is_text_list,
    join_texts,
    number_or_error,
    number_text,
    parse,
    parse_number,
    require_no_compound,
    text_of,
    text_of_list,
    whole_text,
)


@deterministic("atom_length/2")
def atom_length(machine: ProgramMachine, text: Term, length: Term) -> bool:
    """Unify with the number of characters of an atom."""
    length = deref(length)
    # SWI-Prolog accepts numbers and other texts too; ISO 13211-1 only atoms.
    size = len(atom_of(text).name if is_iso(machine) else text_of(text))
    if length.__class__ is not Var:
        if length.__class__ is not int:
            raise type_error("integer", length)
        if length < 0:
            raise domain_error("not_less_than_zero", length)
    return unify(length, size, machine.trail)


_MAX_CASE_CHARACTERS = 1 << 16
"""Limit for the characters whose case is changed in one step."""

_ATOM_BYTES = 64
"""Approximate size of a short atom, for the memory limit."""

TextConstructor = Callable[[str], Term]
"""Function that returns a text as a term of one type, such as `atom` or `codes`."""


def _text_converter(
    to_list: TextConstructor, from_text: Callable[[ProgramMachine, str], Term], type_name: str
) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that converts between a constant and the list of its codes or characters."""

    def run(machine: ProgramMachine, constant: Term, parts: Term) -> bool:
        text = constant_text(deref(constant))
        if text is not None:
            check_text_list(parts)
            text_or_parts = deref(parts)
            if text_or_parts.__class__ is String:
                return text_or_parts.text == text
            return unify(parts, to_list(text), machine.trail)
        if deref(constant).__class__ is not Var:
            raise type_error(type_name, deref(constant))
        text = text_of_list(machine, parts, to_list is codes)
        return unify(constant, from_text(machine, text), machine.trail)

    return run


def _parse_as_atom(machine: ProgramMachine, text: str) -> Term:
    return atom(text)


def _parse_as_constant(machine: ProgramMachine, text: str) -> Term:
    number = parse_number(text, machine.logic.operators)
    return atom(text) if number is None else number


deterministic("atom_codes/2")(_text_converter(codes, _parse_as_atom, "atom"))
deterministic("atom_chars/2")(_text_converter(chars, _parse_as_atom, "atom"))
deterministic("name/2")(_text_converter(codes, _parse_as_constant, "atomic"))


def _number_converter(to_list: TextConstructor) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that converts between a number and the list of its codes or characters."""

    def run(machine: ProgramMachine, number: Term, parts: Term) -> bool:
        number = deref(number)
        if number.__class__ not in (Var, int, float):
            raise type_error("number", number)
        # If the text is known it is parsed, even if the number is known too: "0x10" is equal to 16.
        if not is_iso(machine):
            check_text_list(parts)
        if isinstance(number, (int, float)) and not is_ground(parts):
            return unify(parts, to_list(number_text(number)), machine.trail)
        text = text_of_list(machine, parts, to_list is codes)
        return unify(number, number_or_error(text, machine.logic.operators), machine.trail)

    return run


deterministic("number_codes/2")(_number_converter(codes))
deterministic("number_chars/2")(_number_converter(chars))


def _code_error(machine: ProgramMachine, code: int) -> Exception:
    return representation_error("character_code") if is_iso(machine) else type_error("character_code", code)


@deterministic("char_code/2")
def char_code(machine: ProgramMachine, char: Term, code: Term) -> bool:
    """Convert between a character and its code."""
    char, code = deref(char), deref(code)
    if char.__class__ is Atom:
        if len(char.name) != 1:
            raise type_error("character", char)
        if code.__class__ not in (Var, int):
            raise type_error("integer", code)
        if code.__class__ is int and not 0 <= code <= MAX_CODE:
            raise _code_error(machine, code)
        return unify(code, ord(char.name), machine.trail)
    if char.__class__ is not Var:
        raise type_error("character", char)
    if code.__class__ is not int:
        raise instantiation_or_type_error("integer", code)
    if not 0 <= code <= MAX_CODE:
        raise _code_error(machine, code)
    return unify(char, atom(chr(code)), machine.trail)


@deterministic("atom_number/2")
def atom_number(machine: ProgramMachine, text: Term, number: Term) -> bool:
    """Convert between an atom and the number that it denotes."""
    text, number = deref(text), deref(number)
    if text.__class__ is Var:
        if number.__class__ not in (int, float):
            raise instantiation_or_type_error("number", number)
        return unify(text, atom(number_text(number)), machine.trail)
    # Which of the two arguments is reported, and whether the predicate fails instead, follows SWI-Prolog.
    if text.__class__ not in (Atom, String):
        if number.__class__ is Var:
            raise type_error("atom", text)
        if number.__class__ not in (int, float):
            raise type_error("number", number)
        return False
    characters = atomic_text(text)
    # Unlike number_codes/2, this predicate refuses leading white space.
    if characters[:1].isspace():
        return False
    value = parse_number(characters, machine.logic.operators)
    return value is not None and unify(number, value, machine.trail)


@deterministic("term_to_atom/2")
def term_to_atom(machine: ProgramMachine, term: Term, text: Term) -> bool:
    """Convert between a term and its text as an atom."""
    # A given text is parsed even if the term is known: equal terms may be written differently.
    text_term = deref(text)
    if text_term.__class__ is not Var:
        return unify(term, parse(machine, text_of(text_term)), machine.trail)
    if deref(term).__class__ is Var:
        raise instantiation_error()
    return unify(text, atom(machine.logic.show(term)), machine.trail)


@nondeterministic("atom_concat/3")
def atom_concat(machine: ProgramMachine, left: Term, right: Term, joined: Term) -> Outcome:
    """Relate two texts with their concatenation as an atom."""
    return _concat(machine, left, right, joined, atom)


@nondeterministic("string_concat/3")
def string_concat(machine: ProgramMachine, left: Term, right: Term, joined: Term) -> Outcome:
    """Relate two texts with their concatenation as a string."""
    return _concat(machine, left, right, joined, String)


def _concat(machine: ProgramMachine, left: Term, right: Term, joined: Term, make: TextConstructor) -> Outcome:
    left, right = deref(left), deref(right)
    start = None if left.__class__ is Var else atomic_text(left)
    end = None if right.__class__ is Var else atomic_text(right)
    # With both parts known, the whole is compared as text, so an atom is equal to a string.
    if start is not None and end is not None:
        result = deref(joined)
        text = constant_text(result)
        if text is None and result.__class__ is not Var:
            raise type_error("atomic", result)
        check_text_length(len(start) + len(end), start, end)
        return text == start + end if text is not None else unify(joined, make(start + end), machine.trail)
    if deref(joined).__class__ is Var:
        raise instantiation_error()
    text = atomic_text(joined)
    check_text_length(len(text))
    if start is not None:
        return text.startswith(start) and unify(right, make(text[len(start) :]), machine.trail)
    if end is not None:
        return text.endswith(end) and unify(left, make(text[: len(text) - len(end)]), machine.trail)
    # Only this mode, with both parts unbound, has more than one solution.
    return _enumerate_divisions(machine, left, right, text, make)


def _enumerate_divisions(
    machine: ProgramMachine, left: Term, right: Term, text: str, make: TextConstructor
) -> Solutions:
    """Enumerate the divisions of a text into two parts."""
    for position in range(len(text) + 1):
        # Each solution copies the whole text, so each is charged to the limits.
        check_text_length(len(text))
        if machine.unify_all((left, make(text[:position])), (right, make(text[position:]))):
            yield LAST if position == len(text) else None


@nondeterministic("sub_atom/5")
def sub_atom(
    machine: ProgramMachine, text: Term, before: Term, length: Term, after: Term, part: Term
) -> Outcome:
    """Enumerate the substrings of an atom."""
    return sub_text(machine, text, before, length, after, part, atom)


@nondeterministic("sub_string/5")
def sub_string(
    machine: ProgramMachine, text: Term, before: Term, length: Term, after: Term, part: Term
) -> Outcome:
    """Enumerate the substrings of a string."""
    return sub_text(machine, text, before, length, after, part, String)


def sub_text(
    machine: ProgramMachine,
    text: Term,
    before: Term,
    length: Term,
    after: Term,
    part: Term,
    make: TextConstructor,
) -> Outcome:
    """Enumerate the substrings of a text in the order of their start, then of their length."""
    if deref(text).__class__ is Var:
        raise instantiation_error()
    type_name = "atom" if make is atom else "string"
    source_text = atomic_text(text, type_name)
    size = len(source_text)
    before_count, length_count, after_count = (
        integer_or_var(before),
        integer_or_var(length),
        integer_or_var(after),
    )
    for value in (before_count, length_count, after_count):
        if value is not None and value < 0:
            raise domain_error("not_less_than_zero", value)
    part_term = deref(part)
    # A known substring is searched for, which takes linear time; enumerating all substrings would take quadratic
    # time.
    if part_term.__class__ is not Var:
        if is_iso(machine):
            atom_of(part_term)
        return _find_known_substring(
            machine,
            source_text,
            atomic_text(part_term, type_name),
            before,
            length,
            after,
            before_count,
            after_count,
        )
    # Two known numbers determine the third and the substring.
    if before_count is not None and length_count is not None:
        start, end = before_count, before_count + length_count
    elif before_count is not None and after_count is not None:
        start, end = before_count, size - after_count
    elif length_count is not None and after_count is not None:
        start, end = size - after_count - length_count, size - after_count
    else:
        return _enumerate_substrings(
            machine,
            source_text,
            _candidate_spans(size, before_count, length_count, after_count),
            before,
            length,
            after,
            part,
            make,
        )
    return bool(
        0 <= start <= end <= size
        and machine.unify_all(
            (before, start), (length, end - start), (after, size - end), (part, make(source_text[start:end]))
        )
    )


def _enumerate_substrings(
    machine: ProgramMachine,
    source_text: str,
    spans: Iterator[Tuple[int, int]],
    before: Term,
    length: Term,
    after: Term,
    part: Term,
    make: TextConstructor,
) -> Solutions:
    size = len(source_text)
    for index, (start, end) in enumerate(spans):
        # Substrings that do not unify are skipped within one step of the machine.
        if not index & 255:
            check_limits()
        check_text_length(end - start)
        if machine.unify_all(
            (before, start), (length, end - start), (after, size - end), (part, make(source_text[start:end]))
        ):
            yield None


def _candidate_spans(
    size: int, before_count: Optional[int], length_count: Optional[int], after_count: Optional[int]
) -> Iterator[Tuple[int, int]]:
    """Return the starts and ends of the substrings of a text, given at most one of the three counts."""
    if before_count is not None:
        return ((before_count, end) for end in range(before_count, size + 1))
    if length_count is not None:
        return ((start, start + length_count) for start in range(size - length_count + 1))
    if after_count is not None:
        return ((start, size - after_count) for start in range(size - after_count + 1))
    return ((start, end) for start in range(size + 1) for end in range(start, size + 1))


def _find_known_substring(
    machine: ProgramMachine,
    source_text: str,
    substring: str,
    before: Term,
    length: Term,
    after: Term,
    before_count: Optional[int],
    after_count: Optional[int],
) -> Outcome:
    size, length_count = len(source_text), len(substring)
    if before_count is not None:
        start = before_count
        matches = source_text.startswith(substring, start)
    elif after_count is not None:
        start = size - after_count - length_count
        matches = start >= 0 and source_text.startswith(substring, start)
    else:
        # One occurrence is determinate; a generator is only needed for several.
        start = source_text.find(substring)
        matches = start >= 0
        if matches and source_text.find(substring, start + 1) >= 0:
            return _all_occurrences(machine, source_text, substring, before, length, after)
    return bool(
        matches
        and machine.unify_all((before, start), (length, length_count), (after, size - start - length_count))
    )


def _all_occurrences(
    machine: ProgramMachine, source_text: str, substring: str, before: Term, length: Term, after: Term
) -> Solutions:
    size = len(source_text)
    start = source_text.find(substring)
    while start >= 0:
        following = source_text.find(substring, start + 1)
        if machine.unify_all(
            (before, start), (length, len(substring)), (after, size - start - len(substring))
        ):
            yield LAST if following < 0 else None
        start = following


@deterministic("atomic_list_concat/2")
def atomic_list_concat(machine: ProgramMachine, parts: Term, joined: Term) -> bool:
    """Concatenate texts to an atom."""
    return unify(
        joined,
        atom(join_texts([atomic_text(item, "text") for item in with_limit_checks(items(parts))])),
        machine.trail,
    )


@deterministic("atomic_list_concat/3")
def atomic_list_concat_separated(machine: ProgramMachine, parts: Term, separator: Term, joined: Term) -> bool:
    """Join texts with a separator, or split an atom at the separator."""
    separator_text = atomic_text(separator, "text")
    text = _join(parts, separator_text)
    if text is not None:
        result = constant_text(deref(joined))
        return result == text if result is not None else unify(joined, atom(text), machine.trail)
    if deref(joined).__class__ is Var:
        raise instantiation_error()
    # An empty separator would divide a text at every position, or nowhere.
    if not separator_text:
        raise domain_error("non_empty_atom", separator)
    text = atomic_text(joined)
    # Charges the memory of all parts before they are created.
    check_limits(size=_ATOM_BYTES * text.count(separator_text))
    return unify(parts, make_list(convert_each(atom, text.split(separator_text))), machine.trail)


def _join(parts: Term, separator_text: str) -> Optional[str]:
    """Return the joined text, or None if the list is partial or an item is unbound."""
    texts: List[str] = []
    if list_items(parts) is None:
        partial_items(parts)  # raises the error for a term that is not a list
        return None
    for item in with_limit_checks(items(parts)):
        item = deref(item)
        text = constant_text(item)
        if text is None:
            if item.__class__ is Var:
                return None
            raise type_error("text", item)
        texts.append(text)
    return join_texts(texts, separator_text)


def _case_converter(
    change_case: Callable[[str], str], make: TextConstructor, type_name: str
) -> Callable[[ProgramMachine, Term, Term], bool]:
    def run(machine: ProgramMachine, text: Term, result: Term) -> bool:
        source_text = atomic_text(text)
        check_text_length(len(source_text), source_text)
        # A long text is converted in pieces, with a check of the limits after each. The lower case of a capital sigma
        # depends on the letters around it, which may be in another piece.
        if len(source_text) > _MAX_CASE_CHARACTERS and "Σ" not in source_text:
            changed = "".join([change_case(piece) for piece in in_checked_slices(source_text)])
        else:
            changed = change_case(source_text)
        require_no_compound(result, type_name)
        return unify(result, make(changed), machine.trail)

    return run


deterministic("upcase_atom/2")(_case_converter(str.upper, atom, "atom"))
deterministic("downcase_atom/2")(_case_converter(str.lower, atom, "atom"))
deterministic("string_upper/2")(_case_converter(str.upper, String, "string"))
deterministic("string_lower/2")(_case_converter(str.lower, String, "string"))


_CHECK_INTERVAL_MASK = len(STEPS_PER_ROUND) - 1
"""Mask of a position that is 0 where the limits are checked; the number of steps per round is a power of 2."""


@deterministic("string_length/2")
def string_length(machine: ProgramMachine, text: Term, length: Term) -> bool:
    """Unify with the number of characters of a text."""
    size = len(text_of(text))
    integer_or_var(length)
    return unify(length, size, machine.trail)


def _string_converter(to_list: TextConstructor) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that converts between a string and the list of its codes or characters."""

    def run(machine: ProgramMachine, text: Term, parts: Term) -> bool:
        if deref(text).__class__ is not Var:
            source_text, parts_term = text_of(text), deref(parts)
            if parts_term is not NIL and parts_term.__class__ not in (Var, tuple):
                return source_text == constant_text(parts_term)
            return unify(parts, to_list(source_text), machine.trail)
        return unify(text, String(text_of_list(machine, parts, True)), machine.trail)

    return run


deterministic("string_chars/2")(_string_converter(chars))
deterministic("string_codes/2")(_string_converter(codes))


def _is_compound_non_text(term: Term) -> bool:
    term = deref(term)
    return term.__class__ is tuple and not is_text_list(term)


@deterministic("atom_string/2")
def atom_string(machine: ProgramMachine, name: Term, text: Term) -> bool:
    """Convert between an atom or number and its text as a string."""
    if deref(name).__class__ is Var:
        return unify(name, atom(whole_text(text, "string")), machine.trail)
    if deref(text).__class__ is Var:
        return unify(text, String(whole_text(name, "atom")), machine.trail)
    # Two terms without text are compared below, where the error for them is raised.
    if _is_compound_non_text(name) != _is_compound_non_text(text):
        return False
    return whole_text(text, "string") == whole_text(name, "atom")


@deterministic("message_text/2")
def message_text(machine: ProgramMachine, quoted: Term, text: Term) -> bool:
    """Convert between the text of a message with double quotes inside and the text without them."""
    value = deref(quoted)
    if value.__class__ is Var:
        return unify(quoted, atom(f'"{whole_text(text, "text")}"'), machine.trail)
    name = value.name if value.__class__ is Atom else ""
    if len(name) < 2 or not name[0] == name[-1] == '"':  # noqa: PLR2004 - two quotes
        raise type_error("message_text", value)
    if deref(text).__class__ is Var:
        return unify(text, atom(name[1:-1]), machine.trail)
    return whole_text(text, "text") == name[1:-1]


@deterministic("string_to_atom/2")
def string_to_atom(machine: ProgramMachine, text: Term, name: Term) -> bool:
    """Convert between a string and an atom, see ``atom_string/2``."""
    return atom_string(machine, name, text)


@deterministic("number_string/2")
def number_string(machine: ProgramMachine, number: Term, text: Term) -> bool:
    """Convert between a number and its text as a string; fail if the text does not denote a number."""
    number = deref(number)
    if number.__class__ not in (Var, int, float):
        raise type_error("number", number)
    check_text_list(text)
    if is_ground(text):
        value = parse_number(text_of_list(machine, text, True).strip(), machine.logic.operators)
        return value is not None and unify(number, value, machine.trail)
    if not isinstance(number, (int, float)):
        raise instantiation_error()
    return unify(text, String(number_text(number)), machine.trail)


@deterministic("text_to_string/2")
def text_to_string(machine: ProgramMachine, text: Term, result: Term) -> bool:
    """Convert an atom, a string, or a list of codes or characters to a string."""
    value = text_of(text, numbers=False)
    result_term = deref(result)
    if result_term.__class__ is Atom:
        return result_term.name == value
    return unify(result, String(value), machine.trail)


def _parse_code_argument(term: Term) -> Term:
    """Return the code argument of ``string_code/3``, which may be given as a character."""
    term = deref(term)
    if term.__class__ is Var or (term.__class__ is int and term >= 0):
        return term
    if term.__class__ is Atom or term.__class__ is String or is_text_list(term):
        text = text_of(term)
        if len(text) == 1:
            return ord(text)
    raise type_error("character", term)


@nondeterministic("string_code/3")
def string_code(machine: ProgramMachine, index: Term, text: Term, code: Term) -> Outcome:
    """Enumerate the character codes of a text with their positions from 1."""
    position = integer_or_var(index)
    source_text = text_of(text, numbers=False)
    if position is None:
        return _enumerate_codes(machine, index, source_text, _parse_code_argument(code))
    if position < 0:
        raise domain_error("not_less_than_zero", position)
    return 0 < position <= len(source_text) and unify(code, ord(source_text[position - 1]), machine.trail)


def _enumerate_codes(machine: ProgramMachine, index: Term, source_text: str, code: Term) -> Solutions:
    for position, char in enumerate(source_text, 1):
        if machine.unify_all((index, position), (code, ord(char))):
            yield LAST if position == len(source_text) else None


@nondeterministic("text_concat/3")
def text_concat(machine: ProgramMachine, left: Term, right: Term, joined: Term) -> Outcome:
    """Relate two texts with their concatenation, which is a string if any argument is a string, else an atom."""
    terms = [deref(term) for term in (left, right, joined)]
    make: Callable[[str], Term] = String if any(term.__class__ is String for term in terms) else atom
    start, end, text = (None if term.__class__ is Var else text_of(term) for term in terms)
    if start is not None and end is not None:
        check_text_length(len(start) + len(end), start, end)
        return unify(joined, make(start + end), machine.trail) if text is None else text == start + end
    if text is None:
        raise instantiation_error()
    check_text_length(len(text))
    if start is not None:
        return text.startswith(start) and unify(right, make(text[len(start) :]), machine.trail)
    if end is not None:
        return text.endswith(end) and unify(left, make(text[: len(text) - len(end)]), machine.trail)
    return _enumerate_divisions(machine, left, right, text, make)


@deterministic("split_string/4")
def split_string(machine: ProgramMachine, text: Term, separators: Term, pad: Term, parts: Term) -> bool:
    """Split a text at any of the separators and strip the pad characters from each part."""
    text_value, separator_chars, pad_chars = (
        text_of(argument, numbers=False) for argument in (text, separators, pad)
    )
    separator_chars, pad_chars = _distinct_characters(separator_chars), _distinct_characters(pad_chars)
    check_text_length(len(text_value), text_value)
    partial_items(parts)
    return unify(
        parts,
        make_list(convert_each(String, list(_split(text_value, separator_chars, pad_chars)))),
        machine.trail,
    )


def _distinct_characters(text: str) -> str:
    return text if len(text) < 2 else "".join(dict.fromkeys(with_limit_checks(text)))


def _split(text: str, separators: str, pad: str) -> Iterator[str]:
    """Yield the parts of a text.

    A sequence of separators that are also pad characters counts as one, and is dropped at both ends of the text.
    """
    text = _strip(text, pad)
    start = 0
    for position, char in enumerate(text):
        if not position & _CHECK_INTERVAL_MASK:
            check_limits()
        if position >= start and char in separators:
            yield _strip(text[start:position], pad)
            start = position + 1
            # The index stays in range: the text has been stripped, so it does not end with a pad character.
            while char in pad and text[start] in pad:
                start += 1
    yield _strip(text[start:], pad)


def _strip(text: str, pad: str) -> str:
    return text.strip(pad) if pad else text


@deterministic("normalize_space/2")
def normalize_space(machine: ProgramMachine, sink: Term, text: Term) -> bool:
    """Write a text to a sink, with one space for each sequence of white space and none at the ends."""
    sink = bound(sink)
    if not is_sink(sink):
        raise existence_error("stream", sink) if sink.__class__ is Atom else type_error("output", sink)
    return fill_sink(machine, sink, join_texts(_split_words(atomic_text(text)), " "))


def _split_words(text: str) -> List[str]:
    """Return the words of a text, which are separated by white space."""
    words: List[str] = []
    is_complete = True
    # A word may extend over the boundary between two pieces.
    for piece in in_checked_slices(text):
        piece_words = piece.split()
        if not is_complete and piece_words and not piece[0].isspace():
            words[-1] += piece_words.pop(0)
        words += piece_words
        is_complete = piece[-1:].isspace()  # the only piece of an empty text is empty
    return words


# Character types

_CHAR_TYPE_TESTS: Dict[str, Callable[[str], bool]] = {
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
"""Tests of the types that are atoms. SWI-Prolog enumerates the types in this order."""

_COMPOUND_CHAR_TYPES = ("digit", "xdigit", "to_lower", "to_upper", "upper", "lower")
"""Names of the types with an argument, such as ``digit(Weight)``."""


def _known_character(term: Term) -> Optional[str]:
    """Return the character of an argument, which may be a code; None if it is unbound."""
    term = deref(term)
    if term.__class__ is Var:
        return None
    if term.__class__ is int:
        if not 0 <= term <= MAX_CODE:
            raise domain_error("character", term)
        return chr(term)
    text = constant_text(term)
    if text is None or len(text) != 1:
        raise type_error("character", term)
    return text


def _char_type_predicate(as_code: bool) -> Callable[[ProgramMachine, Term, Term], Outcome]:
    """Return ``code_type/2`` if characters are returned as codes, otherwise ``char_type/2``."""

    def make_character(char: str) -> Term:
        return ord(char) if as_code else atom(char)

    def run(machine: ProgramMachine, char: Term, char_type: Term) -> Outcome:
        """Test or enumerate the types of a character, or the characters of a type up to code 255."""
        char_type = deref(char_type)
        _check_char_type(char_type)
        character = _known_character(char)
        if character is None and char_type.__class__ is Var:
            raise instantiation_error()
        if character is None or char_type.__class__ is Var:
            return enumerate_types(machine, char, char_type, character)
        type_term = next(_matching_types(character, char_type, make_character), None)
        return type_term is not None and unify(char_type, type_term, machine.trail)

    def enumerate_types(
        machine: ProgramMachine, char: Term, char_type: Term, known_character: Optional[str]
    ) -> Solutions:
        # Without a character only Latin-1 is enumerated, since the types of all of Unicode take seconds.
        for character in [known_character] if known_character is not None else map(chr, range(256)):
            for type_term in _matching_types(character, char_type, make_character):
                pairs = [(char_type, type_term)]
                if known_character is None:
                    pairs.append((char, make_character(character)))
                if machine.unify_all(*pairs):
                    yield None

    return run


def _single_case(char: str, changed: str) -> str:
    """Return ``changed``, the character in the other case; if that has more than one character, return ``char``."""
    return changed if len(changed) == 1 else char


def _check_char_type(char_type: Term) -> None:
    """Raise a type error for a term that is not a character type."""
    if char_type.__class__ is tuple and len(char_type) == 2 and char_type[0].name in _COMPOUND_CHAR_TYPES:
        return
    if char_type.__class__ is not Var and (
        char_type.__class__ is not Atom or char_type.name not in _CHAR_TYPE_TESTS
    ):
        raise type_error("char_type", char_type)


def _matching_types(char: str, char_type: Term, make_character: Callable[[str], Term]) -> Iterator[Term]:
    """Yield the types of a character that may unify with a requested type."""
    name = (
        char_type.name
        if char_type.__class__ is Atom
        else char_type[0].name
        if char_type.__class__ is tuple
        else None
    )
    # With a known type only its own test runs; with an unbound one, all types are yielded in the order of the table.
    for type_name, test in _CHAR_TYPE_TESTS.items():
        if (name is None or (type_name == name and char_type.__class__ is Atom)) and test(char):
            yield atom(type_name)
    if char_type.__class__ is Atom:
        return
    if name in (None, "digit") and char.isdigit() and char.isascii():
        yield (functor("digit", 1), ord(char) - 48)
    if name in (None, "xdigit") and char in "0123456789abcdefABCDEF":
        yield (functor("xdigit", 1), int(char, 16))
    # As in SWI-Prolog, the argument of `to_lower` is the upper case of the character, and that of `to_upper` its
    # lower case.
    if name in (None, "to_lower"):
        yield (functor("to_lower", 1), make_character(_single_case(char, char.upper())))
    if name in (None, "to_upper"):
        yield (functor("to_upper", 1), make_character(_single_case(char, char.lower())))
    if name in (None, "upper") and char.isupper():
        yield (functor("upper", 1), make_character(char.lower()[0]))
    if name in (None, "lower") and char.islower():
        yield (functor("lower", 1), make_character(char.upper()[0]))


nondeterministic("char_type/2")(_char_type_predicate(False))
nondeterministic("code_type/2")(_char_type_predicate(True))
