"""Tasks on the workers of a Dask cluster, and the options of commands that use one.

`run_on_cluster` assigns each task to one free worker, so that it knows which task a lost worker was running: the task
is then given to another worker, up to `MAX_WORKER_DEATHS` times. Once a second it lists the workers of the scheduler.
New workers are used if they have the same versions of retalis and Python as this process. Each wait has a time limit,
because neither the scheduler nor a worker can be relied on to answer.
"""

import argparse
import logging
import platform
import sys
import threading
import time
import warnings
from collections import Counter, deque
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Generic,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import UsageError, install_hint
from ..foundation.interrupts import interruptible
from ..playback.decompression import describe_error
from ..playback.worker_pools import MAX_WORKER_DEATHS, Function, Result, Task, TaskResults, Unfinished
from .command_line import version
from .option_values import positive_seconds
from .progress_bar import ProgressBar

WORKER_TIMEOUT_SECONDS = 300.0
"""Default of ``--worker-timeout``."""

_CONNECT_TIMEOUT_SECONDS = 10.0
"""Time limit for connecting to a scheduler."""

_CONNECT_MARGIN_SECONDS = 2.0
"""Time for Dask to end after its own time limit."""

_ANSWER_TIMEOUT_SECONDS = 60.0
"""Time limit for an answer of a scheduler or a worker; a scheduler of many workers can be busy for some seconds."""

_POLL_SECONDS = 1.0
"""Time between two lists of the workers."""

_MAX_LISTED_WORKERS = 5
"""Maximum number of workers that an error names."""


_OLDEST_VERSION = [2022, 4]
"""Oldest version of distributed that is supported: year and month."""


class ClusterError(UsageError):
    """A cluster that cannot be used, or is lost: no further task can be run."""


class ClusterOptions(NamedTuple):
    """Options of a cluster.

    Attributes:
        address: address of the scheduler, ``tcp://HOST:PORT``.
        worker_timeout: time in seconds to wait while there is no worker.
        any_version: whether workers with other versions of retalis or Python are used.
    """

    address: str
    worker_timeout: float = WORKER_TIMEOUT_SECONDS
    any_version: bool = False


class ClusterCounts(NamedTuple):
    """Number of workers that are used, of workers that were lost, and of tasks that were repeated."""

    workers: int = 0
    lost: int = 0
    repeated: int = 0

    def describe(self, verb: str) -> str:
        """Return the counts as text; ``verb`` is the past participle of what is done with bags."""
        text = format_count(self.workers, "worker")
        if self.lost:
            text += f", {self.lost} lost"
        if self.repeated:
            text += f", {format_count(self.repeated, 'bag')} {verb} again"
        return text


class ClusterListener(NamedTuple):
    """Callbacks of a run on a cluster.

    Attributes:
        report: receives a line about the cluster.
        on_worker_death: receives the index of each task that is repeated, and a description of its worker's death.
        on_poll: receives the counts about once a second.
    """

    report: Callable[[str], object]
    on_worker_death: Callable[[int, str], object]
    on_poll: Callable[[ClusterCounts], object]


def make_listener(
    bar: ProgressBar, location_of: Callable[[int], str], verb: str, finished_count: Callable[[], int]
) -> ClusterListener:
    """Return callbacks that print to standard error, and show the counts in a progress bar.

    Args:
        bar: the progress bar of the run.
        location_of: returns the bag of the task with an index.
        verb: past participle of what is done with bags.
        finished_count: returns the number of tasks that have finished.
    """

    def report(line: str) -> None:
        bar.clear()
        print(line, file=sys.stderr, flush=True)

    def warn_worker_death(number: int, description: str) -> None:
        report(f"warning: {location_of(number)}: its worker died {description}; it is {verb} again")

    def show_counts(counts: ClusterCounts) -> None:
        bar.state = counts.describe(verb)
        bar(finished_count())

    return ClusterListener(report, warn_worker_death, show_counts)


def add_cluster_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a Dask cluster."""
    add = parser.add_argument_group("dask cluster").add_argument
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="use the workers of this scheduler, tcp://HOST:8786; they see the programs, bags and results under the "
        "same paths",
    )
    add(
        "--worker-timeout",
        type=positive_seconds,
        default=WORKER_TIMEOUT_SECONDS,
        metavar="SECONDS",
        help=f"end if there is no worker for this long ({WORKER_TIMEOUT_SECONDS:g})",
    )
    add("--any-version", action="store_true", help="use workers with other versions of retalis or Python")


def cluster_options(options: argparse.Namespace) -> ClusterOptions:
    """Return the values of the options of a cluster."""
    return ClusterOptions(options.scheduler, options.worker_timeout, options.any_version)


def run_on_cluster(
    function: "Function[Task, Result]",
    tasks: Sequence[Task],
    options: ClusterOptions,
    listener: ClusterListener,
    ready: Optional[Deque[int]] = None,
) -> "TaskResults[Result]":
    """Run tasks on the workers of a Dask cluster on which this package is installed, one task per worker at a time.

    Args:
        function: performs a task.
        tasks: the tasks.
        options: the cluster.
        listener: callbacks.
        ready: as for `run_in_processes`.

    Raises:
        ClusterError: if no scheduler answers, it is lost, a worker has another version, or there is no worker.
        UsageError: if the Python package distributed is not installed.
    """
    distributed = _import_distributed()
    pending = deque(range(len(tasks))) if ready is None else ready
    with _silent_loggers(), _connect(distributed, options.address) as client:
        yield from _ClusterRun(client, function, tasks, pending, options, listener).results()


def _import_distributed() -> Any:
    try:
        import distributed  # noqa: PLC0415 - an optional package
    except ImportError:
        raise UsageError(
            "--scheduler needs the Python package distributed "
            f"({install_hint('distributed', 'python3-distributed')})"
        ) from None
    found = str(getattr(distributed, "__version__", ""))
    parts = [int(part) for part in found.split(".")[:2] if part.isdecimal()]
    # Schedulers of older versions do not start with the present version of click, or never answer.
    if parts and parts < _OLDEST_VERSION:
        oldest = ".".join(map(str, _OLDEST_VERSION))
        raise UsageError(
            f"--scheduler needs version {oldest} or later of the Python package distributed, found {found} "
            "(pip install --upgrade distributed)"
        )
    return distributed


_FOREIGN_LOGGERS = ("distributed", "tornado", "asyncio")


@contextmanager
def _silent_loggers() -> Iterator[None]:
    """Switch off the loggers of Dask and its libraries: the run reports what concerns the user in one line."""
    # Loggers that are created meanwhile pass their records to the handlers of these.
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _FOREIGN_LOGGERS]
    loggers = [logging.getLogger(name) for name in {*names, *_FOREIGN_LOGGERS}]
    states = [(logger, logger.disabled, logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.disabled, logger.handlers, logger.propagate = True, [logging.NullHandler()], False
    try:
        yield
    finally:
        for logger, disabled, handlers, propagate in states:
            logger.disabled, logger.handlers, logger.propagate = disabled, handlers, propagate


def _call(seconds: float, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Call a function of Dask, and wait for its result up to a number of seconds.

    The time limits of Dask itself do not cover a peer that accepts a connection and never answers.

    Raises:
        TimeoutError: if it takes longer; its thread then ends with the process.
        Exception: the exception of the function.
    """
    results: SimpleQueue[Tuple[Any, Optional[Exception]]] = SimpleQueue()

    def call() -> None:
        try:
            results.put((function(*arguments, **options), None))
        except Exception as error:
            results.put((None, error))

    threading.Thread(target=call, name="Dask-Call", daemon=True).start()
    try:
        with interruptible():
            result, error = results.get(timeout=seconds)
    except Empty:
        raise TimeoutError(f"no answer within {seconds:g} s") from None
    if error is not None:
        raise error
    return result


@contextmanager
def _connect(distributed: Any, address: str) -> Iterator[Any]:
    """Provide a client of a scheduler.

    Raises:
        ClusterError: if no scheduler answers.
    """
    timeout = _CONNECT_TIMEOUT_SECONDS
    try:
        with warnings.catch_warnings():
            # A table of all packages; the versions that matter are compared by this module.
            warnings.simplefilter("ignore")
            client = _call(
                timeout + _CONNECT_MARGIN_SECONDS,
                distributed.Client,
                address,
                timeout=timeout,
                set_as_default=False,
            )
    # Whatever else listens at the port causes any exception.
    except Exception as error:
        reason = printable(describe_error(error))
        raise ClusterError(f"--scheduler {address}: no scheduler answers: {reason}") from error
    try:
        yield client
    finally:
        try:
            _call(_CONNECT_TIMEOUT_SECONDS, client.close, timeout=_CONNECT_TIMEOUT_SECONDS / 2)
        except Exception:  # noqa: S110 - the connection is lost, which has been reported
            pass


class _WorkerVersions(NamedTuple):
    """Versions of a worker: that of retalis, None if it cannot be imported, and major and minor one of Python."""

    retalis: Optional[str]
    python: str

    def __str__(self) -> str:
        package = "no retalis" if self.retalis is None else f"retalis {self.retalis}"
        return printable(f"{package}, Python {self.python}")


def _minor_version(python_version: str) -> str:
    return ".".join(python_version.split(".")[:2])


class _Submitted(NamedTuple):
    task_index: int
    worker: str
    future: Any


class _ClusterRun(Generic[Task, Result]):
    """A run of tasks on the workers of a cluster."""

    def __init__(
        self,
        client: Any,
        function: "Function[Task, Result]",
        tasks: Sequence[Task],
        pending: Deque[int],
        options: ClusterOptions,
        listener: ClusterListener,
    ):
        self._client = client
        self._function = function
        self._tasks = tasks
        self._pending = pending
        self._options = options
        self._listener = listener
        self._counts = ClusterCounts()
        self._own_versions = _WorkerVersions(version(), _minor_version(platform.python_version()))
        self._workers: Dict[str, _WorkerVersions] = {}
        self._rejected: Set[str] = set()
        self._has_started = False
        # Time since which there is no worker, on the monotonic clock in seconds; None while there are workers.
        self._idle_since: Optional[float] = None
        self._submitted: Dict[str, _Submitted] = {}
        self._done: SimpleQueue[Any] = SimpleQueue()
        self._deaths: Dict[int, int] = Counter()
        # Results of tasks that are given up.
        self._given_up: List[Tuple[int, Unfinished]] = []

    def results(self) -> "TaskResults[Result]":
        """Yield the index and the result of each task in the order of completion.

        Raises:
            ClusterError: see `run_on_cluster`.
        """
        next_poll = time.monotonic()
        while self._pending or self._submitted:
            if time.monotonic() >= next_poll:
                self._update_workers()
                self._listener.on_poll(self._counts)
                next_poll = time.monotonic() + _POLL_SECONDS
            self._submit()
            try:
                with interruptible():
                    future = self._done.get(timeout=max(0.0, next_poll - time.monotonic()))
            except Empty:
                pass
            else:
                submitted = self._submitted.get(future.key)
                # Otherwise the task has been repeated, because its worker was lost.
                if submitted is not None:
                    yield from self._take_result(future.key, submitted)
            while self._given_up:
                yield self._given_up.pop()

    def _submit(self) -> None:
        """Give pending tasks to free workers."""
        if not self._pending:
            return
        busy = {submitted.worker for submitted in self._submitted.values()}
        for worker in [address for address in self._workers if address not in busy]:
            if not self._pending:
                break
            index = self._pending.popleft()
            future = self._client.submit(
                _run_on_worker,
                self._function,
                self._tasks[index],
                pure=False,
                workers=[worker],
                allow_other_workers=False,
            )
            self._submitted[future.key] = _Submitted(index, worker, future)
            future.add_done_callback(self._done.put)

    def _take_result(self, key: str, submitted: _Submitted) -> "TaskResults[Result]":
        """Yield the result of a future that is done, unless its worker was lost."""
        try:
            result = _call(_ANSWER_TIMEOUT_SECONDS, submitted.future.result)
        except Exception as error:
            # Names instead of types, because distributed may be a package of any version.
            name = type(error).__name__
            if "Cancelled" in name:
                # All tasks are cancelled if the connection to the scheduler breaks.
                raise self._lost("the connection is closed") from None
            if name in ("KilledWorker", "TimeoutError"):
                self._repeat(key)
                return
            result = Unfinished(f"{name}: {describe_error(error)}")
        del self._submitted[key]
        # A future that is not released would be computed again if its worker dies later.
        submitted.future.release()
        yield submitted.task_index, result

    def _repeat(self, key: str) -> None:
        """Put the task of a lost worker back, or give it up."""
        index, worker, future = self._submitted.pop(key)
        future.release()
        self._deaths[index] += 1
        death = f"at {worker}"
        if self._deaths[index] >= MAX_WORKER_DEATHS:
            reason = f"its worker died {MAX_WORKER_DEATHS} times, at last {death}"
            self._given_up.append((index, Unfinished(reason)))
            return
        # First in the queue, so that a deadly task is given up before it delays the end of the run.
        self._pending.appendleft(index)
        self._counts = self._counts._replace(repeated=self._counts.repeated + 1)
        self._listener.on_worker_death(index, death)

    def _lost(self, reason: str) -> ClusterError:
        return ClusterError(
            f"--scheduler {self._options.address}: the scheduler is lost: {printable(reason)}"
        )

    def _update_workers(self) -> None:
        """Compare the workers of the scheduler with the known ones.

        Raises:
            ClusterError: see `run_on_cluster`.
        """
        # The client reconnects by itself, but has then cancelled all tasks.
        if self._client.status != "running":
            raise self._lost("the connection is closed")
        try:
            addresses = set(_call(_ANSWER_TIMEOUT_SECONDS, self._client.nthreads))
        except Exception as error:
            raise self._lost(describe_error(error)) from None
        self._rejected &= addresses
        lost = self._workers.keys() - addresses
        for address in lost:
            del self._workers[address]
        self._counts = self._counts._replace(lost=self._counts.lost + len(lost))
        for key in [key for key, submitted in self._submitted.items() if submitted.worker in lost]:
            self._repeat(key)
        new_addresses = addresses - self._workers.keys() - self._rejected
        if new_addresses:
            self._check_workers(self._read_versions(sorted(new_addresses)))
        self._counts = self._counts._replace(workers=len(self._workers))
        self._check_presence()

    def _read_versions(self, addresses: List[str]) -> Dict[str, _WorkerVersions]:
        """Return the versions of workers; those that do not answer are left out, and asked again."""

        def run(function: Callable[[], str]) -> Dict[str, Any]:
            # Both functions are found by their names on a worker with any version of this package, or without it.
            results = _call(
                _ANSWER_TIMEOUT_SECONDS, self._client.run, function, workers=addresses, on_error="return"
            )
            return {address: result for address, result in results.items() if not isinstance(result, OSError)}

        try:
            python_versions, package_versions = run(platform.python_version), run(version)
        except Exception as error:
            self._rejected.update(addresses)
            self._warn(f"{_list_names(addresses)} not used: {describe_error(error)}")
            return {}
        versions = {}
        for address in addresses:
            if address not in python_versions or address not in package_versions:
                continue
            package = package_versions[address]
            versions[address] = _WorkerVersions(
                None if isinstance(package, Exception) else str(package),
                _minor_version(str(python_versions[address])),
            )
        return versions

    def _check_workers(self, versions: Dict[str, _WorkerVersions]) -> None:
        """Use new workers whose versions are allowed.

        Raises:
            ClusterError: if a worker has another version, and no task has been submitted.
        """
        mismatches = {
            address: worker_versions
            for address, worker_versions in sorted(versions.items())
            if worker_versions.retalis is None
            or (worker_versions != self._own_versions and not self._options.any_version)
        }
        accepted = {address: versions[address] for address in versions if address not in mismatches}
        if mismatches:
            description = _list_names([f"{address} has {mismatches[address]}" for address in mismatches])
            if not (self._has_started or self._options.any_version):
                raise ClusterError(
                    f"--scheduler {self._options.address}: {description}: expected {self._own_versions}, as here; "
                    "--any-version uses other versions"
                )
            self._rejected.update(mismatches)
            self._warn(f"{description}: not used")
        self._workers.update(accepted)
        if accepted and not self._has_started:
            self._has_started = True
            groups = Counter(map(str, self._workers.values()))
            texts = [f"{format_count(count, 'worker')} with {text}" for text, count in sorted(groups.items())]
            self._listener.report(f"{self._options.address}: {'; '.join(texts)}")

    def _check_presence(self) -> None:
        """Report that there is no worker.

        Raises:
            ClusterError: if there has been none for too long.
        """
        if self._workers:
            self._idle_since = None
            return
        timeout, now = self._options.worker_timeout, time.monotonic()
        if self._idle_since is None:
            self._idle_since = now
            self._listener.report(f"{self._options.address}: waiting for workers, up to {timeout:g} s")
        elif now - self._idle_since >= timeout:
            raise ClusterError(
                f"--scheduler {self._options.address}: no worker with retalis for {timeout:g} s: start workers with "
                f"'dask worker {self._options.address}', or give a longer --worker-timeout"
            )

    def _warn(self, text: str) -> None:
        self._listener.report(f"warning: {text}")


def _list_names(names: Sequence[str]) -> str:
    """Return names in one line, at most `_MAX_LISTED_WORKERS`."""
    omitted = len(names) - _MAX_LISTED_WORKERS
    return ", ".join(names[:_MAX_LISTED_WORKERS]) + (f" and {omitted} more" if omitted > 0 else "")


def _run_on_worker(function: "Function[Task, Result]", task: Task) -> Result:
    """Run a task in a process of a Dask worker, in the worker's temporary folder."""
    return function(task, _import_distributed().get_worker().local_directory)
