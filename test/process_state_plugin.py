"""A pytest plugin that fails each test that leaves the process in another state than it found it in.

The state is read in parts. Each part is a plain value, so that two readings are compared with ``==``; only a part
that differs is described in words and restored. A reading takes 30 µs, and there are two for each test.
"""

import gc
import logging
import os
import signal
import sys
import threading
import time
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Tuple

import pytest

THREAD_TIMEOUT_SECONDS = 30.0
"""Time for threads to end after the test that has started them. Only threads that do not end take as long."""

_THREAD_CHECK_SECONDS = 0.1

VARIABLES_OF_PYTEST = ("PYTEST_CURRENT_TEST",)
"""Environment variables that pytest changes for each phase of a test."""

THREADS_OF_DISTRIBUTED = (
    "AsyncProcess ",
    "Dask-Call",
    "Dask-Callback",
    "Dask-Offload_",
    "IO loop",
    "QueueFeederThread",
)
"""Beginnings of the names of threads that cannot be ended from outside, because distributed does not hand them out.

Those of a worker that a cluster has restarted last as long as the cluster, which may be that of a module. Those for
long computations and of a client that has not reached its scheduler last as long as the process.
"""

FOLDER_OF_DISTRIBUTED = "dask-scratch-space"
"""Name of the folder that distributed adds to ``sys.path`` for a cluster, and removes in a thread after its end."""

THREADS_OF_PROCESS = ("retalis guard of SWI-Prolog",)
"""Names of threads that the first use of a library starts, and that last as long as the process by design."""

SIGNALS = [number for number in signal.Signals if number < signal.SIGRTMIN]

MISSING = object()


class Part(NamedTuple):
    """Part of the state of the process.

    Attributes:
        read: returns the value of the part; equal values are equal states.
        describe: yields a description of each difference between two values.
        restore: restores the first of two values as far as possible.
    """

    read: Callable[[], Any]
    describe: Callable[[Any, Any], Iterator[str]]
    restore: Callable[[Any, Any], None]


def changed_keys(before: Dict[Any, Any], after: Dict[Any, Any]) -> Iterator[Tuple[Any, Any, Any]]:
    """Yield key, old value and new value of each difference between dictionaries, `MISSING` for no value."""
    for key in sorted(before.keys() | after.keys()):
        old, new = before.get(key, MISSING), after.get(key, MISSING)
        if old is not new and old != new:
            yield key, old, new


def shorten(value: Any) -> str:
    """Return the representation of a value for a message, of at most 200 characters."""
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + "..."


def describe_change(name: str, old: Any, new: Any) -> str:
    if old is MISSING:
        return f"{name} is added: {shorten(new)}"
    if new is MISSING:
        return f"{name} is removed: {shorten(old)}"
    return f"{name} is {shorten(new)}, was {shorten(old)}"


# ---- environment variables


def read_environment() -> Dict[str, str]:
    environment = dict(os.environ)
    for name in VARIABLES_OF_PYTEST:
        environment.pop(name, None)
    return environment


def describe_environment(before: Dict[str, str], after: Dict[str, str]) -> Iterator[str]:
    for name, old, new in changed_keys(before, after):
        # Without the values, which may be credentials.
        change = "added" if old is MISSING else "removed" if new is MISSING else "changed"
        yield f"environment variable {name} is {change}"


def restore_environment(before: Dict[str, str], after: Dict[str, str]) -> None:
    for name, old, _ in changed_keys(before, after):
        if old is MISSING:
            del os.environ[name]
        else:
            os.environ[name] = old


# ---- working folder


def read_working_folder() -> Optional[str]:
    try:
        return os.getcwd()
    except FileNotFoundError:  # the folder was removed
        return None


def describe_working_folder(before: Optional[str], after: Optional[str]) -> Iterator[str]:
    yield describe_change("the working folder", before, after)


def restore_working_folder(before: Optional[str], after: Optional[str]) -> None:
    if before is not None:
        os.chdir(before)


# ---- search path of modules


def read_module_path() -> List[str]:
    return [folder for folder in sys.path if not folder.endswith(FOLDER_OF_DISTRIBUTED)]


def describe_module_path(before: List[str], after: List[str]) -> Iterator[str]:
    added = [folder for folder in after if folder not in before]
    removed = [folder for folder in before if folder not in after]
    if added:
        yield f"sys.path has additional folders: {shorten(added)}"
    if removed:
        yield f"sys.path lacks folders: {shorten(removed)}"
    if not added and not removed:
        yield f"the order of sys.path is changed: {shorten(after)}"


def restore_module_path(before: List[str], after: List[str]) -> None:
    sys.path[:] = before


# ---- umask


def read_umask() -> int:
    # The umask can only be read by setting it. For that moment files of other threads are private, not public.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def describe_umask(before: int, after: int) -> Iterator[str]:
    yield f"the umask is {after:03o}, was {before:03o}"


def restore_umask(before: int, after: int) -> None:
    os.umask(before)


# ---- signal handlers


def read_signal_handlers() -> List[Any]:
    return [signal.getsignal(number) for number in SIGNALS]


def describe_signal_handlers(before: List[Any], after: List[Any]) -> Iterator[str]:
    for number, old, new in zip(SIGNALS, before, after):
        if old != new:
            yield describe_change(f"the handler of {signal.Signals(number).name}", old, new)


def restore_signal_handlers(before: List[Any], after: List[Any]) -> None:
    for number, old, new in zip(SIGNALS, before, after):
        if old != new and old is not None:  # None: set by a library in C; Python cannot set it
            signal.signal(number, old)


# ---- loggers


class LoggerState(NamedTuple):
    """Settings of a logger."""

    level: int
    handlers: Tuple[logging.Handler, ...]
    disabled: bool
    propagate: bool


def is_ignored_handler(handler: logging.Handler) -> bool:
    """Return whether a handler does nothing (rospy has a class of its own for that), or is one of pytest's."""
    return type(handler).__name__ == "NullHandler" or type(handler).__module__ == "_pytest.logging"


def read_loggers() -> Dict[str, LoggerState]:
    """Return the settings of the loggers that have others than the default ones, by name.

    Packages create loggers when they are imported, which may be in any test. Such loggers have default settings, and
    some a `NullHandler`, which does nothing.
    """
    loggers: Dict[Any, Any] = {}
    for name, logger in [("root", logging.root), *logging.root.manager.loggerDict.items()]:
        # A placeholder stands for the parent of a logger that has not been created itself.
        if isinstance(logger, logging.PlaceHolder):
            continue
        handlers = tuple(handler for handler in logger.handlers if not is_ignored_handler(handler))
        if logger.level or handlers or logger.disabled or not logger.propagate:
            loggers[name] = LoggerState(logger.level, handlers, logger.disabled, logger.propagate)
    return loggers


def describe_loggers(before: Dict[str, LoggerState], after: Dict[str, LoggerState]) -> Iterator[str]:
    default = LoggerState(logging.NOTSET, (), False, True)
    for name, old, new in changed_keys(before, after):
        old_state = default if old is MISSING else old
        new_state = default if new is MISSING else new
        for field, old_value, new_value in zip(LoggerState._fields, old_state, new_state):
            if old_value != new_value:
                yield describe_change(f"{field} of logger '{name}'", old_value, new_value)


def restore_loggers(before: Dict[str, LoggerState], after: Dict[str, LoggerState]) -> None:
    default = LoggerState(logging.NOTSET, (), False, True)
    for name, old, _ in changed_keys(before, after):
        state = default if old is MISSING else old
        logger = logging.root if name == "root" else logging.getLogger(name)
        logger.setLevel(state.level)
        logger.handlers[:] = [
            *filter(is_ignored_handler, logger.handlers),
            *state.handlers,
        ]
        logger.disabled = state.disabled
        logger.propagate = state.propagate


# ---- garbage collector


def read_garbage_collector() -> Dict[str, Any]:
    return {"enabled": gc.isenabled(), "thresholds": gc.get_threshold()}


def describe_garbage_collector(before: Dict[str, Any], after: Dict[str, Any]) -> Iterator[str]:
    for name, old, new in changed_keys(before, after):
        yield describe_change(f"setting '{name}' of the garbage collector", old, new)


def restore_garbage_collector(before: Dict[str, Any], after: Dict[str, Any]) -> None:
    if before["enabled"]:
        gc.enable()
    else:
        gc.disable()
    gc.set_threshold(*before["thresholds"])


# ---- threads


def read_threads() -> "set[threading.Thread]":
    return {
        thread
        for thread in threading.enumerate()
        if not thread.name.startswith(THREADS_OF_DISTRIBUTED + THREADS_OF_PROCESS)
    }


def describe_threads(before: "set[threading.Thread]", after: "set[threading.Thread]") -> Iterator[str]:
    for thread in sorted(after - before, key=lambda thread: thread.name):
        yield f"thread {shorten(thread)} is running"


def wait_for_threads(before: "set[threading.Thread]") -> None:
    """Wait until the threads that are not in a set have ended, for at most `THREAD_TIMEOUT_SECONDS`."""
    end = time.monotonic() + THREAD_TIMEOUT_SECONDS
    started_threads = read_threads() - before
    while started_threads and time.monotonic() < end:
        # Threads of an executor or of an engine end when their owner is deleted, which another thread may still hold.
        gc.collect()
        next(iter(started_threads)).join(_THREAD_CHECK_SECONDS)
        started_threads = read_threads() - before


PARTS = (
    Part(read_environment, describe_environment, restore_environment),
    Part(read_working_folder, describe_working_folder, restore_working_folder),
    Part(read_module_path, describe_module_path, restore_module_path),
    Part(read_umask, describe_umask, restore_umask),
    Part(read_signal_handlers, describe_signal_handlers, restore_signal_handlers),
    Part(read_loggers, describe_loggers, restore_loggers),
    Part(read_garbage_collector, describe_garbage_collector, restore_garbage_collector),
    Part(read_threads, describe_threads, lambda before, after: None),
)


def read_process_state() -> List[Any]:
    """Return the value of each part of the state of the process."""
    return [part.read() for part in PARTS]


def restore_process_state(before: List[Any]) -> List[str]:
    """Wait until the threads started since a reading have ended, and restore the state of that reading.

    Args:
        before: what `read_process_state` returned.

    Returns:
        A description of each change since then. Threads that do not end cannot be ended from outside.
    """
    wait_for_threads(before[-1])
    after = read_process_state()
    changes: List[str] = []
    for part, old, new in zip(PARTS, before, after):
        if old != new:
            changes.extend(part.describe(old, new))
            part.restore(old, new)
    return changes


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Remove the callback of hypothesis from the garbage collector of Python 3.8; it only measures time.

    If a callback reaches the recursion limit, because a collection starts there, this Python discards the
    `RecursionError` and aborts the process when the recursion goes on. Hypothesis adds its callback once.
    """
    if sys.version_info < (3, 9):
        gc.callbacks[:] = [callback for callback in gc.callbacks if not is_of_hypothesis(callback)]


def is_of_hypothesis(callback: Any) -> bool:
    return (getattr(callback, "__module__", None) or "").startswith("hypothesis.")


@pytest.fixture(autouse=True)
def unchanged_process(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves the process in another state than it found it in.

    Fixtures of modules and sessions are set up before, so what they hold is not a change.
    """
    before = read_process_state()
    yield
    # Objects that fixtures have returned end their threads when they are deleted.
    request.node.funcargs.clear()
    changes = restore_process_state(before)
    if changes:
        text = f"{request.node.nodeid}: the test leaves the process changed: a test restores what it changes:"
        pytest.fail("\n  ".join([text, *changes]), pytrace=False)
