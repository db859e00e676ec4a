"""Long runs of the comparisons of engine and oracle."""

import os
import subprocess
import sys

import pytest
from subprocess_python_path import ROOT, python_path

RUNS = [
    "comparison --cases 10000",
    "comparison --cases 3000 --unsure",
    "comparison --cases 3000 --streams",
    "comparison --cases 3000 --index",
    "comparison --cases 3000 --revision --depth 3",
    "comparison --cases 3000 --revision --overlaps --depth 3",
    "comparison --cases 3000 --nested --overlaps",
    "engine_mutants",
    "snapshot_restoring --cases 500",
    "snapshot_restoring --cases 200 --revision --seed 50000",
    "snapshot_restoring --cases 200 --streams --seed 70000",
    "snapshot_restoring --cases 200 --revision --streams --seed 80000",
    "snapshot_restoring --cases 1000 --clock",
]


@pytest.mark.nightly
@pytest.mark.parametrize("arguments", RUNS)
def test_long_run_has_no_difference(arguments: str) -> None:
    program, *options = arguments.split()
    run = subprocess.run(
        [sys.executable, "-m", f"oracle.{program}", *options],
        env={**os.environ, "PYTHONPATH": python_path(ROOT / "test")},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert run.returncode == 0, run.stdout
