"""Tables of run records in Parquet files."""

import json
import sys
from pathlib import Path

import pytest

from retalis import BagError
from retalis.engine.run_records import RECORD_TYPES
from retalis.playback import playback
from retalis.playback.incomplete_files import IncompleteFile
from retalis.playback.playback import INCOMPLETE_FILES_KEY, RunTable, make_incomplete_file_record

OUTPUT = {"output": "x(1)", "topic": "t", "id": None, "time": 1_500_000_000_000_000_001}
WAIT = {"wait": "w", "memories": ["a", "b"], "start": 1, "end": 2}


def test_rows_have_values_of_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(playback, "_ROW_GROUP_SIZE", 2)
    with RunTable(tmp_path / "run.parquet", events=True) as table:
        for line in (OUTPUT, WAIT, OUTPUT):
            table.write(line)
    rows = parquet.read_table(tmp_path / "run.parquet")
    assert rows.column("output").to_pylist() == ["x(1)", None, "x(1)"]
    assert rows.column("memories").to_pylist() == [None, ["a", "b"], None]
    assert rows.column("time").cast("int64").to_pylist() == [OUTPUT["time"], None, OUTPUT["time"]]
    assert parquet.ParquetFile(tmp_path / "run.parquet").num_row_groups == 2


def test_each_record_field_has_a_column(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    RunTable(tmp_path / "run.parquet", events=True).close()
    # The command refuses to write open states and windows to Parquet.
    record_types = [record_type for name, record_type in RECORD_TYPES.items() if not name.startswith("open")]
    fields = {field for record_type in record_types for field in record_type.__annotations__}
    assert set(parquet.read_table(tmp_path / "run.parquet").column_names) == fields


def test_empty_table_has_columns(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    RunTable(tmp_path / "run.parquet", events=False).close()
    assert parquet.read_table(tmp_path / "run.parquet").column_names == ["output", "topic", "id", "time"]


def test_missing_pyarrow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(BagError, match="writing Parquet needs the Python package pyarrow"):
        RunTable(tmp_path / "run.parquet", events=False)


def test_incomplete_files_are_metadata(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    record = make_incomplete_file_record(IncompleteFile("a.bag", "its index is missing", 2, 5, 4200, 17))
    for lines in ([record], [record, OUTPUT]):
        with RunTable(tmp_path / "run.parquet", events=False) as table:
            for line in lines:
                table.write(line)
        rows = parquet.read_table(tmp_path / "run.parquet")
        assert rows.num_rows == len(lines) - 1
        assert json.loads(rows.schema.metadata[INCOMPLETE_FILES_KEY.encode()]) == [record]
