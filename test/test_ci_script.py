"""The runs of `.ci/run`, with programs that only record how they are called."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Tuple

import pytest

ROOT = Path(__file__).resolve().parent.parent

INSTALL = """#!{python}
import os, sys
words = " ".join(sys.argv[1:])
with open(os.environ["RETALIS_CALLS"], "a") as calls:
    calls.write(f"install.py {{words}}\\n")
if sys.argv[1] == "test":
    fails = words == os.environ.get("RETALIS_FAILURE")
    print("FAILED test/test_x.py::test_x\\n1 failed in 2.00s" if fails else f"passed: {{words}}")
    sys.exit(fails)
"""

OLD_PYTHON = """#!/bin/sh
echo "python3.8 $*" >> "$RETALIS_CALLS"
case "$2" in
  venv) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
  pytest) echo "passed: 3.8" ;;
esac
"""

BARE = """#!/bin/sh
echo "bare${1:+ $1}" >> "$RETALIS_CALLS"
"""

SWI = "install.py test --with-swi -n 0 test/prolog/swi"
OLD_TESTS = "python3.8 -m pytest -n 2 --dist worksteal -m not slow --ignore test/ros1"


def write_program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """Return a function that runs `.ci/run`; it returns exit status, output lines and calls."""
    folder, home, calls = tmp_path / "clone", tmp_path / "home", tmp_path / "calls"
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    script = script.replace("/usr/bin/python3", sys.executable)
    release = tmp_path / "os-release"
    write_program(folder / ".ci" / "run", script.replace("/etc/os-release", str(release)))
    write_program(folder / ".ci" / "bare", BARE)
    write_program(folder / "install.py", INSTALL.format(python=sys.executable))
    shutil.copy(ROOT / "install_shell.py", folder)
    write_program(home / ".pyenv" / "versions" / "3.8.18" / "bin" / "python3", OLD_PYTHON)

    def run(*stages: Any, failure: str = "", codename: str = "bookworm") -> Tuple[Any, ...]:
        release.write_text(f"VERSION_CODENAME={codename}\n", encoding="utf-8")
        environment = {
            "PATH": os.environ["PATH"],
            "HOME": str(home),
            "RETALIS_CALLS": str(calls),
            "RETALIS_FAILURE": failure,
        }
        command = [str(folder / ".ci" / "run"), *stages]
        process = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        lines = calls.read_text().splitlines() if calls.exists() else []
        preparations = ("python3.8 -m venv", "python3.8 -m pip", "python3.8 --version")
        return (
            process.returncode,
            process.stdout.splitlines(),
            [line for line in lines if not line.startswith(preparations)],
        )

    return run


def test_run_without_stage_runs_each_test_once(run: Any) -> None:
    status, lines, calls = run()
    assert (status, lines[-1]) == (0, "passed: test --ros2")
    foreground = [line for line in calls if line not in (OLD_TESTS, "bare")]
    expected = ["install.py lint", SWI, "install.py docs", "install.py test", "install.py test --ros2"]
    assert foreground == expected
    assert calls.count(OLD_TESTS) == calls.count("bare") == 1


@pytest.mark.parametrize("failure", ["test", "test --ros2", "test --with-swi -n 0 test/prolog/swi"])
def test_last_line_is_summary_of_failed_run(run: Any, failure: str) -> None:
    status, lines, calls = run(failure=failure)
    assert (status, lines[-1]) == (1, "1 failed in 2.00s")
    assert "FAILED test/test_x.py::test_x" in lines[lines.index("== results") :]
    assert "install.py test" in calls


def test_ros2_is_left_out_on_other_system(run: Any) -> None:
    status, lines, calls = run(codename="focal")
    assert (status, lines[-1]) == (0, "passed: test")
    assert "install.py test --ros2" not in calls
    assert "NOT RUN: tests on ROS 2: they need Debian 12" in lines


def test_stages_run_parts(run: Any) -> None:
    status, lines, calls = run("fast", "ros", "ros2", "slow")
    assert (status, lines[-1]) == (0, "passed: test -m slow --ignore test/ros1")
    assert sorted(line for line in calls if line.startswith("install.py")) == [
        "install.py docs",
        "install.py lint",
        "install.py test --ros2",
        "install.py test --with-swi -n 0 test/prolog/swi",
        "install.py test --with-swi test/ros1",
        "install.py test -m not slow --ignore test/ros1",
        "install.py test -m slow --ignore test/ros1",
    ]


def test_nightly_stage_runs_nightly_tests(run: Any) -> None:
    assert run("nightly")[2] == [
        "python3.8 install.py docs",
        "install.py test -m nightly",
        "install.py test --ros2 -m nightly",
        "install.py test --ros2=kilted",
        "bare --ros2",
    ]


def test_unknown_stage_is_refused(run: Any) -> None:
    message = ".ci/run: unknown stage 'quick': expected fast, ros, ros2, slow or nightly"
    assert run("fast", "quick") == (2, [message], [])
