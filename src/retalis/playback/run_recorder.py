"""Recording of a playback as flat records: events, outputs, waiting queries, and memories.

`RunRecorder` produces the records, which are written as JSON lines, drawn as a timeline, or written to a Parquet file
by `RunTable` (with the package ``pyarrow``), one row per record.
"""

from itertools import islice
from typing import Any, Callable, Dict, List, NamedTuple, Union

from ..events.knowledge.knowledge_base import MEMORY_EVENTS
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.types import Term
from .decompression import describe_error
from .playback import Output, Playback
from .rosbag1 import BagError, PathLike

RunRecord = Dict[str, Union[None, int, str, List[str]]]
"""A record; its type is the name of its first field. Times are nanoseconds since the epoch, terms are strings."""

MAX_RECORDED_QUERIES = 1000
"""Maximum number of waiting queries that are observed; further ones are not recorded."""


class _Wait(NamedTuple):
    """A waiting query: its event, the ids of the memories that it waits for, and its start in bag time."""

    event: str
    memories: List[str]
    start: int


class RunRecorder:
    """Observer of a playback that reports events, outputs and waits as they occur, and the memories at the end.

    The wait of a query lasts from the message that triggers it to the message that it waits for, in bag time.

    Args:
        playback: the playback to observe.
        write_record: called with each record.
    """

    def __init__(self, playback: Playback, write_record: Callable[[RunRecord], None]):
        self._engine = playback.engine
        self._knowledge = playback.engine.knowledge
        self._read_clock = playback.clock.now
        self._write_record = write_record
        self._waits: Dict[int, _Wait] = {}
        self._engine.on_event(self._record_event)

    def _record_event(self, term: Term, start: int, end: int) -> None:
        # Events of memories are internal; `record_final_state` reports their result.
        if term.__class__ is not tuple or term[0] not in MEMORY_EVENTS:
            self._write_record({"event": canonical_text(term), "start": int(start), "end": int(end)})

    def record_output(self, output: Output) -> None:
        """Report an output."""
        self._write_record(output_record(output))

    def update_waits(self) -> None:
        """Update the waiting queries; to be called after each message."""
        pending = self._knowledge.pending_queries
        # The usual case; this is called after every message.
        if not self._waits and not len(pending):
            return
        now = int(self._read_clock())
        current = {query[0]: query for query in islice(pending, MAX_RECORDED_QUERIES)}
        # A list, because waits are removed in the loop.
        for serial in [serial for serial in self._waits if serial not in current]:
            self._record_wait(self._waits.pop(serial), now)
        for serial, (_, question, values, _, _, missing) in current.items():
            if serial not in self._waits:
                memories = [canonical_text(instance.id) for instance, _ in missing]
                self._waits[serial] = _Wait(canonical_text(question.event_of(values)), memories, now)

    def _record_wait(self, wait: _Wait, now: int) -> None:
        self._write_record({"wait": wait.event, "memories": wait.memories, "start": wait.start, "end": now})

    def record_final_state(self) -> None:
        """Report the queries that are still waiting, and the contents of the memories."""
        now = int(self._read_clock())
        for wait in self._waits.values():
            self._record_wait(wait, now)
        self._waits.clear()
        for memory in self._engine.status(MAX_RECORDED_QUERIES).memories:
            self._write_record(
                {
                    "memory": memory.id,
                    "pattern": memory.event,
                    "size": memory.size,
                    "records": memory.records,
                    "taken": memory.added,
                    "start": memory.oldest,
                    "end": memory.newest,
                }
            )


def output_record(output: Output) -> RunRecord:
    """Return the record of an output."""
    output_id = None if output.id is None else canonical_text(output.id)
    return {
        "output": canonical_text(output.term),
        "topic": output.topic,
        "id": output_id,
        "time": int(output.time),
    }


_ROW_GROUP_SIZE = 10_000
"""Number of rows in a row group."""

_OUTPUT_COLUMNS = {"output": "text", "topic": "text", "id": "text", "time": "instant"}
_OTHER_COLUMNS = {
    "event": "text",
    "start": "instant",
    "end": "instant",
    "wait": "text",
    "memories": "texts",
    "memory": "text",
    "pattern": "text",
    "size": "number",
    "records": "number",
    "taken": "number",
}
"""Columns of outputs, and the additional columns of other records."""


class RunTable:
    """A new Parquet file with the records of a playback; a context manager. The file is complete when it is closed.

    Args:
        path: path of the file; an existing file is replaced.
        events: if there are records other than outputs.

    Raises:
        BagError: if the Python package pyarrow is not available.
    """

    def __init__(self, path: PathLike, events: bool):
        try:
            import pyarrow  # noqa: PLC0415 - an optional package
            from pyarrow import parquet  # noqa: PLC0415
        except ImportError as error:  # also raised by a pyarrow that does not fit the installed numpy
            raise BagError(
                f"writing Parquet needs the Python package pyarrow (pip install pyarrow): {describe_error(error)}"
            ) from None
        arrow_types = {
            "text": pyarrow.string(),
            "texts": pyarrow.list_(pyarrow.string()),
            "number": pyarrow.int64(),
            "instant": pyarrow.timestamp("ns", tz="UTC"),
        }
        columns: Dict[str, str] = {**_OUTPUT_COLUMNS, **(_OTHER_COLUMNS if events else {})}
        self._arrow: Any = pyarrow
        self._schema: Any = pyarrow.schema(
            [(name, arrow_types[column_type]) for name, column_type in columns.items()]
        )
        self._writer: Any = parquet.ParquetWriter(str(path), self._schema)
        self._records: List[RunRecord] = []

    def write(self, record: RunRecord) -> None:
        """Write a record as a row."""
        self._records.append(record)
        if len(self._records) >= _ROW_GROUP_SIZE:
            self._flush()

    def _flush(self) -> None:
        # Column by column, as Parquet stores them; a missing field becomes null.
        columns = [
            self._arrow.array([record.get(field.name) for record in self._records], field.type)
            for field in self._schema
        ]
        self._writer.write_table(self._arrow.Table.from_arrays(columns, schema=self._schema))
        self._records.clear()

    def close(self) -> None:
        """Write the remaining rows and the index."""
        try:
            if self._records:
                self._flush()
        finally:
            self._writer.close()

    def __enter__(self) -> "RunTable":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
