"""Runs as Parquet files."""

import sys

import pytest

from retalis import BagError
from retalis.engine.run_records import RECORD_TYPES
from retalis.playback import playback
from retalis.playback.playback import RunTable

OUTPUT = {"output": "x(1)", "topic": "t", "id": None, "time": 1_500_000_000_000_000_001}
WAIT = {"wait": "w", "memories": ["a", "b"], "start": 1, "end": 2}


def test_rows_are_those_of_json(tmp_path, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(playback, "_ROW_GROUP_SIZE", 2)
    with RunTable(tmp_path / "run.parquet", events=True) as table:
        for line in (OUTPUT, WAIT, OUTPUT):
            table.write(line)
    found = parquet.read_table(tmp_path / "run.parquet")
    assert found.column("output").to_pylist() == ["x(1)", None, "x(1)"]
    assert found.column("memories").to_pylist() == [None, ["a", "b"], None]
    assert found.column("time").cast("int64").to_pylist() == [OUTPUT["time"], None, OUTPUT["time"]]
    assert parquet.ParquetFile(tmp_path / "run.parquet").num_row_groups == 2


def test_each_field_of_a_record_has_a_column(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    RunTable(tmp_path / "run.parquet", events=True).close()
    fields = {field for record_type in RECORD_TYPES.values() for field in record_type.__annotations__}
    assert set(parquet.read_table(tmp_path / "run.parquet").column_names) == fields


def test_a_run_without_outputs_has_its_columns(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    RunTable(tmp_path / "run.parquet", events=False).close()
    assert parquet.read_table(tmp_path / "run.parquet").column_names == ["output", "topic", "id", "time"]


def test_the_package_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(BagError, match="writing Parquet needs the Python package pyarrow"):
        RunTable(tmp_path / "run.parquet", events=False)
