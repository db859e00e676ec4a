"""Sections of bytes by name, one after the other, with what tells whether they are whole.

The sections of a state with the checks of what each contains, apart from what rules and streams know (`nodes`).
"""

import json
from typing import Any, Dict, Tuple
from zlib import crc32

from ..events.knowledge.knowledge_base import MEMORIZE, SUBSCRIBE
from ..events.language.rule_parser import Property
from ..events.network.event_rule import RuleState
from ..foundation.errors import Place, UsageError
from ..prolog.system.logic_state import KeptLogic, KeptValues
from ..prolog.terms.types import Atom, Functor
from .codec import from_bytes
from .match_graph import FIELDS
from .memory_state import read_terms
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

MAGIC = b"retalis state\n"

_MAX_HEADER_BYTES = 16_000_000
"""Bytes of the first lines, at most: there is a name for each memory."""

FORMAT = 6
"""Raised where what is kept is arranged in another way."""


def _layout() -> int:
    """Return a number of what is kept of objects: it is another one where that has changed."""
    kinds = [(name, *fields) for name, (_, fields) in FIELDS.items()]
    kinds += [(kind.__name__, *kind._fields) for kind in (RuleState, KeptLogic, KeptValues)]
    return crc32(repr(kinds).encode())


LAYOUT = _layout()


def pack(sections: Dict[str, bytes]) -> bytes:
    """Return sections as one text of bytes."""
    listed = [[name, len(data), crc32(data)] for name, data in sections.items()]
    head = json.dumps({"format": FORMAT, "layout": LAYOUT, "sections": listed}).encode()
    return b"".join([MAGIC, b"%d\n" % len(head), head, *sections.values()])


def unpack(data: bytes) -> Dict[str, bytes]:
    """Return the sections of a text of bytes.

    Raises:
        UsageError: where it is none, of another version, or damaged.
    """
    head, at = _head(data)
    check_version(head.get("format"), head.get("layout"))
    sections = {}
    for name, length, check in head["sections"]:
        found = sections[name] = data[at : at + length]
        at += length
        if len(found) != length or crc32(found) != check:
            raise UsageError(f"the state is damaged: section {name} is not what it was")
    if at != len(data):
        raise UsageError("the state is damaged: there is more of it than it says")
    return sections


def _head(data: bytes) -> Tuple[Dict[str, Any], int]:
    if not data.startswith(MAGIC):
        raise UsageError("this is no state of an engine")
    end = data.find(b"\n", len(MAGIC), len(MAGIC) + 20)
    try:
        length = int(data[len(MAGIC) : end])
        if not 0 <= length <= _MAX_HEADER_BYTES:
            raise ValueError
        head = json.loads(data[end + 1 : end + 1 + length])
        names = [name for name, length, check in head["sections"] if length >= 0 and check >= 0]
        memories = [name for name in names if name.startswith("memory ")]
        if (
            not all(one.__class__ is int for _, *numbers in head["sections"] for one in numbers)
            or len(set(names)) != len(head["sections"])
            or memories != [f"memory {at}" for at in range(len(memories))]
        ):
            raise ValueError
    except Exception as error:  # of whatever kind: JSON that is deep, or has other types
        raise UsageError("the state is damaged: its first lines do not read") from error
    return head, end + 1 + length


def check_version(form: object, layout: object) -> None:
    """Check that what is kept is arranged as here.

    Raises:
        UsageError: where it is not.
    """
    if form != FORMAT:
        older = form.__class__ is int and form < FORMAT
        why = ", a pickle of an older version of the package, which is never read" if older else ""
        raise UsageError(f"the state is of format {form}{why}: this version reads format {FORMAT}")
    if layout != LAYOUT:
        raise UsageError("the state was kept by another version of the package")


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
