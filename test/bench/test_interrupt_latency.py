"""Response of the commands to Ctrl-C: the cases of the benchmark."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

_path = list(sys.path)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "bench"))
interrupt_latency = importlib.import_module("interrupt_latency")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

COMMON_LOOPS = [
    f"{command}_{loop}" for command in ("events", "bag") for loop in interrupt_latency.LOOPS if loop != "goal"
]
"""Cases with a loop that the console has as well: all commands have one handler of signals."""

MAX_RESPONSE_SECONDS = 20
"""Far above the time that the benchmark measures, for a machine that is busy."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interrupts")
    interrupt_latency.make_files(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly if name in COMMON_LOOPS else ())
        for name in interrupt_latency.CASES
    ],
)
def test_interrupt_ends_command(name: Any, folder: Path) -> None:
    seconds, status, errors = interrupt_latency.measure(interrupt_latency.CASES[name], folder)
    assert (status, errors) == (130, "")
    assert seconds < MAX_RESPONSE_SECONDS
