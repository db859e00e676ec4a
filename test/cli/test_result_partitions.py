"""Folders of results by day and robot, and robots from paths."""

import argparse
import json
import os
from pathlib import Path
from typing import Any, List

import pytest
from many_bags_program import make_bag, make_program

from retalis import UsageError
from retalis.cli.command_line import main
from retalis.cli.result_partitions import (
    ResultTarget,
    find_robot,
    make_target,
    parse_partition,
    parse_robot,
    utc_day,
)

DAY = 86_400


@pytest.mark.parametrize(
    ("pattern", "location", "robot"),
    [
        ("r07", "a.bag", "r07"),
        ("{robot}/*", "/data/r07/a.bag", "r07"),
        ("{robot}/*/*.bag", "s3://bucket/r07/2026-11-30/a.bag", "r07"),
        ("robot={robot}/*", "day=1/robot=r07/a.bag", "r07"),
        ("{robot}_*.bag", "r07_2026_a.bag", "r07"),
        ("run-*_{robot}.bag", "x/run-1_2_r07.bag", "2_r07"),
        ("/{robot}.bag", "data/r07.bag", "r07"),
    ],
)
def test_robot_is_part_of_path(pattern: str, location: str, robot: str) -> None:
    assert find_robot(parse_robot(pattern), location) == robot


@pytest.mark.parametrize(
    ("pattern", "location"),
    [
        ("{robot}/*/*.bag", "/a.bag"),
        ("{robot}/*.bag", "r07/a.db3"),
        ("robot={robot}/*", "r07/a.bag"),
        ("{robot}_*.bag", "_a.bag"),
        ("{robot}_*_x.bag", "a_x.bag"),
    ],
)
def test_other_path_is_an_error(pattern: str, location: str) -> None:
    with pytest.raises(UsageError, match="its robot is not known: expected a path that ends as --robot"):
        find_robot(pattern, location)


@pytest.mark.parametrize("text", ["", "{robot}/{robot}", "*/*.bag", "{robo}", "r07/"])
def test_invalid_pattern_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="expected a name, or the end of a path"):
        parse_robot(text)


def test_partition_has_known_keys() -> None:
    assert parse_partition("robot,day") == ("robot", "day")
    for text in ("", "day,day", "month"):
        with pytest.raises(argparse.ArgumentTypeError, match="expected day or robot, or both"):
            parse_partition(text)


def test_target_contains_day_and_quoted_robot() -> None:
    target = make_target("out", "a.csv", ("day", "robot"), "r/7=")
    assert target.locate("2026-11-30") == "out/day=2026-11-30/robot=r%2F7%3D/a.csv"
    assert make_target("out", "a.csv", ("robot", "day"), "r7").locate("x") == "out/robot=r7/day=x/a.csv"
    assert make_target("out", "a.csv", ("robot",), "r7") == ResultTarget("out/robot=r7/a.csv")
    assert make_target("out{", "a.csv", (), None).locate("x") == "out{/a.csv"
    # A folder whose name is not UTF-8.
    assert make_target("out", "a.csv", ("robot",), "r\udcff").head == "out/robot=r%FF/a.csv"


@pytest.mark.parametrize(
    ("instant", "day"),
    [
        (0, "1970-01-01"),
        (DAY * 10**9 - 1, "1970-01-01"),
        (DAY * 10**9, "1970-01-02"),
        (1 << 79, "9999-12-31"),
    ],
)
def test_day_is_that_of_utc(instant: int, day: str) -> None:
    assert utc_day(instant) == day


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> List[str]:
    """Return a command over bags of two robots and days, in the working folder."""
    monkeypatch.chdir(tmp_path)
    make_program(tmp_path / "program")
    make_bag(tmp_path / "bags" / "r1" / "a.bag", "x", start=DAY)
    make_bag(tmp_path / "bags" / "r2" / "b.bag", "x", start=2 * DAY)
    options = ["--program", "program", "--jobs", "1", "--format", "csv", "--robot", "{robot}/*.bag"]
    return ["bag", "bags", *options]


def list_results(folder: str) -> List[str]:
    return sorted(str(path.relative_to(folder)) for path in Path(folder).rglob("*.csv"))


@pytest.mark.slow
def test_results_are_in_partitions(
    command: List[str], capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main([*command, "--output", "flat"]) == 0
    assert list_results("flat") == ["r1/a.csv", "r2/b.csv"]
    assert Path("flat/r1/a.csv").read_text().splitlines()[1].startswith('"bags/r1/a.bag","r1",false,"bag"')
    options = ["--partition", "day,robot", "--output", "out"]
    assert main([*command, *options]) == 0
    results = ["day=1970-01-02/robot=r1/r1/a.csv", "day=1970-01-03/robot=r2/r2/b.csv"]
    assert list_results("out") == results
    # The robot is in the path.
    assert Path("out", results[0]).read_text().startswith('"bag","incomplete","kind",')
    assert main([*command, *options]) == 1
    assert "out/day=*/robot=r1/r1/a.csv already exists; --overwrite replaces it" in capfd.readouterr().err
    # A bag of another day in the place of the first one.
    os.unlink("bags/r1/a.bag")
    make_bag(tmp_path / "bags" / "r1" / "a.bag", "x", start=5 * DAY)
    assert main([*command, *options, "--resume"]) == 0
    assert (
        capfd.readouterr().err
        == "resume: 1 of 2 results are whole; the others are computed: 1 with other bag\n"
    )
    assert list_results("out") == ["day=1970-01-03/robot=r2/r2/b.csv", "day=1970-01-06/robot=r1/r1/a.csv"]
    os.unlink("out/day=1970-01-03/robot=r2/r2/b.csv")
    assert main([*command, *options, "--resume"]) == 0
    assert capfd.readouterr().err.endswith("the others are computed: 1 with no result\n")
    # A manifest names no file outside of the partitions.
    manifest = Path("out/.manifest/robot=r1/r1/a.csv.json")
    content = json.loads(manifest.read_text())
    content["outcome"]["day"] = "../.."
    manifest.write_text(json.dumps(content))
    assert main([*command, *options, "--resume"]) == 0
    assert capfd.readouterr().err.endswith("the others are computed: 1 with an unreadable manifest\n")


@pytest.mark.slow
def test_bags_of_robots_can_have_same_name(tmp_path: Path, command: List[str], capfd: Any) -> None:
    make_bag(tmp_path / "bags" / "r2" / "a.bag", "y", start=3 * DAY)
    os.unlink("bags/r2/b.bag")
    arguments = ["bag", "bags/r1", "bags/r2", *command[2:], "--partition", "day,robot", "--output", "out"]
    assert main(arguments) == 0
    assert list_results("out") == ["day=1970-01-02/robot=r1/a.csv", "day=1970-01-04/robot=r2/a.csv"]
    assert main([*arguments, "--resume"]) == 0
    assert capfd.readouterr().err == "resume: 2 of 2 results are whole\n"


def test_robot_of_folder_is_no_column(command: List[str], tmp_path: Path) -> None:
    make_bag(tmp_path / "days" / "robot=r1" / "a.bag", "x")
    command = ["bag", "days", *command[2:], "--output", "out"]
    assert main([*command, "--robot", "robot={robot}/*"]) == 0
    assert Path("out/robot=r1/a.csv").read_text().startswith('"bag","incomplete",')


@pytest.mark.parametrize("bag", ["misspelt", "memory://misspelt"])
def test_missing_input_is_reported_before_robot(command: List[str], bag: str, capfd: Any) -> None:
    if bag.startswith("memory"):
        pytest.importorskip("fsspec")
    assert main(["bag", bag, *command[2:], "--output", "out"]) == 1
    assert capfd.readouterr().err == f"retalis: {bag}: there is no such file or folder\n"


@pytest.mark.slow
def test_results_at_url_are_in_partitions(command: List[str], tmp_path: Path, capfd: Any) -> None:
    pytest.importorskip("fsspec")
    options = ["--partition", "day", "--output", f"file://{tmp_path}/out"]
    assert main([*command, *options]) == 0
    results = ["day=1970-01-02/r1/a.csv", "day=1970-01-03/r2/b.csv"]
    assert list_results("out") == results
    assert main([*command, *options, "--resume"]) == 0
    assert capfd.readouterr().err == "resume: 2 of 2 results are whole\n"


def test_incomplete_files_in_partitions_are_removed(
    command: List[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def leave_file(function: Any, tasks: Any, *arguments: Any) -> Any:
        folder = Path("out/day=1970-01-02/r1")
        folder.mkdir(parents=True)
        for name in ("a.csv", "other.csv"):
            (folder / f".{'0' * 32}.incomplete.{name}").touch()
        yield from ()

    monkeypatch.setattr("retalis.cli.bag_command.run_in_processes", leave_file)
    main([*command, "--partition", "day", "--output", "out"])
    assert [path.name[-9:] for path in Path("out").rglob(".*.csv")] == ["other.csv"]


CONFLICTS = {
    "--partition robot --output new --format csv": "--partition robot needs --robot",
    "--robot r7 --output new": "--robot needs --format parquet or csv, or --partition robot",
    "--partition day": "--partition needs --output",
    "--robot {robot}_x.bag --output new --format csv": "bags/r1/a.bag: its robot is not known",
    "--times=relative --output new --format csv": "--times=relative: --format csv has times in UTC",
}


@pytest.mark.parametrize("options", CONFLICTS)
def test_conflicting_options_are_errors(
    command: List[str], options: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bag", "bags", "--program", "program", "--jobs", "1", *options.split()]
    assert main(arguments) == 1
    assert CONFLICTS[options] in capsys.readouterr().err
    assert not Path("new").exists()
