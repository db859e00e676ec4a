"""Fixture of the tests of benchmarks."""

import importlib
import sys
from pathlib import Path
from typing import Any, Iterator

import pytest

from retalis.foundation.garbage_collection import stop_limiting_gc_pauses

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("curves", "engine", "offline", "performance", "processes", "workload")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the function that imports the module of a benchmark."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "bench"), str(ROOT / "examples" / "nao"), *sys.path])
    yield importlib.import_module
    for name in MODULES:
        sys.modules.pop(name, None)
    stop_limiting_gc_pauses()  # the benchmark limits them
