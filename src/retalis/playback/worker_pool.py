"""Tasks shared between processes of this machine, or between the workers of a Dask cluster.

A worker may die: what it was at is done again by another one, up to `MAX_WORKER_DEATHS` deaths, and then given up.
"""

import multiprocessing
import signal
from collections import Counter, deque
from multiprocessing.connection import Connection, wait
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Generator,
    Generic,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

from ..foundation.errors import UsageError
from .decompression import reason

MAX_WORKER_DEATHS = 4
"""Workers that a task may take with it; of a cluster its scheduler says it, by default the same."""

_CONNECT = 10
"""Seconds that a scheduler has to answer."""

T = TypeVar("T")
R = TypeVar("R")

Function = Callable[[T, str], R]
"""Does a task, given a folder for what it needs meanwhile; raises nothing."""


class Unfinished(NamedTuple):
    """What there is of a task instead of a result: why it could not be done."""

    cause: str


Done = Generator[Tuple[int, Union[R, Unfinished]], None, None]
"""Yields the number of a task and its result, in whatever order they come; the workers end when it is closed."""


def in_processes(
    function: "Function[T, R]",
    tasks: Sequence[T],
    jobs: int,
    scratch: str,
    lost: Callable[[int, str], object],
    ready: Optional[Deque[int]] = None,
) -> "Done[R]":
    """Do tasks in processes of this machine; they end with the iterator.

    An executor of Python's own would give up all tasks where one of its processes dies, and not say whose it was.

    Args:
        function: does a task; imported by each process.
        tasks: what to do.
        jobs: how many at a time.
        scratch: a folder.
        lost: told the number of each task that is done again, and how its process ended.
        ready: the numbers of the tasks to do, by default all; who takes the results may add others meanwhile.
    """
    waiting = deque(range(len(tasks))) if ready is None else ready
    deaths: Dict[int, int] = Counter()
    idle: List[_Worker[T, R]] = []
    busy: Dict[object, _Worker[T, R]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < jobs:
                worker = idle.pop() if idle else _Worker(function, scratch)
                busy[worker.connection] = worker
                worker.begin(waiting.popleft(), tasks)
            for connection in wait([worker.connection for worker in busy.values()]):
                worker = busy.pop(connection)
                number, result = worker.number, worker.result()
                if not isinstance(result, _Death):
                    idle.append(worker)
                    yield number, result
                    continue
                deaths[number] += 1
                if deaths[number] < MAX_WORKER_DEATHS:
                    lost(number, result.how)
                    waiting.appendleft(number)
                else:
                    yield (
                        number,
                        Unfinished(f"its worker died {MAX_WORKER_DEATHS} times, at last {result.how}"),
                    )
    finally:
        for worker in (*idle, *busy.values()):
            worker.end()


class _Death(NamedTuple):
    how: str


class _Worker(Generic[T, R]):
    """A process that does one task at a time.

    Attributes:
        connection: has the result when it can be read.
        number: of the task that it is at.
    """

    def __init__(self, function: "Function[T, R]", scratch: str):
        context = multiprocessing.get_context("spawn")  # threads and locks of this process are not its
        self.connection, other = context.Pipe()
        self.number = -1
        self._process = context.Process(target=_serve, args=(function, other, scratch), daemon=True)
        self._process.start()
        other.close()

    def begin(self, number: int, tasks: Sequence[T]) -> None:
        """Send it a task."""
        self.number = number
        try:
            self.connection.send(tasks[number])
        except OSError:  # it has died: its result will say so
            pass

    def result(self) -> Union[R, _Death]:
        """Return what became of the task."""
        try:
            result: R = self.connection.recv()
            return result
        except (EOFError, OSError):
            self.connection.close()
            self._process.join()
            return _Death(_ended(self._process.exitcode))

    def end(self) -> None:
        """End it, whatever it is at."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _serve(function: "Function[T, R]", connection: Connection, scratch: str) -> None:
    """Do the tasks that come, until nobody is there any more to send one."""
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # ctrl-C is for the process that started this one, which ends it
    try:
        while True:
            connection.send(function(connection.recv(), scratch))
    except (EOFError, OSError):
        pass


def _ended(code: Optional[int]) -> str:
    if code is not None and code < 0:
        return f"by {signal.Signals(-code).name}"
    return f"with status {code}"


def on_cluster(
    function: "Function[T, R]", tasks: Sequence[T], address: str, ready: Optional[Deque[int]] = None
) -> "Done[R]":
    """Do tasks on the workers of a Dask cluster, which has to have this package.

    A task goes from a worker that is lost to another one; its scheduler gives one up after as many deaths as
    ``distributed.scheduler.allowed-failures`` says. There are never more tasks there than workers: to the scheduler
    a death is the fault of all that the worker has.

    Args:
        function: does a task.
        tasks: what to do.
        address: of the scheduler, ``tcp://HOST:PORT``.
        ready: as for `in_processes`.

    Raises:
        UsageError: where no scheduler answers there, or the Python package distributed is missing.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:  # also one of time
        raise UsageError(f"--scheduler {address}: no scheduler answers: {reason(error)}") from error
    with client:
        waiting = deque(range(len(tasks))) if ready is None else ready
        numbers: Dict[Any, int] = {}
        finished = distributed.as_completed(loop=client.loop)
        while waiting or numbers:
            while waiting and len(numbers) < max(1, len(client.nthreads())):
                future = client.submit(_on_worker, function, tasks[waiting[0]], pure=False)
                numbers[future] = waiting.popleft()
                finished.add(future)
            future = next(finished)
            result = _result(future)
            future.release()  # or it would be done again where its worker dies later
            yield numbers.pop(future), result


def _distributed() -> Any:
    try:
        import distributed  # noqa: PLC0415 - an optional package
    except ImportError:
        raise UsageError(
            "--scheduler needs the Python package distributed (pip install distributed)"
        ) from None
    return distributed


def _on_worker(function: "Function[T, R]", task: T) -> R:
    """Do a task in the process of a Dask worker, in the folder that ends with it."""
    return function(task, _distributed().get_worker().local_directory)


def _result(future: Any) -> Any:
    try:
        return future.result()
    except (
        Exception
    ) as error:  # the cluster's: a worker that is lost or lacks a package, a scheduler that has gone
        return Unfinished(f"{type(error).__name__}: {reason(error)}")
