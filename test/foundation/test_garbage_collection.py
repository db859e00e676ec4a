"""Garbage collection in processes of its own: it depends on all objects of a process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from subprocess_python_path import python_path


@pytest.mark.slow
def test_collector_checks_pass_in_own_process() -> None:
    checks = Path(__file__).with_name("garbage_collection_checks.py")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", str(checks)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=checks.parents[2],
    )
    assert run.returncode == 0, run.stdout


def test_stopped_collector_stays_idle_at_exit() -> None:
    script = """
import gc
from retalis.foundation.garbage_collection import stop_collecting
cycle = []
cycle.append(cycle)
del cycle
stop_collecting()
print(gc.collect(), gc.isenabled())
"""
    process = subprocess.run(
        [sys.executable, "-c", script],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": python_path()},
    )
    assert process.stdout == "0 False\n"
