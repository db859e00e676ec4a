"""A run of the search for changes of the source that no test notices."""

import os
import subprocess
import sys

import pytest
from subprocess_python_path import ROOT, python_path


@pytest.mark.nightly
def test_most_mutants_are_noticed() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "mutation", "--places", "60"],
        env={**os.environ, "PYTHONPATH": python_path(ROOT / "test")},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert run.returncode == 0, run.stdout
