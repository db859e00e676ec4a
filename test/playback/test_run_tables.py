"""Tables of run records in Parquet and CSV files."""

import csv
import json
import logging
import resource
import signal
import sys
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Type

import pytest

from retalis import BagError, Definitions
from retalis.engine.run_records import RECORD_TYPES
from retalis.messages.message_dictionaries import make_message_term
from retalis.playback import run_tables
from retalis.playback.incomplete_files import IncompleteFile
from retalis.playback.playback import Output, make_incomplete_file_record
from retalis.playback.run_tables import INCOMPLETE_FILES_KEY, CsvTable, ParquetTable, RunTable

SECOND = 10**9
OUTPUT = {"output": "x(1)", "topic": "t", "id": None, "time": 1_500_000_000_000_000_001}
WAIT = {"wait": "w", "memories": ["a", "b"], "start": 1, "end": 2001}
INCOMPLETE = make_incomplete_file_record(IncompleteFile("a.bag", "its index is missing", 2, 5, 4200, 17))
LABELS = {"bag": "day/a.bag", "robot": "r07"}
DEFINITIONS = Definitions()
DEFINITIONS.add("lab/Point", "float64 x\nfloat32 y")
DEFINITIONS.add("lab/Nothing", "")
SAMPLE = DEFINITIONS.add(
    "lab/Sample",
    "time stamp\nduration wait\nbool ok\nstring name\nuint8[] data\nuint32[2] pair\nlab/Point first\n"
    "lab/Point[] path\ntime[] stamps\nlab/Nothing none\nlab/Nothing[] nones\nuint64 big",
)
VALUES = {
    "stamp": 12 * SECOND + 3_004,
    "wait": -SECOND // 2,
    "ok": True,
    "name": 'a "b"',
    "data": b"\0\xff",
    "pair": [1, 2],
    "first": {"x": 0.5},
    "path": [{"x": 1.0}, {"x": 2.0, "y": 1.5}],
    "stamps": [5_000],
    "nones": [{}],
    "big": (1 << 64) - 1,
}


def make_output(topic: str, type_name: str, values: Optional[Mapping[str, Any]]) -> Output:
    """Return an output; without values its term does not fit the type."""
    definition = DEFINITIONS.find(type_name)
    data = None
    if values is not None:
        data = DEFINITIONS.encoder(definition).encode(make_message_term(definition, values))
    return Output(topic, 0, 3 * SECOND, definition, data)


def write_table(
    table_type: Type[RunTable],
    path: Path,
    lines: Iterable[Any],
    types: Mapping[str, str] = {},
    has_events: bool = False,
    labels: Mapping[str, Optional[str]] = LABELS,
) -> None:
    """Write records and outputs; ``types`` has the types of topics by full name."""
    with table_type(path, labels, has_events) as table:
        lines = list(lines)
        if INCOMPLETE in lines:
            table.write(INCOMPLETE)
            lines.remove(INCOMPLETE)
        definitions = {name: DEFINITIONS.find(type_name) for name, type_name in types.items()}
        table.begin(definitions, DEFINITIONS, SECOND, 9 * SECOND)
        for line in lines:
            if isinstance(line, Output):
                table.write({**OUTPUT, "topic": line.topic}, line)
            else:
                table.write(line)


def read_rows(path: Path) -> List[Dict[str, Any]]:
    """Return the rows of a Parquet file; timestamps are microseconds."""
    parquet = pytest.importorskip("pyarrow.parquet")
    return [dict(row) for row in parquet.read_table(path).to_pylist()]


def read_csv(path: Path) -> List[Dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_rows_have_values_of_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(run_tables, "_ROW_GROUP_SIZE", 2)
    path = tmp_path / "run.parquet"
    write_table(ParquetTable, path, [OUTPUT, WAIT, OUTPUT], has_events=True)
    rows = parquet.read_table(path)
    assert rows.column("kind").to_pylist() == ["bag", "output", "wait", "output"]
    assert rows.column("output").to_pylist() == [None, "x(1)", None, "x(1)"]
    assert rows.column("memories").to_pylist() == [None, None, ["a", "b"], None]
    assert rows.column("time_ns").to_pylist() == [None, OUTPUT["time"], None, OUTPUT["time"]]
    assert rows.column("ended").cast("int64").to_pylist() == [9_000_000, None, 2, None]
    assert rows.column("robot").to_pylist() == ["r07"] * 4
    assert str(rows.schema.field("time").type) == "timestamp[us, tz=UTC]"
    assert parquet.ParquetFile(path).num_row_groups == 2


def test_large_messages_end_row_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(run_tables, "_ROW_GROUP_BYTES", 100)
    output = make_output("t", "lab/Sample", {"data": bytes(70)})
    write_table(ParquetTable, tmp_path / "p", [output] * 4, {"/t": "lab/Sample"})
    assert parquet.ParquetFile(tmp_path / "p").num_row_groups == 4


def test_each_record_field_has_a_column(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    write_table(ParquetTable, tmp_path / "run.parquet", [], has_events=True)
    # The command refuses to write open states and windows to tables.
    record_types = [record_type for name, record_type in RECORD_TYPES.items() if not name.startswith("open")]
    fields = {field for record_type in record_types for field in record_type.__annotations__}
    fields = fields - {"start", "end"} | {"started", "ended", "started_ns", "ended_ns", "time_ns"}
    columns = set(parquet.read_table(tmp_path / "run.parquet").column_names)
    assert columns == fields | {"bag", "robot", "incomplete", "kind"}


@pytest.mark.parametrize("table_type", [ParquetTable, CsvTable])
def test_table_without_records_has_row_of_bag(tmp_path: Path, table_type: Type[RunTable]) -> None:
    path = tmp_path / "run"
    if table_type is ParquetTable:
        pytest.importorskip("pyarrow")
    write_table(table_type, path, [])
    (row,) = read_csv(path) if table_type is CsvTable else read_rows(path)
    assert list(row) == [
        *("bag", "robot", "incomplete", "kind", "time", "time_ns", "topic", "id", "output"),
        *("started", "started_ns", "ended", "ended_ns"),
    ]
    assert (row["bag"], row["kind"], int(row["started_ns"])) == ("day/a.bag", "bag", SECOND)


def test_missing_pyarrow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(BagError, match="writing Parquet needs the Python package pyarrow"):
        ParquetTable(tmp_path / "run.parquet", {}, has_events=False)


def test_incomplete_files_are_marked(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    for lines in ([INCOMPLETE], [INCOMPLETE, OUTPUT]):
        write_table(ParquetTable, tmp_path / "run.parquet", lines)
        rows = parquet.read_table(tmp_path / "run.parquet")
        assert rows.column("incomplete").to_pylist() == [True] * len(lines)
        assert json.loads(rows.schema.metadata[INCOMPLETE_FILES_KEY.encode()]) == [INCOMPLETE]
    write_table(CsvTable, tmp_path / "run.csv", [INCOMPLETE])
    assert [row["incomplete"] for row in read_csv(tmp_path / "run.csv")] == ["true"]


def test_slots_of_messages_are_nested_columns(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    outputs = [
        make_output("t", "lab/Sample", VALUES),
        make_output("/robot/t", "lab/Point", {"x": 7.0}),
        make_output("t", "lab/Sample", None),
        make_output("trigger", "lab/Nothing", {}),
        make_output("untyped", "lab/Point", {"x": 8.0}),
    ]
    types = {"/t": "lab/Sample", "/robot/t": "lab/Point", "/trigger": "lab/Nothing", "/unused": "lab/Sample"}
    write_table(ParquetTable, tmp_path / "p", outputs, types)
    column = parquet.read_table(tmp_path / "p").column("message").combine_chunks()
    sample = column.field("t")
    assert str(sample.field("stamp").type) == "timestamp[us, tz=UTC]"
    assert sample.field("stamp").cast("int64").to_pylist()[1] == 12_000_003
    (stamps,) = sample.field("stamps").to_pylist()[1]
    assert stamps.microsecond == 5
    message = {key: value for key, value in sample.to_pylist()[1].items() if key not in ("stamp", "stamps")}
    assert message == {
        "stamp_ns": 12 * SECOND + 3_004,
        "wait": -0.5,
        "wait_ns": -SECOND // 2,
        "ok": True,
        "name": 'a "b"',
        "data": b"\0\xff",
        "pair": [1, 2],
        "first": {"x": 0.5, "y": 0.0},
        "path": [{"x": 1.0, "y": 0.0}, {"x": 2.0, "y": 1.5}],
        "stamps_ns": [5_000],
        "none": True,
        "nones": [True],
        "big": (1 << 64) - 1,
    }
    rows = [row["message"] for row in read_rows(tmp_path / "p")]
    assert [row is None for row in rows] == [True, False, False, True, False, True]
    assert rows[2]["robot/t"] == {"x": 7.0, "y": 0.0}
    assert [name for name, value in rows[2].items() if value is not None] == ["robot/t"]
    assert rows[4]["trigger"] is True


def test_scalar_slots_are_columns_of_csv(tmp_path: Path) -> None:
    outputs = [
        make_output("t", "lab/Sample", VALUES),
        make_output("robot/t", "lab/Point", {"x": float("inf")}),
    ]
    write_table(CsvTable, tmp_path / "c", outputs, {"/t": "lab/Sample", "/robot/t": "lab/Point"})
    _, sample, point = read_csv(tmp_path / "c")
    messages = {key[len("message.") :]: value for key, value in sample.items() if key.startswith("message.")}
    assert messages == {
        "t.stamp": "1970-01-01T00:00:12.000003Z",
        "t.stamp_ns": "12000003004",
        "t.wait": "-0.5",
        "t.wait_ns": "-500000000",
        "t.ok": "true",
        "t.name": 'a "b"',
        "t.data": "AP8=",
        "t.pair": "[1, 2]",
        "t.first.x": "0.5",
        "t.first.y": "0.0",
        "t.path": '[{"x": 1.0, "y": 0.0}, {"x": 2.0, "y": 1.5}]',
        "t.stamps": '["1970-01-01T00:00:00.000005Z"]',
        "t.stamps_ns": "[5000]",
        "t.none": "true",
        "t.nones": "[true]",
        "t.big": "18446744073709551615",
        "robot/t.x": "",
        "robot/t.y": "",
    }
    assert (point["message.robot/t.x"], point["message.t.name"], point["time"]) == (
        "inf",
        "",
        "2017-07-14T02:40:00.000000Z",
    )


def test_names_differ_without_regard_to_case(tmp_path: Path) -> None:
    definitions = Definitions()
    definition = definitions.add("lab/Case", "float64 x\nfloat64 X\ntime t\nint32 t_ns\nint32 T")
    names = [column.name for column in run_tables.message_columns(definition)]
    assert names == ["x", "X_", "t", "t_ns_", "t_ns", "T_"]
    write_table(
        CsvTable, tmp_path / "c", [make_output("A", "lab/Point", {})], {"/a": "lab/Point", "/A": "lab/Point"}
    )
    row = read_csv(tmp_path / "c")[1]
    assert (row["message.a.x"], row["message.A_.x"]) == ("", "0.0")


def test_topics_beyond_limit_have_no_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(run_tables, "MAX_MESSAGE_COLUMNS", 3)
    types = {"/a": "lab/Point", "/b": "lab/Point", "/c": "lab/Nothing"}
    with caplog.at_level(logging.WARNING):
        write_table(CsvTable, tmp_path / "c", [make_output("b", "lab/Point", {})], types)
    names = [name for name in read_csv(tmp_path / "c")[0] if name.startswith("message")]
    assert names == ["message.a.x", "message.a.y", "message.c"]
    assert "topic b: its messages have no columns" in caplog.text


def test_deeply_nested_messages_have_no_columns(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    definitions = Definitions()
    definitions.add("lab/Level0", "bool a")
    for level in range(1, 30):
        definitions.add(f"lab/Level{level}", f"lab/Level{level - 1}[] a")
    types = {f"/t{level}": definitions.find(f"lab/Level{level}") for level in (19, 20)}
    with caplog.at_level(logging.WARNING), CsvTable(tmp_path / "c", {}, has_events=False) as table:
        table.begin(types, definitions, 0, 0)
    assert [name for name in read_csv(tmp_path / "c")[0] if name.startswith("message")] == ["message.t19.a"]
    assert "topic t20: its messages have no columns, because they would be nested more than 60" in caplog.text


def test_integers_beyond_64_bits_are_null(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("pyarrow")
    far = {"event": "e", "start": -(1 << 70), "end": 1 << 70}
    with caplog.at_level(logging.WARNING):
        write_table(ParquetTable, tmp_path / "p", [far, far], has_events=True)
    assert [row["ended_ns"] for row in read_rows(tmp_path / "p")] == [9 * SECOND, None, None]
    assert "column ended_ns: 2 integers of more than 64 bits: null in the result" in caplog.text
    write_table(CsvTable, tmp_path / "c", [far], has_events=True)
    assert f",,{-(1 << 70)},,{1 << 70}," in (tmp_path / "c").read_text()


def test_timestamps_of_csv_have_years_of_four_digits(tmp_path: Path) -> None:
    event = {"event": "e", "start": -50 * 10**18, "end": 0}
    write_table(CsvTable, tmp_path / "c", [event], has_events=True)
    row = read_csv(tmp_path / "c")[1]
    assert (row["started"], row["ended"]) == ("0385-07-25T07:06:40.000000Z", "1970-01-01T00:00:00.000000Z")


@pytest.mark.parametrize("table_type", [ParquetTable, CsvTable])
def test_unpaired_surrogates_are_replaced(tmp_path: Path, table_type: Type[RunTable]) -> None:
    if table_type is ParquetTable:
        pytest.importorskip("pyarrow")
    write_table(table_type, tmp_path / "p", [{**OUTPUT, "output": "a\udc80\n\ud800"}])
    rows = read_csv(tmp_path / "p") if table_type is CsvTable else read_rows(tmp_path / "p")
    assert rows[1]["output"] == "a\ufffd\n\ufffd"


@pytest.mark.parametrize("table_type", [ParquetTable, CsvTable])
def test_full_disk_is_the_only_error(tmp_path: Path, table_type: Type[RunTable]) -> None:
    if table_type is ParquetTable:
        pytest.importorskip("pyarrow")
    # A row group that exceeds the buffers.
    lines = [{**OUTPUT, "output": str(number**3)} for number in range(10_000)]
    size_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The signal of a file that grows beyond the limit is ignored, so that writing raises an error, as on a full disk.
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, size_limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_table(table_type, tmp_path / "run", lines)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, size_limit)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("table_type", [ParquetTable, CsvTable])
def test_name_of_table_need_not_be_unicode(tmp_path: Path, table_type: Type[RunTable]) -> None:
    if table_type is ParquetTable:
        pytest.importorskip("pyarrow")
    path = tmp_path / "r\udcff"
    write_table(table_type, path, [], labels={"bag": "r\udcff.bag"})
    (row,) = read_csv(path) if table_type is CsvTable else read_rows(path.rename(tmp_path / "r"))
    assert row["bag"] == "r\ufffd.bag"


def test_column_of_shared_value_can_be_omitted(tmp_path: Path) -> None:
    write_table(CsvTable, tmp_path / "c", [], labels={"bag": "a.bag"})
    assert list(read_csv(tmp_path / "c")[0])[:2] == ["bag", "incomplete"]
