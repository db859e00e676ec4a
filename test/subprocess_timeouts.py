"""Processes that are killed after a time limit, so that a test that reads from them ends."""

import subprocess
import threading
from contextlib import contextmanager, suppress
from typing import Any, Iterator, List

TIMEOUT_SECONDS = 60.0


@contextmanager
def running(command: List[str], **options: Any) -> Iterator["subprocess.Popen[Any]"]:
    """Run a command within the time limit; kill it at the end of the block, and close its pipes."""
    process = subprocess.Popen(command, **options)
    timer = threading.Timer(TIMEOUT_SECONDS, process.kill)
    timer.start()
    try:
        yield process
    finally:
        timer.cancel()
        timer.join()
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe is not None:
                with suppress(OSError):  # text that the process has not read
                    pipe.close()
