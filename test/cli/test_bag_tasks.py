"""What a worker does with one bag of many."""

import argparse
import json
import os
import sys

import pytest
from bags_and_program import SECOND, make_bag, make_program

from retalis import BagReader
from retalis.cli.bag_command import _MAX_MESSAGE_CHARACTERS, BagTask, add_parser, play_bag, single_bag_options
from retalis.foundation.garbage_collection import stop_limiting_gc_pauses


@pytest.fixture(autouse=True)
def tightened(monkeypatch):
    """Record each `restore_gc`, which frees a bag's program; without a collection of what all tests have loaded."""
    asked = []

    def restore_gc():
        asked.append(True)
        stop_limiting_gc_pauses()

    monkeypatch.setattr("retalis.cli.bag_command.restore_gc", restore_gc)
    return asked


@pytest.fixture
def program(tmp_path):
    return make_program(tmp_path / "program")


def task(program, bag, target, kind, *more):
    parsers = argparse.ArgumentParser().add_subparsers()
    parsers_made = []
    add_parser(
        lambda *names, **told: parsers_made.append(parsers.add_parser(*names, **told)) or parsers_made[-1]
    )
    options = parsers_made[0].parse_args([str(bag), "--program", str(program), *more])
    return BagTask(str(bag), str(target), kind, single_bag_options(options))


@pytest.mark.slow
def test_a_result_has_what_the_format_says(program, tmp_path, capsys):
    bag = make_bag(tmp_path / "a.bag", "x", "x")
    assert play_bag(task(program, bag, tmp_path / "text", None), str(tmp_path)) == (0, "", None, None)
    assert (tmp_path / "text").read_text().splitlines() == [
        """output(std_msgs__0__String('"x"'),said).""",
    ] * 3
    assert play_bag(task(program, bag, tmp_path / "lines", "jsonl"), str(tmp_path)) == (0, "", None, None)
    lines = (tmp_path / "lines").read_text().splitlines()
    assert lines[0].startswith('{"output": "std_msgs__0__String(') and len(lines) == 3
    assert play_bag(task(program, bag, tmp_path / "b.bag", "bag"), str(tmp_path)) == (0, "", None, None)
    with BagReader(tmp_path / "b.bag") as reader:
        assert [record.topic.name for record in reader.records()] == ["/said"] * 3
    assert capsys.readouterr() == ("", "")


def test_a_part_goes_on_from_the_state_of_the_one_before(program, tmp_path):
    """The pattern that begins in one part ends in the next one."""
    first = task(program, make_bag(tmp_path / "a_0.bag", "x"), tmp_path / "0", "jsonl")
    played = play_bag(first._replace(has_next_part=True), str(tmp_path))
    second = task(program, make_bag(tmp_path / "a_1.bag", "x", start=9), tmp_path / "1", "jsonl")
    assert play_bag(second._replace(state=played.state), str(tmp_path)) == (0, "", None, None)
    lines = [json.loads(line) for line in (tmp_path / "1").read_text().splitlines()]
    assert [(line["id"], line["time"] // SECOND) for line in lines] == [("all", 9), ("twice", 9)]


def test_parquet_has_the_lines_of_json(program, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    bag = make_bag(tmp_path / "a.bag", "x", "x")
    played = play_bag(task(program, bag, tmp_path / "p", "parquet", "--events"), str(tmp_path))
    assert played == (0, "", None, None)
    found = parquet.read_table(tmp_path / "p").to_pylist()
    assert [row["id"] for row in found if row["output"]] == ["all", "all", "twice"]
    assert sum(row["event"] is not None for row in found) == 3


def test_a_bag_that_cannot_be_played_leaves_nothing(program, tmp_path):
    bag = make_bag(tmp_path / "a.bag", *(f"text {number}" for number in range(300)))
    with open(bag, "r+b") as file:
        file.seek(5000)
        file.write(b"\xff" * 5000)
    before = set(os.listdir(tmp_path))
    played = play_bag(task(program, bag, tmp_path / "result", "jsonl"), str(tmp_path))
    assert played.failure.startswith(f"{bag}")
    assert set(os.listdir(tmp_path)) == before


def test_whatever_goes_wrong_is_the_bags_failure(program, tmp_path, monkeypatch, tightened):
    bag = make_bag(tmp_path / "a.bag", "x")
    asked = task(program, bag, tmp_path / "result", None)
    monkeypatch.setattr("retalis.cli.bag_command.play", lambda *given: 1 / 0)
    assert play_bag(asked, str(tmp_path)).failure == "ZeroDivisionError: division by zero"
    assert tightened == [True]


def test_of_what_is_said_the_beginning_is_kept(program, tmp_path, monkeypatch):
    bag = make_bag(tmp_path / "a.bag", "x")
    asked = task(program, bag, tmp_path / "result", None)
    monkeypatch.setattr(
        "retalis.cli.bag_command.play", lambda *given: sys.stderr.write("e" * (_MAX_MESSAGE_CHARACTERS + 7))
    )
    assert (
        play_bag(asked, str(tmp_path)).stderr_text
        == "e" * _MAX_MESSAGE_CHARACTERS + "\n... and 7 more characters\n"
    )


def test_a_bag_of_a_url_is_called_by_it(program, tmp_path):
    pytest.importorskip("fsspec")
    (tmp_path / "bad.bag").write_text("no bag")
    played = play_bag(task(program, f"file://{tmp_path}/bad.bag", tmp_path / "r", None), str(tmp_path))
    assert played.failure == f"file://{tmp_path}/bad.bag is not a complete ROS 1 bag: File magic is invalid"
