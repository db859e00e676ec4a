"""The installed node as a process."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

EXIT_SECONDS = 60.0
"""Seconds after which the end of a process counts as a failure; only a busy machine needs most of them."""


def find_program(name: str) -> Path:
    """Return an installed program of the package."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix) / "lib" / "retalis" / name
        if path.exists():
            return path
    pytest.skip("the package is not installed")


class NodeProcess:
    """The process of a node.

    Args:
        log: file for its output.
        arguments: arguments for ROS.
    """

    def __init__(self, log: Path, *arguments: str):
        self._log = log
        with log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, str(find_program("retalis_node")), "--ros-args", *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def log(self) -> str:
        """Return what it has printed."""
        return self._log.read_text()

    def interrupt(self) -> int:
        """Send SIGINT; return the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(EXIT_SECONDS)

    def kill(self) -> None:
        """End it, if it has not ended."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
