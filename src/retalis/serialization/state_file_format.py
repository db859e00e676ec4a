"""Sections of a state file: container format with checksums, and the schema of each section.

A state file consists of a magic line, the length of a JSON header, the header, and the sections. The header has the
format number, a checksum of the names of stored attributes (`LAYOUT_CHECKSUM`), and the name, length and CRC-32 of
each section. Files of other versions are rejected with an error that names the version.

`read_section` decodes a section and checks it with its schema in `SECTIONS`. State that only makes sense together
with a program (partial matches, streams) is checked in `network_state`.
"""

import json
import sys
from typing import Any, Dict, Tuple
from zlib import crc32

from ..events.knowledge.knowledge_base import MEMORIZE, SUBSCRIBE
from ..events.language.rule_head_parser import Property
from ..events.network.event_rule import RuleState
from ..foundation.errors import Place, UsageError
from ..prolog.syntax.operators import TYPES
from ..prolog.system.logic_state import ProgramSnapshot, ValuesSnapshot
from ..prolog.terms.timestamps import MAX_TIMESTAMP, FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Functor
from .codec import from_bytes
from .columns import decode_records
from .decoded_value_checks import (
    Decoded,
    ValueCheck,
    any_value,
    boolean,
    callable_term,
    count,
    dict_of,
    functor,
    instant,
    integer,
    invalid_value,
    items,
    key,
    mapping_with,
    one_of,
    optional,
    path,
    record,
    seconds,
    sequence_of,
    term,
    text,
    tuple_of,
    variable,
    with_name,
)
from .match_graph import FIELDS

MAGIC = b"retalis state\n"

_MAX_HEADER_BYTES = 16_000_000
"""Maximum size of the header, which has an entry for each memory."""

_MAX_HEADER_DIGITS = 20
"""Maximum number of digits of an integer in the header."""

FORMAT_NUMBER = 10
"""Format number of state files, incremented when their structure changes."""


def _layout_checksum() -> int:
    """Return a checksum of the names of stored attributes, so that renamed or added attributes are detected."""
    names = [
        (sys.byteorder,),
        *((kind, *map(str, attributes.items())) for kind, (_, attributes) in FIELDS.items()),
    ]
    names += [
        (named_tuple.__name__, *named_tuple._fields)
        for named_tuple in (RuleState, ProgramSnapshot, ValuesSnapshot)
    ]
    names.append(("instant", "int", FloatSeconds.__name__, Stamp.__name__))
    return crc32(repr(names).encode())


LAYOUT_CHECKSUM = _layout_checksum()


def pack_sections(sections: Dict[str, bytes]) -> bytes:
    """Return sections as the content of a state file."""
    entries = [[name, len(data), crc32(data)] for name, data in sections.items()]
    header = json.dumps({"format": FORMAT_NUMBER, "layout": LAYOUT_CHECKSUM, "sections": entries}).encode()
    return b"".join([MAGIC, b"%d\n" % len(header), header, *sections.values()])


def unpack_sections(data: bytes) -> Dict[str, bytes]:
    """Return the sections of a state file.

    Raises:
        UsageError: if the data is not a state file, is of another version, or is damaged.
    """
    header, offset = _read_header(data)
    check_version(header.get("format"), header.get("layout"))
    sections = {}
    for name, length, checksum in header["sections"]:
        section = sections[name] = data[offset : offset + length]
        offset += length
        if len(section) != length or crc32(section) != checksum:
            raise UsageError(f"the state is damaged: the checksum of section {name} is wrong")
    if offset != len(data):
        raise UsageError("the state is damaged: it is longer than its header states")
    return sections


def _read_header(data: bytes) -> Tuple[Dict[str, Any], int]:
    """Return the header of a state file, and the offset of the first section."""
    if not data.startswith(MAGIC):
        raise UsageError("this is not a state file")
    end = data.find(b"\n", len(MAGIC), len(MAGIC) + 20)
    try:
        length = int(data[len(MAGIC) : end])
        if not 0 <= length <= _MAX_HEADER_BYTES:
            raise ValueError
        # Decoded first: the JSON module would guess the encoding of bytes, and import its codec.
        header = json.loads(str(data[end + 1 : end + 1 + length], "utf-8"), parse_int=_parse_header_integer)
        # Negative lengths would pass the checksum of an empty section, and shift those that follow.
        names = [name for name, length, checksum in header["sections"] if length >= 0 and checksum >= 0]
        memory_names = [name for name in names if name.startswith("memory ")]
        if (
            not all(number.__class__ is int for _, *numbers in header["sections"] for number in numbers)
            or len(set(names)) != len(header["sections"])
            or memory_names != [f"memory {index}" for index in range(len(memory_names))]
        ):
            raise ValueError
    except Exception as error:  # any error of malformed JSON, including excessive nesting
        raise UsageError("the state is damaged: its header is malformed") from error
    return header, end + 1 + length


def _parse_header_integer(digits: str) -> int:
    # Conversion takes time quadratic in the number of digits.
    if len(digits) > _MAX_HEADER_DIGITS:
        raise ValueError
    return int(digits)


def check_version(format_number: object, layout: object) -> None:
    """Check the format and the stored attributes of a state.

    Raises:
        UsageError: if the state was written by another version of the package.
    """
    if format_number != FORMAT_NUMBER:
        # Formats before 6 were pickles, which can execute code when they are read.
        is_pickle = format_number.__class__ is int and format_number < 6
        explanation = (
            ", a pickle of an older version of the package, which is never read" if is_pickle else ""
        )
        raise UsageError(
            f"the state is of format {format_number}{explanation}: this version reads format {FORMAT_NUMBER}"
        )
    if layout != LAYOUT_CHECKSUM:
        raise UsageError("the state was written by another version of the package")


check_place = record(Place, source=text, line=count, column=count, text=text, before=count)
"""Check of a position in a source file."""

check_clause = tuple_of(callable_term, term, optional(check_place))
"""Check of a clause: head, body, and place."""

check_rule = tuple_of(
    callable_term, optional(term), optional(check_place), dict_of(variable, text), count, text, boolean
)
"""Check of a rule: term, label, place, names of variables, serial, name, and whether it is active."""

_check_property_items = record(Property, label=term, name=text, value=term)
_check_positions = sequence_of(count)


def _make_definition_check(expected: Functor) -> ValueCheck:
    """Return a check of the defining term of a memory or subscription."""

    def check(value: Decoded) -> Decoded:
        if value.__class__ is not tuple or value[0] is not expected:
            raise invalid_value(value, f"a term of {expected}")
        return value

    return check


def _check_property(value: Decoded) -> Property:
    label_property: Property = _check_property_items(value)
    if label_property.label.__class__ is not Atom or label_property.error_text is not None:
        raise invalid_value(value, label_property.error_text or "a property of a label")
    return label_property


_check_predicate_items = tuple_of(
    functor, tuple_of(boolean, boolean, boolean, boolean, boolean), sequence_of(check_clause)
)


def _check_predicate(value: Decoded) -> Decoded:
    """Check a predicate and its clauses."""
    predicate, properties, clauses = _check_predicate_items(value)
    for head, body, _ in clauses:
        arity = len(head) - 1 if head.__class__ is tuple else 0
        # A clause in the wrong predicate would be called with missing arguments.
        if arity != predicate.arity:
            raise invalid_value(head, f"a clause of {predicate}")
        if body.__class__ in (int, float):
            raise invalid_value(body, "the body of a clause")
    return predicate, properties, clauses


_check_network = mapping_with(
    definitions=sequence_of(check_rule),
    properties=sequence_of(_check_property),
    flags=dict_of(text, term),
    loaded_files=sequence_of(path),
    program_folders=sequence_of(path),
)
_check_deployment = mapping_with(
    rules=_check_positions,
    clauses=sequence_of(tuple_of(functor, _check_positions)),
    retracted=sequence_of(tuple_of(functor, sequence_of(check_clause))),
    memories=_check_positions,
    subscriptions=_check_positions,
    properties=sequence_of(_check_property),
    flags=dict_of(text, optional(term)),
    dynamic=sequence_of(functor),
    replaced=sequence_of(functor),
    files=sequence_of(path),
    states=_check_positions,
    timers=sequence_of(tuple_of(term, term)),
)
_check_module = tuple_of(sequence_of(functor), sequence_of(functor), sequence_of(text), sequence_of(text))
_check_argument_kinds = sequence_of(
    lambda value: text(value) if value.__class__ is str else integer(0, 100)(value), tuple
)
_BUILTIN_STATE_CHECKS: Dict[str, ValueCheck] = {
    "counters": dict_of(text, integer()),
    "flags": dict_of(text, term),
    "flag": dict_of(text, term),
    "gensym": dict_of(text, count),
    "counters of events": dict_of(key, integer()),
    "flags of events": dict_of(key, term),
    "modules": dict_of(text, _check_module),
    "arguments of predicates": dict_of(functor, _check_argument_kinds),
}


def _check_builtin_state(value: Decoded) -> Dict[str, Decoded]:
    values = dict_of(text, any_value)(value)
    for name in values:
        if name not in _BUILTIN_STATE_CHECKS:
            raise invalid_value(name, "a kind of state of built-in predicates")
    return {name: with_name(name, _BUILTIN_STATE_CHECKS[name])(state) for name, state in values.items()}


_check_operator = tuple_of(integer(0, 1200), one_of(*TYPES), text)
"""Check of the priority, type, and name of an operator."""

_MAX_CLOCK_INSTANT = MAX_TIMESTAMP + (1 << 60)
"""Largest instant in ns that a clock reaches: each event without a timestamp advances it by 1 ns."""


def _check_clock_instant(value: Decoded) -> Decoded:
    # A clock nearer to the largest instant of the format would leave no room for the events after a restore.
    if abs(instant(value)) > _MAX_CLOCK_INSTANT:
        raise invalid_value(value, "an instant that a clock can reach")
    return value


def _check_clock(value: Decoded) -> Decoded:
    """Check the state of a clock; see `Clock.snapshot`."""
    # A `StreamClock` appends its time if it is set, and its constant time if it is pinned.
    optional_instants = [_check_clock_instant] * max(0, min(2, len(items(value)) - 4))
    return tuple_of(_check_clock_instant, _check_clock_instant, integer(0, 1), count, *optional_instants)(
        value
    )


def _make_unchecked_mapping(names: str) -> ValueCheck:
    """Return a check for a mapping with exactly these names; the values are checked against the program later."""
    return mapping_with(**dict.fromkeys(names.split(), any_value))


SECTIONS: Dict[str, ValueCheck] = {
    "values": record(
        ValuesSnapshot,
        flags=dict_of(text, term),
        global_variables=dict_of(text, term),
        column=count,
        builtin_state=_check_builtin_state,
        table_answers=sequence_of(tuple_of(key, sequence_of(sequence_of(term, tuple)), boolean)),
    ),
    "matches": _make_unchecked_mapping(
        "rules occurrences alarms next_query_order pending_queries state_intervals rate_limiters timeouts timers "
        "stored_events counts objects"
    ),
    "run": mapping_with(
        clock=_check_clock,
        clock_follows_events=boolean,
        stamp_jumps=tuple_of(
            boolean,
            optional(_check_clock_instant),
            sequence_of(
                tuple_of(
                    optional(_check_clock_instant),
                    _check_clock_instant,
                    count,
                    _check_clock_instant,
                    sequence_of(optional(functor)),
                )
            ),
            sequence_of(
                tuple_of(
                    optional(functor),
                    optional(_check_clock_instant),
                    _check_clock_instant,
                    _check_clock_instant,
                )
            ),
        ),
        lags=sequence_of(tuple_of(functor, _check_clock_instant, count, count)),
        event_count=count,
        far_ahead_count=count,
        dropped_count=count,
        next_token_number=count,
        sent_counts=sequence_of(count),
    ),
    "program": mapping_with(
        rules=_check_network,
        memories=sequence_of(tuple_of(_make_definition_check(MEMORIZE), boolean)),
        subscriptions=sequence_of(_make_definition_check(SUBSCRIBE)),
        states=sequence_of(callable_term),
        deployments=dict_of(path, _check_deployment),
        topics=sequence_of(tuple_of(text, text, text)),
        event_types=dict_of(text, text),
        foreign_modules=sequence_of(path),
        swi_files=sequence_of(tuple_of(path, term, term)),
    ),
    "clauses": record(
        ProgramSnapshot,
        operators=sequence_of(_check_operator),
        table_declarations=sequence_of(term),
        predicates=sequence_of(_check_predicate),
        observed_predicates=sequence_of(functor),
        empty_dynamic=sequence_of(functor),
    ),
}
"""Checks of all sections by name, except those of memories."""


def read_section(name: str, data: bytes) -> Decoded:
    """Return the checked content of a section.

    Raises:
        UsageError: if the section is damaged or unknown.
    """
    check = SECTIONS.get(name)
    if check is None:
        raise UsageError(f"section '{name[:40]}' is unknown")
    return with_name(f"section {name}", check)(from_bytes(data))


def read_records(data: bytes) -> Decoded:
    """Return consecutive records of a memory, see `decode_records`.

    Raises:
        UsageError: if they are damaged.
    """
    return decode_records(from_bytes(data))


checkpoint_header = mapping_with(
    format=count,
    layout=count,
    files=sequence_of(tuple_of(path, text)),
    memories=sequence_of(tuple_of(count, count, decode_records)),
    written_at=seconds,
)
"""Check of the header of a checkpoint."""
