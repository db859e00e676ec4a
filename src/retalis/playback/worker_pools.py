"""Worker pools that run tasks in processes of this machine.

A task may kill its worker, for example by a crash or by exhausting the memory. The task is then repeated on another
worker, and reported as unfinished after `MAX_WORKER_DEATHS` deaths.
"""

import multiprocessing
import signal
from collections import Counter, deque
from multiprocessing.connection import Connection, wait
from typing import (
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

from ..foundation.interrupts import interruptible

MAX_WORKER_DEATHS = 4
"""Number of worker deaths after which a task is given up."""

_POLL_SECONDS = 1.0
"""Time without a result after which ``on_poll`` is called."""

Task = TypeVar("Task")
Result = TypeVar("Result")

Function = Callable[[Task, str], Result]
"""Function that performs a task, given a folder for temporary files; it must not raise exceptions."""


class Unfinished(NamedTuple):
    """Result of a task that could not be completed, with the reason."""

    reason: str


TaskResults = Generator[Tuple[int, Union[Result, Unfinished]], None, None]
"""Generator of task indexes and results in order of completion; closing it terminates the workers."""


def run_in_processes(
    function: "Function[Task, Result]",
    tasks: Sequence[Task],
    jobs: int,
    scratch: str,
    on_worker_death: Callable[[int, str], object],
    ready: Optional[Deque[int]] = None,
    on_poll: Callable[[], object] = lambda: None,
) -> "TaskResults[Result]":
    """Run tasks in processes of this machine, which end when the generator is closed.

    `ProcessPoolExecutor` is not used: when a worker dies, it fails all pending tasks, and does not report which task
    the worker was running.

    Args:
        function: performs a task; each process imports it.
        tasks: the tasks.
        jobs: maximum number of processes at a time.
        scratch: folder for temporary files.
        on_worker_death: called with the index of each task that is repeated, and a description of its worker's death.
        ready: indexes of the tasks to run, all by default. The consumer may add indexes while it iterates.
        on_poll: called once a second while no task ends.
    """
    pending = deque(range(len(tasks))) if ready is None else ready
    deaths: Dict[int, int] = Counter()
    idle: List[_Worker[Task, Result]] = []
    busy: Dict[object, _Worker[Task, Result]] = {}
    try:
        while pending or busy:
            while pending and len(busy) < jobs:
                # Processes are started on demand and reused, because starting Python and importing the package takes
                # long.
                worker = idle.pop() if idle else _Worker(function, scratch)
                busy[worker.connection] = worker
                worker.send_task(pending.popleft(), tasks)
            with interruptible():
                ready_connections = wait([worker.connection for worker in busy.values()], _POLL_SECONDS)
            if not ready_connections:
                on_poll()
            for connection in ready_connections:
                worker = busy.pop(connection)
                index, result = worker.task_index, worker.receive_result()
                if not isinstance(result, _WorkerDeath):
                    idle.append(worker)
                    yield index, result
                    continue
                deaths[index] += 1
                if deaths[index] < MAX_WORKER_DEATHS:
                    # First in the queue, so that a deadly task is given up before it delays the end of the run.
                    on_worker_death(index, result.death_description)
                    pending.appendleft(index)
                else:
                    yield (
                        index,
                        Unfinished(
                            f"its worker died {MAX_WORKER_DEATHS} times, at last {result.death_description}"
                        ),
                    )
    finally:
        # Also after an error or Ctrl-C: worker processes must not outlive the generator.
        for worker in (*idle, *busy.values()):
            worker.kill()


class _WorkerDeath(NamedTuple):
    death_description: str


class _Worker(Generic[Task, Result]):
    """A process that runs one task at a time.

    Attributes:
        connection: becomes readable when a result is available or the process has died.
    """

    def __init__(self, function: "Function[Task, Result]", scratch: str):
        # "spawn": a forked process would inherit locks that other threads of this process hold.
        context = multiprocessing.get_context("spawn")
        self.connection, child_connection = context.Pipe()
        self.task_index = -1
        self._process = context.Process(
            target=_run_tasks, args=(function, child_connection, scratch), daemon=True
        )
        self._process.start()
        # Otherwise this process would keep the pipe open, and `recv` would not notice the death of the worker.
        child_connection.close()

    def send_task(self, task_index: int, tasks: Sequence[Task]) -> None:
        """Send a task to the process."""
        self.task_index = task_index
        try:
            self.connection.send(tasks[task_index])
        except OSError:  # the process has died, which `receive_result` reports
            pass

    def receive_result(self) -> Union[Result, _WorkerDeath]:
        """Return the result of the task, or the death of the process."""
        try:
            result: Result = self.connection.recv()
            return result
        except (EOFError, OSError):
            self.connection.close()
            self._process.join()
            return _WorkerDeath(_describe_exit(self._process.exitcode))

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _run_tasks(function: "Function[Task, Result]", connection: Connection, scratch: str) -> None:
    """Run tasks from a connection until it is closed."""
    # Ctrl-C interrupts the parent process, which kills this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while True:
            connection.send(function(connection.recv(), scratch))
    except (EOFError, OSError):
        pass


def _describe_exit(code: Optional[int]) -> str:
    if code is not None and code < 0:
        return f"by {signal.Signals(-code).name}"
    return f"with status {code}"
