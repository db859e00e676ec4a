"""Comparison of the process before and after each test, in a run of pytest with tests that leave changes."""

import os
import re
import subprocess
import sys

import pytest
from subprocess_python_path import ROOT, python_path

CONFTEST = """
import process_state_plugin

process_state_plugin.THREAD_TIMEOUT_SECONDS = 0.1
"""

CHANGES = {
    "variable": ("os.environ['LEFT'] = '1'", "environment variable LEFT is added"),
    "removed_variable": ("del os.environ['HELD']", "environment variable HELD is removed"),
    "changed_variable": ("os.environ['HELD'] = 'other'", "environment variable HELD is changed"),
    "working_folder": ("os.chdir('/')", r"the working folder is '/', was '\S+'"),
    "module_path": ("sys.path.append('/left')", r"sys.path has additional folders: \['/left'\]"),
    "removed_module_path": ("sys.path.remove('/held')", r"sys.path lacks folders: \['/held'\]"),
    "order_of_module_path": ("sys.path.append('/held')", r"the order of sys.path is changed: \[.*"),
    "umask": ("os.umask(0o007)", "the umask is 007, was 022"),
    "signal_handler": (
        "signal.signal(signal.SIGUSR1, signal.SIG_IGN)",
        r"the handler of SIGUSR1 is <Handlers.SIG_IGN: 1>, was <Handlers.SIG_DFL: 0>",
    ),
    "root_level": ("logging.root.setLevel('DEBUG')", "level of logger 'root' is 10, was 30"),
    "root_handler": (
        "logging.root.addHandler(logging.StreamHandler())",
        r"handlers of logger 'root' is \(<StreamHandler .*\), was \(\)",
    ),
    "handler": (
        "logging.getLogger('retalis.left').addHandler(logging.StreamHandler())",
        r"handlers of logger 'retalis.left' is \(<StreamHandler .*\), was \(\)",
    ),
    "disabled_logger": (
        "logging.getLogger('held').disabled = True",
        "disabled of logger 'held' is True, was False",
    ),
    "propagation": (
        "logging.getLogger('held').propagate = False",
        "propagate of logger 'held' is False, was True",
    ),
    "garbage_collector": (
        "retalis.limit_gc_pauses()",
        r"setting 'thresholds' of the garbage collector is \(2000, .*\), was \(.*\)",
    ),
    "disabled_garbage_collector": (
        "gc.disable()",
        "setting 'enabled' of the garbage collector is False, was True",
    ),
    "thread": ("start_thread(60, daemon=True)", r"thread <Thread\(left, started daemon \d+\)> is running"),
    "other_thread": ("start_thread(1, daemon=False)", r"thread <Thread\(left, started \d+\)> is running"),
}
"""Statements that change the process, and the descriptions of their changes."""

MODULE = """
import gc, logging, os, signal, sys, threading
import pytest, retalis
from process_state_plugin import read_process_state

os.umask(0o022)
held = logging.getLogger("held")


def start_thread(seconds, daemon):
    threading.Thread(target=threading.Event().wait, args=(seconds,), name="left", daemon=daemon).start()


@pytest.fixture(scope="module")
def process():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HELD", "held")
        patch.syspath_prepend("/held")
        thread = threading.Thread(target=threading.Event().wait, daemon=True)
        thread.start()
        yield read_process_state()
"""

UNCHANGED = """

def test_unchanged_by_fixtures(process, monkeypatch, tmp_path, caplog):
    monkeypatch.setenv("HELD", "other")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("/left")
    caplog.set_level("DEBUG")


def test_unchanged_by_library(process):
    logging.getLogger("library").addHandler(logging.NullHandler())


def test_unchanged_by_cluster(process):
    sys.path.append("/tmp/dask-scratch-space")


def test_unchanged_after_thread_has_ended(process):
    start_thread(0.01, daemon=False)


class Owner:
    def __init__(self):
        self.end = threading.Event()
        self.me = self
        threading.Thread(target=self.end.wait, daemon=True).start()

    def __del__(self):
        self.end.set()


@pytest.fixture
def owner():
    return Owner()


def test_unchanged_after_owner_of_thread_is_deleted(process, owner):
    assert not owner.end.is_set()


def test_callback_of_hypothesis_is_added(process):
    def callback(phase, info):
        pass

    callback.__module__ = "hypothesis.internal"
    gc.callbacks.append(callback)


def test_callback_of_hypothesis_is_removed_before_next_test_on_python_3_8(process):
    is_removed = [callback.__module__ for callback in gc.callbacks] == []
    assert is_removed == (sys.version_info < (3, 9))
"""

TEST = """

def test_{name}(process):
    {statement}


def test_{name}_is_restored(process):
    assert [part for part in read_process_state()[:-1] if part not in process] == []
"""


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the output of a run of pytest with tests that leave the process changed or unchanged."""
    folder = tmp_path_factory.mktemp("changes")
    (folder / "conftest.py").write_text(CONFTEST)
    tests = [TEST.format(name=name, statement=statement) for name, (statement, _) in CHANGES.items()]
    (folder / "test_changes.py").write_text("".join([MODULE, *tests, UNCHANGED]))
    environment = {**os.environ, "PYTHONPATH": python_path(ROOT / "test")}
    options = ["-p", "process_state_plugin", "-p", "no:cacheprovider", "-p", "no:xdist", "-rA"]
    command = [sys.executable, "-m", "pytest", *options, str(folder)]
    return subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True).stdout


@pytest.mark.parametrize("name", CHANGES)
def test_change_is_an_error_and_restored(output: str, name: str) -> None:
    place = rf"test_changes\.py::test_{name}"
    message = "the test leaves the process changed: a test restores what it changes:"
    assert re.search(rf"^{place}: {message}\n  {CHANGES[name][1]}\n(?!  )", output, re.MULTILINE), output
    assert re.search(rf"^PASSED {place}_is_restored$", output, re.MULTILINE), output


def test_tests_without_change_pass(output: str) -> None:
    count = 2 * len(CHANGES) + 7
    assert re.search(rf"= {count} passed, {len(CHANGES)} errors in ", output), output
