"""What workers do in tests: functions that other processes import by name."""

import os
import signal
from pathlib import Path


def deed(task, scratch):
    """Do one thing: tell of this process, die, or die the first time only."""
    kind, _, name = task.partition(" ")
    if kind == "pid":
        return os.getpid()
    done_before = Path(scratch, name).exists()
    if kind == "die" or not done_before:
        Path(scratch, name).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def marked(task, scratch):
    """As `deed`, with a folder that all workers share in the task."""
    task, _, folder = task.partition(" in ")
    return deed(task, folder)
