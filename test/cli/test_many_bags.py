"""Separate playback of several bags: results, order and failures."""

import json
import signal
import sys
from pathlib import Path
from typing import Any, Iterator

import pytest
from many_bags_program import make_bag, make_program

from retalis.cli.bag_tasks import BagOutcome
from retalis.cli.command_line import main
from retalis.cli.dask_cluster import ClusterError


@pytest.fixture
def program(tmp_path: Path) -> str:
    return str(make_program(tmp_path / "program"))


@pytest.fixture
def bags(tmp_path: Path) -> Path:
    """Return a folder with three bags and a damaged one."""
    for number, name in enumerate(("r1/a", "r1/b", "r2/a")):
        make_bag(tmp_path / "bags" / f"{name}.bag", *"xxyxy"[number:])
    (tmp_path / "bags" / "r1" / "aa.bag").write_text("no bag")
    return tmp_path / "bags"


VALID_BAGS = ("r1/a", "r1/b", "r2/a")


@pytest.mark.slow
def test_output_equals_that_of_single_bags(
    program: str, bags: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options = ["--program", program, "--json", "--events", "--explain", "again(_)"]
    for name in VALID_BAGS:
        assert main(["bag", f"{bags}/{name}.bag", *options]) == 0
    expected = capfd.readouterr()
    assert expected.out
    assert not expected.err
    assert main(["bag", str(bags), *options, "--jobs", "2"]) == 1
    captured = capfd.readouterr()
    assert captured.out == expected.out
    assert captured.err == (
        f"error: {bags}/r1/aa.bag is not a complete ROS 1 bag: it does not begin with '#ROSBAG V2.0'\n"
        "1 of 4 bags failed\n"
    )


@pytest.mark.slow
def test_results_equal_those_of_single_bags(
    program: str, bags: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["bag", str(bags), "--program", program, "--jobs", "2", "--output", f"{tmp_path}/new"]) == 1
    assert capfd.readouterr().out == ""
    results = sorted(path.relative_to(tmp_path / "new") for path in (tmp_path / "new").rglob("[!.]*.bag"))
    assert [str(path) for path in results] == [f"{name}.bag" for name in VALID_BAGS]
    for name in VALID_BAGS:
        single = tmp_path / "one.bag"
        options = ["bag", f"{bags}/{name}.bag", "--program", program, "--output", str(single), "--overwrite"]
        assert main(options) == 0
        assert (tmp_path / "new" / f"{name}.bag").read_bytes() == single.read_bytes()


@pytest.mark.slow
def test_parts_continue_from_previous_part(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    parts = [
        make_bag(tmp_path / "day" / f"r_{number}.bag", *"xy", start=1 + 3 * number) for number in range(3)
    ]
    assert main(["bag", *map(str, parts), "--program", program, "--json"]) == 0
    expected = capfd.readouterr().out
    assert expected.count('"id": "twice"') == 4
    options = ["bag", str(tmp_path / "day"), "--program", program, "--jobs", "2", "--json"]
    assert main([*options, "--parts"]) == 0
    assert capfd.readouterr().out == expected
    parts[1].write_text("no bag")
    assert main([*options, "--parts"]) == 1
    captured = capfd.readouterr()
    assert captured.out == "".join(expected.splitlines(keepends=True)[:2])
    assert captured.err.splitlines()[1:] == [
        f"error: {parts[2]}: not played: it goes on from {parts[1]}, which failed",
        "2 of 3 bags failed",
    ]


@pytest.mark.slow
def test_failed_bags_lose_results_of_earlier_run(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    parts = [make_bag(tmp_path / "day" / f"r_{number}.bag", "x", start=1 + number) for number in range(3)]
    output = tmp_path / "results"
    options = [
        "bag",
        str(tmp_path / "day"),
        "--program",
        program,
        "--jobs",
        "1",
        "--parts",
        "--format",
        "jsonl",
    ]
    assert main([*options, "--output", str(output)]) == 0
    parts[1].write_text("no bag")
    assert main([*options, "--output", str(output), "--resume"]) == 1
    assert capfd.readouterr().err.endswith("2 of 3 bags failed\n")
    # The third part is not played, because it continues from the second one.
    assert sorted(path.name for path in output.rglob("*.json*")) == ["r_0.jsonl", "r_0.jsonl.json"]


@pytest.mark.parametrize(("result_format", "package"), [("parquet", "pyarrow"), ("mcap", "mcap")])
def test_missing_package_is_one_error(
    program: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    result_format: str,
    package: str,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    options = ["--program", program, "--jobs", "1", "--format", result_format, "--output", f"{tmp_path}/out"]
    assert main(["bag", f"{tmp_path}/a.bag", f"{tmp_path}/b.bag", *options]) == 1
    expected = (
        f"retalis: --format {result_format} needs the Python package {package} (pip install {package})\n"
    )
    assert capsys.readouterr().err == expected


def test_missing_program_keeps_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_bag(tmp_path / "a.bag", "x")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.jsonl").touch()
    options = ["--jobs", "1", "--format", "jsonl", "--output", f"{tmp_path}/results", "--overwrite"]
    assert main(["bag", f"{tmp_path}/a.bag", "--program", f"{tmp_path}/none", *options]) == 1
    assert capsys.readouterr().err == f"retalis: --program {tmp_path}/none: there is no such folder\n"
    assert (tmp_path / "results" / "a.jsonl").exists()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Return the address of a scheduler; its start sets environment variables and loggers for good."""
    distributed = pytest.importorskip("distributed")
    options = {"dashboard_address": None, "processes": True}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=2, **options) as local_cluster:
        yield local_cluster.scheduler_address


@pytest.mark.slow
def test_cluster_has_same_results(
    program: str,
    bags: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    cluster: Any,
) -> None:
    monkeypatch.chdir(bags.parent)  # the workers have another working folder
    options = ["bag", "bags", "--program", "program", "--json", "--output", "new"]
    assert main([*options, "--scheduler", cluster]) == 1
    errors = capfd.readouterr().err
    assert errors.startswith(f"{cluster}: 1 worker with retalis ")
    assert f"error: {bags}/r1/aa.bag is not a complete ROS 1 bag" in errors
    assert errors.endswith("1 of 4 bags failed\n")
    assert main([*options, "--scheduler", cluster, "--resume"]) == 1
    assert "resume: 3 of 4 results are whole" in capfd.readouterr().err
    for name in VALID_BAGS:
        assert main(["bag", f"{bags}/{name}.bag", "--program", program, "--json"]) == 0
        assert (tmp_path / "new" / f"{name}.jsonl").read_text() == capfd.readouterr().out


def test_lost_cluster_is_one_line_with_count(
    program: str, bags: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose(function: Any, tasks: Any, *arguments: Any) -> Iterator[Any]:
        yield 2, BagOutcome(0, "", "the third bag fails")
        raise ClusterError("the scheduler is lost")

    monkeypatch.setattr("retalis.cli.bag_command.run_on_cluster", lose)
    monkeypatch.chdir(bags.parent)
    options = ["bag", "bags", "--program", program, "--output", "new", "--scheduler", "tcp://here:1"]
    assert main(options) == 1
    assert capfd.readouterr().err.splitlines() == [
        "error: the scheduler is lost; --resume continues the run",
        f"error: {bags}/r1/b.bag: the third bag fails",
        "4 of 4 bags failed",
    ]


@pytest.mark.slow
def test_equal_errors_of_bags_are_printed_once(
    program: str, bags: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "program" / "goalPredicates.txt").write_text("nothing_such(1)\n")
    options = ["bag", f"{bags}/r1/a.bag", f"{bags}/r1/b.bag", "--program", program, "--jobs", "1"]
    assert main(options) == 1
    errors = capfd.readouterr().err
    assert errors.startswith(f"{bags}/r1/a.bag:\nerror: ")
    assert errors.endswith("1 more bags had the same errors and warnings as one before\n")
    assert errors.count("error: ") == 1


CONFLICTS = {
    "bags --jobs 2 --scheduler tcp://x:1 --output new": "--jobs and --scheduler: give only one option",
    "bags --scheduler tcp://x:1": "--scheduler needs --output",
    "bags --jobs 2 --format jsonl": "--format needs --output",
    "bags --parts": "--parts needs --jobs or --scheduler",
    "bags --jobs 2 --resume": "--resume needs --output",
    "bags --resume --output new": "--resume needs --jobs or --scheduler",
    "bags --jobs 2 --resume --coverage --output new": "--resume: whole results have no coverage",
    "bags --format jsonl --output new": "--format needs --jobs or --scheduler",
    "bags --jobs 2 --write-folder x": "--write-folder: bags that are played at the same time",
    "bags --jobs 2 --output new --events": "--events: a bag contains only published messages",
    "bags --jobs 2 --output new --explain x": "--explain: --format bag cannot contain explanations",
    "bags --jobs 2 --output bags/new": "--output bags/new is below bags: results would be played the next time",
    "bags --jobs 2 --output old": "old/r1/b.bag already exists; --overwrite replaces it",
    "other/r2/a.bag bags/r2 --jobs 2 --output new": "bags/r2/a.bag: the result of both would be new/a.bag",
    "bags": "bags is not a ROS 2 bag: it has no metadata.yaml: name its .db3 or .mcap file, or use --jobs",
}


@pytest.mark.parametrize("arguments", CONFLICTS)
def test_conflicting_options_are_errors(
    program: str,
    bags: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: str,
) -> None:
    monkeypatch.chdir(bags.parent)
    (bags.parent / "old" / "r1").mkdir(parents=True)
    (bags.parent / "old" / "r1" / "b.bag").touch()
    assert main(["bag", *arguments.split(), "--program", program]) == 1
    assert CONFLICTS[arguments] in capsys.readouterr().err
    assert not (bags.parent / "new").exists()


def test_url_needs_jobs(program: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "s3://bucket/a.bag", "--program", program]) == 1
    assert "s3://bucket/a.bag: --jobs plays bags of URLs, each by itself" in capsys.readouterr().err


RULES = "frequent(Text) <- std_msgs__0__String(Text) where Text == '\"x\"'.\n"


def list_coverage(capfd: pytest.CaptureFixture[str], *options: str) -> str:
    """Return the coverage that a run prints."""
    assert main(["bag", "--quiet", "--coverage", *options]) == 0
    return capfd.readouterr().err


@pytest.mark.slow
def test_coverage_is_that_of_all_bags(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with (tmp_path / "program" / "eventRules.txt").open("a") as file:
        file.write(RULES)
    first, second = (
        make_bag(tmp_path / f"r_{number}.bag", text, start=number) for number, text in ((1, "x"), (5, "y"))
    )
    common = ("--program", "program")
    text = list_coverage(capfd, str(first), *common)
    assert text.startswith("coverage        used   all\nrule               1     2\n")
    assert "not used: again(Text) (program/eventRules.txt:1): rule again(" in text
    assert "not used: frequent(Text) (program/eventRules.txt:2): condition 1 false, " in text
    reports = []
    for options in ((), ("--jobs", "2"), ("--jobs", "1", "--parts")):
        text = list_coverage(
            capfd, str(first), str(second), *common, *options, "--html", "a.html", "--cobertura", "a.xml"
        )
        assert "condition" not in text.split("not used: ", 1)[1]
        reports.append(
            (text, Path("a.html").read_text(encoding="utf-8"), Path("a.xml").read_text(encoding="utf-8"))
        )
    assert reports[0] == reports[1] == reports[2]
    assert "<h1>Coverage of program</h1>" in reports[0][1]


def test_coverage_file_that_cannot_be_written_is_an_error(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "a.bag", "x")
    assert main(["bag", str(bag), "--program", program, "--quiet", "--html", str(tmp_path)]) == 1
    assert capfd.readouterr().err.startswith(f"retalis: cannot write {tmp_path}: ")


def cut_bag(path: Path, text: str) -> str:
    """Write a bag of two texts whose second message is cut; return the description of what is missing."""
    make_bag(path, text, "not read")
    content = path.read_bytes()
    # Before the text are lengths of 4 bytes each of text, data and header, and the header of 38 bytes.
    start = content.index(b"not read") - 4 - 4 - 38 - 4
    path.write_bytes(content[: start + 30])
    return (
        f"{path} is incomplete: its index is missing: 1 message was read, the last of time 1.000000000 s; "
        f"30 bytes from byte {start} on were not, at least "
    )


def test_incomplete_bag_is_played_with_status_3(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "a.bag.active"
    description = cut_bag(bag, "x")
    assert main(["bag", str(bag), "--program", program]) == 3
    captured = capfd.readouterr()
    assert captured.out == """output(std_msgs__0__String('"x"'),speech).\n"""
    assert captured.err.startswith(f"warning: {description}")
    assert captured.err.count("\n") == 1
    assert main(["bag", str(bag), "--program", program, "--json", "--times=relative"]) == 3
    record = json.loads(capfd.readouterr().out.splitlines()[0])
    assert (record["incomplete"], record["problem"], record["messages"], record["unread_bytes"]) == (
        str(bag),
        "its index is missing",
        1,
        30,
    )


def test_strict_option_refuses_incomplete_bag(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, output = tmp_path / "a.bag", tmp_path / "out.bag"
    description = cut_bag(bag, "x")
    assert main(["bag", str(bag), "--program", program, "--strict", "--output", str(output)]) == 1
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"retalis: {description}")
    assert not output.exists()


@pytest.mark.slow
def test_summary_counts_incomplete_bags(
    program: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    make_bag(tmp_path / "bags" / "a.bag", "x")
    description = cut_bag(tmp_path / "bags" / "b.bag.active", "x")
    results = ["--program", program, "--jobs", "2", "--format", "jsonl", "--output"]
    assert main(["bag", str(tmp_path / "bags"), *results, str(tmp_path / "results")]) == 3
    messages = capfd.readouterr().err
    assert messages.startswith(f"{tmp_path}/bags/b.bag.active:\nwarning: {description}")
    assert messages.endswith("\n1 of 2 bags are incomplete\n")
    lines = [(tmp_path / "results" / f"{name}.jsonl").read_text().splitlines() for name in "ab"]
    assert lines[1][0].startswith(f'{{"incomplete": "{tmp_path}/bags/b.bag.active", ')
    assert lines[1][1:] == lines[0]
    assert main(["bag", str(tmp_path / "bags"), *results, str(tmp_path / "strict"), "--strict"]) == 1
    assert capfd.readouterr().err.endswith("\n1 of 2 bags failed\n")
    assert [path.name for path in (tmp_path / "strict").glob("*.jsonl")] == ["a.jsonl"]
    assert main(["bag", str(tmp_path / "bags"), *results, str(tmp_path / "results"), "--resume"]) == 3
    assert capfd.readouterr().err.endswith("\n1 of 2 bags are incomplete\n")


def test_ended_run_leaves_no_incomplete_results(
    program: str, bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "results" / "r1"
    target.mkdir(parents=True)
    scratch_folders = []

    def end_process(function: Any, tasks: Any, jobs: int, scratch: str, *arguments: Any) -> Any:
        scratch_folders.append(Path(scratch))
        (target / f".{'0' * 32}.incomplete.a.csv.part").touch()
        signal.raise_signal(signal.SIGTERM)
        yield

    monkeypatch.setattr("retalis.cli.bag_command.run_in_processes", end_process)
    arguments = ["--program", program, "--jobs", "1", "--format", "csv", "--output", f"{tmp_path}/results"]
    with pytest.raises(SystemExit) as raised:
        main(["bag", str(bags), *arguments])
    assert raised.value.code == 128 + signal.SIGTERM
    assert [*target.iterdir(), *filter(Path.exists, scratch_folders)] == []
