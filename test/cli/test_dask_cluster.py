"""Tasks on a Dask cluster: workers and their versions, lost workers, lost schedulers, and time limits."""

import logging
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable, Dict, Iterator, List, Tuple

import pytest
from parsed_sources import ROOT
from subprocess_python_path import python_path
from worker_tasks import run_task_in_folder

from retalis import UsageError
from retalis.cli import dask_cluster
from retalis.cli.command_line import version
from retalis.cli.dask_cluster import (
    ClusterCounts,
    ClusterError,
    ClusterListener,
    ClusterOptions,
    run_on_cluster,
)
from retalis.playback.worker_pools import MAX_WORKER_DEATHS, Unfinished

ADDRESS = "tcp://here:8786"
PYTHON = ".".join(platform.python_version_tuple()[:2])


class KilledWorker(Exception):
    """The exception of distributed for a task whose worker died."""


class Future:
    """Future of a task that has been run, or whose worker died."""

    def __init__(self, key: str, compute: Callable[[], Any]):
        self.key = key
        self._compute = compute

    def result(self) -> Any:
        return self._compute()

    def add_done_callback(self, callback: Callable[[Any], object]) -> None:
        callback(self)

    def release(self) -> None:
        pass


class Client:
    """Client of a cluster whose workers have the given versions of retalis; None for none.

    Attributes:
        workers: versions by address.
        assigned: worker of each task that was submitted.
    """

    def __init__(self, **workers: Any):
        self.workers: Dict[str, Any] = dict(workers)
        self.assigned: List[Tuple[Any, str]] = []
        self.status = "running"

    def nthreads(self) -> Any:
        return dict.fromkeys(self.workers, 1)

    def run(self, function: Any, workers: List[str], on_error: str) -> Any:
        if function is platform.python_version:
            return dict.fromkeys(workers, platform.python_version())
        return {name: self.workers[name] or ModuleNotFoundError("retalis") for name in workers}

    def submit(self, run: Any, function: Any, task: Any, workers: List[str], **options: Any) -> Future:
        self.assigned.append((task, workers[0]))
        return Future(f"key {len(self.assigned)}", lambda: run(function, task))

    def close(self, timeout: float) -> None:
        pass


@pytest.fixture
def lines() -> List[Any]:
    """Return what the listener receives."""
    return []


@pytest.fixture
def listener(lines: List[Any]) -> ClusterListener:
    return ClusterListener(lines.append, lambda *death: lines.append(death), lambda counts: None)


@pytest.fixture(autouse=True)
def use_short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "_POLL_SECONDS", 0.01)


def connect(monkeypatch: pytest.MonkeyPatch, client: Callable[..., Any]) -> None:
    """Use a client in place of the one of Dask."""
    worker = SimpleNamespace(local_directory="scratch")
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=client, get_worker=lambda: worker))


def join(task: Any, scratch: str) -> str:
    if task == "die":
        raise KilledWorker
    return f"{task} in {scratch}"


def test_each_worker_has_one_task_at_a_time(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    client = Client(one=version(), two=version())
    connect(monkeypatch, lambda *arguments, **options: client)
    results = dict(run_on_cluster(join, ["a", "b", "c"], ClusterOptions(ADDRESS), listener))
    assert results == {0: "a in scratch", 1: "b in scratch", 2: "c in scratch"}
    assert client.assigned[:2] == [("a", "one"), ("b", "two")]
    assert lines == [f"{ADDRESS}: 2 workers with retalis {version()}, Python {PYTHON}"]


def test_task_that_kills_its_workers_is_given_up(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    connect(monkeypatch, lambda *arguments, **options: Client(one=version()))
    results = dict(run_on_cluster(join, ["die", "a"], ClusterOptions(ADDRESS), listener))
    assert results[0] == Unfinished(f"its worker died {MAX_WORKER_DEATHS} times, at last at one")
    assert results[1] == "a in scratch"
    assert lines[1:] == [(0, "at one")] * (MAX_WORKER_DEATHS - 1)


def test_task_of_lost_worker_is_repeated(monkeypatch: pytest.MonkeyPatch, lines: List[Any]) -> None:
    client = Client(one=version())
    counts: List[ClusterCounts] = []

    class PendingFuture(Future):
        """The future of a task on a lost worker, which is never done."""

        def add_done_callback(self, callback: Callable[[Any], object]) -> None:
            client.workers = {"two": version()}

    submit: Any = client.submit

    def submit_to_dying_worker(*arguments: Any, workers: List[str], **options: Any) -> Future:
        future: Future = submit(*arguments, workers=workers, **options)
        return PendingFuture(future.key, future.result) if workers == ["one"] else future

    monkeypatch.setattr(client, "submit", submit_to_dying_worker)
    connect(monkeypatch, lambda *arguments, **options: client)
    listener = ClusterListener(lines.append, lambda *death: lines.append(death), counts.append)
    assert dict(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener)) == {0: "a in scratch"}
    assert client.assigned == [("a", "one"), ("a", "two")]
    assert lines[1:] == [(0, "at one")]
    assert counts[-1] == ClusterCounts(workers=1, lost=1, repeated=1)
    assert counts[-1].describe("played") == "1 worker, 1 lost, 1 bag played again"


@pytest.mark.parametrize(("package", "text"), [("0.1", "retalis 0.1"), (None, "no retalis")])
def test_worker_with_other_version_is_refused(
    monkeypatch: pytest.MonkeyPatch, listener: ClusterListener, package: Any, text: str
) -> None:
    client = Client(one=version(), two=package)
    connect(monkeypatch, lambda *arguments, **options: client)
    own_versions = f"retalis {version()}, Python {PYTHON}"
    expected = f"--scheduler {ADDRESS}: two has {text}, Python {PYTHON}: expected {own_versions}"
    with pytest.raises(ClusterError, match=expected):
        list(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener))
    assert client.assigned == []


def test_any_version_uses_workers_with_package(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    client = Client(one="0.1", two=None)
    connect(monkeypatch, lambda *arguments, **options: client)
    options = ClusterOptions(ADDRESS, any_version=True)
    assert len(list(run_on_cluster(join, ["a", "b"], options, listener))) == 2
    assert {worker for _, worker in client.assigned} == {"one"}
    assert lines == [
        f"warning: two has no retalis, Python {PYTHON}: not used",
        f"{ADDRESS}: 1 worker with retalis 0.1, Python {PYTHON}",
    ]


def test_later_worker_with_other_version_is_not_used(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    client = Client(one=version())
    connect(monkeypatch, lambda *arguments, **options: client)
    outcomes = run_on_cluster(join, ["a", "b", "c"], ClusterOptions(ADDRESS), listener)
    next(outcomes)
    client.workers["two"] = "0.1"
    time.sleep(0.02)  # the poll interval
    assert len(list(outcomes)) == 2
    assert {worker for _, worker in client.assigned} == {"one"}
    assert lines[1:] == [f"warning: two has retalis 0.1, Python {PYTHON}: not used"]


def test_missing_workers_are_an_error_after_timeout(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    connect(monkeypatch, lambda *arguments, **options: Client())
    with pytest.raises(ClusterError, match=f"--scheduler {ADDRESS}: no worker with retalis for 0.05 s: "):
        list(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS, worker_timeout=0.05), listener))
    assert lines == [f"{ADDRESS}: waiting for workers, up to 0.05 s"]


def test_peer_that_never_answers_is_an_error(
    monkeypatch: pytest.MonkeyPatch, listener: ClusterListener
) -> None:
    monkeypatch.setattr(dask_cluster, "_CONNECT_TIMEOUT_SECONDS", 0.01)
    monkeypatch.setattr(dask_cluster, "_CONNECT_MARGIN_SECONDS", 0.01)
    is_over = threading.Event()
    connect(monkeypatch, lambda *arguments, **options: is_over.wait())
    with pytest.raises(ClusterError, match=f"--scheduler {ADDRESS}: no scheduler answers: no answer within "):
        list(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener))
    is_over.set()


def test_closed_connection_is_an_error(
    monkeypatch: pytest.MonkeyPatch, lines: List[Any], listener: ClusterListener
) -> None:
    client = Client(one=version())
    connect(monkeypatch, lambda *arguments, **options: client)
    outcomes = run_on_cluster(join, ["a", "b", "c"], ClusterOptions(ADDRESS), listener)
    assert next(outcomes) == (0, "a in scratch")
    client.status = "connecting"
    time.sleep(0.02)  # the poll interval
    with pytest.raises(ClusterError, match="the scheduler is lost: the connection is closed"):
        list(outcomes)


def test_loggers_of_dask_are_silent_during_run(
    monkeypatch: pytest.MonkeyPatch, listener: ClusterListener, caplog: pytest.LogCaptureFixture
) -> None:
    connect(monkeypatch, lambda *arguments, **options: Client(one=version()))
    outcomes = run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener)
    next(outcomes)
    for name in ("tornado", "asyncio", "tornado.new"):
        logging.getLogger(name).error("a foreign traceback")
    assert caplog.records == []
    assert list(outcomes) == []
    logging.getLogger("asyncio").error("after the run")
    assert [record.message for record in caplog.records] == ["after the run"]


@pytest.mark.parametrize("version", ["2.8.1", "2022.03.0"])
def test_old_distributed_is_refused(
    monkeypatch: pytest.MonkeyPatch, listener: ClusterListener, version: str
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(__version__=version))
    with pytest.raises(UsageError, match=f"needs version 2022.4 or later of .* distributed, found {version}"):
        list(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener))


def test_missing_distributed_is_named(monkeypatch: pytest.MonkeyPatch, listener: ClusterListener) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs the Python package distributed"):
        list(run_on_cluster(join, ["a"], ClusterOptions(ADDRESS), listener))


def find_free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port: int = server.getsockname()[1]
        return port


@pytest.fixture(scope="module")
def distributed() -> Any:
    """Return the package, imported before the state of loggers is compared: its import sets their levels."""
    return pytest.importorskip("distributed")


@pytest.fixture
def cluster(distributed: Any, tmp_path: Path) -> Iterator[Tuple[str, "subprocess.Popen[bytes]"]]:
    """Return the address of a scheduler with a worker, and its process."""
    address = f"tcp://127.0.0.1:{find_free_port()}"
    environment = {**os.environ, "PYTHONPATH": python_path(ROOT / "test")}
    scheduler, worker = (
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{name}", *options, "--host", "127.0.0.1"],
            cwd=tmp_path,
            env=environment,
            stderr=subprocess.DEVNULL,
        )
        for name, options in (
            ("scheduler", ["--port", address.rpartition(":")[2], "--no-dashboard"]),
            ("worker", [address, "--nthreads", "1", "--no-dashboard"]),
        )
    )
    yield address, scheduler
    for process in (worker, scheduler):
        process.send_signal(signal.SIGTERM)
    for process in (worker, scheduler):
        process.wait()


@pytest.mark.slow
def test_lost_worker_and_lost_scheduler_are_reported(
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    lines: List[Any],
    listener: ClusterListener,
    cluster: Any,
) -> None:
    """The task kills its worker, which Dask replaces; then the scheduler is killed."""
    address, scheduler = cluster
    outcomes = run_on_cluster(
        run_task_in_folder,
        [f"{task} in {tmp_path}" for task in ("once a", "pid")],
        ClusterOptions(address, worker_timeout=60),
        listener,
    )
    assert next(outcomes) == (0, "once a")
    assert [line[0] for line in lines if isinstance(line, tuple)] == [0]
    scheduler.kill()
    scheduler.wait()
    with pytest.raises(ClusterError, match="the scheduler is lost"):
        list(outcomes)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_silent_listener_is_no_scheduler(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    listener: ClusterListener,
    distributed: Any,
) -> None:
    monkeypatch.setattr(dask_cluster, "_CONNECT_TIMEOUT_SECONDS", 0.5)
    monkeypatch.setattr(dask_cluster, "_CONNECT_MARGIN_SECONDS", 0.1)
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ClusterError, match="no scheduler answers"):
            list(run_on_cluster(join, ["a"], ClusterOptions(address), listener))
    with pytest.raises(ClusterError, match="--scheduler nonsense://: no scheduler answers: "):
        list(run_on_cluster(join, ["a"], ClusterOptions("nonsense://"), listener))
    assert capfd.readouterr().err == ""
