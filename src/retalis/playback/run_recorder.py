"""What happens in a run over a bag, as plain records that turn into JSON: for files, and for pictures of it.

A run as a Parquet file: a row for each line that it would be as JSON. ``pyarrow`` does the work.
"""

from itertools import islice
from typing import Any, Callable, Dict, List, NamedTuple, Union

from ..events.knowledge.knowledge_base import OF_MEMORIES
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.types import Term
from .decompression import reason
from .playback import Output, Playback
from .rosbag1 import BagError, PathLike

Line = Dict[str, Union[None, int, str, List[str]]]
"""A record; its kind is the name of its first field. Instants are nanoseconds since the epoch, terms are texts."""

MAX_RECORDED_QUERIES = 1000
"""Queries that are looked at; where more wait at once, the others are not told of."""


class _Wait(NamedTuple):
    """A query that waits: its event, the ids of the memories, and since when by the bag's time."""

    event: str
    memories: List[str]
    start: int


class RunRecorder:
    """Looks at a run and tells of events, outputs and waits as they come, and of memories at the end.

    A wait of a query lasts from the message that had it wait to the one that it was waiting for, by the bag's time.

    Args:
        playback: whose events, queries and memories are looked at.
        tell: takes each record.
    """

    def __init__(self, playback: Playback, tell: Callable[[Line], None]):
        self._engine = playback.engine
        self._knowledge = playback.engine.knowledge
        self._now = playback.clock.now
        self._tell = tell
        self._waits: Dict[int, _Wait] = {}
        self._engine.on_event(self._event)

    def _event(self, term: Term, start: int, end: int) -> None:
        if term.__class__ is not tuple or term[0] not in OF_MEMORIES:
            self._tell({"event": canonical_text(term), "start": int(start), "end": int(end)})

    def output(self, output: Output) -> None:
        """Tell of an output."""
        self._tell(output_line(output))

    def look(self) -> None:
        """Look which queries wait; to be called after each message."""
        waiting = self._knowledge.waiting
        if not self._waits and not len(waiting):
            return
        now = int(self._now())
        there = {one[0]: one for one in islice(waiting, MAX_RECORDED_QUERIES)}
        for order in [one for one in self._waits if one not in there]:
            self._end(self._waits.pop(order), now)
        for order, (_, question, values, _, _, missing) in there.items():
            if order not in self._waits:
                memories = [canonical_text(instance.id) for instance, _ in missing]
                self._waits[order] = _Wait(canonical_text(question.event(values)), memories, now)

    def _end(self, wait: _Wait, now: int) -> None:
        self._tell({"wait": wait.event, "memories": wait.memories, "start": wait.start, "end": now})

    def finish(self) -> None:
        """Tell of the queries that still wait, and of what the memories hold."""
        now = int(self._now())
        for wait in self._waits.values():
            self._end(wait, now)
        self._waits.clear()
        for memory in self._engine.status(MAX_RECORDED_QUERIES).memories:
            self._tell(
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


def output_line(output: Output) -> Line:
    """Return what is told of an output."""
    name = None if output.id is None else canonical_text(output.id)
    return {
        "output": canonical_text(output.term),
        "topic": output.topic,
        "id": name,
        "time": int(output.time),
    }


_ROWS = 10_000
"""Rows that are written at a time: a row group."""

_OF_OUTPUTS = {"output": "text", "topic": "text", "id": "text", "time": "instant"}
_OF_OTHERS = {
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
"""Columns of outputs, and those that the other lines have besides."""


class RunTable:
    """A new Parquet file of a run; a context manager. The file is complete when it is closed.

    Args:
        path: the file; one that is there is replaced.
        events: whether there are lines besides outputs.

    Raises:
        BagError: where the Python package pyarrow is missing.
    """

    def __init__(self, path: PathLike, events: bool):
        try:
            import pyarrow  # noqa: PLC0415 - an optional package
            from pyarrow import parquet  # noqa: PLC0415
        except ImportError as error:  # also where it does not fit what else is installed
            raise BagError(
                f"writing Parquet needs the Python package pyarrow (pip install pyarrow): {reason(error)}"
            ) from None
        kinds = {
            "text": pyarrow.string(),
            "texts": pyarrow.list_(pyarrow.string()),
            "number": pyarrow.int64(),
            "instant": pyarrow.timestamp("ns", tz="UTC"),
        }
        columns: Dict[str, str] = {**_OF_OUTPUTS, **(_OF_OTHERS if events else {})}
        self._arrow: Any = pyarrow
        self._schema: Any = pyarrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
        self._writer: Any = parquet.ParquetWriter(str(path), self._schema)
        self._lines: List[Line] = []

    def write(self, line: Line) -> None:
        """Write a line."""
        self._lines.append(line)
        if len(self._lines) >= _ROWS:
            self._flush()

    def _flush(self) -> None:
        columns = [
            self._arrow.array([line.get(one.name) for line in self._lines], one.type) for one in self._schema
        ]
        self._writer.write_table(self._arrow.Table.from_arrays(columns, schema=self._schema))
        self._lines.clear()

    def close(self) -> None:
        """Write the rest and the index."""
        try:
            if self._lines:
                self._flush()
        finally:
            self._writer.close()

    def __enter__(self) -> "RunTable":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
