"""Selection of nightly tests, in runs of pytest with two modules."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, List, Tuple

import pytest
from subprocess_python_path import ROOT, python_path

pytestmark = pytest.mark.slow

CONFIGURATION = "[pytest]\nmarkers =\n    nightly: runs at night\n    slow: takes long\n"
MODULE = """
import pytest

@pytest.mark.nightly
def test_long():
    pass

def test_short():
    pass
"""


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """Return a function that runs the modules and returns the names of the tests that passed."""
    (tmp_path / "pytest.ini").write_text(CONFIGURATION)
    for name in "ab":
        (tmp_path / f"test_{name}.py").write_text(MODULE)

    def run(*arguments: Any) -> List[Any]:
        options = [
            "-p",
            "nightly_test_selection",
            "-p",
            "no:cacheprovider",
            "-p",
            "no:xdist",
            "-v",
            *arguments,
        ]
        process = subprocess.run(
            [sys.executable, "-m", "pytest", *options],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": python_path(ROOT / "test")},
            stdout=subprocess.PIPE,
            text=True,
        )
        return sorted(line.split()[0] for line in process.stdout.splitlines() if " PASSED " in line)

    return run


@pytest.mark.parametrize("arguments", [(), ("-m", "not slow"), (".",)])
def test_nightly_tests_are_omitted(run: Any, arguments: Tuple[Any, ...]) -> None:
    assert run(*arguments) == ["test_a.py::test_short", "test_b.py::test_short"]


def test_marker_selects_nightly_tests(run: Any) -> None:
    assert run("-m", "nightly") == ["test_a.py::test_long", "test_b.py::test_long"]


def test_named_file_includes_nightly_tests(run: Any) -> None:
    assert run("test_a.py") == ["test_a.py::test_long", "test_a.py::test_short"]
    assert run("test_a.py::test_long") == ["test_a.py::test_long"]
