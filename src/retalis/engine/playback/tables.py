"""A run as a Parquet file: a row for each line that it would be as JSON. ``pyarrow`` does the work."""

from typing import Any, Dict, List

from .bags import BagError, PathLike
from .decompression import reason
from .looking import Line

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
