"""Response of the commands to Ctrl-C: the cases of the benchmark."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

_path = list(sys.path)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "bench"))
interrupts = importlib.import_module("interrupts")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

MAX_RESPONSE_SECONDS = 20
"""Far above the time that the benchmark measures, for a machine that is busy."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interrupts")
    interrupts.make_files(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", interrupts.CASES)
def test_interrupt_ends_command(name: Any, folder: Path) -> None:
    seconds, status, errors = interrupts.measure(interrupts.CASES[name], folder)
    assert (status, errors) == (130, "")
    assert seconds < MAX_RESPONSE_SECONDS
