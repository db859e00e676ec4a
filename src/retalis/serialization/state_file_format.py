"""Container of a state file: header, checksums, format version, and migrations between versions.

A state file consists of a magic line, the length of a JSON header, the header, and the sections. The header has the
format number, the byte order of packed numbers, and the name, length and CRC-32 of each section.

Files of older formats are migrated when they are read: `MIGRATIONS` has the changes from each format to the next.
"""

import json
import sys
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple
from zlib import crc32

from ..foundation.errors import UsageError
from .state_fields import named_values, read_named_values
from .stored_field_types import ANYTHING, COUNT, FieldChange, items_of, sequence_of, tuple_of

MAGIC = b"retalis state\n"

_MAX_HEADER_BYTES = 16_000_000
"""Maximum size of the header, which has an entry for each memory."""

_MAX_HEADER_DIGITS = 20
"""Maximum number of digits of an integer in the header."""

FORMAT_NUMBER = 14
"""Format number of state files, incremented when the fields of a record change, see `MIGRATIONS`."""

_NO_SERVICE_CALLS = ["count", 0, "failed_count", 0, "refused_count", 0, "unanswered_calls", [0, []]]

_ASSIGNMENTS = sequence_of(sequence_of(tuple_of(COUNT, COUNT)))
"""Order and step of each element of some matches."""
_TABLE = tuple_of(COUNT, ANYTHING)


def _share_matched_elements(fields: Dict[str, object]) -> Dict[str, object]:
    """Replace the list of elements of each match in the partitions of a row pattern by nodes of a shared buffer."""
    node_tables, state_tables, match_tables = [], [], []
    for state_table, completed in zip(items_of(fields.get("states")), items_of(fields.get("completed"))):
        row_count, stored = _TABLE.check(state_table)
        columns = read_named_values(stored)
        state_assignments = _ASSIGNMENTS.check(columns.pop("assignments", ()))
        completed_assignments = _ASSIGNMENTS.check(completed)
        nodes: Dict[_Node, int] = {}
        for name, column in zip(_MATCH_COLUMNS, _match_columns(state_assignments, nodes)):
            columns[name] = column
        state_tables.append([row_count, named_values(list(columns), list(columns.values()))])
        match_columns = _match_columns(completed_assignments, nodes)
        match_tables.append(_table_of(_MATCH_COLUMNS, len(completed_assignments), match_columns))
        node_tables.append(_table_of(_Node._fields, len(nodes), list(zip(*nodes))))
    return {**fields, "nodes": node_tables, "states": state_tables, "completed": match_tables}


class _Node(NamedTuple):
    """Node of a shared buffer."""

    element: int
    step: int
    previous: Optional[int]


_MATCH_COLUMNS = ("last_node", "start_order")


def _match_columns(
    matches: Sequence[Sequence[Tuple[int, int]]], nodes: Dict[_Node, int]
) -> Tuple[List[Optional[int]], List[int]]:
    """Return the columns that replace the assignments of matches.

    Args:
        matches: order and step of each element of each match.
        nodes: index of each node; new ones are added.
    """
    last_nodes: List[Optional[int]] = []
    start_orders = []
    for assignments in matches:
        last_node: Optional[int] = None
        for order, step in assignments:
            last_node = nodes.setdefault(_Node(order, step, last_node), len(nodes))
        last_nodes.append(last_node)
        start_orders.append(assignments[0][0] if assignments else 0)
    return last_nodes, start_orders


def _table_of(names: Sequence[str], row_count: int, columns: Sequence[Sequence[object]]) -> List[object]:
    """Return a table as `rows_of` stores it."""
    return [row_count, named_values(names, [list(column) for column in columns]) if row_count else []]


MIGRATIONS: Dict[int, Mapping[str, FieldChange]] = {
    11: {"StoredProgram": FieldChange(added={"strings": "quoted"})},
    12: {
        "StoredProgram": FieldChange(added={"awaited_types": []}),
        "StoredRule": FieldChange(removed=["name"]),
        "EventInput": FieldChange(added={"processed_messages": ["identities", []]}),
        "RunState": FieldChange(added={"service_calls": _NO_SERVICE_CALLS}),
        "StoredState": FieldChange(removed=["preceding_matches"]),
    },
    13: {
        "RepetitionChain": FieldChange(added={"omitted_count": 0}),
        "StoredPartition": FieldChange(convert=_share_matched_elements),
        # Releases have no conditions with aggregates of steps, whose totals would be needed.
        "StoredState": FieldChange(added={"totals": []}),
    },
}
"""By format number: the changes of records, by name, from that format to the next one.

The name of a record is that of the class whose state it is, or of the class of its rows.
"""


def changes_since(format_number: int) -> Dict[str, List[FieldChange]]:
    """Return the changes of each record from a format to the present one, oldest first."""
    changes: Dict[str, List[FieldChange]] = {}
    for number in range(format_number, FORMAT_NUMBER):
        for name, change in MIGRATIONS[number].items():
            changes.setdefault(name, []).append(change)
    return changes


def check_version(format_number: object, byte_order: object) -> int:
    """Check the format and the byte order of a state; return the format.

    Raises:
        UsageError: if this version of the package cannot read it.
    """
    oldest_format = min(MIGRATIONS, default=FORMAT_NUMBER)
    if type(format_number) is not int or not oldest_format <= format_number <= FORMAT_NUMBER:
        # Formats before 6 were pickles, which can execute code when they are read.
        is_pickle = type(format_number) is int and format_number < 6
        explanation = (
            ", a pickle of an older version of the package, which is never read" if is_pickle else ""
        )
        formats = f"format {FORMAT_NUMBER}"
        if oldest_format < FORMAT_NUMBER:
            formats = f"formats {oldest_format} to {FORMAT_NUMBER}"
        raise UsageError(f"the state is of format {format_number}{explanation}: this version reads {formats}")
    if byte_order != sys.byteorder:
        raise UsageError(f"the state was written on a machine with another byte order: {byte_order}")
    return format_number


class _Section(NamedTuple):
    """Entry of a section in the header."""

    name: str
    length: int
    checksum: int


class _Header(NamedTuple):
    """Header of a state file."""

    format_number: object
    byte_order: object
    sections: List[_Section]


class StateFile(NamedTuple):
    """Contents of a state file.

    Attributes:
        sections: encoded sections by name.
        format_number: format of the sections.
    """

    sections: Dict[str, bytes]
    format_number: int


def pack_sections(sections: Dict[str, bytes], format_number: int = FORMAT_NUMBER) -> bytes:
    """Return sections as the content of a state file."""
    entries = [[name, len(data), crc32(data)] for name, data in sections.items()]
    header = json.dumps({"format": format_number, "byte_order": sys.byteorder, "sections": entries}).encode()
    return b"".join([MAGIC, b"%d\n" % len(header), header, *sections.values()])


def unpack_sections(data: bytes) -> StateFile:
    """Return the sections of a state file.

    Raises:
        UsageError: if the data is not a state file, is of another version, or is damaged.
    """
    header, offset = _read_header(data)
    format_number = check_version(header.format_number, header.byte_order)
    sections = {}
    for name, length, checksum in header.sections:
        section = sections[name] = data[offset : offset + length]
        offset += length
        if len(section) != length or crc32(section) != checksum:
            raise UsageError(f"the state is damaged: the checksum of section {name} is wrong")
    if offset != len(data):
        raise UsageError("the state is damaged: it is longer than its header states")
    return StateFile(sections, format_number)


def _read_header(data: bytes) -> Tuple[_Header, int]:
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
        sections = [_Section(*entry) for entry in header["sections"]]
        # Negative lengths would pass the checksum of an empty section, and shift those that follow.
        names = [section.name for section in sections if section.length >= 0 and section.checksum >= 0]
        memory_names = [name for name in names if name.startswith("memory ")]
        if (
            not all(type(number) is int for _, *numbers in sections for number in numbers)
            or len(set(names)) != len(sections)
            or memory_names != [f"memory {index}" for index in range(len(memory_names))]
        ):
            raise ValueError
    except Exception as error:  # any error of malformed JSON, including excessive nesting
        raise UsageError("the state is damaged: its header is malformed") from error
    return _Header(header.get("format"), header.get("byte_order"), sections), end + 1 + length


def _parse_header_integer(digits: str) -> int:
    # Conversion takes time quadratic in the number of digits.
    if len(digits) > _MAX_HEADER_DIGITS:
        raise ValueError
    return int(digits)
