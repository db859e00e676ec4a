"""The sections of a state with the checks of what each contains, apart from what rules and streams know (`nodes`)."""

from typing import Dict

from ...events.knowledge import MEMORIZE, SUBSCRIBE
from ...events.language import Property
from ...foundation import Place, UsageError
from ...prolog.logic import KeptLogic, KeptValues
from ...prolog.terms import Atom, Functor
from .coding import from_bytes
from .holdings import read_terms
from .schema import (
    Decoded,
    ValueCheck,
    anything,
    boolean,
    callable_term,
    count,
    dict_of,
    each,
    fields,
    fixed,
    functor,
    instant,
    integer,
    items,
    key,
    named,
    one_of,
    optional,
    path,
    record,
    seconds,
    term,
    text,
    variable,
    wrong,
)

place = record(Place, source=text, line=count, column=count, text=text, before=count)
"""Check of where something stands in a file."""

clause = fixed(callable_term, term, optional(place))
"""Check of the head, the body and the place of a clause."""

rule = fixed(callable_term, optional(term), optional(place), dict_of(variable, text), count, text, boolean)
"""Check of a rule: its term, label, place and names of variables; its serial, its name, and whether it is active."""

_property = record(Property, label=term, name=text, value=term)
_places = each(count)


def _definition(of: Functor) -> ValueCheck:
    """Return a check of the term that a memory or subscription was made of."""

    def check(value: Decoded) -> Decoded:
        if value.__class__ is not tuple or value[0] is not of:
            raise wrong(value, f"a term of {of}")
        return value

    return check


def _property_that_is_known(value: Decoded) -> Property:
    found: Property = _property(value)
    if found.label.__class__ is not Atom or found.problem is not None:
        raise wrong(value, found.problem or "a property of a label")
    return found


def _clauses(value: Decoded) -> Decoded:
    """Check a predicate with its clauses."""
    kind, marks, clauses = fixed(functor, fixed(boolean, boolean, boolean, boolean), each(clause))(value)
    for head, body, _ in clauses:
        arity = len(head) - 1 if head.__class__ is tuple else 0
        if arity != kind.arity:
            raise wrong(head, f"a clause of {kind}")
        if body.__class__ in (int, float):
            raise wrong(body, "the body of a clause")
    return kind, marks, clauses


_network = fields(
    rules=each(rule),
    properties=each(_property_that_is_known),
    flags=dict_of(text, term),
    loaded=each(path),
    own=each(path),
)
_standing = fields(
    rules=_places,
    clauses=each(fixed(functor, _places)),
    retracted=each(fixed(functor, each(clause))),
    memories=_places,
    subscriptions=_places,
    properties=each(_property_that_is_known),
    flags=dict_of(text, optional(term)),
    dynamic=each(functor),
    replaced=each(functor),
    files=each(path),
    declared=_places,
    timers=each(fixed(term, term)),
)
_module = fixed(each(functor), each(functor), each(text), each(text))
_kinds = each(lambda value: text(value) if value.__class__ is str else integer(0, 100)(value), tuple)
_COUNTED: Dict[str, ValueCheck] = {
    "counters": dict_of(text, integer()),
    "flags": dict_of(text, term),
    "flag": dict_of(text, term),
    "gensym": dict_of(text, count),
    "counters of events": dict_of(key, integer()),
    "flags of events": dict_of(key, term),
    "modules": dict_of(text, _module),
    "arguments of predicates": dict_of(functor, _kinds),
}


def _counted(value: Decoded) -> Dict[str, Decoded]:
    found = dict_of(text, anything)(value)
    for name in found:
        if name not in _COUNTED:
            raise wrong(name, "what built-ins keep")
    return {name: named(name, _COUNTED[name])(one) for name, one in found.items()}


_operator_columns = fixed(
    each(integer(0, 1200)), each(one_of("xfx", "xfy", "yfx", "fy", "fx", "xf", "yf")), each(text)
)


def _operators(value: Decoded) -> Decoded:
    """Check the priorities, types and names of operators."""
    priorities, types, names = columns = _operator_columns(value)
    if not len(priorities) == len(types) == len(names):
        raise wrong(len(names), f"{len(priorities)} names and types of operators")
    return columns


def _clock(value: Decoded) -> Decoded:
    return fixed(instant, instant, integer(0, 1), count, *[instant] * max(0, min(2, len(items(value)) - 4)))(
        value
    )


def _unchecked(names: str) -> ValueCheck:
    """Return a check of a mapping of exactly these names; what they have is checked against the program."""
    return fields(**dict.fromkeys(names.split(), anything))


SECTIONS: Dict[str, ValueCheck] = {
    "values": record(
        KeptValues,
        flags=dict_of(text, term),
        values=dict_of(text, term),
        column=count,
        counted=_counted,
        records=fixed(count, each(fixed(key, each(fixed(count, term))))),
        answers=each(fixed(key, each(each(term, tuple)), boolean)),
    ),
    "matches": _unchecked(
        "states tracked alarms order waiting held rates timeouts timers stored counts rows"
    ),
    "run": fields(clock=_clock, followed=boolean, taken=count, dropped=count, tokens=count, sent=each(count)),
    "program": fields(
        network=_network,
        memories=each(fixed(_definition(MEMORIZE), boolean)),
        subscriptions=each(_definition(SUBSCRIBE)),
        declared=each(callable_term),
        standings=dict_of(path, _standing),
        topics=each(fixed(text, text, text)),
        events=dict_of(text, text),
        foreign=each(path),
        swi=each(fixed(path, term, term)),
    ),
    "clauses": record(
        KeptLogic,
        operators=_operators,
        tabled=each(term),
        predicates=each(_clauses),
        incremental=each(functor),
    ),
}
"""The checks of all sections but those of memories, by name."""


def read_section(name: str, data: bytes) -> Decoded:
    """Return what a section contains, checked.

    Raises:
        UsageError: where it is damaged, or is no section of a state.
    """
    check = SECTIONS.get(name)
    if check is None:
        raise UsageError(f"it has a section '{name[:40]}', which no state has")
    return named(f"section {name}", check)(from_bytes(data))


def _column(value: Decoded) -> Decoded:
    """Check the instants of records; see `_instants`."""
    numbers, forms, stamps = fixed(anything, anything, each(term))(value)
    if forms.__class__ is not bytes or forms.translate(None, b"\0\1\2") or forms.count(2) != len(stamps):
        raise wrong(forms, "the forms of instants")
    if numbers.__class__ is bytes:
        if len(numbers) != 8 * len(forms):
            raise wrong(len(numbers), f"{len(forms)} instants")
    elif len(each(instant)(numbers)) != len(forms):
        raise wrong(numbers, f"{len(forms)} instants")
    return numbers, forms, stamps


_records = fixed(count, count, boolean, anything, _column, optional(_column))


def records(value: Decoded) -> Decoded:
    """Check some records of a memory, one after the other."""
    before, late, is_open, terms, ends, starts = _records(value)
    number = len(ends[1])
    if starts is not None and len(starts[1]) != number:
        raise wrong(len(starts[1]), f"{number} instants")
    return before, late, is_open, named("terms", lambda one: read_terms(one, number))(terms), ends, starts


def read_records(data: bytes) -> Decoded:
    """Return some records of a memory, checked.

    Raises:
        UsageError: where they are damaged.
    """
    return records(from_bytes(data))


about = fields(
    format=count,
    layout=count,
    files=each(fixed(path, text)),
    memories=each(fixed(count, count, records)),
    made=seconds,
)
"""Check of what a checkpoint says of itself."""
