"""Tasks in worker processes: distribution and dead workers."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import fail
from parsed_sources import ROOT
from subprocess_python_path import python_path
from worker_tasks import run_task

from retalis.playback.worker_pools import (
    MAX_WORKER_DEATHS,
    Unfinished,
    run_in_processes,
)

pytestmark = pytest.mark.slow


def test_tasks_are_divided_among_processes(tmp_path: Path) -> None:
    results = dict(
        run_in_processes(run_task, ["pid"] * 6, 2, str(tmp_path), lambda number, reason: fail(reason))
    )
    assert sorted(results) == list(range(6))
    assert os.getpid() not in results.values()
    assert len(set(results.values())) <= 2
    for process in set(results.values()):
        assert isinstance(process, int)
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_task_of_dead_worker_is_retried_up_to_limit(tmp_path: Path) -> None:
    deaths: List[Any] = []
    tasks = ["pid", "die always", "once a", "pid"]
    results = dict(
        run_in_processes(
            run_task, tasks, 2, str(tmp_path), lambda number, cause: deaths.append((number, cause))
        )
    )
    assert results[1] == Unfinished(f"its worker died {MAX_WORKER_DEATHS} times, at last by SIGKILL")
    assert results[2] == "once a"
    assert isinstance(results[0], int)
    assert isinstance(results[3], int)
    assert sorted(deaths) == [(1, "by SIGKILL")] * (MAX_WORKER_DEATHS - 1) + [(2, "by SIGKILL")]


def test_long_task_is_polled(tmp_path: Path) -> None:
    results = run_in_processes(
        run_task,
        ["wait poll"],
        1,
        str(tmp_path),
        lambda number, reason: fail(reason),
        on_poll=lambda: (tmp_path / "poll").touch(),
    )
    assert list(results) == [(0, "poll")]


def test_workers_end_with_killed_parent() -> None:
    """Workers inherit the standard output of the killed process: it is at its end if no worker is left."""
    script = (
        "import os, signal\n"
        "from worker_tasks import run_task\n"
        "from retalis.playback.worker_pools import run_in_processes\n"
        "if __name__ == '__main__':\n"
        "    for number, process in run_in_processes(run_task, ['pid'] * 2, 1, '', print):\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": python_path(ROOT / "test")}
    process = subprocess.run(
        [sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE, timeout=60
    )
    assert process.returncode == -9
