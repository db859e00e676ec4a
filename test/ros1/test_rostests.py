"""Runs of each rostest with its own master."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).resolve().parent))
from rostest_results import failure_report  # noqa: E402

TEST = Path(__file__).resolve().parents[1]
TESTS = sorted(path for folder in ("ros1/rostests", "faults") for path in (TEST / folder).glob("*.test"))
ROSTEST_TIMEOUT_SECONDS = 960
"""Longer than the time limit of every test in the files, with their default arguments."""

LONG_RUNS = {
    "port_attacks": ["requests:=2000", "characters:=10000000"],
    "first_outputs": ["starts:=20"],
    "latched_direct": ["orders:=all"],
    "latched_text": ["orders:=all"],
    "malformed_inputs": ["inputs:=1500"],
    "start_orders": ["starts:=20", "kills:=20"],
}
"""Arguments of the long forms of rostests."""

NIGHTLY_RUNS = ("latched_text", "port_attacks", "start_orders")
"""Rostests that run nightly only: each push runs their like with one node, or its parts without ROS."""

LONG_TIMEOUT_SECONDS = 4 * 3600


def package_is_built() -> bool:
    """Return whether the shell has sourced a workspace with the built package."""
    if not shutil.which("rostest") or not shutil.which("rospack"):
        return False
    result = subprocess.run(["rospack", "find", "retalis"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return result.returncode == 0


def run_rostest(
    path: Any, arguments: Any, timeout: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run a rostest; fail with its failed test cases."""
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    results = tmp_path / "results"
    monkeypatch.setenv("ROS_TEST_RESULTS_DIR", str(results))
    log = tmp_path / "rostest.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["rostest", str(path), *arguments], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        code = process.wait(timeout)
    finally:
        if process.poll() is None:
            # rostest ends its master and its nodes after SIGINT, but not if it is killed.
            process.send_signal(signal.SIGINT)
            process.wait(60)
    assert code == 0, failure_report(results, log.read_text(errors="replace"))


@pytest.mark.slow
@pytest.mark.skipif(not package_is_built(), reason="./install.py test builds the package")
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.nightly if path.stem in NIGHTLY_RUNS else ())
        for path in TESTS
    ],
)
def test_rostest_succeeds(path: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_rostest(path, [], ROSTEST_TIMEOUT_SECONDS, tmp_path, monkeypatch)


@pytest.mark.nightly
@pytest.mark.skipif(not package_is_built(), reason="./install.py test builds the package")
@pytest.mark.parametrize(
    "path", [pytest.param(path, id=path.stem) for path in TESTS if path.stem in LONG_RUNS]
)
def test_long_rostest_succeeds(path: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_rostest(path, LONG_RUNS[path.stem], LONG_TIMEOUT_SECONDS, tmp_path, monkeypatch)
