"""Settings of all tests.

Hypothesis tries the same examples in every run, so that a failure can be repeated, and has no deadline, because a
machine may be busy. The commands for long runs (``test/oracle``, ``test/fuzz``) take seeds and try other examples.

The fast tests are distributed over processes if pytest-xdist is installed. The slow ones are not, unless ``-n``
requests it: some of them measure memory, and those of ROS start many processes themselves.
"""

import gc
import os
from typing import Any, Iterator

import pytest

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Definitions
from retalis.foundation import garbage_collection

pytest_plugins = ["nightly_test_selection", "process_state_plugin", "random_order"]

FAST_TESTS = "not slow"
"""The expression of ``-m`` that selects the fast tests."""

MAX_PROCESSES = 8

GC_THRESHOLDS = (700, 10, 100)
"""Thresholds of the garbage collector: those of Python, except that all objects are visited a tenth as often."""


class FrozenCollector:
    """The garbage collector for commands in the process of the tests, which does not collect.

    `limit_gc_pauses` collects all garbage. Each command would visit the objects of the tests, which takes longer than
    its work. The settings are those of the process. The tests of the garbage collector use the real one.
    """

    def __getattr__(self, name: Any) -> Any:
        return getattr(gc, name)

    def collect(self) -> int:
        return 0


# The module has no other place for a replacement that is in effect before the first command of any test.
vars(garbage_collection)["gc"] = FrozenCollector()

try:
    import lark  # noqa: F401 - sets its logger when it is imported, which a test must not change
except ImportError:
    pass

try:
    from hypothesis import settings
except ImportError:  # the tests that need hypothesis are skipped, or fail with a message
    pass
else:
    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: Any) -> None:
    option = config.option
    if "PYTEST_XDIST_WORKER" in os.environ:  # a process of xdist, or started by one, starts no further ones
        return
    if option.markexpr == FAST_TESTS and getattr(option, "numprocesses", 0) is None and not option.usepdb:
        option.numprocesses = min(MAX_PROCESSES, os.cpu_count() or 1)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection(session: Any) -> Iterator[None]:
    """Exempt the objects of the collection from the garbage collector.

    A million objects of modules, syntax trees and tests stay until the end. Each full collection would visit them, in
    the middle of any test.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(*GC_THRESHOLDS)


@pytest.fixture(scope="module")
def definitions() -> Definitions:
    """Return the installed message definitions."""
    return Definitions()


@pytest.fixture(scope="module")
def module_browser() -> Iterator[Any]:
    """Return a browser for the tests of a module; its start takes a second."""
    pytest.importorskip("tornado", reason="the browser is controlled through tornado")
    from browser import Browser, chromium  # noqa: PLC0415 - tornado is optional

    if chromium() is None:
        pytest.skip("no Chromium is installed (Debian's package chromium)")
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture
def browser(module_browser: Any) -> Iterator[Any]:
    """Return a browser with an empty page; fail if a problem is left at the end of the test."""
    module_browser.reset()
    yield module_browser
    assert module_browser.take_problems() == []


@pytest.fixture(scope="module", autouse=True)
def freeze_caches() -> Iterator[None]:
    """Exempt the objects that a module of tests has left in caches, too: some tests collect all garbage."""
    yield
    gc.collect()
    gc.freeze()
