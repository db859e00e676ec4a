"""Results that are whole are not computed again: causes to compute them, recordings in parts, and outcomes."""

import os
from pathlib import Path
from typing import Any, Dict, List

import pytest
from many_bags_program import make_bag, make_program

from retalis.cli.command_line import main, version
from retalis.cli.result_manifest import (
    ResultManifest,
    compute_inputs,
    find_whole_results,
    record_result,
)
from retalis.cli.result_partitions import ResultTarget

INPUTS = {"retalis": version(), "program": "a", "options": "b"}
OUTCOME = {"errors": 2, "stderr_text": "a warning"}


@pytest.fixture
def manifests(tmp_path: Path) -> List[ResultManifest]:
    """Return the manifests of two results that have been recorded."""
    entries = []
    for name in ("a", "b"):
        bag, target = tmp_path / f"{name}.bag", tmp_path / "out" / f"{name}.jsonl"
        bag.write_text("messages")
        place = f"{tmp_path}/out/.manifest/{target.name}.json"
        entries.append(ResultManifest(place, str(bag), ResultTarget(str(target)), INPUTS))
        record(entries[-1], tmp_path)
    return entries


def record(manifest: ResultManifest, folder: Path, *files: str) -> None:
    def write() -> Any:
        Path(manifest.target.head).parent.mkdir(exist_ok=True)
        Path(manifest.target.head).write_text("result\n")
        return OUTCOME, files

    record_result(manifest, str(folder), write)


def test_outcome_of_whole_result_is_kept(manifests: List[ResultManifest], tmp_path: Path) -> None:
    assert find_whole_results(manifests, [0, 1]) == (
        {0: OUTCOME, 1: OUTCOME},
        "resume: 2 of 2 results are whole",
    )


def change_bag(manifest: ResultManifest) -> None:
    os.utime(manifest.bag, (1, 1))


def remove_result(manifest: ResultManifest) -> None:
    os.unlink(manifest.target.head)


def change_result(manifest: ResultManifest) -> None:
    """Replace the result by another text of the same length."""
    Path(manifest.target.head).write_text("RESULT\n")


def remove_manifest(manifest: ResultManifest) -> None:
    os.unlink(manifest.location)


def damage_manifest(manifest: ResultManifest) -> None:
    Path(manifest.location).write_text('{"inputs": ')


CHANGES = {
    "other bag": change_bag,
    "no result": remove_result,
    "a changed result": change_result,
    "a result without manifest": remove_manifest,
    "an unreadable manifest": damage_manifest,
}


@pytest.mark.parametrize("reason", CHANGES)
def test_changed_file_has_result_computed(manifests: List[ResultManifest], reason: str) -> None:
    CHANGES[reason](manifests[0])
    assert find_whole_results(manifests, [0, 1]) == (
        {1: OUTCOME},
        f"resume: 1 of 2 results are whole; the others are computed: 1 with {reason}",
    )


@pytest.mark.parametrize("name", INPUTS)
def test_changed_input_has_result_computed(manifests: List[ResultManifest], name: str) -> None:
    changed = manifests[0]._replace(inputs={**INPUTS, name: "changed"})
    assert find_whole_results([changed], [0])[1].endswith(f": 1 with other {name}")


def test_manifest_has_version_of_worker(
    manifests: List[ResultManifest], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("retalis.cli.result_manifest.version", lambda: "0.1")
    record(manifests[0], tmp_path)
    assert find_whole_results(manifests[:1], [0])[1].endswith(": 1 with other retalis")


def test_file_outside_of_program_counts(manifests: List[ResultManifest], tmp_path: Path) -> None:
    rules = tmp_path / "common.txt"
    rules.write_text("a <- b.")
    record(manifests[0], tmp_path, str(rules))
    assert len(find_whole_results(manifests, [0, 1])[0]) == 2
    rules.write_text("a <- c.")
    assert find_whole_results(manifests, [0, 1])[1].endswith(": 1 with other program")


def test_parts_of_recording_are_whole_together(manifests: List[ResultManifest]) -> None:
    change_bag(manifests[1])
    assert find_whole_results(manifests, [0]) == (
        {},
        "resume: 0 of 2 results are whole; the others are computed: "
        "1 with another part that is computed, 1 with other bag",
    )


def test_failed_computation_leaves_no_manifest(manifests: List[ResultManifest], tmp_path: Path) -> None:
    record_result(manifests[0], str(tmp_path), lambda: (None, ()))
    assert not Path(manifests[0].location).exists()


def test_results_and_bags_in_program_are_no_inputs(tmp_path: Path) -> None:
    program = Path(make_program(tmp_path / "program"))
    options: Dict[str, Any] = {"program": program, "msg": [], "answers": None, "events": False}

    def inputs() -> Dict[str, str]:
        return compute_inputs(options, ("jsonl", False), str(program / "out"))

    first = inputs()
    assert first["retalis"] == version()
    assert "retalis" not in compute_inputs(options, ("jsonl", False), "out", any_version=True)
    (program / "out").mkdir()
    for name in ("out/a.jsonl", "a.bag", ".hidden"):
        (program / name).write_text("data")
    assert inputs() == first
    (program / "eventRules.txt").write_text("a <- b.\n")
    assert [name for name in first if inputs()[name] != first[name]] == ["program"]
    options["events"] = True
    assert [name for name in first if inputs()[name] != first[name]] == ["program", "options"]


@pytest.mark.slow
def test_resumed_run_computes_missing_results_only(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make_program(tmp_path / "program")
    for name in ("a", "b"):
        make_bag(tmp_path / "bags" / f"{name}.bag", "x")
    command = ["bag", "bags", "--program", "program", "--jobs", "1", "--output", "out", "--format", "jsonl"]
    assert main(command) == 0
    (tmp_path / "out" / "b.jsonl").unlink()
    whole = (tmp_path / "out" / "a.jsonl").stat()
    assert main([*command, "--resume"]) == 0
    assert capfd.readouterr().err == (
        "resume: 1 of 2 results are whole; the others are computed: 1 with no result\n"
    )
    assert (tmp_path / "out" / "a.jsonl").stat() == whole
    assert (tmp_path / "out" / "b.jsonl").exists()
    assert main([*command, "--resume", "--events"]) == 0
    assert "0 of 2 results are whole; the others are computed: 2 with other options" in capfd.readouterr().err
    assert main([*command, "--resume", "--events"]) == 0
    assert capfd.readouterr().err == "resume: 2 of 2 results are whole\n"
