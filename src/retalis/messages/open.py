"""Terms with variables against message types: what no values of the variables would make right."""

from typing import Any, Dict, List, Optional

from ..foundation import MessageError
from ..prolog.terms import CONS, FALSE, NIL, Term, Var, atom, deref, functor, make_list
from .checking import CheckingEncoder
from .definition import Definition, Field
from .slots import TIMES, VARIABLE

_DEFAULTS: Dict[str, Term] = {
    "string": atom('""'),
    "bool": FALSE,
    "time": make_list([0, 0]),
    "duration": make_list([0, 0]),
}
_SECONDS = Field("", "uint32")

LARGEST = 1 << 20
"""Bytes that a message may have at least for its terms to be looked at: values are made of all that is left open."""


def fault_of(definition: Definition, term: Term, topic: str = "") -> Optional[str]:
    """Return why a term is no message of a type, whatever its variables are; None where it may be one.

    Nothing is found in types whose messages are larger than `LARGEST` whatever they hold.

    Args:
        definition: the type.
        term: the term.
        topic: is named in the answer.
    """
    if definition.measure.least > LARGEST:
        return None
    try:
        CheckingEncoder(definition).encode(_filled(definition, term), topic)
    except MessageError as error:
        return error.message
    return None


def _filled(definition: Definition, term: Term) -> Term:
    """Return a message that has values which fit in the place of variables."""
    term = deref(term)
    if term.__class__ is Var:
        return _message(definition)
    if term.__class__ is not tuple or len(term) - 1 != len(definition.fields):
        return term
    return (term[0], *[_slot(slot, value) for slot, value in zip(definition.fields, term[1:])])


def _slot(slot: Field, value: Term) -> Term:
    value = deref(value)
    if value.__class__ is Var:
        return _some(slot)
    if slot.length is not None:
        return _elements(slot, slot._replace(length=None), value)
    if slot.definition is not None:
        return _filled(slot.definition, value)
    return _elements(slot, _SECONDS, value) if slot.type in TIMES else value


def _elements(slot: Field, element: Field, value: Any) -> Term:
    """Return a list that has values for its variables; where its end is one, any that fits."""
    items: List[Term] = []
    rest = value
    while rest.__class__ is tuple and rest[0] is CONS:
        items.append(_slot(element, rest[1]))
        rest = deref(rest[2])
    if rest.__class__ is Var:
        return _some(slot)
    return make_list(items) if rest is NIL else value


def _some(slot: Field) -> Term:
    """Return a value that fits into a slot."""
    if slot.length is not None:
        number = 0 if slot.length == VARIABLE else slot.length
        return make_list([_some(slot._replace(length=None))] * number)
    return _DEFAULTS.get(slot.type, 0) if slot.definition is None else _message(slot.definition)


def _message(definition: Definition) -> Term:
    slots = definition.fields
    if not slots:
        return atom(definition.functor_name)
    return (functor(definition.functor_name, len(slots)), *map(_some, slots))
