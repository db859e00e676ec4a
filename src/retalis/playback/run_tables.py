"""Tables of run records for data analysis, as Parquet or CSV: one row per record, and one for the bag.

All rows of a result have the columns of `_list_columns`. An output that is a message has its slots in the column
``message``, in a struct that is named after the topic: ``message.alarm.header.frame_id``. The slots are read from the
serialized message that the playback has made from the term, so that they have the values that a subscriber receives.

An instant is two columns: a timestamp in microseconds, because most tools have no nanoseconds with a time zone, and
the nanoseconds as integer, whose name ends with ``_ns``.

`ParquetTable` stores rows until they fill a row group, of limited number and size, and converts them column by
column. `CsvTable` writes each row at once; its columns are the scalars of the same structs.
"""

import json
import logging
from base64 import b64encode
from collections import Counter
from contextlib import suppress
from datetime import datetime, timedelta
from itertools import accumulate, chain
from types import TracebackType
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Type,
)

from ..foundation.displayed_text import format_count
from ..foundation.ros_name_checks import strip_slashes
from ..messages.message_dictionaries import read_message_term
from ..messages.type_definition import PRIMITIVES, Definition, Field
from ..messages.type_registry import Definitions
from .decompression import describe_error
from .playback import Output
from .rosbag1 import BagError, PathLike

log = logging.getLogger("retalis")

MAX_MESSAGE_COLUMNS = 10_000
"""Maximum number of scalar and array columns of messages; the messages of further topics have no columns."""

MAX_MESSAGE_LEVELS = 60
"""Maximum depth of a message in Parquet's schema, in which a list has two levels: pyarrow reads at most 100."""

_ROW_GROUP_SIZE = 10_000

_ROW_GROUP_BYTES = 1 << 23
"""Size of texts and messages from which a row group is written, so that large messages do not fill the memory."""

INCOMPLETE_FILES_KEY = "retalis.incomplete_files"
"""Key of the metadata of a Parquet file with the incomplete files of the bag, a JSON list of records."""


class TableColumn(NamedTuple):
    """A column of a table, or a field of a struct.

    Attributes:
        type: type of its values, or of the elements of its lists: a number type of messages, ``text``, ``texts``,
            ``bytes``, ``timestamp`` (of nanoseconds), ``seconds`` (of nanoseconds), ``mark`` (a message without
            slots, which is true) or ``struct``.
        source: key of its value in a record or message.
        is_list: whether its values are lists.
    """

    name: str
    type: str
    source: str
    is_list: bool = False
    fields: "Tuple[TableColumn, ...]" = ()


def _make_instant(name: str, source: str) -> List[TableColumn]:
    return [TableColumn(name, "timestamp", source), TableColumn(f"{name}_ns", "int64", source)]


def _list_columns(
    labels: Iterable[str], message: Sequence[TableColumn], has_events: bool
) -> List[TableColumn]:
    """Return the columns of a table.

    Args:
        labels: names of the columns whose value all rows share.
        message: structs of the topics with messages.
        has_events: whether there are records other than outputs.
    """
    columns = [
        *(TableColumn(name, "text", name) for name in labels),
        TableColumn("incomplete", "bool", "incomplete"),
        TableColumn("kind", "text", "kind"),
        *_make_instant("time", "time"),
        TableColumn("topic", "text", "topic"),
        TableColumn("id", "text", "id"),
        TableColumn("output", "text", "output"),
    ]
    if message:
        columns.append(TableColumn("message", "struct", "message", fields=tuple(message)))
    columns += [*_make_instant("started", "start"), *_make_instant("ended", "end")]
    if has_events:
        columns += [
            TableColumn("event", "text", "event"),
            TableColumn("wait", "text", "wait"),
            TableColumn("memories", "texts", "memories"),
            TableColumn("memory", "text", "memory"),
            TableColumn("pattern", "text", "pattern"),
            TableColumn("size", "int64", "size"),
            TableColumn("records", "int64", "records"),
            TableColumn("taken", "int64", "taken"),
        ]
    return columns


def message_columns(definition: Definition) -> Tuple[TableColumn, ...]:
    """Return the columns of a message's slots; empty for a type without slots."""
    taken: Set[str] = {slot.name.lower() for slot in definition.fields}
    used: Set[str] = set()
    columns: List[TableColumn] = []
    for slot in definition.fields:
        # SQL does not distinguish case, so that `X` after `x` would be the same column.
        name = _make_unique(slot.name, used)
        used.add(name.lower())
        columns.append(_make_slot_column(slot, name))
        if columns[-1].type in ("timestamp", "seconds"):
            nanoseconds = _make_unique(f"{slot.name}_ns", taken | used)
            used.add(nanoseconds.lower())
            columns.append(TableColumn(nanoseconds, "int64", slot.name, slot.length is not None))
    return tuple(columns)


def _make_unique(name: str, taken: Set[str]) -> str:
    while name.lower() in taken:
        name += "_"
    return name


def _make_slot_column(slot: Field, name: str) -> TableColumn:
    if slot.is_bytes:
        return TableColumn(name, "bytes", slot.name)
    is_list = slot.length is not None
    if slot.definition is not None:
        fields = message_columns(slot.definition)
        # Parquet has no structs without fields.
        return TableColumn(name, "struct" if fields else "mark", slot.name, is_list, fields)
    special_types = {"time": "timestamp", "duration": "seconds", "string": "text"}
    return TableColumn(name, special_types.get(slot.type, slot.type), slot.name, is_list)


def _count_leaves(columns: Iterable[TableColumn]) -> int:
    return sum(_count_leaves(column.fields) if column.fields else 1 for column in columns)


def _count_levels(columns: Iterable[TableColumn]) -> int:
    return max((1 + 2 * column.is_list + _count_levels(column.fields) for column in columns), default=0)


class RunTable:
    """A new table with the records of a playback; a context manager. The file is complete when it is closed.

    If the block of the context manager raises an exception, the file is closed as it is.

    `begin` is called once, after the records of incomplete files and before all others.

    Args:
        path: path of the file; an existing file is replaced.
        labels: values of the columns that all rows share, by name.
        has_events: whether there are records other than outputs.
    """

    def __init__(self, path: PathLike, labels: Mapping[str, Optional[str]], has_events: bool):
        self._path = str(path)
        self._labels = labels
        self._has_events = has_events
        self._incomplete_files: List[Mapping[str, Any]] = []
        self._shared: Dict[str, Any] = {}
        self._topics: Dict[str, TableColumn] = {}
        """Structs of topics by their names without the first slash."""
        self._file: Any = None
        self._read: Dict[str, Callable[[bytes], Any]] = {}
        """Functions from a serialized message to its slots, by the names of topics."""

    def begin(self, types: Mapping[str, Definition], definitions: Definitions, start: int, end: int) -> None:
        """Add the columns, and the row of the bag.

        Args:
            types: message types of the output topics.
            definitions: the known message types.
            start: time of the first message in nanoseconds; 0 for an empty bag.
            end: time of the last message in nanoseconds; 0 for an empty bag.
        """
        count = 0
        names: Set[str] = set()
        for full_name, definition in types.items():
            topic = strip_slashes(full_name)
            fields = message_columns(definition)
            leaf_count = max(1, _count_leaves(fields))
            problem = ""
            if count + leaf_count > MAX_MESSAGE_COLUMNS:
                problem = f"all messages would have more than {MAX_MESSAGE_COLUMNS}"
            elif _count_levels(fields) > MAX_MESSAGE_LEVELS:
                problem = f"they would be nested more than {MAX_MESSAGE_LEVELS} deep"
            if problem:
                log.warning("topic %s: its messages have no columns, because %s", topic, problem)
                continue
            count += leaf_count
            name = _make_unique(topic, names)
            names.add(name.lower())
            self._topics[topic] = TableColumn(name, "struct" if fields else "mark", topic, fields=fields)
            self._read[topic] = _make_reader(definition, definitions)
        self._shared = {**self._labels, "incomplete": bool(self._incomplete_files)}
        columns = _list_columns(self._labels, tuple(self._topics.values()), self._has_events)
        self._open(columns)
        self._write_row({"kind": "bag", "start": start if end else None, "end": end or None}, "", None)

    def write(self, record: Mapping[str, Any], output: Optional[Output] = None) -> None:
        """Write a record as a row, with the message of an output.

        Args:
            record: a record of the run.
            output: the output that the record describes.
        """
        if "incomplete" in record:
            self._incomplete_files.append(record)
            return
        topic = "" if output is None else strip_slashes(output.topic)
        data = output.data if output is not None and topic in self._topics else None
        # The name of the first field is the kind of the record.
        self._write_row({"kind": next(iter(record)), **record}, topic, data)

    def _open(self, columns: List[TableColumn]) -> None:
        raise NotImplementedError

    def _write_row(self, row: Dict[str, Any], topic: str, data: Optional[bytes]) -> None:
        """Write a row with the message of a topic, which is serialized; None without a message."""
        raise NotImplementedError

    def _finish(self) -> None:
        """Write what is not in the file yet."""

    def close(self) -> None:
        """Complete the file."""
        if self._file is None:
            return
        try:
            self._finish()
            self._file.close()
        except BaseException:
            self._discard()
            raise

    def _discard(self) -> None:
        """Close the file as it is."""
        # The buffer may be what cannot be written.
        with suppress(OSError):
            self._file.close()

    def __enter__(self) -> "RunTable":
        return self

    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        if error is None:
            self.close()
        elif self._file is not None:
            self._discard()


def _make_reader(definition: Definition, definitions: Definitions) -> Callable[[bytes], Any]:
    if not definition.fields:
        return lambda data: True
    decode = definitions.decoder(definition).decode
    return lambda data: read_message_term(definition, decode(data))


# ---- Parquet -----------------------------------------------------------------------------------------


class ParquetTable(RunTable):
    """A Parquet file; see `RunTable`. Records of incomplete files become metadata of the file.

    Raises:
        BagError: if the Python package pyarrow is not available.
    """

    def __init__(self, path: PathLike, labels: Mapping[str, Optional[str]], has_events: bool):
        super().__init__(path, labels, has_events)
        try:
            import pyarrow  # noqa: PLC0415 - an optional package
            from pyarrow import parquet  # noqa: PLC0415
        except ImportError as error:  # also raised by a pyarrow that does not fit the installed numpy
            raise BagError(
                f"writing Parquet needs the Python package pyarrow (pip install pyarrow): {describe_error(error)}"
            ) from None
        self._arrow: Any = pyarrow
        self._parquet: Any = parquet
        self._columns: List[TableColumn] = []
        self._rows: List[Dict[str, Any]] = []
        self._messages: List[Optional[Tuple[str, bytes]]] = []
        self._byte_count = 0
        self._dropped: Dict[str, int] = Counter()
        """Numbers of values that have been replaced by null, by column."""
        self._writer: Any = None
        number_types = {
            name: getattr(pyarrow, {"byte": "int8", "char": "uint8", "bool": "bool_"}.get(name, name))()
            for name in PRIMITIVES
        }
        self._types: Dict[str, Any] = {
            **number_types,
            "text": pyarrow.string(),
            "texts": pyarrow.list_(pyarrow.string()),
            "bytes": pyarrow.binary(),
            "timestamp": pyarrow.timestamp("us", tz="UTC"),
            "seconds": pyarrow.float64(),
            "mark": pyarrow.bool_(),
        }

    def _open(self, columns: List[TableColumn]) -> None:
        metadata = (
            {INCOMPLETE_FILES_KEY: json.dumps(self._incomplete_files)} if self._incomplete_files else None
        )
        fields = [(column.name, self._find_type(column)) for column in columns]
        self._columns = columns
        self._schema: Any = self._arrow.schema(fields, metadata)
        # Not by its path, which pyarrow refuses if it is not UTF-8.
        self._file = open(self._path, "wb")  # noqa: SIM115 - `close` closes it
        self._writer = self._parquet.ParquetWriter(self._file, self._schema)

    def _find_type(self, column: TableColumn) -> Any:
        if column.fields:
            element = self._arrow.struct([(field.name, self._find_type(field)) for field in column.fields])
        else:
            element = self._types[column.type]
        return self._arrow.list_(element) if column.is_list else element

    def _write_row(self, row: Dict[str, Any], topic: str, data: Optional[bytes]) -> None:
        self._rows.append(row)
        self._messages.append(None if data is None else (topic, data))
        self._byte_count += len(data or b"") + len(row.get("output") or row.get("event") or "")
        if len(self._rows) >= _ROW_GROUP_SIZE or self._byte_count >= _ROW_GROUP_BYTES:
            self._flush()

    def _flush(self) -> None:
        """Write the stored rows as a row group."""
        arrays = [self._make_column(column) for column in self._columns]
        self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))
        self._rows.clear()
        self._messages.clear()
        self._byte_count = 0

    def _make_column(self, column: TableColumn) -> Any:
        if column.name == "message":
            return self._make_messages(column)
        if column.source in self._shared:
            values = [self._shared[column.source]] * len(self._rows)
        else:
            values = [row.get(column.source) for row in self._rows]
        return self._make_array(column, values)

    def _make_messages(self, column: TableColumn) -> Any:
        """Return the column of messages, in which the structs of other topics are null."""
        messages = [message for message in self._messages if message is not None]
        # Grouped first, because a program can have thousands of topics.
        positions: Dict[str, List[int]] = {topic.source: [] for topic in column.fields}
        for position, (name, _) in enumerate(messages):
            positions[name].append(position)
        structs = []
        for topic in column.fields:
            indices: List[Optional[int]] = [None] * len(messages)
            values: List[Any] = []
            for position in positions[topic.source]:
                indices[position] = len(values)
                values.append(self._read[topic.source](messages[position][1]))
            structs.append(self._place(self._make_array(topic, values), indices))
        numbers = iter(range(len(messages)))
        indices = [None if message is None else next(numbers) for message in self._messages]
        fields = [self._arrow.field(topic.name, self._find_type(topic)) for topic in column.fields]
        return self._place(self._arrow.StructArray.from_arrays(structs, fields=fields), indices)

    def _place(self, array: Any, indices: List[Optional[int]]) -> Any:
        """Return the elements of an array at the given indices, and nulls."""
        if not len(array):
            return self._arrow.nulls(len(indices), array.type)
        return array.take(self._arrow.array(indices, self._arrow.int64()))

    def _make_array(self, column: TableColumn, values: List[Any]) -> Any:
        """Return an array of values; only scalars may be None."""
        if column.is_list:
            offsets = self._arrow.array([0, *accumulate(map(len, values))], self._arrow.int32())
            elements = self._make_array(column._replace(is_list=False), list(chain.from_iterable(values)))
            return self._arrow.ListArray.from_arrays(offsets, elements)
        if column.fields:
            arrays = [
                self._make_array(field, [value[field.source] for value in values]) for field in column.fields
            ]
            fields = [self._arrow.field(field.name, self._find_type(field)) for field in column.fields]
            return self._arrow.StructArray.from_arrays(arrays, fields=fields)
        return self._make_scalars(column, values)

    def _make_scalars(self, column: TableColumn, values: List[Any]) -> Any:
        arrow_type = self._types[column.type]
        if column.type == "mark":
            values = [True] * len(values)
        elif column.type == "seconds":
            values = [value / 10**9 for value in values]
        elif column.type == "timestamp":
            # Readers fail at years beyond 9999; the integer of such an instant is null, too.
            values = [value // 1000 if _fits_integer(value) else None for value in values]
        try:
            return self._arrow.array(values, arrow_type)
        except UnicodeEncodeError:
            return self._arrow.array(
                [None if value is None else _as_unicode(value) for value in values], arrow_type
            )
        except OverflowError:
            kept = [value if _fits_integer(value) else None for value in values]
            self._dropped[column.name] += kept.count(None) - values.count(None)
            return self._arrow.array(kept, arrow_type)

    def _discard(self) -> None:
        # Otherwise its destructor would write to the closed file.
        if self._writer is not None:
            self._writer.is_open = False
        super()._discard()

    def _finish(self) -> None:
        """Write the remaining rows and the index."""
        if self._rows:
            self._flush()
        self._writer.close()
        for name, count in self._dropped.items():
            log.warning(
                "column %s: %s of more than 64 bits: null in the result", name, format_count(count, "integer")
            )


def _fits_integer(value: Optional[int]) -> bool:
    """Return whether a value is an integer of 64 bits."""
    return value is not None and -(1 << 63) <= value < 1 << 63


def _as_unicode(text: str) -> str:
    """Return a text with unpaired surrogates replaced, which UTF-8 does not have."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


# ---- CSV ---------------------------------------------------------------------------------------------


class _CsvLeaf(NamedTuple):
    """A column of a CSV file: its name, the keys that lead to its value, and its column."""

    name: str
    keys: Tuple[str, ...]
    column: TableColumn


class CsvTable(RunTable):
    """A CSV file (RFC 4180, with line feeds); see `RunTable`.

    The fields of structs are columns, whose names contain dots. Lists are JSON, bytes are base64.
    """

    def __init__(self, path: PathLike, labels: Mapping[str, Optional[str]], has_events: bool):
        super().__init__(path, labels, has_events)
        self._before: List[_CsvLeaf] = []
        self._after: List[_CsvLeaf] = []
        """Columns before and after those of messages."""
        self._leaves: Dict[str, List[_CsvLeaf]] = {}
        """Columns of messages by topic."""

    def _open(self, columns: List[TableColumn]) -> None:
        names = [column.name for column in columns]
        position = names.index("message") if "message" in names else len(names)
        self._before = list(_list_leaves(columns[:position]))
        self._after = list(_list_leaves(columns[position + 1 :]))
        self._leaves = {
            topic: list(_list_leaves([column], "message.")) for topic, column in self._topics.items()
        }
        # Not with the platform's line ends, so that a result is the same everywhere.
        self._file = open(self._path, "w", encoding="utf-8", newline="")  # noqa: SIM115 - `close` closes it
        leaves = [*self._before, *chain.from_iterable(self._leaves.values()), *self._after]
        self._write_cells(_quote(leaf.name) for leaf in leaves)

    def _write_row(self, row: Dict[str, Any], topic: str, data: Optional[bytes]) -> None:
        row.update(self._shared)
        cells = [_format_cell(leaf, row) for leaf in self._before]
        for name, leaves in self._leaves.items():
            if name == topic and data is not None:
                message = {topic: self._read[topic](data)}
                cells += [_format_cell(leaf, message) for leaf in leaves]
            else:
                cells += [""] * len(leaves)
        cells += [_format_cell(leaf, row) for leaf in self._after]
        self._write_cells(cells)

    def _write_cells(self, cells: Iterable[str]) -> None:
        self._file.write(",".join(cells) + "\n")


def _list_leaves(
    columns: Iterable[TableColumn], prefix: str = "", keys: Tuple[str, ...] = ()
) -> Iterator[_CsvLeaf]:
    """Yield the columns of CSV for columns and the fields of their structs."""
    for column in columns:
        if column.fields and not column.is_list:
            yield from _list_leaves(column.fields, f"{prefix}{column.name}.", (*keys, column.source))
        else:
            yield _CsvLeaf(f"{prefix}{column.name}", (*keys, column.source), column)


def _format_cell(leaf: _CsvLeaf, row: Mapping[str, Any]) -> str:
    """Return the text of a cell; "" for a missing value."""
    value: Any = row
    for key in leaf.keys:
        value = value.get(key)
    if value is None:
        return ""
    column = leaf.column
    if column.is_list or column.type == "texts":
        return _quote(json.dumps(_plain_value(column, value), ensure_ascii=False))
    plain = _plain_value(column, value)
    if plain is None:
        return ""
    if plain.__class__ is bool:
        return "true" if plain else "false"
    return repr(plain) if isinstance(plain, (int, float)) else _quote(plain)


def _plain_value(column: TableColumn, value: Any) -> Any:
    """Return a value of a column as JSON can represent it."""
    if column.is_list:
        element = column._replace(is_list=False)
        return [_plain_value(element, item) for item in value]
    if column.fields:
        return {field.name: _plain_value(field, value[field.source]) for field in column.fields}
    convert = _PLAIN_VALUES.get(column.type)
    return value if convert is None else convert(value)


_EPOCH = datetime(1970, 1, 1)


def _format_timestamp(nanoseconds: int) -> Optional[str]:
    """Return an instant in ISO 8601; None outside of the years 1 to 9999."""
    try:
        instant = _EPOCH + timedelta(microseconds=nanoseconds // 1000)
    except OverflowError:
        return None
    return f"{instant.isoformat(timespec='microseconds')}Z"


_PLAIN_VALUES: Dict[str, Callable[[Any], Any]] = {
    "timestamp": _format_timestamp,
    "seconds": lambda nanoseconds: nanoseconds / 10**9,
    "bytes": lambda data: str(b64encode(data), "ascii"),
    "mark": lambda value: True,
}


def _quote(text: str) -> str:
    return '"' + _as_unicode(text).replace('"', '""') + '"'


TABLE_TYPES: Dict[str, Type[RunTable]] = {"parquet": ParquetTable, "csv": CsvTable}
"""Table types by format."""
