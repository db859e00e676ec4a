"""Each rostest of this folder, run against a master of its own."""

import shutil
import subprocess
from pathlib import Path

import pytest

TESTS = sorted(Path(__file__).resolve().parent.glob("*.test"))
SECONDS = 300


def package_is_built():
    """Is this shell one that has sourced a workspace with the package."""
    if not shutil.which("rostest") or not shutil.which("rospack"):
        return False
    found = subprocess.run(["rospack", "find", "retalis"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return found.returncode == 0


@pytest.mark.skipif(not package_is_built(), reason="./install.py test builds the package")
@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in TESTS])
def test_rostest(path, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    run = subprocess.run(
        ["rostest", str(path)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=SECONDS
    )
    assert run.returncode == 0, run.stdout
