"""Garbage collection in processes of its own: it depends on all objects of a process."""

import os
import re
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


def run_script(script: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": python_path()},
    )


def test_collection_at_recursion_limit_is_silent() -> None:
    script = """
import json
from retalis import Engine, limit_gc_pauses
from retalis.foundation.garbage_collection import YoungCollector

def attempt(work, *arguments):
    try:
        work(*arguments)
    except Exception as error:
        print(error)

engine = Engine()
YoungCollector.YOUNG_THRESHOLD = 1  # each allocation begins a collection
limit_gc_pauses()
attempt(json.loads, "[" * 3000)
attempt(engine.load, "a <- " + " and ".join(["b"] * 1500) + ".")
attempt(engine.call, r"length(L, 3000), foldl([_,G,(\\+ G)]>>true, L, true, Goal), call(Goal)")
"""
    process = run_script(script)
    assert (process.returncode, process.stderr) == (0, "")
    assert re.search("recursion depth.*nested too deeply.*term_size", process.stdout, re.DOTALL), (
        process.stdout
    )


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
    process = run_script(script)
    assert process.stdout == "0 False\n", process.stderr
