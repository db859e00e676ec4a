"""Processes of nodes: the exit status after signals, errors and a shutdown that hangs."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Callable, Iterator, List

import pytest
from subprocess_python_path import python_path

PROGRAM = """
import signal
import sys
import time

from retalis.node.node_process import run_node_process, wait_while

# A shell starts background processes with this signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)

def run(shutdown):
    shutdown.callback(lambda: print("ended last", flush=True))
    shutdown.callback({shut_down})
    print("started", flush=True)
    {body}

sys.exit(run_node_process(run, {max_seconds}))
"""
TIMEOUT_SECONDS = 60
"""Time for the end of a process; only a busy machine needs most of it."""

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts a process with a node whose body and shutdown are given as Python code."""
    processes: List[subprocess.Popen[str]] = []

    def start_process(
        body: str, shut_down: str = "lambda: None", max_seconds: float = TIMEOUT_SECONDS
    ) -> "subprocess.Popen[str]":
        script = tmp_path / "node.py"
        script.write_text(PROGRAM.format(body=body, shut_down=shut_down, max_seconds=max_seconds))
        process = subprocess.Popen(
            [sys.executable, str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": python_path()},
            text=True,
        )
        processes.append(process)
        return process

    yield start_process
    for process in processes:
        process.kill()
        process.communicate()


def read_line(process: Any) -> str:
    return str(process.stdout.readline())


@pytest.mark.parametrize("status", [0, 1])
def test_status_of_node_is_that_of_process(start: Start, status: int) -> None:
    process = start(f"return {status}")
    assert process.communicate(timeout=TIMEOUT_SECONDS) == ("started\nended last\n", "")
    assert process.returncode == status


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_waiting_node(start: Start, number: int) -> None:
    process = start("wait_while(lambda: True)")
    assert read_line(process) == "started\n"
    process.send_signal(number)
    assert process.communicate(timeout=TIMEOUT_SECONDS) == ("ended last\n", "")
    assert process.returncode == 0


def test_node_ends_when_it_is_shut_down(start: Start) -> None:
    process = start("wait_while(iter([True, False]).__next__); return 0")
    assert process.communicate(timeout=TIMEOUT_SECONDS) == ("started\nended last\n", "")
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("body", "status"), [("return 0", 0), ("return 1", 1), ("raise ValueError('a bug')", 1)]
)
def test_process_exits_if_shutdown_hangs(start: Start, body: str, status: int) -> None:
    process = start(body, "lambda: time.sleep(1000)", max_seconds=0.2)
    output, errors = process.communicate(timeout=TIMEOUT_SECONDS)
    assert (output, errors) == (
        "started\n",
        "the shutdown has not ended after 0.2 s: the process exits now\n",
    )
    assert process.returncode == status


def test_shutdown_continues_after_error(start: Start) -> None:
    process = start("raise ValueError('a bug')")
    output, errors = process.communicate(timeout=TIMEOUT_SECONDS)
    assert output == "started\nended last\n"
    assert errors.endswith("ValueError: a bug\n")
    assert process.returncode == 1


def test_signal_in_shutdown_is_ignored(start: Start) -> None:
    process = start("return 0", "lambda: sys.stdin.readline()")
    assert read_line(process) == "started\n"
    # The body has returned when the handlers are replaced.
    wait_until_ignored(process.pid)
    process.send_signal(signal.SIGINT)
    assert process.communicate("\n", timeout=TIMEOUT_SECONDS) == ("ended last\n", "")
    assert process.returncode == 0


def wait_until_ignored(pid: int) -> None:
    """Wait until a process ignores SIGINT."""
    end = time.monotonic() + TIMEOUT_SECONDS
    while True:
        (line,) = (
            line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigIgn")
        )
        if int(line.split()[1], 16) & 1 << signal.SIGINT - 1:
            return
        assert time.monotonic() < end, "SIGINT is not ignored"
        time.sleep(0.01)
