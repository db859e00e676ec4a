"""Tasks in other processes: all are done, and a worker that dies costs none of them."""

import os
import subprocess
import sys

import pytest
from python_path import python_path
from source import ROOT
from worker_tasks import run_task, run_task_in_folder

from retalis import UsageError
from retalis.playback.process_and_dask_pool import (
    MAX_WORKER_DEATHS,
    Unfinished,
    run_in_processes,
    run_on_cluster,
)

pytestmark = pytest.mark.slow


def test_tasks_are_shared_between_processes_that_end_with_them(tmp_path):
    done = dict(run_in_processes(run_task, ["pid"] * 6, 2, str(tmp_path), pytest.fail))
    assert sorted(done) == list(range(6))
    assert os.getpid() not in done.values()
    assert len(set(done.values())) <= 2
    for process in set(done.values()):
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_what_a_dead_worker_was_at_is_done_again_and_given_up_in_the_end(tmp_path):
    lost = []
    tasks = ["pid", "die always", "once a", "pid"]
    done = dict(
        run_in_processes(run_task, tasks, 2, str(tmp_path), lambda number, how: lost.append((number, how)))
    )
    assert done[1] == Unfinished(f"its worker died {MAX_WORKER_DEATHS} times, at last by SIGKILL")
    assert done[2] == "once a"
    assert isinstance(done[0], int) and isinstance(done[3], int)
    assert sorted(lost) == [(1, "by SIGKILL")] * (MAX_WORKER_DEATHS - 1) + [(2, "by SIGKILL")]


def test_workers_end_where_nobody_waits_for_them_any_more():
    """Their standard output is that of the process that is killed: it ends when the last of them has."""
    script = (
        "import os, signal\n"
        "from worker_tasks import run_task\n"
        "from retalis.playback.process_and_dask_pool import run_in_processes\n"
        "if __name__ == '__main__':\n"
        "    for number, process in run_in_processes(run_task, ['pid'] * 2, 1, '', print):\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": python_path(ROOT / "test")}
    ran = subprocess.run([sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE, timeout=60)
    assert ran.returncode == -9


@pytest.fixture(scope="module")
def distributed():
    """Return the package, whose import sets the levels of loggers."""
    return pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster(distributed):
    options = {"dashboard_address": None, "scheduler_kwargs": {"allowed_failures": 1}}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, **options) as one:
        yield one.scheduler_address


def test_a_cluster_does_again_what_a_lost_worker_was_at(cluster, tmp_path):
    done = dict(
        run_on_cluster(
            run_task_in_folder, [f"{task} in {tmp_path}" for task in ("once a", "pid", "die b")], cluster
        )
    )
    assert done[0] == "once a"
    assert isinstance(done[1], int)
    assert isinstance(done[2], Unfinished)
    assert done[2].reason.startswith("KilledWorker: ")


def test_a_scheduler_that_does_not_answer_is_an_error(monkeypatch, distributed):
    monkeypatch.setattr("retalis.playback.process_and_dask_pool._CONNECT_TIMEOUT_SECONDS", 0.2)
    with pytest.raises(UsageError, match="--scheduler tcp://127.0.0.1:1: no scheduler answers: "):
        list(run_on_cluster(run_task, ["pid"], "tcp://127.0.0.1:1"))
    with pytest.raises(UsageError, match="--scheduler nonsense://: no scheduler answers: "):
        list(run_on_cluster(run_task, ["pid"], "nonsense://"))


def test_the_package_for_clusters_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs the Python package distributed"):
        list(run_on_cluster(run_task, ["pid"], "tcp://127.0.0.1:1"))
