"""Tasks for worker processes, which import them by name."""

import os
import signal
import time
from pathlib import Path
from typing import Any


def run_task(task: Any, scratch: Any) -> Any:
    """Return this process's number for `pid`, and wait for a file for `wait NAME`; otherwise kill the process.

    `die NAME` kills it each time. Any other task kills it at the first attempt and is returned at the second.
    """
    action, _, name = task.partition(" ")
    if action == "pid":
        return os.getpid()
    if action == "wait":
        while not Path(scratch, name).exists():
            time.sleep(0.01)
        return name
    has_failed_before = Path(scratch, name).exists()
    if action == "die" or not has_failed_before:
        Path(scratch, name).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def run_task_in_folder(task: Any, scratch: Any) -> Any:
    """Run a task `TASK in FOLDER` with a folder that all workers share instead of the one for this worker."""
    task, _, folder = task.partition(" in ")
    return run_task(task, folder)
