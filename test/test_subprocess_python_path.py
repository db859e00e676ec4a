"""Search path of the Python processes that tests start."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from subprocess_python_path import ROOT, python_path


def test_process_finds_packages_of_python_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "elsewhere_only.py").write_text("PLACE = 'elsewhere'\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "elsewhere"))
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "elsewhere_only.py").write_text("PLACE = 'first'\n")
    code = "import elsewhere_only, retalis; print(elsewhere_only.PLACE, retalis.__file__)"
    for folders, place in (((), "elsewhere"), ((tmp_path / "first",), "first")):
        environment = {"PYTHONPATH": python_path(*folders)}
        output = subprocess.check_output(
            [sys.executable, "-c", code], env=environment, universal_newlines=True
        )
        assert output.split() == [place, str(ROOT / "src" / "retalis" / "__init__.py")]


def test_tests_extend_search_path() -> None:
    """A test that replaces it fails if rosbags and others are in a folder that only ``PYTHONPATH`` names."""
    replacing = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "test").rglob("*.py")
        for value in re.findall(r"""PYTHONPATH["']: *(\S.*)""", path.read_text(encoding="utf-8"))
        if not value.startswith("python_path(")
    }
    # The first tests the removal of the variable, the second starts it with a copy of the package.
    assert replacing == {"test/test_install_shell.py", "test/test_contributing_examples.py"}
