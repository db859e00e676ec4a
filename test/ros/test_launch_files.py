"""Runs of each rostest with its own master."""

import shutil
import signal
import subprocess
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parents[1]
TESTS = sorted(path for folder in ("ros", "faults") for path in (TEST / folder).glob("*.test"))
SECONDS = 960
"""More than any of them gives its test."""


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
    log = tmp_path / "rostest.log"
    with log.open("wb") as output:
        process = subprocess.Popen(["rostest", str(path)], stdout=output, stderr=subprocess.STDOUT)
    try:
        code = process.wait(SECONDS)
    finally:
        if (
            process.poll() is None
        ):  # rostest ends its master and its nodes when it is asked, not when it is killed
            process.send_signal(signal.SIGINT)
            process.wait(60)
    assert code == 0, log.read_text(errors="replace")
