"""Costs of snapshots in two checkouts."""

import re
from pathlib import Path
from typing import Any, Callable

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def snapshots(import_benchmark: Callable[[str], Any]) -> Any:
    return import_benchmark("snapshots")


@pytest.mark.slow
def test_checkouts_are_compared(snapshots: Any, capsys: pytest.CaptureFixture[str]) -> None:
    few = ["--sizes", "5", "--runs", "1", "--repeats", "1"]
    assert snapshots.main([str(ROOT), *few, "--most", "1000"]) == 0
    cost = r" [\d.]+ -> [\d.]+ (ms|kB) \([\d.]+\)"
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["memory", "seq", "join"]
    for line in lines:
        assert re.search(f"snapshot{cost} +restore{cost} +size{cost}$", line)


def test_costlier_case_is_reported(
    snapshots: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    costs = iter([snapshots.Costs(1.0, 1.0, 100), snapshots.Costs(1.0, 1.3, 100)])
    monkeypatch.setattr(snapshots, "measure", lambda *arguments: next(costs))
    few = ["--case", "seq", "--sizes", "5", "--runs", "1"]
    assert snapshots.main([str(ROOT), *few]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "more than 1.2 times as much: seq 5"
