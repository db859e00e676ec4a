"""What all tests share: hypothesis tries the same examples in every run, so that a failure can be repeated, and
takes its time: a machine may be busy.

The commands for long runs (``test/oracle``, ``test/fuzz``) take seeds and try others.

The fast tests are shared between processes where pytest-xdist is installed. The slow ones are not, unless ``-n`` says
so: some of them measure memory, and those on ROS are many processes by themselves.
"""

import gc
import os

import pytest

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Definitions
from retalis.foundation.cpython_and_pypy import PYPY

FAST = "not slow"
MOST = 8

LOOKS = (700, 10, 100)
"""When the garbage collector looks: at what is young as usual, at all of it a tenth as often."""

try:
    from hypothesis import settings
except ImportError:  # the tests that need it are skipped, or say so themselves
    pass
else:
    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    option = config.option
    if "PYTEST_XDIST_WORKER" in os.environ:  # one of those processes, or below one: it starts no others
        return
    if option.markexpr == FAST and getattr(option, "numprocesses", 0) is None and not option.usepdb:
        option.numprocesses = min(MOST, os.cpu_count() or 1)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection(session):
    """Let the garbage collector leave alone what is collected: a million objects of modules, syntax trees and tests
    that stay to the end, and that each full run would walk, in the middle of whatever test makes it run.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if not PYPY:
            gc.freeze()
            gc.set_threshold(*LOOKS)


@pytest.fixture(scope="module")
def definitions():
    """The message definitions that are installed."""
    return Definitions()


@pytest.fixture(scope="module", autouse=True)
def what_modules_leave():
    """Let it leave alone what a module of tests has left in caches, too: some have it look at all that is there."""
    yield
    gc.collect()
    if not PYPY:
        gc.freeze()


def pytest_runtest_teardown():
    if not PYPY:
        # A command that was run here has changed the collector for its process. Callbacks of other packages stay:
        # a Dask cluster that finds its callback removed when it ends keeps the next one from starting.
        gc.callbacks[:] = [
            each
            for each in gc.callbacks
            if not (getattr(each, "__module__", None) or "").startswith("retalis")
        ]
        gc.set_threshold(*LOOKS)
