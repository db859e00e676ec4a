"""Kinds of values: the lattice of the value flow analysis, and the texts of its findings.

Each term has one *kind*, see `kind_of`. `Kinds` are the kinds that the values of a variable can have, each with the
`ValueOrigin` of such a value; None stands for unknown values, the top of the lattice, and an empty mapping for no
value, its bottom. The lattice is finite, so a fixpoint is reached after a bounded number of joins.
"""

import os
from typing import Callable, Dict, NamedTuple, Optional

from ...foundation.source_places import Place
from ...messages.type_definition import Field
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.syntax.literals import atom_text
from ...prolog.terms.types import CONS, FALSE, NIL, TRUE, Atom, String, Term, deref
from ..language.event_declarations import ValueType, slot_value_type

TEXT, BOOL, NUMBER, STAMP, LIST = "text", "bool", "number", "stamp", "list"
ATOM, WORD, STRING, COMPOUND = "atom", "word", "string", "compound"
PLAIN_TEXT = "plain_text"
"""Kind of a string of a message in the plain form: any atom without double quotes inside.

An atom with them is a `TEXT`: a program that has one probably means the other form.
"""
MAX_KINDS = 6
"""Maximum number of kinds of one variable; values of more kinds are taken for unknown."""


class ValueOrigin(NamedTuple):
    """Origin of a value.

    Attributes:
        text: message slot, or another origin in words; "" for a constant of the program.
        constant: the constant, or None.
        place: the place of the constant, or None.
    """

    text: str
    constant: Optional[Term] = None
    place: Optional[Place] = None


Kinds = Optional[Dict[str, ValueOrigin]]
"""Kinds of a variable's values, each with an origin; None if they are unknown."""

DESCRIPTIONS = {
    TEXT: "a text",
    PLAIN_TEXT: "a plain text",
    BOOL: "true or false",
    NUMBER: "a number",
    STAMP: "a stamp [Sec,NSec]",
    LIST: "a list",
    ATOM: "an atom",
    WORD: "the name of a number",
    STRING: "a string",
    COMPOUND: "a compound term",
}
"""A value of each kind in words."""

_OVERLAPPING = {
    # ``nan``, ``inf``, ``pi`` and the like are atoms, and numbers for slots and arithmetic.
    NUMBER: frozenset((NUMBER, WORD)),
    WORD: frozenset((WORD, NUMBER, PLAIN_TEXT)),
    ATOM: frozenset((ATOM, PLAIN_TEXT)),
    BOOL: frozenset((BOOL, PLAIN_TEXT)),
    PLAIN_TEXT: frozenset((PLAIN_TEXT, ATOM, WORD, BOOL)),
    STAMP: frozenset((STAMP, LIST)),
    LIST: frozenset((LIST, STAMP)),
}
"""Kinds with common values; all other kinds overlap only with themselves."""

_KINDS_OF_FORMS = {
    "atom": (ATOM, BOOL, WORD),
    "quoted": (TEXT,),
    "word": (WORD,),
    "nil": (LIST,),
    "cons": (LIST,),
    "stamp": (STAMP,),
    "text": (STRING,),
    "integer": (NUMBER,),
    "float": (NUMBER,),
    "compound": (COMPOUND,),
}
"""Kinds of the forms of `ValueType`."""

_USED_AS_NUMBER = "used as a number"
_NUMERIC = frozenset((NUMBER, WORD, STAMP, LIST, STRING, COMPOUND))
"""Kinds of terms that arithmetic can evaluate: also timestamps, one-element lists, expressions, and characters."""


def kind_of(term: Term) -> Optional[str]:
    """Return the kind of a term, or None for a variable."""
    value = deref(term)
    if isinstance(value, Atom):
        if value is NIL:
            return LIST
        # A string of a message, which is an atom that includes the quotes.
        if value.name.startswith('"'):
            return TEXT
        if value is TRUE or value is FALSE:
            return BOOL
        return WORD if value.functor in EVALUABLE or value.name in ("nan", "inf", "infinite") else ATOM
    if isinstance(value, (int, float)):
        return NUMBER
    if isinstance(value, String):
        return STRING
    if isinstance(value, tuple):
        return LIST if value[0] is CONS else COMPOUND
    return None


def kinds_of_slot(slot: Field, origin: str) -> Kinds:
    """Return the kinds of the values of a message slot."""
    value_type = slot_value_type(slot)
    if value_type is None:
        # A message without slots is an atom.
        kind = COMPOUND if slot.definition is None or slot.definition.fields else ATOM
        return {kind: ValueOrigin(origin)}
    return {value_type.term.name: ValueOrigin(origin)} if isinstance(value_type.term, Atom) else None


def kinds_of_type(value_type: ValueType, origin: str) -> Kinds:
    """Return the kinds of the values of a declared type."""
    kinds = {kind: ValueOrigin(origin) for form in sorted(value_type.forms) for kind in _KINDS_OF_FORMS[form]}
    return kinds if len(kinds) <= MAX_KINDS else None


def numeric_kinds() -> Kinds:
    """Return the kinds of values that arithmetic accepts."""
    return {kind: ValueOrigin(_USED_AS_NUMBER) for kind in sorted(_NUMERIC)}


def join(first: Kinds, second: Kinds) -> Kinds:
    """Return the kinds of values that are in one of two sets."""
    if first is None or second is None:
        return None
    # The first origin of a kind is kept, so that the result is stable.
    result = {**second, **first}
    return result if len(result) <= MAX_KINDS else None


def meet(first: Kinds, second: Kinds) -> Kinds:
    """Return the kinds of values that are in both sets."""
    if first is None or second is None:
        return second if first is None else first
    return {kind: origin for kind, origin in first.items() if overlaps(kind, second)}


def overlaps(kind: str, kinds: Kinds) -> bool:
    """Return whether a value of a kind can be in a set of values."""
    if kinds is None:
        return True
    return kind in kinds or any(other in kinds for other in _OVERLAPPING.get(kind, ()))


def are_disjoint(first: Kinds, second: Kinds) -> bool:
    """Return whether two sets, which are known and not empty, have no common value."""
    return bool(first) and bool(second) and not meet(first, second)


def describe(kinds: Dict[str, ValueOrigin], show: Callable[[Term], str], file: Optional[str]) -> str:
    """Return the kinds in words, with their sources.

    Args:
        kinds: the kinds.
        show: returns the text of a term.
        file: the file of the finding; constants of other files are shown with the name of theirs.
    """
    parts: Dict[str, None] = {}
    for kind, origin in kinds.items():
        if origin.text == _USED_AS_NUMBER:
            parts[origin.text] = None
        elif origin.constant is None:
            parts[f"{DESCRIPTIONS[kind]} ({origin.text})"] = None
        else:
            place = origin.place
            line = "" if place is None else f" in line {place.line}"
            if place is not None and place.source is not None and place.source != file:
                line += f" of {os.path.basename(place.source)}"
            parts[f"{DESCRIPTIONS[kind]} ({show(origin.constant)}{line})"] = None
    return " or ".join(parts)


def advise(kinds: Dict[str, ValueOrigin], constant: Term, show: Callable[[Term], str]) -> str:
    """Return what to write instead of a constant that is not in a set of values, or ""."""
    value = deref(constant)
    content = value.name if isinstance(value, Atom) else value.text if isinstance(value, String) else ""
    is_name = isinstance(value, Atom) and kind_of(value) != TEXT
    bare = content[1:-1] if len(content) > 1 and content[0] == content[-1] == '"' else content
    if not content and isinstance(value, (int, float)):
        bare = str(value)
    if TEXT in kinds and bare and value.__class__ is not tuple:
        return f"a text keeps its quotes in events, write '\"{bare}\"'"
    if PLAIN_TEXT in kinds and bare and value.__class__ is not tuple:
        return f"write {atom_text(bare)}"
    if BOOL in kinds and ATOM not in kinds:
        return "write true or false"
    if NUMBER in kinds and is_numeral(bare):
        return f"write {bare}"
    if STRING in kinds and is_name:
        return f'write "{bare}"'
    if ATOM in kinds and bare and not is_name:
        example = kinds[ATOM].constant
        return f"write the atom without double quotes{'' if example is None else f', as {show(example)}'}"
    return ""


def advise_conversion(first: Kinds, second: Kinds, name: str) -> str:
    """Return what to do for a variable with values of two sets that are never equal, or ""."""
    quoted = find_quoted_text(first, second)
    if quoted is not None:
        return advise_plain_text(quoted)
    for kinds, others in ((first, second), (second, first)):
        if not kinds or not others or TEXT not in kinds:
            continue
        for kind in (ATOM, STRING, BOOL, WORD):
            constant = others[kind].constant if kind in others else None
            if isinstance(constant, (Atom, String)):
                content = constant.name if isinstance(constant, Atom) else constant.text
                return f"a text keeps its quotes in events, write '\"{content}\"'"
        content_goal = f"sub_atom({name if name[:1].isupper() else 'X'}, 1, _, 1, Atom)"
        if NUMBER in others:
            return f"for the number in a text write {content_goal}, atom_number(Atom, Number)"
        if ATOM in others or PLAIN_TEXT in others:
            return f"for the atom in a text write {content_goal}"
    return ""


def find_quoted_text(first: Kinds, second: Kinds) -> Optional[ValueOrigin]:
    """Return the constant with double quotes inside among values that meet plain texts only, or None."""
    for kinds, others in ((first, second), (second, first)):
        if kinds and others and PLAIN_TEXT in others and TEXT not in others and TEXT in kinds:
            return kinds[TEXT] if kinds[TEXT].constant is not None else None
    return None


def advise_plain_text(quoted: ValueOrigin) -> str:
    """Return what to write instead of a constant with double quotes inside, in a program with plain strings."""
    constant = quoted.constant
    content = constant.text if isinstance(constant, String) else getattr(constant, "name", "")
    return f"write {atom_text(content.strip(chr(34)))}"


def conversion_to_text(name: str, has_quotes: bool = True) -> str:
    """Return the advice to make a text of a variable, with or without double quotes inside."""
    directive = '"~w"' if has_quotes else "~w"
    return f"make a text of it, as with format(atom(Text), '{directive}', [{name if name[:1].isupper() else 'X'}])"


def is_numeral(text: str) -> bool:
    """Return whether a text is that of a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
