"""Terms to event text, as the String topics carry it."""

from typing import Any, List

from ..terms import CONS, NIL, Atom, String, Term, Var, deref, serial
from .atoms import atom_text, quote
from .numerals import integer_text


def to_text(term: Term) -> str:
    """Return a term as event text: quoted, without operators and blanks.

    Floats are written as Python's shortest text that reads back; ``nan``, ``inf`` and ``-inf`` bare (the
    atoms of these names are quoted).
    """
    out: List[str] = []
    stack: List[Any] = [term]
    while stack:
        item = stack.pop()
        kind = item.__class__
        if kind is str:
            out.append(item)
            continue
        if kind is Var or item.__class__ not in _KNOWN:
            item = deref(item)
            kind = item.__class__
        if kind is tuple:
            if item[0] is CONS:
                _list(item, stack)
            else:
                stack.append(")")
                for argument in item[:1:-1]:
                    stack.append(argument)
                    stack.append(",")
                stack.append(item[1])
                out.append(atom_text(item[0].name) + "(")
        elif kind is Atom:
            out.append(_name(item.name))
        elif kind is float:
            out.append(_float(item))
        elif kind is int:
            out.append(integer_text(item))
        elif kind is String:
            out.append(quote(item.text, '"'))
        else:
            out.append(f"_G{serial(item)}")
    return "".join(out)


_KNOWN = frozenset((tuple, Atom, float, int, String))


def _list(term: Term, stack: List[Any]) -> None:
    entries: List[Any] = ["["]
    while term.__class__ is tuple and term[0] is CONS:
        entries += (term[1], ",")
        term = deref(term[2])
    entries.pop()
    if term is not NIL:
        entries += ("|", term)
    entries.append("]")
    entries.reverse()
    stack += entries


def _name(name: str) -> str:
    return f"'{name}'" if name == "nan" or name == "inf" else atom_text(name)


def _float(value: float) -> str:
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text
