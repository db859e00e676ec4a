"""Tasks of workers: playback of one bag of several."""

import argparse
import csv
import json
import os
import sys
from pathlib import Path
from typing import Any, List, Optional

import pytest
from asserting_accessors import required
from many_bags_program import SECOND, make_bag, make_program

from retalis import BagError, BagReader
from retalis.cli.bag_command import add_parser, play_bag
from retalis.cli.bag_tasks import BagOutcome, BagTask
from retalis.cli.many_bags_options import single_bag_options
from retalis.cli.result_partitions import ResultTarget
from retalis.cli.stderr_reports import MAX_BAG_TEXT_CHARACTERS
from retalis.foundation.garbage_collection import stop_limiting_gc_pauses
from retalis.playback.bag_locations import open_bag


@pytest.fixture(autouse=True)
def restore_gc_calls(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Record each `restore_gc`, which frees the program of a bag, without collecting the objects of all tests."""
    calls: List[Any] = []

    def restore_gc() -> None:
        calls.append(True)
        stop_limiting_gc_pauses()

    monkeypatch.setattr("retalis.cli.bag_command.restore_gc", restore_gc)
    return calls


@pytest.fixture
def program(tmp_path: Path) -> Any:
    return make_program(tmp_path / "program")


def make_task(program: Any, bag: str, target: Any, result_format: Optional[str], *options: Any) -> Any:
    commands = argparse.ArgumentParser().add_subparsers()
    parsers: List[Any] = []

    def add_command(*names: Any, **settings: Any) -> Any:
        parsers.append(commands.add_parser(*names, **settings))
        return parsers[-1]

    add_parser(add_command)
    (parser,) = parsers
    arguments = parser.parse_args([str(bag), "--program", str(program), *options])
    return BagTask(str(bag), ResultTarget(str(target)), result_format, single_bag_options(arguments))


def test_error_names_result_as_given(program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Any, overwrite: bool) -> Any:
        raise BagError(f"{path} cannot be written")

    monkeypatch.setattr("retalis.cli.bag_command.BagWriter", fail)
    bag = make_bag(tmp_path / "a.bag", "x")
    outcome = play_bag(make_task(program, bag, tmp_path / "out.bag", "bag"), str(tmp_path))
    assert outcome.failure == f"{tmp_path}/out.bag cannot be written"


@pytest.mark.slow
def test_result_has_requested_format(
    program: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "a.bag", "x", "x")
    assert play_bag(make_task(program, bag, tmp_path / "text", None), str(tmp_path)) == (BagOutcome(0, ""))
    assert (tmp_path / "text").read_text().splitlines() == [
        """output(std_msgs__0__String('"x"'),speech).""",
    ] * 3
    assert play_bag(make_task(program, bag, tmp_path / "lines", "jsonl"), str(tmp_path)) == (
        BagOutcome(0, "")
    )
    lines = (tmp_path / "lines").read_text().splitlines()
    assert lines[0].startswith('{"output": "std_msgs__0__String(')
    assert len(lines) == 3
    assert play_bag(make_task(program, bag, tmp_path / "b.bag", "bag"), str(tmp_path)) == (BagOutcome(0, ""))
    with BagReader(tmp_path / "b.bag") as reader:
        assert [record.topic.name for record in reader.records()] == ["/speech"] * 3
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["s.parquet", "s.csv"])
def test_table_has_messages_of_outputs(program: Any, tmp_path: Path, name: str) -> None:
    table_format = name.partition(".")[2]
    bag = make_bag(tmp_path / "a.bag", "x")
    if table_format == "parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
    task = make_task(program, bag, tmp_path / name, table_format)._replace(labels={"bag": "b", "robot": "r7"})
    assert play_bag(task, str(tmp_path)) == BagOutcome(0, "")
    if table_format == "parquet":
        rows = parquet.read_table(tmp_path / name).to_pylist()
        assert [row["message"] for row in rows] == [None, {"speech": {"data": "x"}}]
    else:
        with (tmp_path / name).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        assert [row["message.speech.data"] for row in rows] == ["", "x"]
    assert [row["robot"] for row in rows] == ["r7", "r7"]


def test_part_continues_from_state_of_previous_part(program: Any, tmp_path: Path) -> None:
    """A pattern begins in one part and ends in the next one."""
    first = make_task(program, make_bag(tmp_path / "a_0.bag", "x"), tmp_path / "0", "jsonl")
    result = play_bag(first._replace(has_next_part=True), str(tmp_path))
    second = make_task(program, make_bag(tmp_path / "a_1.bag", "x", start=9), tmp_path / "1", "jsonl")
    assert play_bag(second._replace(state=result.state), str(tmp_path)) == BagOutcome(0, "")
    lines = [json.loads(line) for line in (tmp_path / "1").read_text().splitlines()]
    assert [(line["id"], line["time"] // SECOND) for line in lines] == [("all", 9), ("twice", 9)]


def test_parquet_result_has_records(program: Any, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    bag = make_bag(tmp_path / "a.bag", "x", "x")
    result = play_bag(make_task(program, bag, tmp_path / "p", "parquet", "--events"), str(tmp_path))
    assert result == BagOutcome(0, "")
    rows = parquet.read_table(tmp_path / "p").to_pylist()
    assert [row["id"] for row in rows if row["output"]] == ["all", "all", "twice"]
    assert sum(row["event"] is not None for row in rows) == 3


def test_mcap_result_has_published_messages(program: Any, tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    bag = make_bag(tmp_path / "a.bag", "x", "x")
    result = play_bag(make_task(program, bag, tmp_path / "a.mcap", "mcap"), str(tmp_path))
    assert result == BagOutcome(0, "")
    with open_bag(tmp_path / "a.mcap") as reader:
        assert [(record.topic.name, record.data[8:-1]) for record in reader.records()] == [
            ("/speech", b"x")
        ] * 3


@pytest.mark.parametrize("result_format", ["jsonl", "csv", "parquet"])
def test_failed_playback_leaves_no_file(program: Any, tmp_path: Path, result_format: str) -> None:
    if result_format == "parquet":
        pytest.importorskip("pyarrow")
    bag = make_bag(tmp_path / "a.bag", *(f"text {number}" for number in range(300)))
    with open(bag, "r+b") as file:
        file.seek(5000)
        file.write(b"\xff" * 5000)
    before = set(os.listdir(tmp_path))
    result = play_bag(make_task(program, bag, tmp_path / "result", result_format), str(tmp_path))
    assert required(result.failure).startswith(f"{bag}")
    assert set(os.listdir(tmp_path)) == before


def test_any_exception_is_failure_of_bag(
    program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, restore_gc_calls: Any
) -> None:
    bag = make_bag(tmp_path / "a.bag", "x")
    task = make_task(program, bag, tmp_path / "result", None)
    monkeypatch.setattr("retalis.cli.bag_command.play", lambda *arguments: 1 / 0)
    assert play_bag(task, str(tmp_path)).failure == "ZeroDivisionError: division by zero"
    assert restore_gc_calls == [True]


def test_long_stderr_is_truncated(program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = make_bag(tmp_path / "a.bag", "x")
    task = make_task(program, bag, tmp_path / "result", None)
    monkeypatch.setattr(
        "retalis.cli.bag_command.play",
        lambda *arguments: sys.stderr.write("e" * (MAX_BAG_TEXT_CHARACTERS + 7)),
    )
    assert (
        play_bag(task, str(tmp_path)).stderr_text
        == "e" * MAX_BAG_TEXT_CHARACTERS + "\n... and 7 more characters\n"
    )


def test_error_names_url_of_bag(program: Any, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    (tmp_path / "bad.bag").write_text("no bag")
    result = play_bag(make_task(program, f"file://{tmp_path}/bad.bag", tmp_path / "r", None), str(tmp_path))
    assert (
        result.failure
        == f"file://{tmp_path}/bad.bag is not a complete ROS 1 bag: it does not begin with '#ROSBAG V2.0'"
    )
