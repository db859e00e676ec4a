"""Signals that interrupt the main thread at safe points."""

import os
import signal
import subprocess
import sys
import threading
from typing import Any, Iterator, List
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from asserting_accessors import required
from subprocess_python_path import python_path

from retalis import Engine, UsageError
from retalis.foundation.interrupts import (
    PENDING,
    Interrupt,
    are_deferred,
    check_interrupt,
    deferred_interrupts,
    interruptible,
    is_interrupted,
    postpone,
)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Set the usual handler, also if a shell has started the tests in the background."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)
    assert not PENDING


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


def test_signal_is_raised_at_safe_point() -> None:
    with deferred_interrupts():
        check_interrupt()
        interrupt()
        assert is_interrupted()
        with pytest.raises(Interrupt):
            check_interrupt()
        check_interrupt()


def test_signal_in_wait_is_raised_at_once() -> None:
    steps: List[Any] = []

    def wait() -> None:
        with interruptible():
            interrupt()
            steps.append("after the signal")

    with deferred_interrupts():
        with pytest.raises(KeyboardInterrupt):
            wait()
        # The block has ended, so the next signal is recorded.
        interrupt()
        steps.append("recorded")
        with pytest.raises(KeyboardInterrupt):
            check_interrupt()
    assert steps == ["recorded"]


def test_signal_in_remote_call_is_raised_at_once() -> None:
    has_ended = threading.Event()

    def signal_and_wait() -> bool:
        signal.pthread_kill(required(threading.main_thread().ident), signal.SIGINT)
        return has_ended.wait(60)

    with SimpleXMLRPCServer(("localhost", 0), logRequests=False) as server:
        server.register_function(signal_and_wait)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with deferred_interrupts(), pytest.raises(Interrupt):
                ServerProxy(f"http://localhost:{server.server_address[1]}").signal_and_wait()
        finally:
            has_ended.set()
            server.shutdown()
            thread.join()


def test_pending_signal_is_raised_before_wait() -> None:
    with deferred_interrupts():
        interrupt()
        with pytest.raises(Interrupt), interruptible():
            pytest.fail("the block waits")
        interrupt()
        with pytest.raises(Interrupt):
            check_interrupt()


def test_nested_waits_are_interruptible_until_outer_end() -> None:
    with deferred_interrupts(), interruptible():
        with interruptible():
            pass
        with pytest.raises(Interrupt):
            interrupt()


def test_pending_signal_is_raised_at_end_of_context() -> None:
    with pytest.raises(Interrupt), deferred_interrupts():
        interrupt()

    def interrupt_inner_context() -> None:
        with deferred_interrupts():
            with deferred_interrupts():
                interrupt()
            assert is_interrupted()  # the outer context raises it

    with pytest.raises(Interrupt):
        interrupt_inner_context()


def test_signal_in_callback_of_reference_is_not_lost() -> None:
    class Item:
        def __del__(self) -> None:
            interrupt()

    with deferred_interrupts():
        Item()
        with pytest.raises(Interrupt):
            check_interrupt()


def test_signal_in_callback_during_wait_is_not_lost() -> None:
    class Item:
        def __del__(self) -> None:
            interrupt()

    hook = sys.unraisablehook
    with deferred_interrupts():
        with interruptible():
            Item()
        with pytest.raises(Interrupt):
            check_interrupt()
    assert sys.unraisablehook is hook


def test_handlers_are_installed_within_context_only() -> None:
    handler = signal.getsignal(signal.SIGTERM)
    with deferred_interrupts(signal.SIGTERM):
        assert are_deferred()
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Interrupt):
            check_interrupt()
        with pytest.raises(KeyboardInterrupt):  # of the handler of Python
            interrupt()
    assert signal.getsignal(signal.SIGTERM) == handler
    assert not are_deferred()


def test_engine_installs_no_handler() -> None:
    handlers = [signal.getsignal(number) for number in signal.valid_signals()]
    engine = Engine()
    engine.load(rules="b <- a.")
    engine.event("a", 1)
    assert [signal.getsignal(number) for number in signal.valid_signals()] == handlers


def test_ignored_signal_remains_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with deferred_interrupts():
        interrupt()
        check_interrupt()


def test_context_in_other_thread_is_refused() -> None:
    errors: List[Any] = []

    def enter() -> None:
        with pytest.raises(UsageError) as error, deferred_interrupts():
            pass
        errors.append(str(error.value))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert errors == [
        "deferred_interrupts: signals are handled in the main thread only: call it in the main thread"
    ]


def test_other_thread_leaves_signal_to_main_thread() -> None:
    checked: List[Any] = []

    def check() -> None:
        with interruptible():
            check_interrupt()
        checked.append(is_interrupted())

    with deferred_interrupts():
        interrupt()
        thread = threading.Thread(target=check)
        thread.start()
        thread.join()
        with pytest.raises(Interrupt):
            check_interrupt()
    assert checked == [False]


def test_first_postponed_exception_is_raised() -> None:
    postpone(SystemExit(3))
    postpone(SystemExit(4))
    with pytest.raises(SystemExit, match="3"):
        check_interrupt()
    check_interrupt()


WITHOUT_SAFE_POINTS = """
import signal
from retalis.foundation import interrupts

signal.signal(signal.SIGINT, signal.default_int_handler)
interrupts.MAX_RESPONSE_SECONDS = {seconds}
with interrupts.deferred_interrupts():
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    print("continued", flush=True)
"""


@pytest.mark.parametrize(
    ("seconds", "shown", "status"),
    [(0.0, "", 130), (3600.0, "continued\n", 1)],
    ids=["after_limit", "before_limit"],
)
def test_second_signal_ends_process_without_safe_points(seconds: float, shown: str, status: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT_SAFE_POINTS.format(seconds=seconds)],
        env={**os.environ, "PYTHONPATH": python_path()},
        capture_output=True,
        text=True,
    )
    assert ended.stdout == shown
    if status == 130:
        assert ended.returncode == 130
        assert ended.stderr == "\nretalis: interrupted twice: the process ends without cleaning up\n"
    else:
        assert "Interrupt" in ended.stderr
