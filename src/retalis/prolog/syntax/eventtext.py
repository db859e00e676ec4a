"""Terms to event text, as the String topics carry it."""

from functools import lru_cache
from typing import Any, List, Union

from ..terms import CONS, NIL, SECOND, Atom, String, Term, Var, datime, deref, serial
from .atoms import atom_text, quote
from .numerals import integer_text


def to_text(  # noqa: C901 -- the loop of all events that go out: a call for each part would cost as much
    term: Term,
) -> str:
    """Return a term as event text: quoted, without operators and blanks.

    Floats are written as Python's shortest text that reads back; ``nan``, ``inf`` and ``-inf`` bare (the
    atoms of these names are quoted).
    """
    out: List[str] = []
    put = out.append
    stack: List[Union[Term, str]] = [term]
    pop = stack.pop
    while stack:
        item: Any = pop()
        kind = item.__class__
        if kind is str:
            put(item)
        elif kind is float:
            put(float_text(item))
        elif kind is int:
            put(integer_text(item))
        elif kind is tuple:
            if item[0] is CONS:
                _list(item, stack)
            else:
                put(atom_text(item[0].name) + "(")
                stack.append(")")
                for argument in item[:1:-1]:
                    stack += (argument, ",")
                stack.append(item[1])
        elif kind is Atom:
            put(_name(item.name))
        elif kind is String:
            put(quote(item.text, '"'))
        elif kind is Var and item.ref is None:
            put(f"_G{serial(item)}")
        else:
            stack.append(deref(item))
    return "".join(out)


def event_text(event: str, instant: int) -> str:
    """Return the goal that makes an event, from the event's text and its instant.

    Raises:
        UsageError: where the instant lies outside the years 1 to 9999.
    """
    seconds, nanoseconds = divmod(instant, SECOND)
    stamp = f"{_second_text(seconds)}{nanoseconds})"
    return f"event({event},[{stamp},{stamp}])"


@lru_cache(maxsize=64)
def _second_text(seconds: int) -> str:
    """Return the text of a datime up to its nanoseconds; many events fall into one second."""
    return to_text(datime(seconds * SECOND))[:-2]


def _list(term: Term, stack: List[Union[Term, str]]) -> None:
    entries: List[Union[Term, str]] = ["["]
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


def float_text(value: float) -> str:
    """Return a float as event text has it."""
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text
