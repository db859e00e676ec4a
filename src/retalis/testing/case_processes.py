"""Execution of many cases in processes.

Loading a program takes longer than running most cases. A process therefore loads the program of several cases once,
and forks a process for each of them, so that each case starts with a new program, and a case that hangs or crashes
does not affect the others. Cases with bags, whose types a program may use, load their program themselves.
"""

import ctypes
import os
import signal
from collections import deque
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Deque, Dict, Generator, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..foundation.errors import RetalisError
from ..messages.type_registry import Definitions
from .case_definition import Case
from .case_run import CaseResult, ProgramUnderTest, load_program, run_case

_fork = get_context("fork")

_PR_SET_PDEATHSIG = 1
"""Option of ``prctl(2)``: the signal that the process gets when its parent dies."""

NumberedCase = Tuple[int, Case]
"""A case, and its position in the list of all cases."""


class _BatchProcess(NamedTuple):
    """A process that runs a batch of cases, and the connection on which it sends their results."""

    process: Any
    results: Connection
    batch: Sequence[NumberedCase]


def run_cases(
    cases: Sequence[Case], definitions: Definitions, jobs: int, records_coverage: bool = False
) -> Generator[Tuple[int, CaseResult], None, None]:
    """Run cases, and yield the position of each case and its result when it has ended.

    Args:
        cases: the cases.
        definitions: known message types.
        jobs: maximum number of processes that run cases at a time.
        records_coverage: see `run_case`.
    """
    batches: Deque[Sequence[NumberedCase]] = deque(_make_batches(cases, jobs))
    workers: Dict[Connection, _BatchProcess] = {}
    try:
        while batches or workers:
            while batches and len(workers) < jobs:
                worker = _start_worker(batches.popleft(), definitions, records_coverage)
                workers[worker.results] = worker
            for results in wait(list(workers)):
                assert isinstance(results, Connection)
                yield from _receive_results(results, workers)
    finally:
        for worker in workers.values():
            _kill_group(worker.process)
            worker.process.join()


def _make_batches(cases: Sequence[Case], jobs: int) -> List[List[NumberedCase]]:
    """Group the cases by their program, and split large groups, so that all processes have work."""
    groups: Dict[object, List[NumberedCase]] = {}
    for number, case in enumerate(cases):
        # Parameters may be lists and mappings, which cannot be keys.
        program = case.program._replace(parameters=(), ros_parameters=())
        values = repr((case.program.parameters, case.program.ros_parameters))
        key = (number,) if case.bags else (program, values)
        groups.setdefault(key, []).append((number, case))
    size = max(1, -(-len(cases) // jobs))
    return [group[start : start + size] for group in groups.values() for start in range(0, len(group), size)]


def _start_worker(
    batch: Sequence[NumberedCase], definitions: Definitions, records_coverage: bool
) -> _BatchProcess:
    receiver, sender = _fork.Pipe(duplex=False)
    process = _fork.Process(target=_run_batch, args=(batch, definitions, records_coverage, sender))
    process.start()
    # The only other end is that of the worker, so that its death ends the connection.
    sender.close()
    return _BatchProcess(process, receiver, batch)


def _receive_results(
    results: Connection, workers: Dict[Connection, _BatchProcess]
) -> Iterator[Tuple[int, CaseResult]]:
    """Yield the result that a worker has sent; if the worker has ended, yield results for cases that have none."""
    worker = workers[results]
    try:
        number, result = results.recv()
    except EOFError:
        del workers[results]
        worker.process.join()
        for number, _ in worker.batch:
            reason = f"the process that loads the program has ended with status {worker.process.exitcode}"
            yield number, CaseResult((reason,), (), 0.0)
        return
    workers[results] = worker._replace(batch=[entry for entry in worker.batch if entry[0] != number])
    yield number, result


def _run_batch(
    batch: Sequence[NumberedCase], definitions: Definitions, records_coverage: bool, results: Connection
) -> None:
    """Run cases of one program one after the other, each in a process."""
    # With the processes of its cases, this process forms a group that can be ended as one.
    os.setpgrp()
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    program: Optional[ProgramUnderTest] = None
    if len(batch) > 1:
        try:
            program = load_program(batch[0][1], definitions, records_coverage=records_coverage)
        except RetalisError:
            # Each case reports the error itself.
            program = None
    for number, case in batch:
        results.send((number, _run_in_process(case, definitions, program, records_coverage)))


def _run_in_process(
    case: Case, definitions: Definitions, program: Optional[ProgramUnderTest], records_coverage: bool
) -> CaseResult:
    receiver, sender = _fork.Pipe(duplex=False)
    process = _fork.Process(target=_send_result, args=(case, definitions, program, records_coverage, sender))
    process.start()
    sender.close()
    try:
        if not receiver.poll(case.timeout):
            process.kill()
            reason = f"not finished after {case.timeout:g} s (key 'timeout')"
            return CaseResult((reason,), (), case.timeout)
        result: CaseResult = receiver.recv()
    except EOFError:
        process.join()
        return CaseResult((f"its process has ended with status {process.exitcode}",), (), 0.0)
    finally:
        process.join()
        receiver.close()
    return result


def _send_result(
    case: Case,
    definitions: Definitions,
    program: Optional[ProgramUnderTest],
    records_coverage: bool,
    results: Connection,
) -> None:
    _end_with_parent()
    results.send(run_case(case, definitions, program, records_coverage))


def _end_with_parent() -> None:
    """Make Linux kill this process when its parent dies: a parent that is killed cannot end it."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _kill_group(process: Any) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        # It has not become the leader of its group yet, or has ended.
        process.kill()
