"""Interrupts within callbacks, in which Python ignores exceptions."""

import os
import subprocess
import sys

import pytest
from python_path import python_path

LOSING_INTERRUPT = """
import signal
import sys
import time
import weakref

# A process that a shell has started in the background ignores the signal.
signal.signal(signal.SIGINT, signal.default_int_handler)

class Item:
    def __del__(self):
        if sys.argv[1] == "finalizer":
            signal.raise_signal(signal.SIGINT)

def wait_after_lost_interrupt():
    item = Item()
    callback = lambda reference: sys.argv[1] == "reference" and signal.raise_signal(signal.SIGINT)
    reference = weakref.ref(item, callback)
    del item
    print("continued", flush=True)
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        time.sleep(0.01)
"""


def run(code, callback):
    """Run code in another process; return its exit status and output."""
    done = subprocess.run(
        [sys.executable, "-c", LOSING_INTERRUPT + code, callback],
        env={**os.environ, "PYTHONPATH": python_path()},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("callback", ["reference", "finalizer"])
def test_interrupt_in_callback_is_repeated(callback):
    code = """
from retalis.foundation.lost_interrupts import repeat_lost_interrupts

previous_hook = sys.unraisablehook
try:
    with repeat_lost_interrupts():
        wait_after_lost_interrupt()
except KeyboardInterrupt:
    print("interrupted", sys.unraisablehook is previous_hook)
"""
    assert run(code, callback) == (0, "continued\ninterrupted True\n", "")


def test_interrupt_in_callback_ends_command():
    code = """
from retalis.__main__ import main
from retalis.cli import command_line

command_line.main = wait_after_lost_interrupt
raise SystemExit(main())
"""
    assert run(code, "reference") == (130, "continued\n", "")


def test_other_error_in_callback_is_reported():
    code = """
from retalis.foundation.lost_interrupts import repeat_lost_interrupts

def fail(reference):
    raise ValueError("text")

with repeat_lost_interrupts():
    item = Item()
    reference = weakref.ref(item, fail)
    del item
print("continued")
"""
    status, output, errors = run(code, "none")
    assert (status, output) == (0, "continued\n")
    assert "Exception ignored in" in errors
    assert "ValueError: text" in errors
