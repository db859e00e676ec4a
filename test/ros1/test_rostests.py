"""Runs of each rostest with its own master."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parent))
from rostest_results import failure_report  # noqa: E402

TEST = Path(__file__).resolve().parents[1]
TESTS = sorted(path for folder in ("ros1", "faults") for path in (TEST / folder).glob("*.test"))
ROSTEST_TIMEOUT_SECONDS = 960
"""Longer than the time limit of every test in the files."""


def package_is_built():
    """Return whether the shell has sourced a workspace with the built package."""
    if not shutil.which("rostest") or not shutil.which("rospack"):
        return False
    result = subprocess.run(["rospack", "find", "retalis"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return result.returncode == 0


@pytest.mark.skipif(not package_is_built(), reason="./install.py test builds the package")
@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in TESTS])
def test_rostest_succeeds(path, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    results = tmp_path / "results"
    monkeypatch.setenv("ROS_TEST_RESULTS_DIR", str(results))
    log = tmp_path / "rostest.log"
    with log.open("wb") as output:
        process = subprocess.Popen(["rostest", str(path)], stdout=output, stderr=subprocess.STDOUT)
    try:
        code = process.wait(ROSTEST_TIMEOUT_SECONDS)
    finally:
        if process.poll() is None:
            # rostest ends its master and its nodes after SIGINT, but not if it is killed.
            process.send_signal(signal.SIGINT)
            process.wait(60)
    assert code == 0, failure_report(results, log.read_text(errors="replace"))
